"""Pictures of a scene and plots of its history by one call, from all ranks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crms_fenicsx.cables.deformed_surface import CurrentSurface, current_surface
from crms_fenicsx.output.cable_lines import cable_lines
from crms_fenicsx.output.data import Line
from crms_fenicsx.output.figures.history import draw_history
from crms_fenicsx.output.figures.paths import draw_path
from crms_fenicsx.output.figures.surface import draw_shape
from crms_fenicsx.output.history import History
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.errors import InputError, PictureWarning, raised_together

if TYPE_CHECKING:
    from crms_fenicsx.equilibrium.system import System
    from crms_fenicsx.scene import Scene


MOST_CELLS = 500_000
"""Most cells of a mesh that is drawn. The first process gathers and draws all of them, which takes
20 s and 0.7 GB for a million; and in a picture of a million points nobody would see so many."""

_SEEN = 0.01
"""Share of a panel's largest value from which on a column is seen in it."""


@dataclass(frozen=True)
class Colour:
    """Something that the membrane can be coloured by.

    Attributes
    ----------
    label
        Of the colour bar.
    unit
        Key of `units`, or "".
    values
        One for each triangle or point, from the surface and the membrane's results.
    """

    label: str
    unit: str
    values: Callable[[CurrentSurface, MembraneResults], Array]


COLOURS = {
    "height": Colour("height", "length", lambda s, r: s.points[:, 2][s.triangles].mean(axis=1)),
    "displacement": Colour("displacement", "length", lambda s, r: _displacement(s)),
    "stress": Colour("larger section force", "stress", lambda s, r: r.true_forces[s.parents, 0]),
    "stress 2": Colour("smaller section force", "stress", lambda s, r: r.true_forces[s.parents, 1]),
    "strain": Colour("larger strain", "", lambda s, r: r.strains[s.parents, 0]),
    "state": Colour(
        "0 slack, 1 wrinkled, 2 taut", "", lambda s, r: r.state[s.parents].astype(np.float64)
    ),
}
"""What `draw_scene` can colour the membrane by."""


def units(length: str, force: str) -> dict[str, str]:
    """Units of the quantities that results hold, as far as those of length and force tell.

    Parameters
    ----------
    length, force
        As they are written, such as "cm" and "kgf"; "" where unknown.
    """
    found = {"length": length, "L0": length, "volume": f"{length}³" if length else ""}
    found |= {"tension": force, "residual": force}
    if length and force:
        found |= {
            "stress": f"{force}/{length}",
            "pressure": f"{force}/{length}²",
            "energy": f"{force} {length}",
        }
    return {name: unit for name, unit in found.items() if unit}


def draw_scene(
    system: System,
    filename: str | Path,
    *,
    colour: str | None = None,
    unit: str = "",
    force: str = "",
    ghost: bool = False,
    **options: Any,
) -> None:
    """Draw the scene as it is, and say or colour the cables' tensions. Collective.

    Cables are striped where they are off the membrane.

    Parameters
    ----------
    system
        The scene's potential.
    filename
        Picture to write; its suffix (.png, .pdf, .svg ...) says the format.
    colour
        What colours the membrane: "height" (z), "displacement", "stress" and "stress 2" (larger
        and smaller principal true section force), "strain" (larger principal Green-Lagrange
        strain), "state"; None: plain fabric.
    unit, force
        Names of the units of length and force, for labels.
    ghost
        Whether to show the stress-free shape, faintly.
    **options
        As for `crms_fenicsx.output.draw_shape`: ``view``, ``box``, ``title``, ``limits`` ...

    Raises
    ------
    InputError
        On all ranks: an unknown colour or option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        The mesh has more than `MOST_CELLS` cells; nothing is drawn.
    """
    if colour is not None and colour not in list(COLOURS):
        raise InputError(
            f"draw: colour = {colour!r} is not known; use one of {list(COLOURS)} or None."
        )
    taken = sorted({"points", "triangles", "lines", "values", "line_values"} & set(options))
    if taken:
        raise InputError(f"draw: {taken} come from the scene; use draw_shape to draw arrays.")
    scene, named = system.scene, units(unit, force)
    if _too_large(scene, f"{filename} is not drawn"):
        return
    surface = current_surface(scene.net)
    values: Array = np.empty(0)
    if colour is not None:
        chosen = COLOURS[colour]
        values = chosen.values(surface, membrane_results(system))
        options.setdefault("label", _labelled(chosen.label, named.get(chosen.unit, "")))
    if colour == "state":
        options.setdefault("limits", (0.0, 2.0))
    if any(cable.taut for cable in scene.cables):
        options |= {"line_values": "tension"}
        options.setdefault("line_label", _labelled("tension", force))
    if any(cable.lifted.any() for cable in scene.cables):
        options.setdefault("loose", "lifted")
    cells = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
    lines = cable_lines(scene)
    parts = scene.comm.gather((surface, values, cells if ghost else cells[:0]))
    with raised_together(scene.comm):
        if parts is not None:
            ends = np.cumsum([len(part.points) for part, _, _ in parts])
            starts = [end - len(part.points) for (part, _, _), end in zip(parts, ends, strict=True)]
            if ghost:
                free = np.concatenate([part.stress_free for part, _, _ in parts])
                options |= {"ghost": (free, _numbered([part[2] for part in parts], starts))}
            draw_shape(
                filename,
                np.concatenate([part.points for part, _, _ in parts]),
                _numbered([part.triangles for part, _, _ in parts], starts),
                lines,
                values=None if colour is None else np.concatenate([part[1] for part in parts]),
                hidden=_numbered([part.inner for part, _, _ in parts], starts),
                unit=unit,
                **options,
            )


def draw_scene_paths(
    scene: Scene,
    filename: str | Path,
    lines: Sequence[Line] = (),
    paths: Sequence[Line] = (),
    *,
    unit: str = "",
    **options: Any,
) -> None:
    """Draw paths of cables and ways of points over the stress-free mesh, in plan. Collective.

    Parameters
    ----------
    scene
        Its mesh is drawn.
    filename
        Picture to write; its suffix says the format.
    lines, paths
        As for `crms_fenicsx.output.draw_path`, on the first rank.
    unit
        Name of the unit of length, for labels.
    **options
        As for `crms_fenicsx.output.draw_path`.

    Raises
    ------
    InputError
        On all ranks: nothing to draw, an unknown option, or a file that cannot be written.

    Warns
    -----
    PictureWarning
        The mesh has more than `MOST_CELLS` cells, and is left out.
    """
    taken = sorted({"points", "triangles"} & set(options))
    if taken:
        raise InputError(f"draw_paths: {taken} come from the scene; use draw_path to draw arrays.")
    parts = None
    if not _too_large(scene, f"{filename} is drawn without the mesh"):
        cells = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
        parts = scene.comm.gather((scene.membrane.stress_free, cells))
    with raised_together(scene.comm):
        if parts is not None:
            ends = np.cumsum([len(points) for points, _ in parts])
            starts = [end - len(points) for (points, _), end in zip(parts, ends, strict=True)]
            options["points"] = np.concatenate([points for points, _ in parts])
            options["triangles"] = _numbered([part for _, part in parts], starts)
        if scene.comm.rank == 0:
            draw_path(filename, paths, lines=lines, unit=unit, **options)


def _too_large(scene: Scene, happens: str) -> bool:
    """Whether a scene's mesh is too large for a picture; warns then."""
    cells = scene.mesh.mesh.topology.index_map(2).size_global
    if cells > MOST_CELLS and scene.comm.rank == 0:
        warnings.warn(
            f"{happens}: the mesh has {cells} cells, more than the {MOST_CELLS} that one process "
            'draws; look at the ParaView files of Solver(scene, results="folder").',
            PictureWarning,
            stacklevel=5,
        )
    return cells > MOST_CELLS


def _numbered(parts: list[Integers], starts: list[int]) -> Integers:
    """Join the ranks' vertex numbers; each rank's begin at its start."""
    return np.concatenate([part + start for part, start in zip(parts, starts, strict=True)])


def _displacement(surface: CurrentSurface) -> Array:
    size: Array = np.linalg.norm(surface.points - surface.stress_free, axis=1)
    return size[surface.triangles].mean(axis=1)


def _labelled(label: str, unit: str) -> str:
    return f"{label} [{unit}]" if unit else label


def draw_scene_history(
    history: History,
    filename: str | Path,
    panels: Sequence[Sequence[str]] | None = None,
    *,
    unit: str = "",
    force: str = "",
    **options: Any,
) -> None:
    """Plot a scene's history over its load steps. Collective.

    Parameters
    ----------
    history
        A recorder's.
    filename
        Picture to write; its suffix says the format.
    panels
        Columns that share a panel; by default those of `default_panels`.
    unit, force
        Names of the units of length and force, for labels.
    **options
        As for `crms_fenicsx.output.draw_history`.

    Raises
    ------
    InputError
        On all ranks: no step yet, an unknown column, or a file that cannot be written.
    """
    with raised_together(history.comm):
        if history.comm.rank == 0:
            panels = default_panels(history) if panels is None else panels
            named = units(unit, force) | dict(options.pop("units", {}))
            draw_history(filename, history, panels=panels, units=named, **options)


def default_panels(history: History) -> list[list[str]]:
    """Columns that show a run: what drives it, then what it answers, as far as it changes.

    These are pressure, load factor, unstressed lengths, volume, tensions and energies. An energy
    that would not be seen beside the others is left out.
    """
    groups = [
        [column for column in history.columns if column == name or column.startswith(f"{name} ")]
        for name in ("pressure", "load", "L0", "volume", "tension", "energy")
    ]
    shown = [[c for c in group if _span(history[c]) > 0.0] for group in groups]
    if not any(shown):  # a single step, say
        shown = [[c for c in group if np.any(history[c] != 0.0)] for group in groups]
    largest = [max((_size(history[c]) for c in group), default=0.0) for group in shown]
    seen = [
        [c for c in group if _size(history[c]) >= _SEEN * size]
        for group, size in zip(shown, largest, strict=True)
    ]
    return [group for group in seen if group]


def _span(values: Array) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def _size(values: Array) -> float:
    return float(np.nanmax(np.abs(values)))
