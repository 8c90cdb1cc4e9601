"""A load case in the report: its extremes, checks and pictures."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.foundations import Foundations, foundations
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.output.figures.draw_scene import (
    QUANTITY_OF,
    SIGNED,
    HasSystem,
    draw,
    label_of,
)
from crms_fenicsx.results.output.report.interactive import interactive_view
from crms_fenicsx.results.output.report.page import Figure
from crms_fenicsx.results.output.report.units import Units
from crms_fenicsx.results.shape_change import Shape, ShapeChange, shape_change
from crms_fenicsx.results.summary import SUMMED_UP, Summary, held_groups, summary

SHARPEST, COARSEST, MANY = 150, 70, 20
"""Resolution of pictures (pixels per inch): largest, up to MANY pictures, and smallest."""
WIDTH = 6.0
"""Width of a picture (inches)."""


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
    dpi = int(np.clip(SHARPEST * math.sqrt(MANY / count), COARSEST, SHARPEST))
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
        draw(solver, path, width=WIDTH, **options)
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
