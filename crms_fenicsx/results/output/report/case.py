"""A load case in the report: its extremes, checks and change of shape, and the verdict on all."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.strengths import SERVICE
from crms_fenicsx.results.foundations import Foundations, foundations
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.output.report.page import Figure, Verdict, number, per_cent, place
from crms_fenicsx.results.quantities import Solved
from crms_fenicsx.results.summary import Summary, summary

Corner = tuple[float, ...]


@dataclass(frozen=True)
class Case:
    """A load case as shown in a report; plain data, to be sent between processes."""

    name: str  # of the combination
    summary: Summary  # extremes
    # checks of this state; None if not verified in this run
    verification: Verification | None
    foundations: Foundations  # forces on foundations
    # since the base state: volume between roof and rim, relative to that before, None if the roof
    # enclosed none; share of the former area turned by more than 90 degrees
    volume: float | None
    turned: float
    # largest smoothed cell values, by part and quantity but the utilisation
    recovered: Mapping[str, Mapping[str, float]]
    # corners of the bounding box of membrane, cables and bars (length)
    low: Corner
    high: Corner
    # on the first rank: pictures, and the interactive page
    pictures: tuple[Figure, ...] = ()
    view: str = ""


def case_of(solver: Solved, name: str, before: Shape) -> Case:
    """Record the current state of a solver's scene, which had the shape `before`. Collective."""
    system = solver.system
    found, scene, comm = summary(system), system.scene, solver.comm
    places = np.concatenate([scene.positions(), *(cable.line for cable in scene.cables),
                             *(bar.points for bar in scene.bars)])  # fmt: skip
    settled = scene.versions.current.equilibrium
    checked = settled.verification if settled is not None and found.in_equilibrium else None
    return Case(
        name, found, checked, foundations(system), *_shape_change(before, scene),
        recovered(membrane_results(system), found), *box(comm, places),
    )  # fmt: skip


def recovered(results: MembraneResults, found: Summary) -> dict[str, dict[str, float]]:
    """Largest smoothed cell values, by part and quantity but the utilisation. Collective.

    A smoothed cell value is the mean of its vertices' values, which are means over the adjacent
    cells.
    """
    values: dict[str, dict[str, float]] = {part: {} for part in found.parts}
    for name in sorted(found.membrane.largest.keys() - {"utilisation"}):
        nodal = results.function(name, smooth=True)
        at = nodal.x.array[nodal.function_space.dofmap.list[: len(results.state)]].mean(axis=1)
        for part in found.parts:
            own = at[results.parts[part]] if part else at
            most = float(np.max(own[np.isfinite(own)], initial=-np.inf))
            values[part][name] = results.comm.allreduce(most, op=MPI.MAX)
    return values


def box(comm: MPI.Intracomm, places: Array) -> tuple[Corner, Corner]:
    """Lowest and highest corner of the bounding box of all ranks' places (n, 3). Collective."""
    high = [comm.allreduce(float(x.max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    low = [-comm.allreduce(float((-x).max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    return tuple(low), tuple(high)


def verdict_on(
    cases: Sequence[Case], size: float, strain: float, cables: Mapping[str, float]
) -> Verdict:
    """The verdict, with all objections to the structure or its results: limits are the larger
    principal strain and the strengths of cables, by name."""
    reasons, count = [], f"All {len(cases)} combinations" if len(cases) > 1 else "The state"
    for case in cases:
        found = *_doubts(case), *_excess(case, strain, cables), *_used_fabric(case, size)
        reasons += [f"{case.name}: {reason}" for reason in found]
    wet = [case for case in cases if case.summary.hollows]
    rain = []
    if wet:
        most = max(wet, key=lambda case: case.summary.hollows[0].depth)
        deepest = most.summary.hollows[0]
        rain.append(
            f"Rain would stand in {len(wet)} of {len(cases)} combinations, up to "
            f"{number(deepest.depth)} deep at x; y; z = {place(deepest.at, size)} ({most.name}): "
            "check the roof for ponding."
        )
    told, (refined, coarse) = [*_reinforced(cases), *rain], _refined(cases)
    missing = [case.name for case in cases if case.summary.in_equilibrium and not case.verification]
    if reasons:
        moved = [case.name for case in cases if not case.summary.in_equilibrium]
        text = f"Not in equilibrium: {', '.join(moved)}" if moved else (
            "Not acceptable as it stands, for the reasons below"
        )  # fmt: skip
        return Verdict(text, [*reasons, *told], "failed")
    if missing:
        return Verdict(f"Not verified in this run: {', '.join(missing)}", told, "doubtful")
    used = any("utilisation" in case.summary.membrane.largest for case in cases)
    what = "no strain or utilisation" if used else "no strain"
    text = f"Verified: {count[:1].lower() + count[1:]} passed all checks of equilibrium, and {what}"
    notes = [] if used else [
        "Strengths of the membrane were not given: its utilisation is not checked."
    ]  # fmt: skip
    bars = [bar for case in cases for bar in case.summary.bars.values()]
    unchecked = dict.fromkeys(x.name for x in bars if x.force < 0.0 and x.utilisation is None)
    if unchecked:
        notes.append(
            "Buckling is not checked, as no curve was given, of bars in compression: "
            f"{', '.join(unchecked)}."
        )
    look = "doubtful" if wet or coarse else ""
    return Verdict(f"{text} is beyond its limit", (*notes, *refined, *told), look)


def _doubts(case: Case) -> Iterator[str]:
    """Reasons why a state is unusable."""
    summary, checked, volume = case.summary, case.verification, case.volume
    if not summary.in_equilibrium:
        yield "the scene has been changed since its last load step, or there was none."
    for one in () if checked is None else checked.failed:
        where = f"{one.name} at {one.where}" if one.where else one.name
        yield (
            f"no verified equilibrium: the check of {where} is {one.value:.2g}, its limit "
            f"{one.limit:.2g}."
        )
    for warning in summary.warnings:
        yield f"{warning}."
    if volume is not None and volume < 0.0:
        yield "the roof has turned inside out: it lies on the other side of its supports."
    elif volume is not None and volume < 0.5:
        yield f"the roof has collapsed: {per_cent(volume)} of its inner volume is left."
    elif case.turned > 0.01:
        yield f"{per_cent(case.turned)} of the membrane has turned over."


def _excess(case: Case, limit: float, strengths: Mapping[str, float]) -> Iterator[str]:
    """Strains, cables and bars beyond their limits."""
    strain = case.summary.membrane.largest["strain 1"].value
    if strain > limit:
        yield f"the membrane is strained to {per_cent(strain)}, limit {per_cent(limit)}."
    for check in case.summary.checks:
        if not check.passed and check.what in ("deflection", "prestress", "slope", "ponding"):
            yield f"{check!r}."
    for name, cable in case.summary.cables.items():
        if cable.largest > strengths.get(name, math.inf) and case.summary.state not in SERVICE:
            share = cable.largest / strengths[name]
            yield f"the cable {name} is loaded to {per_cent(share)} of its strength."
    for name, bar in case.summary.bars.items():
        if bar.utilisation is not None and bar.utilisation > 1.0:
            how = "tension" if bar.force > 0.0 else "compression"
            yield f"the bar {name} is loaded to {per_cent(bar.utilisation)} in {how}."


def _used_fabric(case: Case, size: float) -> Iterator[str]:
    """Parts of the membrane beyond their strengths."""
    parts = case.summary.parts
    for name, part in parts.items():
        one = part.largest.get("utilisation")
        if one is not None and one.value > 1.0 and (name or len(parts) == 1):
            of = f"its part {name}" if name else "the membrane"
            yield (
                f"{of} is loaded to {per_cent(one.value)} of its strength at x; y; z = "
                f"{place(one.at, size)}; finer cells may change this by "
                f"{per_cent(part.change or 0.0)}."
            )


def _refined(cases: Sequence[Case]) -> tuple[list[str], bool]:
    """Note on what finer cells may change of the largest utilisation, and whether it may then be
    above 1."""
    found = [
        (one.value * (1.0 + (part.change or 0.0)), one.value, case.name, part.change or 0.0)
        for case in cases for part in case.summary.parts.values()
        if (one := part.largest.get("utilisation")) is not None
    ]  # fmt: skip
    if not found:
        return [], False
    most, value, name, change = max(found)
    text = (
        f"{name}: the membrane is loaded to {per_cent(value)} of its strength; finer cells may "
        f"change this by {per_cent(change)}"
    )
    near = value <= 1.0 < most
    return [f"{text}; refine the mesh there to judge it." if near else f"{text}."], near


def _reinforced(cases: Sequence[Case]) -> list[str]:
    """Note on the corners where plain fabric is not judged."""
    every = {name: one.patch for case in cases for name, one in case.summary.patches.items()}
    if not every:
        return []
    radii = [patch.radius for patch in every.values()]
    span = number(min(radii))
    if number(max(radii)) != span:
        span += f" to {number(max(radii))}"
    assumed = [name for name, patch in every.items() if not patch.given]
    most, name, where = max(
        (one.utilisation, case.name, corner)
        for case in cases for corner, one in case.summary.patches.items()
    )  # fmt: skip
    text = (
        f"Corners to be reinforced ({', '.join(every)}): within a radius of {span} the plain "
        "fabric is not judged, as its utilisation depends on the mesh there; on this one it is "
        f"{per_cent(most)} ({where}, {name})."
    )
    if assumed:
        text += (
            " Radii that were not given are a twentieth of the distance to the next corner: "
            f"{', '.join(assumed)}."
        )
    return [text]


@dataclass(frozen=True)
class Shape:
    """Shape of this rank's cells in a state of a scene."""

    apex: Array  # (3,) mean of the held vertices in the first state (length)
    vectors: Array  # (m, 3) areas times unit normals (length squared)
    volume: float  # between the cells and the apex: the cone over the rim (length cubed)
    area: float  # of the cells (length squared)


def shape_of(scene: Scene, apex: Array | None = None) -> Shape:
    """Present shape and volume, about the held vertices' mean or a given apex. Collective."""
    comm, own = scene.comm, scene.mesh.mesh.topology.index_map(2).size_local
    places, n = scene.positions(), scene.V.dofmap.index_map.size_local
    if apex is None:
        held = scene.held[:n].any(axis=1)
        held = held if comm.allreduce(int(held.sum())) else np.ones(n, dtype=bool)
        apex = comm.allreduce(places[:n][held].sum(axis=0)) / comm.allreduce(int(held.sum()))
    corners = places[scene.V.dofmap.list[:own]]
    vectors = double_areas(corners) / 2
    volume = float(((corners.mean(axis=1) - apex) * vectors).sum()) / 3
    volume, area = comm.allreduce(np.array([volume, norm(vectors).sum()])).tolist()
    return Shape(apex, vectors, volume, area)


def _shape_change(before: Shape, scene: Scene) -> tuple[float | None, float]:
    """`Case.volume` and `Case.turned` since an earlier shape. Collective."""
    now = shape_of(scene, before.apex)
    turned = np.einsum("mi,mi->m", before.vectors, now.vectors) < 0.0
    share = scene.comm.allreduce(float(norm(before.vectors)[turned].sum())) / before.area
    encloses = abs(before.volume) > 0.02 * before.area**1.5
    return (now.volume / before.volume if encloses else None), share
