"""Cutting patterns: seams, flat pieces, compensation, sheets, and the roof sewn of them."""

from crms_fenicsx.patterns.adjusting import Adjusted, adjust
from crms_fenicsx.patterns.compensation import EdgeShrink, Shrink, largest_width, shrink_for
from crms_fenicsx.patterns.pattern import FlatPiece, Pattern, flatten
from crms_fenicsx.patterns.pieces import Piece, PieceEdge, Pieces, cut
from crms_fenicsx.patterns.seams import (
    Seam,
    edge_line,
    geodesic,
    geodesic_along,
    parallel,
    plane_section,
)
from crms_fenicsx.patterns.sewn import Comparison, SewnPiece, compare, sew
from crms_fenicsx.patterns.strip_layout import strips

__all__ = [
    "Adjusted",
    "Comparison",
    "EdgeShrink",
    "FlatPiece",
    "Pattern",
    "Piece",
    "PieceEdge",
    "Pieces",
    "Seam",
    "SewnPiece",
    "Shrink",
    "adjust",
    "compare",
    "cut",
    "edge_line",
    "flatten",
    "geodesic",
    "geodesic_along",
    "largest_width",
    "parallel",
    "plane_section",
    "sew",
    "shrink_for",
    "strips",
]
