"""Cutting patterns: seams, flat pieces, compensation, sheets, and the roof sewn from them."""

from crms_fenicsx.design.patterns.compensation import EdgeShrink, Shrink, largest_width, shrink_for
from crms_fenicsx.design.patterns.pattern import FlatPiece, Pattern, flatten
from crms_fenicsx.design.patterns.pattern_report import report_sections
from crms_fenicsx.design.patterns.pieces import Piece, PieceEdge, Pieces, cut
from crms_fenicsx.design.patterns.seams import (
    Seam,
    edge_line,
    geodesic,
    geodesic_along,
    parallel,
    plane_section,
)
from crms_fenicsx.design.patterns.sewn import Adjusted, Comparison, SewnPiece, adjust, compare, sew
from crms_fenicsx.design.patterns.sheet import Nesting, Sheet, nest
from crms_fenicsx.design.patterns.sheet_files import draw_sheets, write_dxf
from crms_fenicsx.design.patterns.strip_layout import Estimate, estimates, strips

__all__ = [
    "Adjusted", "Comparison", "EdgeShrink", "Estimate", "FlatPiece", "Nesting", "Pattern",
    "Piece", "PieceEdge", "Pieces", "Seam", "SewnPiece", "Sheet", "Shrink", "adjust", "compare",
    "cut", "draw_sheets", "edge_line", "estimates", "flatten", "geodesic", "geodesic_along",
    "largest_width", "nest", "parallel", "plane_section", "report_sections", "sew", "shrink_for",
    "strips", "write_dxf",
]  # fmt: skip
