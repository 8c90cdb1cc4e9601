"""Layout of cable nets on a membrane's current shape: paths, lengths, crossings, lengths to order.

`Scene.lay_net` lays the cables of a net.
"""

from crms_fenicsx.design.nets.equidistant import equidistant
from crms_fenicsx.design.nets.layouts import (
    from_paths,
    geodesics_across,
    geodesics_between,
    great_circle,
    sections,
)
from crms_fenicsx.design.nets.tuning import tune
from crms_fenicsx.model.cable import Net, NetCrossing, NetLine
from crms_fenicsx.results.cable_order import CableOrder, Order, lengths_to_order

__all__ = [
    "CableOrder", "Net", "NetCrossing", "NetLine", "Order", "equidistant", "from_paths",
    "geodesics_across", "geodesics_between", "great_circle", "lengths_to_order", "sections",
    "tune",
]  # fmt: skip
