"""Load combinations shared out to groups of processes, each with its own scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from crms_fenicsx.analysis.steps.load_cases import checked_combinations
from crms_fenicsx.design.study.values import Build, built
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, redistributed
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Count, File, collective
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.combination_table import CombinationTable

if TYPE_CHECKING:
    from crms_fenicsx.results.output.report.case import Case


@collective
def combine_in_groups(
    build: Build,
    mesh: MembraneMesh,
    combinations: Mapping[str, Mapping[str, float]],
    *,
    groups: Count,
    steps: Count = 1,
    report: File | None = None,
    **options: Any,
) -> dict[str, Case]:
    """Solve combinations of loads in groups of processes side by side. Collective.

    One scene of moderate size gains little from more processes, many combinations gain much. Each
    group builds the scene on its own copy of the mesh and takes every `groups`-th combination.

    Parameters
    ----------
    build
        Function of a mesh that makes scene and solver and returns the solver in the base state,
        the same in all groups. Give the solver no folder for results, which cannot be shared.
    mesh
        The mesh, on all processes.
    combinations, steps
        As for `Solver.combine`.
    groups
        Number of groups, at most that of processes.
    report
        File for a report on all combinations, as for `Solver.report`; None writes none.
    **options
        Options of `Solver.report`: ``title``, ``unit``, ``force``, ``pictures`` ...

    Returns
    -------
    dict
        A `Case` with ``summary`` and ``verification`` for each combination, in their order, the
        same on all processes.

    Raises
    ------
    InputError
        On all processes, before any combination is solved: an invalid combination, more groups
        than processes, a `build` that returns no solver, or a report that cannot be written.
    ConvergenceError
        On all processes: a combination without equilibrium, which is named.

    Examples
    --------
    >>> def build(mesh):
    ...     scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    ...     scene.fix("boundary")
    ...     scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
    ...     solver = Solver(scene)
    ...     solver.advance(pressure=0.7)
    ...     return solver
    >>> mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=20.0, height=10.0, size=1.0)
    >>> found = study.combine_in_groups(build, mesh, table, groups=4, report="dome.html")
    >>> max(found, key=lambda name: found[name].summary.membrane.largest["warp"].value)
    """
    from crms_fenicsx.results.output.report.case import BASE
    from crms_fenicsx.results.output.report.reporting import (
        checked_plan,
        drawn,
        model_of,
        results_of,
        write_files,
    )

    comm = mesh.comm
    if groups > comm.size:
        raise InputError(
            f"combine_in_groups: groups = {groups} is more than the {comm.size} processes; use "
            "fewer groups, or start more processes."
        )
    if report is None and options:
        raise InputError(
            f"combine_in_groups: {sorted(options)} are options of a report; set report= to a file."
        )
    number = comm.rank * groups // comm.size
    own: Any = comm.Split(number, comm.rank)
    copy = redistributed(mesh, own)
    with raised_together(comm):
        solver = built("combine_in_groups", build, copy)
        checked_combinations(solver.scene, combinations)
    table = combinations if isinstance(combinations, CombinationTable) else None
    scene, combinations = solver.scene, checks.in_one_order(comm, combinations)
    checks.same(
        comm, "combine_in_groups: build", cells=scene.mesh.mesh.topology.index_map(2).size_global,
        cables=[cable.name for cable in scene.cables], loads=[load.name for load in scene.loads],
    )  # fmt: skip
    plan = None if report is None else checked_plan(comm, scene, report, **options)
    mine = {name: combinations[name] for name in list(combinations)[number::groups]}
    with raised_together(comm):
        states = solver.combine(mine, steps=steps) if mine else {}
        states = {name: replace(one, table=table) for name, one in states.items()}
        cases = results_of(solver, states) if mine else []
    every = _joined(comm, own, cases, [BASE, *combinations])
    if plan is not None:
        with raised_together(comm):
            shown = drawn(solver, plan, states, cases, list(every.values())) if mine else []
        pictured = _joined(comm, own, shown, [BASE, *combinations])
        with raised_together(comm):
            if number == 0:
                write_files(solver, plan, model_of(solver, plan, states), list(pictured.values()))
    del solver, scene, states, copy
    own.Free()
    return {name: every[name] for name in combinations}


def _joined(
    comm: MPI.Intracomm, own: MPI.Intracomm, cases: list[Case], names: list[str]
) -> dict[str, Case]:
    """All groups' cases in the order of `names`, pictures on the first process. Collective."""
    sent = cases if own.rank == 0 else []
    plain = comm.allgather([replace(case, pictures=(), view="") for case in sent])
    found = {case.name: case for part in plain for case in part}
    for part in comm.gather(sent) or []:
        found |= {case.name: case for case in part}
    return {name: found[name] for name in names if name in found}
