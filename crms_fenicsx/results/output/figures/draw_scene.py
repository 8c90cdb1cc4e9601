"""Draw a scene, or paths over its mesh, by one call on all ranks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.meshes.triangles import double_areas
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import PerRank, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, PictureWarning, raised_together
from crms_fenicsx.results.foundations import held_rim
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.output.figures.axes3d import FLAT, with_unit
from crms_fenicsx.results.output.figures.draw_paths import draw_path
from crms_fenicsx.results.output.figures.draw_surface import draw_shape, sides_among
from crms_fenicsx.results.output.figures.plots import units_of_results
from crms_fenicsx.results.quantities import (
    QUANTITIES,
    QUANTITY_OF,
    Solved,
    load_directions,
    load_label,
    load_values,
)
from crms_fenicsx.results.reactions import gap, held_ends
from crms_fenicsx.results.recovered_values import at_facets, judged_utilisation, patches, recovered
from crms_fenicsx.results.view_data import (
    Line,
    Surface,
    bar_lines,
    cable_lines,
    held_places,
    point_homes,
    surface_piece,
    whole_surface,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CELLS = 500_000
"""Largest number of cells drawn: the first process needs 20 s and 0.7 GB for a million, more than a
picture can show."""

MOST_STROKES = 12
"""Number of principal directions drawn along the size of a surface."""

SIGNED = "RdYlBu_r"
"""Colour map of tension and compression."""


COLOURS = ("height", "displacement", *QUANTITY_OF)
"""Colours of the membrane that `draw` accepts."""


LEVELS = 6
"""Number of colours of loads."""

LOAD = "load "
"""Prefix of the colours of loads, before the load's name."""


def label_of(colour: str) -> tuple[str, str]:
    """Label of a colour, and the kind of its unit."""
    if colour == "displacement":
        return "deflection", "length"
    if colour not in QUANTITY_OF:
        return colour, "length"
    one = QUANTITIES[QUANTITY_OF[colour]]
    return one.label, one.unit


@collective
def draw(
    solver: Solved,
    filename: str | Path | None = None,
    *,
    colour: str | None = None,
    unit: str = "",
    force: str = "",
    ghost: bool = False,
    tensions: bool = True,
    directions: bool = False,
    **options: Any,
) -> Figure | None:
    """Draw the current state of a solver's scene, with forces of cables and bars. Collective.

    Cables are striped where off the membrane; compression of bars is negative and blue. Held edges
    are thick lines, other supports triangles on the ground. Colours begin at 0, except heights;
    for comparable pictures pass the same ``limits`` and ``line_limits``.

    Parameters
    ----------
    solver
        `Solver` of the scene.
    filename
        Picture file (.png, .pdf, .svg ...); None returns the figure.
    colour
        Colour of the membrane: "height" (z), "displacement", "stress" and "stress 2" (larger and
        minor principal true section force), "warp", "weft" and "shear" (true section forces;
        not of isotropic membranes),
        "strain" (major principal Green-Lagrange strain), "state", "utilisation" (of the strengths
        of `Scene.set_strengths`, grey in reinforced corners), "load snow" (force per area of the
        load "snow" at factor 1; pressure coefficients c_p for wind); None: plain fabric. Forces,
        strains and utilisation are the recovered ones, means at each vertex of the cells around of
        one material.
    unit, force
        Units of length and force, for labels.
    ghost
        Whether to show the stress-free shape faintly.
    tensions
        Whether to colour cables and bars by their forces, with a separate colour bar.
    directions
        Whether to show the directions of the major principal section force as strokes.
    **options
        Options of `ShapeOptions`: ``view``, ``box``, ``title``, ``limits`` ...

    Returns
    -------
    matplotlib.figure.Figure
        The figure for notebooks, on the first rank and without a file; else None.

    Raises
    ------
    InputError
        On all ranks: an unknown colour or option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        Nothing is drawn, as the mesh has more than `MOST_CELLS` cells.

    Examples
    --------
    >>> output.draw(solver, "roof.png", colour="stress", unit="m", force="kN")
    """
    if not hasattr(type(solver), "system"):
        raise InputError(f"draw: solver is of type {type(solver).__name__}; pass a Solver.")
    loads = [f"{LOAD}{name}" for name in solver.system.scene.loads.factors]
    checks.one_of("draw: colour", colour, (None, *COLOURS, *loads))
    taken = sorted({"points", "triangles", "lines", "values", "line_values"} & set(options))
    if taken:
        raise InputError(f"draw: {taken} come from the scene; use draw_shape to draw arrays.")
    system = solver.system
    scene = system.scene
    if _too_large(scene, f"{filename or 'the scene'} is not drawn"):
        return None
    shape = current_surface(scene.net)
    fields: dict[str, ArrayLike] = {"inner": sides_among(shape.triangles, shape.inner)}
    if colour in loads:
        own = load_values(scene, str(colour).removeprefix(LOAD))
        fields["values"] = own[shape.parents]
        arrows = _load_arrows(scene, str(colour).removeprefix(LOAD), own)
        options = {"arrows": arrows, "levels": LEVELS, "colours": "Wistia", **options}
    elif colour in QUANTITY_OF:
        fields["values"] = _recovered(system, colour)
    if directions:
        options["strokes"] = _principal_strokes(system)
    if colour is not None:
        label, kind = (
            load_label(scene, colour[len(LOAD) :]) if colour in loads else label_of(colour)
        )
        named = units_of_results(unit, force).get(kind, "")
        options.setdefault("label", with_unit(label, named))
    defaults = _supports(scene)
    defaults |= {"limits": (0.0, 2.0)} if colour == "state" else {}
    defaults |= {"without": "reinforced corner"} if colour == "utilisation" else {}
    if tensions and (scene.bars or any(cable.taut for cable in scene.cables)):
        defaults |= _coloured_forces(scene, force)
    options = {**defaults, **options}
    if any(cable.state.lifted.any() for cable in scene.cables):
        options.setdefault("loose", "lifted")
    belts = {cable.name for cable in scene.cables if cable.hold == "bonded"}
    ropes = sorted(cable_lines(scene.net), key=lambda line: line.name not in belts)
    lines = [*bar_lines(scene.bars), *ropes]  # belts below the cables in their pockets
    piece = replace(surface_piece(scene.membrane, shape, {}), cell_data=fields)
    surface = whole_surface(scene.comm, piece)
    free = whole_surface(scene.comm, _stress_free(scene)) if ghost else None
    with raised_together(scene.comm):
        if surface is not None:
            corners = np.asarray(surface.triangles)
            sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1)
            values = surface.cell_data.get("values")
            if colour == "height":
                values = np.asarray(surface.points)[:, 2]
                if np.ptp(values) > FLAT * np.ptp(surface.points, axis=0).max():
                    options.setdefault("limits", (float(values.min()), float(values.max())))
            elif colour == "displacement":
                values = np.linalg.norm(surface.point_data["displacement"], axis=1)
            return draw_shape(
                filename, surface.points, corners, lines, unit=unit, values=values,
                hidden=sides[np.asarray(surface.cell_data["inner"])],
                ghost=None if free is None else (free.points, free.triangles), **options,
            )  # fmt: skip
    return None


def _recovered(system: System, colour: str) -> Array:
    """Values (m, 3) of a colour at the corners of the current surface's facets. Collective."""
    results, name = membrane_results(system), QUANTITY_OF[colour]
    if name == "state":
        values = results.values(name)[results.surface.parents]
        return np.repeat(values[:, None], 3, axis=1)
    if name == "utilisation" and "utilisation" in results.names:
        corners = judged_utilisation(results, patches(system.scene)).shown
    else:
        corners = recovered(results, name)
    return at_facets(results, corners)


def _supports(scene: Scene) -> dict[str, Any]:
    """Held edges, (h, 2, 3), and held points off them, (k, 3), on all ranks. Collective."""
    rim = held_rim(scene)
    places = np.concatenate([
        held_places(scene)[0],
        *(joint.position[None] for joint in scene.joints if joint.held.any()),
        *(end.place[None] for end in held_ends(scene)),
    ])  # fmt: skip
    near = 1e-6 * scene.membrane.size
    off = [place for place in np.unique(places, axis=0) if gap(place, rim) > near]
    return {"held": rim, "supports": np.reshape(off, (-1, 3))}


def _principal_strokes(system: System) -> Array:
    """Strokes (k, 2, 3) along the major principal forces, spread over the surface. Collective."""
    results, scene = membrane_results(system), system.scene
    n = len(results.state)
    centres = scene.positions()[scene.V.dofmap.list[:n]].mean(axis=1)
    taut = results.state > 0
    pieces = scene.comm.allgather((centres[taut], results.true_directions[taut, 0]))
    places, ways = (np.concatenate([one[k] for one in pieces]) for k in (0, 1))
    if not len(places):
        return np.zeros((0, 2, 3))
    size = float(np.ptp(places, axis=0).max()) or 1.0
    chosen = spread(places, size / MOST_STROKES)
    half = 0.35 * size / MOST_STROKES * ways[chosen]
    return np.stack([places[chosen] - half, places[chosen] + half], axis=1)


def _load_arrows(scene: Scene, name: str, values: Array) -> Array:
    """Arrows (k, 2, 3) of a load with values (m,) in this rank's cells, spread over the surface,
    that end on it where they press. Collective."""
    ways, corners = load_directions(scene, name), scene.positions()[scene.V.dofmap.list]
    corners = corners[: len(values)]
    normals = double_areas(corners)
    loaded: Booleans = np.abs(values) > 0.0
    pressing = (normals * ways).sum(axis=1) < 0.0
    pieces = scene.comm.allgather([
        one[loaded] for one in (corners.mean(axis=1), ways, np.abs(values), pressing)
    ])  # fmt: skip
    places, ways, sizes, pressing = (np.concatenate([one[k] for one in pieces]) for k in range(4))
    if not len(places):
        return np.zeros((0, 2, 3))
    step = 1.5 * scene.membrane.size / MOST_STROKES
    chosen = spread(places, step)
    long = 0.9 * step * ways[chosen] * (sizes[chosen] / sizes.max())[:, None]
    tails = places[chosen] - long * pressing[chosen, None]
    return np.stack([tails, tails + long], axis=1)


def spread(places: Array, step: float) -> Integers:
    """Indices of places (n, 3), one per cube of size `step`: the closest to its centre."""
    cubes = np.floor(places / step)
    off = np.linalg.norm(places / step - cubes - 0.5, axis=1)
    order = np.lexsort((*places.T, off))
    _, first = np.unique(cubes[order], axis=0, return_index=True)
    return np.asarray(order[first])


def _coloured_forces(scene: Scene, force: str) -> dict[str, Any]:
    """Colours of cables and bars by their forces, from blue compression if there is any to red
    tension, and their label with the unit of force."""
    kind = "axial force" if scene.bars else "tension"
    found: dict[str, Any] = {"line_label": with_unit(kind, force), "line_values": "tension"}
    forces = [bar.force for bar in scene.bars]
    if min(forces, default=0.0) < 0.0:
        most = max(map(abs, [*forces, *(float(cable.tensions.max()) for cable in scene.cables)]))
        found |= {"line_limits": (-most, most), "line_colours": SIGNED}
    return found


@collective
def draw_paths(
    scene: Scene,
    filename: str | Path | None = None,
    lines: PerRank[Sequence[Line]] = (),
    paths: PerRank[Sequence[Line]] = (),
    **options: Any,
) -> Figure | None:
    """Draw cables and paths of points over the stress-free mesh, in plan. Collective.

    Parameters
    ----------
    scene
        Scene of the mesh.
    filename
        Picture file (.png, .pdf, .svg ...); None returns the figure.
    lines
        Cables, such as ``Line(cable.line, name="now")``, from the first rank.
    paths
        Paths of points, step by step, from the first rank.
    **options
        Options of `PathOptions`: ``unit``, ``closeups``, ``title`` ...

    Returns
    -------
    matplotlib.figure.Figure
        The figure for notebooks, on the first rank and without a file; else None.

    Raises
    ------
    InputError
        On all ranks: nothing to draw, an unknown option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        The mesh is omitted, as it has more than `MOST_CELLS` cells.

    Examples
    --------
    >>> before = output.Line(ridge.line, name="before")
    >>> step = solver.advance(pressure=1.5)
    >>> after = output.Line(ridge.line, name="after")
    >>> output.draw_paths(scene, "cables.png", [before, after])
    """
    taken = sorted({"points", "triangles"} & set(options))
    if taken:
        raise InputError(f"draw_paths: {taken} come from the scene; use draw_path to draw arrays.")
    whole = None
    if not _too_large(scene, f"{filename or 'the picture'} is drawn without the mesh"):
        whole = whole_surface(scene.comm, _stress_free(scene))
    with raised_together(scene.comm):
        if whole is not None:
            options |= {"points": whole.points, "triangles": whole.triangles}
        if scene.comm.rank == 0:
            return draw_path(filename, paths, lines=lines, **options)
    return None


def _too_large(scene: Scene, happens: str) -> bool:
    """Whether a scene's mesh is too large for a picture; warns if so."""
    cells = scene.mesh.mesh.topology.index_map(2).size_global
    if cells > MOST_CELLS and scene.comm.rank == 0:
        warnings.warn(
            f"{happens}: the mesh has {cells} cells, more than the {MOST_CELLS} that one process "
            'draws; look at the ParaView files of Solver(scene, results="folder").',
            PictureWarning,
            stacklevel=4,
        )
    return cells > MOST_CELLS


def _stress_free(scene: Scene) -> Surface:
    """This rank's piece of the stress-free mesh."""
    points = scene.membrane.stress_free
    homes = point_homes(scene.membrane, len(points))
    return Surface(points, scene.V.dofmap.list, homes=homes)
