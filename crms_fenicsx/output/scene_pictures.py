"""Pictures of a scene and plots of its history by one call, from all ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.errors import InputError, raised_together
from crms_fenicsx.output.history import History
from crms_fenicsx.output.pictures import draw_shape
from crms_fenicsx.output.plots import draw_history
from crms_fenicsx.output.recorder import cable_lines
from crms_fenicsx.results import MembraneResults, membrane_results
from crms_fenicsx.shape import current_surface

if TYPE_CHECKING:
    from crms_fenicsx.system import System

Array = npt.NDArray[np.float64]

COLOURS: dict[str, tuple[str, Callable[[MembraneResults], Array]]] = {
    "stress": ("larger section force", lambda results: results.true_forces[:, 0]),
    "stress 2": ("smaller section force", lambda results: results.true_forces[:, 1]),
    "strain": ("larger strain", lambda results: results.strains[:, 0]),
    "state": ("0 slack, 1 wrinkled, 2 taut", lambda results: results.state.astype(float)),
}
"""What `draw_scene` can colour the membrane by: label of the colour bar, values of the cells."""


def draw_scene(
    system: System, filename: str | Path, *, colour: str | None = None, **options: Any
) -> None:
    """Draw the scene as it is, its cables coloured by their tension. Collective.

    Parameters
    ----------
    system
        The scene's potential.
    filename
        Picture to write; its suffix (.png, .pdf, .svg ...) says the format.
    colour
        What colours the membrane: "stress" and "stress 2" (larger and smaller principal true
        section force), "strain" (larger principal Green-Lagrange strain), "state",
        "displacement"; None: plain fabric.
    **options
        As for `crms_fenicsx.output.draw_shape`: ``view``, ``title``, ``label``, ``unit`` ...

    Raises
    ------
    InputError
        On all ranks: an unknown colour or option, or a file that cannot be written.
    """
    known = [*COLOURS, "displacement"]
    if colour is not None and colour not in known:
        raise InputError(f"draw: colour = {colour!r} is not known; use one of {known} or None.")
    taken = sorted({"points", "triangles", "lines", "values", "line_values"} & set(options))
    if taken:
        raise InputError(f"draw: {taken} come from the scene; use draw_shape to draw arrays.")
    scene = system.scene
    surface = current_surface(scene)
    values = None
    if colour == "displacement":
        values = np.linalg.norm(surface.points - surface.stress_free, axis=1)
        options.setdefault("label", "displacement")
    elif colour is not None:
        label, of_cells = COLOURS[colour]
        values = of_cells(membrane_results(system))[surface.parents]
        options.setdefault("label", label)
    if colour == "state":
        options.setdefault("limits", (0.0, 2.0))
    if any(cable.taut for cable in scene.cables):
        options |= {"line_values": "tension"}
        options.setdefault("line_label", "tension")
    parts = scene.comm.gather((surface.points, surface.triangles, values))
    with raised_together(scene.comm):
        if parts is not None:
            ends = np.cumsum([len(points) for points, _, _ in parts])
            corners = [t + end - len(p) for (p, t, _), end in zip(parts, ends, strict=True)]
            draw_shape(
                filename,
                np.concatenate([points for points, _, _ in parts]),
                np.concatenate(corners),
                cable_lines(scene),
                values=None if values is None else np.concatenate([part[2] for part in parts]),
                **options,
            )


def draw_scene_history(
    history: History,
    filename: str | Path,
    panels: Sequence[Sequence[str]] | None = None,
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
        Columns that share a panel; by default pressure, volume, energies and the cables' tensions
        and unstressed lengths, as far as there are any.
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
            draw_history(filename, history, panels=panels, **options)


def default_panels(history: History) -> list[list[str]]:
    """The panels that show a run: what drives it, then what it answers."""
    groups = [
        [column for column in history.columns if column == name or column.startswith(f"{name} ")]
        for name in ("pressure", "L0", "volume", "tension", "energy")
    ]
    return [group for group in groups if any(np.any(history[c] != 0.0) for c in group)]
