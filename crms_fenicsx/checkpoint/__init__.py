"""Checkpoints: the whole state of a run in a folder, to go on from on any number of processes.

    state.json          loads, cables, history: what is small and the same on all ranks; digests of
                        itself and the other files, by which accidental changes are told
    displacement.npy    rows by the vertices' ids, that is numbers in the mesh as it was given
    held.npy            held components, by the same ids
    held_edges.npy      ids of the ends of the edges that are held over their whole length
    positions.npy       where the vertices are when stress-free, to tell other meshes
    forces_1.npy, ...   nodal forces of the loads on the membrane, in their order
    suction_1.npy, ...  force per area of the cells, of loads that follow the surface
    stage_1.npy, ...    displacements of states in which cables, loads or bars were put on the scene
    cells.npy           state of the cells at the step's start, with the paper's incremental strain

The first rank has one whole field at a time. Numbers survive to the last digit, and nothing that is
read is executed. See `Solver.save` and `Solver.load`. `journal` keeps checkpoints of all calls of
`Solver.advance`, for scripts that are started again.
"""

from crms_fenicsx.checkpoint.contents import Run
from crms_fenicsx.checkpoint.saving import load, save

__all__ = ["Run", "load", "save"]
