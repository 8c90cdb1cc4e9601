"""Cable-reinforced membrane structures with foldable finite elements on FEniCSx.

Each package imports from those before it only: `foundation` (meshes, unknowns), `model` (parts of a
scene), `energy` (terms of the potential and its minimum), `cabling` (cables on the membrane),
`analysis` (load steps of a scene), `results` (values, files, pictures), `solver`, and `design`
(forms, nets, loads by code, patterns). A load step begins in `solver` and goes down.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from mpi4py import MPI as _MPI  # noqa: F401  # before DOLFINx: wheels of PyPI count on its library

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.movements import Rotation
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.energy.minimization.taylor import TaylorRates, taylor_test
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation import meshes
from crms_fenicsx.foundation.runtime.errors import (
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
from crms_fenicsx.model.bar import Bar, Joint, MeshVertex, PlacedBar
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import IsotropicMembrane, OrthotropicMembrane
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.solver import Solver

if TYPE_CHECKING:
    from crms_fenicsx.design import codes, exchange, form_finding, nets, patterns, study
    from crms_fenicsx.results import output

    __version__: str

show_warnings()
del show_warnings

_RELEASE = "0.3.0"
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
    "codes",
    "exchange",
    "form_finding",
    "meshes",
    "nets",
    "output",
    "patterns",
    "study",
    "taylor_test",
]


def __getattr__(name: str) -> object:
    """The version, and the packages that most scripts do without, imported at the first access."""
    if name == "__version__":
        return _version()
    if name == "output":
        return import_module("crms_fenicsx.results.output")
    if name in {"codes", "exchange", "form_finding", "nets", "patterns", "study"}:
        return import_module(f"crms_fenicsx.design.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _version() -> str:
    """The release with the commit of the clone, or of that which `setup.py` built from, and
    ".dirty" if files differ: "0.3.0+g1a2b3c4d"."""
    import os
    import subprocess
    from pathlib import Path

    clone, built = Path(__file__).parents[1], Path(__file__).with_name("COMMIT")
    if not (clone / ".git").exists():
        commit = built.read_text().strip() if built.exists() else ""
    elif not (commit := os.environ.get("CRMS_COMMIT", "")):  # from `run`, which hides git
        describe = ["git", "describe", "--always", "--dirty", "--exclude=*", "--abbrev=8"]
        try:
            done = subprocess.run(describe, cwd=clone, capture_output=True, text=True, check=False)
        except OSError:
            return _RELEASE
        commit = done.stdout.strip()
    return f"{_RELEASE}+g{commit.replace('-', '.')}" if commit else _RELEASE
