"""Checkpoints: the full state of a run in a folder, to resume on any number of processes.

    state.json        the `SceneState` as data, the load steps, and digests of all files to detect
                      accidental changes
    positions.npy     stress-free vertices, to recognise the mesh
    membrane.u.npy, loads.loads.0.forces.npy ...
                      the state's arrays on the mesh, named by the path of fields that leads to
                      them; rows follow the vertices, edges or cells of the mesh as given

The first rank holds one whole array at a time. Numbers keep every digit, and reading executes no
code. See `Solver.save` and `Solver.load`. `journal` checkpoints all calls of `Solver.advance`, for
scripts that are started again.
"""

from crms_fenicsx.results.checkpoint.saving import Run, load, save

__all__ = ["Run", "load", "save"]
