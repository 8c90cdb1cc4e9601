"""Studies of a roof by a function that builds it: error bars, adapted meshes, load combinations.

One idiom serves all of them: ``build(mesh)`` makes scene and solver on a mesh, brings the loads on
and returns the solver.
"""

from crms_fenicsx.study.adaptivity import adapt, marked_cells
from crms_fenicsx.study.convergence import Convergence, convergence
from crms_fenicsx.study.groups import combine_in_groups
from crms_fenicsx.study.values import Quantity

__all__ = ["Convergence", "Quantity", "adapt", "combine_in_groups", "convergence", "marked_cells"]
