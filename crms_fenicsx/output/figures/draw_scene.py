"""Draw a scene, and paths over its mesh, by one call on all ranks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.cables.deformed_surface import CurrentSurface, current_surface
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.output.figures.axes3d import with_unit
from crms_fenicsx.output.figures.draw_paths import draw_path
from crms_fenicsx.output.figures.draw_surface import draw_shape, sides_among
from crms_fenicsx.output.figures.picture import given_file
from crms_fenicsx.output.figures.plots import units_of_results
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.quantities import QUANTITIES
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, PictureWarning, collective, raised_together
from crms_fenicsx.scene import Scene
from crms_fenicsx.views.view_data import (
    Line,
    Surface,
    bar_lines,
    cable_lines,
    point_homes,
    whole_surface,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CELLS = 500_000
"""Most cells of a mesh that is drawn. The first process gathers and draws all of them, which takes
20 s and 0.7 GB for a million; and in a picture of a million points nobody would see so many."""

SIGNED = "RdYlBu_r"
"""Colours of tensions and compressions."""


@dataclass(frozen=True)
class Colour:
    """Something that the membrane can be coloured by."""

    label: str  # of the colour bar
    unit: str  # key of `units`, or ""
    # one for each triangle or point, from the surface and the membrane's results
    values: Callable[[CurrentSurface, MembraneResults], Array]


def _of_cells(name: str) -> Colour:
    one = QUANTITIES[name]
    return Colour(one.label, one.unit, lambda s, r: r.values(name)[s.parents])


COLOURS = {
    "height": Colour("height", "length", lambda s, r: s.points[:, 2][s.triangles].mean(axis=1)),
    "displacement": Colour("displacement", "length", lambda s, r: _displacement(s)),
    "state": Colour(
        "0 slack, 1 wrinkled, 2 taut", "", lambda s, r: r.state[s.parents].astype(np.float64)
    ),
} | {name: _of_cells(name) for name in ("warp", "weft", "shear", "utilisation")}
COLOURS |= {
    "stress": _of_cells("true force 1"), "stress 2": _of_cells("true force 2"),
    "strain": _of_cells("strain 1"),
}  # fmt: skip
"""What `draw` can colour the membrane by."""


class HasSystem(Protocol):
    """A `Solver`, which lies above this module."""

    comm: MPI.Intracomm

    @property
    def system(self) -> System:
        """The scene's potential."""


@collective
def draw(
    solver: HasSystem,
    filename: str | Path | None = None,
    *,
    colour: str | None = None,
    unit: str = "",
    force: str = "",
    ghost: bool = False,
    tensions: bool = True,
    **options: Any,
) -> Figure | None:
    """Draw a solver's scene in its current state, with the tensions of cables and bars. Collective.

    Cables are striped where they are off the membrane; the compression of bars is negative, and
    blue.

    Parameters
    ----------
    solver
        A `Solver`; its scene is drawn.
    filename
        Picture to write; its suffix (.png, .pdf, .svg ...) says the format. None returns it.
    colour
        What colours the membrane: "height" (z), "displacement", "stress" and "stress 2" (larger
        and smaller principal true section force), "warp", "weft" and "shear" (true section
        forces), "strain" (larger principal Green-Lagrange strain), "state", "utilisation" (of the
        strengths of `Scene.set_strengths`); None: plain fabric.
    unit, force
        Names of the units of length and force, for labels.
    ghost
        Whether to show the stress-free shape, faintly.
    tensions
        Whether to colour the cables by their tensions, which takes a colour bar of its own.
    **options
        As `ShapeOptions`: ``view``, ``box``, ``title``, ``limits`` ...

    Returns
    -------
    matplotlib.figure.Figure
        On the first rank, without a file; a notebook shows it. Else None.

    Raises
    ------
    InputError
        On all ranks: an unknown colour or option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        The mesh has more than `MOST_CELLS` cells; nothing is drawn.
    """
    if not hasattr(type(solver), "system"):
        raise InputError(f"draw: solver is of type {type(solver).__name__}; give a Solver.")
    checks.same(
        solver.comm, "draw", filename=filename, colour=colour, unit=unit, force=force, ghost=ghost,
        tensions=tensions, **options,
    )  # fmt: skip
    filename = given_file("draw", filename)
    if colour is not None and colour not in list(COLOURS):
        raise InputError(
            f"draw: colour = {colour!r} is not known; use one of {list(COLOURS)} or None."
        )
    taken = sorted({"points", "triangles", "lines", "values", "line_values"} & set(options))
    if taken:
        raise InputError(f"draw: {taken} come from the scene; use draw_shape to draw arrays.")
    system = solver.system
    scene = system.scene
    if _too_large(scene, f"{filename or 'the scene'} is not drawn"):
        return None
    shape = current_surface(scene.net)
    data: dict[str, ArrayLike] = {"inner": sides_among(shape.triangles, shape.inner)}
    if colour is not None:
        chosen = COLOURS[colour]
        data["values"] = chosen.values(shape, membrane_results(system))
        named = units_of_results(unit, force).get(chosen.unit, "")
        options.setdefault("label", with_unit(chosen.label, named))
    if colour == "state":
        options.setdefault("limits", (0.0, 2.0))
    if tensions and (scene.bars or any(cable.taut for cable in scene.cables)):
        options |= {"line_values": "tension"}
        options.setdefault("line_label", with_unit("tension", force))
        options = {**_signed_colours(scene), **options}
    if any(cable.lifted.any() for cable in scene.cables):
        options.setdefault("loose", "lifted")
    lines = [*bar_lines(scene.bars), *cable_lines(scene.net)]
    homes = point_homes(scene.membrane, len(shape.points))
    surface = whole_surface(scene.comm, Surface(shape.points, shape.triangles, {}, data, homes))
    free = whole_surface(scene.comm, _stress_free(scene)) if ghost else None
    with raised_together(scene.comm):
        if surface is not None:
            corners = np.asarray(surface.triangles)
            sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1)
            inner = np.asarray(surface.cell_data["inner"])
            return draw_shape(
                filename, surface.points, corners, lines, unit=unit,
                values=surface.cell_data.get("values"), hidden=sides[inner],
                ghost=None if free is None else (free.points, free.triangles), **options,
            )  # fmt: skip
    return None


def _signed_colours(scene: Scene) -> dict[str, Any]:
    """Colours of tensions from blue compression to red tension, where there is compression."""
    forces = [bar.force for bar in scene.bars]
    if min(forces, default=0.0) >= 0.0:
        return {}
    most = max(map(abs, [*forces, *(float(cable.tensions.max()) for cable in scene.cables)]))
    return {"line_limits": (-most, most), "line_colours": SIGNED}


@collective
def draw_paths(
    scene: Scene,
    filename: str | Path | None = None,
    lines: Sequence[Line] = (),
    paths: Sequence[Line] = (),
    **options: Any,
) -> Figure | None:
    """Draw paths of cables and ways of points over the stress-free mesh, in plan. Collective.

    Parameters
    ----------
    scene
        Its mesh is drawn.
    filename
        Picture to write; its suffix says the format. None returns it.
    lines
        Paths of cables, such as ``Line(cable.line, name="now")``; those of the first rank count.
    paths
        Ways of points, step by step; those of the first rank count.
    **options
        As `PathOptions`: ``unit``, ``closeups``, ``title`` ...

    Returns
    -------
    matplotlib.figure.Figure
        On the first rank, without a file; a notebook shows it. Else None.

    Raises
    ------
    InputError
        On all ranks: nothing to draw, an unknown option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        The mesh has more than `MOST_CELLS` cells, and is left out.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"draw_paths: scene is of type {type(scene).__name__}; give a Scene.")
    checks.same(scene.comm, "draw_paths", filename=filename, **options)
    filename = given_file("draw_paths", filename)
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
    """Whether a scene's mesh is too large for a picture; warns then."""
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
    cells = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
    points = scene.membrane.stress_free
    return Surface(points, cells, homes=point_homes(scene.membrane, len(points)))


def _displacement(surface: CurrentSurface) -> Array:
    size: Array = np.linalg.norm(surface.points - surface.stress_free, axis=1)
    return size[surface.triangles].mean(axis=1)
