"""The layout of a net: paths of cables by family, with names, lengths and crossings."""

from __future__ import annotations

from dataclasses import dataclass, field

from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.checks import counted, span


@dataclass(frozen=True)
class NetLine:
    """A line of a net, on which a cable can be laid.

    Attributes
    ----------
    name
        Name: the family's letter and a number, "A1", "A2" ...
    path
        Its way over the membrane, from rim to rim, (k, 3) (length), as `Scene.lay_cable` takes it.
    length
        Its length on the smooth surface behind the facets (length): the unstressed length of a
        cable that is just taut on it, but where it spans hollows.
    """

    name: str
    path: Array = field(repr=False)
    length: float


@dataclass(frozen=True)
class NetCrossing:
    """A place where two lines of a net cross.

    Attributes
    ----------
    lines
        Names of the two lines, that of the earlier family first.
    place
        Where it is, (3,) (length).
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
        Where they cross each other.
    nodes : (n, m, 3)
        Nodes of an equidistant net (length): ``nodes[i, j]`` is joined to ``nodes[i + 1, j]`` by a
        line of the first family and to ``nodes[i, j + 1]`` by one of the second. NaN where there is
        none; None for other nets.
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
