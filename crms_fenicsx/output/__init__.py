"""What a run leaves behind: its history, files for ParaView, and pictures. All from arrays."""

from crms_fenicsx.output.data import Line, Surface
from crms_fenicsx.output.history import History
from crms_fenicsx.output.montage import join_pictures
from crms_fenicsx.output.paraview import Series
from crms_fenicsx.output.paths import draw_path
from crms_fenicsx.output.pictures import draw_shape
from crms_fenicsx.output.plots import draw_history

__all__ = [
    "History",
    "Line",
    "Series",
    "Surface",
    "draw_history",
    "draw_path",
    "draw_shape",
    "join_pictures",
]
