"""Cutting patterns: seams, flat pieces, compensation, sheets, and the roof sewn of them."""

from crms_fenicsx.patterns.compensation import EdgeShrink, Shrink, shrink_for
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
from crms_fenicsx.patterns.strip_layout import strips

__all__ = [
    "EdgeShrink",
    "FlatPiece",
    "Pattern",
    "Piece",
    "PieceEdge",
    "Pieces",
    "Seam",
    "Shrink",
    "cut",
    "edge_line",
    "flatten",
    "geodesic",
    "geodesic_along",
    "parallel",
    "plane_section",
    "shrink_for",
    "strips",
]
