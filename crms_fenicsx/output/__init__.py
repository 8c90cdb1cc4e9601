"""What a run leaves behind: its history, files for ParaView, and pictures. All from arrays."""

from crms_fenicsx.output.history import History
from crms_fenicsx.output.paraview import Series
from crms_fenicsx.output.pictures import draw_shape
from crms_fenicsx.output.plots import draw_history, draw_path
from crms_fenicsx.output.shapes import Line, Surface

__all__ = ["History", "Line", "Series", "Surface", "draw_history", "draw_path", "draw_shape"]
