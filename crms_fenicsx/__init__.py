"""Cable-reinforced membrane structures with foldable finite elements on FEniCSx.

A load step passes through the packages in one direction: `solver` and `steps` (loads) ->
`equilibrium` (iterations, potential of a `scene`) -> `energies` (terms of the potential) ->
`minimization` (its minimum) -> `verification`, `results`, `output` and `checkpoint`.
"""

from mpi4py import MPI as _MPI  # noqa: F401  # before DOLFINx: wheels of PyPI count on its library

from crms_fenicsx import meshes
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.taylor import TaylorRates, taylor_test
from crms_fenicsx.model.bar import Bar, Joint, MeshVertex, PlacedBar
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import IsotropicMembrane, OrthotropicMembrane
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.runtime.errors import (
    ConvergenceError,
    DoubtWarning,
    FrictionWarning,
    InputError,
    InstabilityWarning,
    MeshError,
    NetWarning,
    PathError,
    PathWarning,
    PatternWarning,
    PenaltyWarning,
    PictureWarning,
    PondWarning,
    SnapThroughWarning,
    show_warnings,
)
from crms_fenicsx.scene import Scene
from crms_fenicsx.solver import Solver
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.steps.movements import Rotation

show_warnings()
del show_warnings

__version__ = "0.2.0"
__all__ = [
    "Bar",
    "Cable",
    "ConvergenceError",
    "DoubtWarning",
    "EnergyTerm",
    "FanControl",
    "Friction",
    "FrictionWarning",
    "InputError",
    "InstabilityWarning",
    "IsotropicMembrane",
    "Joint",
    "LaidCable",
    "MeshError",
    "MeshVertex",
    "NetWarning",
    "OrthotropicMembrane",
    "PathError",
    "PathWarning",
    "PatternWarning",
    "PenaltyWarning",
    "PictureWarning",
    "PlacedBar",
    "PondWarning",
    "Rotation",
    "Scene",
    "SnapThroughWarning",
    "Solver",
    "Step",
    "TaylorRates",
    "UflMembrane",
    "meshes",
    "taylor_test",
]
