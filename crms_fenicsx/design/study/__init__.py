"""Studies of a roof built by a function: error bars, adapted meshes, load combinations.

All of them call ``build(mesh)``, which makes scene and solver on a mesh, applies the loads and
returns the solver.
"""

from crms_fenicsx.design.study.adaptivity import adapt, marked_cells
from crms_fenicsx.design.study.convergence import Convergence, Quantity, convergence
from crms_fenicsx.design.study.governing import combine_governing
from crms_fenicsx.design.study.groups import combine_in_groups

__all__ = [
    "Convergence",
    "Quantity",
    "adapt",
    "combine_governing",
    "combine_in_groups",
    "convergence",
    "marked_cells",
]
