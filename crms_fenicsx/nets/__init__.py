"""Layout of cable nets on the current shape of a membrane: where their cables lie, how long they
are, and where they cross.

`Scene.lay_net` lays the cables of a net.
"""

from crms_fenicsx.model.net import Net, NetCrossing, NetLine
from crms_fenicsx.nets.equidistant import equidistant
from crms_fenicsx.nets.geodesics import geodesics_across, geodesics_between
from crms_fenicsx.nets.plane_routes import from_paths, great_circle, sections

__all__ = [
    "Net",
    "NetCrossing",
    "NetLine",
    "equidistant",
    "from_paths",
    "geodesics_across",
    "geodesics_between",
    "great_circle",
    "sections",
]
