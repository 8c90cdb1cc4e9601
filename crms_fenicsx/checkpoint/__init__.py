"""Checkpoints: the whole state of a run in a folder, to go on from on any number of processes.

    state.json        the `SceneState` as data, the load steps, and digests of all files, by which
                      accidental changes are told
    positions.npy     where the vertices are when stress-free, to tell other meshes
    membrane.u.npy, loads.loads.0.forces.npy ...
                      the state's arrays on the mesh, by the names of the fields that lead to them;
                      their rows are the vertices, edges or cells in the mesh as it was given

The first rank has one whole array at a time. Numbers survive to the last digit, and nothing that is
read is executed. See `Solver.save` and `Solver.load`. `journal` keeps checkpoints of all calls of
`Solver.advance`, for scripts that are started again.
"""

from crms_fenicsx.checkpoint.contents import Run
from crms_fenicsx.checkpoint.saving import load, save

__all__ = ["Run", "load", "save"]
