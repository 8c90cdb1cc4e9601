"""The layout of a net: cable paths by family, with names, lengths and crossings."""

from __future__ import annotations

from dataclasses import dataclass, field

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.checks import counted, span


@dataclass(frozen=True)
class NetLine:
    """A line of a net on which a cable can be laid.

    Attributes
    ----------
    name
        Name: the family's letter and a number, "A1", "A2" ...
    path
        Path over the membrane, from rim to rim, (k, 3) (length), as `Scene.lay_cable` takes it.
    length
        Length on the smooth surface approximated by the facets (length): the unstressed length of a
        cable just taut on it, except where it spans hollows.
    """

    name: str
    path: Array = field(repr=False)
    length: float


@dataclass(frozen=True)
class NetCrossing:
    """A crossing of two lines of a net.

    Attributes
    ----------
    lines
        Names of the two lines, that of the earlier family first.
    place
        Its position, (3,) (length).
    at
        Distances from the starts of these lines, measured as their lengths (length).
    """

    lines: tuple[str, str]
    place: Array
    at: tuple[float, float]


@dataclass(frozen=True)
class Net:
    """The layout of a net, for `Scene.lay_net`.

    Attributes
    ----------
    lines
        The lines, family by family.
    crossings
        Crossings of the lines.
    nodes : (n, m, 3)
        Nodes of an equidistant net (length): a line of the first family joins ``nodes[i, j]`` to
        ``nodes[i + 1, j]``, one of the second to ``nodes[i, j + 1]``. NaN for missing nodes; None
        for other nets.
    """

    lines: tuple[NetLine, ...]
    crossings: tuple[NetCrossing, ...] = field(repr=False)
    nodes: Array | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        lengths = span([line.length for line in self.lines])
        return (
            f"Net({counted(len(self.lines), 'line')}, length {lengths}; "
            f"{counted(len(self.crossings), 'crossing')})"
        )
