"""Output of a run: history, ParaView files and pictures."""

from importlib import import_module
from typing import TYPE_CHECKING

from crms_fenicsx.results.output.history import History

if TYPE_CHECKING:
    from crms_fenicsx.results.output.figures.draw_paths import PathOptions, draw_path
    from crms_fenicsx.results.output.figures.draw_scene import draw, draw_paths
    from crms_fenicsx.results.output.figures.draw_surface import ShapeOptions, draw_shape
    from crms_fenicsx.results.output.figures.picture import join_pictures
    from crms_fenicsx.results.output.figures.plots import HistoryOptions, draw_history
    from crms_fenicsx.results.output.paraview import Series, write_vtkhdf
    from crms_fenicsx.results.view_data import Line, Surface

__all__ = [
    "History",
    "HistoryOptions",
    "Line",
    "PathOptions",
    "Series",
    "ShapeOptions",
    "Surface",
    "draw",
    "draw_history",
    "draw_path",
    "draw_paths",
    "draw_shape",
    "join_pictures",
    "write_vtkhdf",
]

NAMES = {
    "crms_fenicsx.results.output.figures.draw_paths": ("PathOptions", "draw_path"),
    "crms_fenicsx.results.output.figures.draw_scene": ("draw", "draw_paths"),
    "crms_fenicsx.results.output.figures.draw_surface": ("ShapeOptions", "draw_shape"),
    "crms_fenicsx.results.output.figures.picture": ("join_pictures",),
    "crms_fenicsx.results.output.figures.plots": ("HistoryOptions", "draw_history"),
    "crms_fenicsx.results.output.paraview": ("Series", "write_vtkhdf"),
    "crms_fenicsx.results.view_data": ("Line", "Surface"),
}
"""Modules imported at the first access to one of their names."""


def __getattr__(name: str) -> object:
    for module, names in NAMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
