"""Cutting patterns: seams, flat pieces, compensation, sheets, and the roof sewn of them."""

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
    "Piece",
    "PieceEdge",
    "Pieces",
    "Seam",
    "cut",
    "edge_line",
    "geodesic",
    "geodesic_along",
    "parallel",
    "plane_section",
    "strips",
]
