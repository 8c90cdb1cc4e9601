"""Cables, how they are attached and clamped, and the layout of a net of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import NonNegative, Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.temperature import check_expansion


@checked
@dataclass(frozen=True)
class Cable:
    """A linearly elastic cable (section 2.2).

    Parameters
    ----------
    EA
        Axial stiffness (force).
    law
        "total": tension ``EA (L - L0)/L0`` where positive, with the unstressed length L0. "step":
        the paper's (2.2-2), a tension that grows by ``EA/l_n`` times the elongation in the step,
        with the length l_n at the step's start.
    friction
        Friction on the membrane: a coefficient, or a `Friction` with more data. The default 0 costs
        nothing.
    expansion
        Coefficient of thermal expansion alpha (per kelvin), 1.2e-5 of steel, needed by temperature
        loads (`Scene.put_temperature`); None: unknown.
    diameter
        Diameter (length). Two cables that lie along lines of the mesh and do not cross come no
        nearer to each other than half the sum of their diameters. The default 0 means no contact.

    Examples
    --------
    >>> rope = Cable(EA=1e3, friction=0.2)
    >>> cable = scene.lay_cable(rope, [(2.0, 0.0), (2.0, 4.0)], tension=3.0)
    >>> round(cable.tension, 6)
    3.0
    """

    EA: Positive
    law: Literal["total", "step"] = "total"
    friction: float | Friction = 0.0
    expansion: float | None = None
    diameter: NonNegative = 0.0

    def __post_init__(self) -> None:
        check_expansion("Cable", self.expansion)
        if not isinstance(self.friction, Friction):
            Friction(checks.finite("Cable: friction", self.friction))
        if self.law == "step" and self.along:
            raise InputError(
                f'Cable: law = "step" has one tension for the whole cable, but its friction has '
                f'along = {self.along}; use law="total", or leave it out.'
            )

    @property
    def sideways(self) -> Friction | None:
        """Friction against sideways sliding; None if it slides freely."""
        friction = self.friction
        if not isinstance(friction, Friction):
            return Friction(friction) if friction > 0 else None
        return friction if friction.at_rest > 0 else None

    @property
    def along(self) -> float:
        """Coefficient of friction along the cable's axis."""
        return self.friction.along if isinstance(self.friction, Friction) else 0.0

    @property
    def cone(self) -> bool:
        """Whether one limit couples friction sideways and along the axis."""
        return isinstance(self.friction, Friction) and self.friction.cone


Hold = Literal["outside", "sleeve", "pocket", "bonded"]


@dataclass(frozen=True)
class _Freedom:
    """Motions relative to the membrane that an attachment leaves free."""

    lifts: bool  # off the membrane
    sideways: bool  # sliding sideways over the fabric
    along: bool  # sliding along its axis


HOLDS: dict[Hold, _Freedom] = {
    "outside": _Freedom(lifts=True, sideways=True, along=True),
    "sleeve": _Freedom(lifts=False, sideways=True, along=True),
    "pocket": _Freedom(lifts=False, sideways=False, along=True),
    "bonded": _Freedom(lifts=False, sideways=False, along=False),
}
"""Free motions of each kind of attachment."""


@dataclass(frozen=True)
class Bonds:
    """Points between its ends at which a cable is bonded to the fabric."""

    supports: tuple[Support, ...]  # supports of its m points, in order
    at: Annotated[Array, "m"]  # unstressed lengths up to them, relative to the whole cable's


@dataclass(frozen=True)
class Clamp:
    """A clamp at a crossing of two cables along lines of the mesh.

    Attributes
    ----------
    name
        Names of the cables, "A1 x B2", with a number if they have several clamps.
    cables
        Names of the two cables.
    at
        Unstressed lengths from the cables' starts to the clamp, relative to the whole cables';
        constant while it holds.
    place
        Its position, (3,) (length).
    slip
        Difference of a cable's tensions on the clamp's two sides at which the cable slips (force);
        None if it never does.
    vertex
        Number of the vertex of the mesh that both cables share.
    """

    name: str
    cables: tuple[str, str]
    at: tuple[float, float]
    place: Annotated[Array, 3] = field(repr=False)
    slip: float | None
    vertex: int = field(repr=False)


@dataclass(frozen=True)
class ClampedParts:
    """The m + 1 parts of a cable between m clamps, each with its own tension."""

    at: Annotated[Array, "m"]  # unstressed lengths up to the clamps, relative to the whole cable's
    nodes: tuple[int, ...]  # nodes at the clamps, in order; () until crossings are arranged
    tensions: Annotated[Array, "p"]  # of the parts (force)
    smoothing: Annotated[Array, "p"]  # lengths added to the parts by smoothing (length)
    grips: Annotated[Array, "m"]  # slip forces of the clamps, 0 if unlimited (force)
    slips: Annotated[
        Array, "m"
    ]  # of the cable, in its direction, in this step, including the elastic slip of earlier steps
    # (length)
    loss: float = 0.0  # energy dissipated by slips in this step (force x length)
    dissipated: float = 0.0  # energy dissipated before this step (force x length)


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

    @property
    def paths(self) -> dict[str, Array]:
        """Paths of the lines, (k, 3) (length), by name, for a mesh that follows them.

        Examples
        --------
        >>> net = nets.sections(scene, angles=(0.0,), offsets=[1.0, 3.0])
        >>> list(net.paths)
        ['A1', 'A2']
        """
        return {line.name: line.path for line in self.lines}

    def __repr__(self) -> str:
        lengths = span([line.length for line in self.lines])
        return (
            f"Net({counted(len(self.lines), 'line')}, length {lengths}; "
            f"{counted(len(self.crossings), 'crossing')})"
        )
