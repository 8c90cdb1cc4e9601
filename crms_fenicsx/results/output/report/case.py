"""A load case in the report: its extremes, checks and pictures."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.foundations import Foundations, foundations
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.output.figures.draw_scene import (
    QUANTITY_OF,
    SIGNED,
    draw,
    label_of,
)
from crms_fenicsx.results.output.report.page import Figure, Units, Verdict, number, per_cent, place
from crms_fenicsx.results.output.report.pdf_and_views import interactive_view
from crms_fenicsx.results.quantities import HasSystem
from crms_fenicsx.results.summary import SUMMED_UP, Summary, held_groups, summary

SHARPEST = 150
"""Largest resolution of pictures (pixels per inch), for up to 20 of them."""


Corner = tuple[float, ...]


@dataclass(frozen=True)
class Case:
    """A load case as shown in a report; plain data, to be sent between processes."""

    name: str  # of the combination
    summary: Summary  # extremes
    # checks of this state; None if not verified in this run
    verification: Verification | None
    foundations: Foundations  # forces on foundations
    change: ShapeChange  # since the base state
    # largest smoothed cell values, by part and quantity but the utilisation
    recovered: Mapping[str, Mapping[str, float]]
    # corners of the bounding box of membrane, cables and bars (length)
    low: Corner
    high: Corner
    # on the first rank: pictures, and the interactive page
    pictures: tuple[Figure, ...] = ()
    view: str = ""


def case_of(solver: HasSystem, name: str, before: Shape) -> Case:
    """Record the current state of a solver's scene, which had the shape `before`. Collective."""
    system = solver.system
    found, scene, comm = summary(system), system.scene, solver.comm
    places = np.concatenate([scene.positions(), *(cable.line for cable in scene.cables),
                             *(bar.points for bar in scene.bars)])  # fmt: skip
    settled = scene.versions.current.equilibrium
    checked = settled.verification if settled is not None and found.in_equilibrium else None
    groups = {key: dofs for key, (_, dofs) in held_groups(scene.membrane).items()}
    return Case(
        name, found, checked, foundations(system, groups), shape_change(before, scene),
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


def with_pictures(
    solver: HasSystem, case: Case, every: Sequence[Case], colours: Sequence[str], look: Any
) -> Case:
    """The case with pictures of the solver's current state. Collective."""
    common = _common(every)
    options = {"box": common[0], "line_limits": common[1], **look}
    if common[1] is not None and common[1][0] < 0.0:
        options.setdefault("line_colours", SIGNED)
    count = max(len(every) * len(colours), 1)
    dpi = int(np.clip(SHARPEST * math.sqrt(20 / count), 70, SHARPEST))
    pictures = []
    for colour in colours:  # one colour bar per picture, to leave room for the shape
        fabric = None if colour == TENSION else colour
        forces = QUANTITY_OF.get(colour) in SUMMED_UP and colour not in ("strain", "utilisation")
        options |= {
            "colour": fabric, "tensions": fabric is None, "ghost": colour == "displacement",
            "directions": forces, "loose": "lifted" if fabric is None else None,
        }  # fmt: skip
        png = draw_png(solver, dpi=dpi, limits=_limits(every, colour), **options)
        if png:
            label = LINES if fabric is None else label_of(colour)[0]
            label += "; strokes: larger principal force" if forces else ""
            pictures.append(Figure(png, f"{case.name}: {label}"))
    return replace(case, pictures=tuple(pictures))


def with_view(
    solver: HasSystem, case: Case, every: Sequence[Case], colours: Sequence[str], units: Units
) -> Case:
    """The case with an interactive page of the solver's current state. Collective."""
    known = (one for one in colours if QUANTITY_OF.get(one) in SUMMED_UP)
    colour = next(known, "stress")
    limits = {"membrane": _limits(every, colour), "lines": _common(every)[1]}
    labels = units[label_of(colour)[1]], units["force"]
    return replace(case, view=interactive_view(solver, case.name, colour, limits, labels))


def draw_png(solver: HasSystem, **options: Any) -> bytes:
    """PNG of a scene as bytes, on the first rank; empty if the scene is too large. Collective."""
    comm, buffer = solver.comm, io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(comm.bcast(folder)) / "picture.png"
        draw(solver, path, width=6.0, **options)
        comm.barrier()
        if comm.rank == 0 and path.exists():
            from PIL import Image

            with Image.open(path) as picture:  # 256 colours take a third of the space
                # not the default, "median cut", which replaces the ends of colour bars
                reduced = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
                reduced.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _common(every: Sequence[Case]) -> tuple[tuple[Array, Array], tuple[float, float] | None]:
    """Box and force range common to all cases; no range without forces."""
    low = np.min([case.low for case in every], axis=0)
    high = np.max([case.high for case in every], axis=0)
    air = 0.03 * float((high - low).max())
    box = low - np.array([air, air, 0.0]), high + np.array([air, air, air / 2])
    forces = [0.0]
    for case in every:
        forces += [one.largest for one in case.summary.cables.values()]
        forces += [one.force for one in case.summary.bars.values()]
    low, high = min(forces), max(forces)
    if low < 0.0:  # symmetric, as the colours of compression and tension
        low, high = min(low, -high), max(-low, high)
    return box, (low, high) if any(forces) else None


TENSION, LINES = "tension", "axial forces of cables and bars"
"""Name and caption of the picture of axial forces on plain fabric."""


def _limits(every: Sequence[Case], colour: str) -> tuple[float, float] | None:
    """Range of a colour over all cases; None if unknown."""
    if colour == "displacement":
        return 0.0, max(case.summary.displacement.value for case in every) or 1.0
    name, parts = QUANTITY_OF.get(colour), [case.summary.membrane for case in every]
    if name not in SUMMED_UP:
        return None
    low = min(part.least[name].value for part in parts if name in part.least)
    high = max(part.largest[name].value for part in parts if name in part.largest)
    low = 0.0 if low > -1e-9 * high else low
    return (low, max(high, 0.0)) if low < high else None


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
            "the roof is to be checked for ponding."
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
    summary, checked, change = case.summary, case.verification, case.change
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
    if change.volume is not None and change.volume < 0.0:
        yield "the roof has turned inside out: it lies on the other side of its supports."
    elif change.volume is not None and change.volume < 0.5:
        yield f"the roof has collapsed: of its inner volume {per_cent(change.volume)} are left."
    elif change.turned > 0.01:
        yield f"{per_cent(change.turned)} of the membrane have turned over."


def _excess(case: Case, limit: float, strengths: Mapping[str, float]) -> Iterator[str]:
    """Strains, cables and bars beyond their limits."""
    strain = case.summary.membrane.largest["strain 1"].value
    if strain > limit:
        yield f"the membrane is strained to {per_cent(strain)}, limit {per_cent(limit)}."
    for name, cable in case.summary.cables.items():
        if cable.largest > strengths.get(name, math.inf):
            share = cable.largest / strengths[name]
            yield f"the cable {name} is used to {per_cent(share)} of its strength."
    for name, bar in case.summary.bars.items():
        if bar.utilisation is not None and bar.utilisation > 1.0:
            how = "tension" if bar.force > 0.0 else "compression"
            yield f"the bar {name} is used to {per_cent(bar.utilisation)} in {how}."


def _used_fabric(case: Case, size: float) -> Iterator[str]:
    """Parts of the membrane beyond their strengths."""
    parts = case.summary.parts
    for name, part in parts.items():
        one = part.largest.get("utilisation")
        if one is not None and one.value > 1.0 and (name or len(parts) == 1):
            of = f"its part {name}" if name else "the membrane"
            yield (
                f"{of} is used to {per_cent(one.value)} of its strength at x; y; z = "
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
        f"{name}: the membrane is used to {per_cent(value)} of its strength; finer cells may "
        f"change this by {per_cent(change)}"
    )
    near = value <= 1.0 < most
    return [f"{text}, and are needed there to tell." if near else f"{text}."], near


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


@dataclass(frozen=True)
class ShapeChange:
    """Change of a shape."""

    # volume between roof and rim, relative to that before; None if the roof enclosed none
    volume: float | None
    turned: float  # share of the former area turned by more than 90 degrees


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


def shape_change(before: Shape, scene: Scene) -> ShapeChange:
    """Change since an earlier shape. Collective."""
    now = shape_of(scene, before.apex)
    turned = np.einsum("mi,mi->m", before.vectors, now.vectors) < 0.0
    share = scene.comm.allreduce(float(norm(before.vectors)[turned].sum())) / before.area
    encloses = abs(before.volume) > 0.02 * before.area**1.5
    return ShapeChange(now.volume / before.volume if encloses else None, share)
