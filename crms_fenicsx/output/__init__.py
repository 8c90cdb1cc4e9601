"""What a run leaves behind: its history, files for ParaView, and pictures."""

from crms_fenicsx.output.figures.draw_paths import PathOptions, draw_path
from crms_fenicsx.output.figures.draw_scene import draw, draw_paths
from crms_fenicsx.output.figures.draw_surface import ShapeOptions, draw_shape
from crms_fenicsx.output.figures.picture import join_pictures
from crms_fenicsx.output.figures.plots import HistoryOptions, draw_history
from crms_fenicsx.output.history import History
from crms_fenicsx.output.paraview import Series
from crms_fenicsx.views.view_data import Line, Surface

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
]
