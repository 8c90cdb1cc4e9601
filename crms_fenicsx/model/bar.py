"""Bars in tension and compression, their joints, and the state of both."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.handle import Handle, ReadOnly
from crms_fenicsx.model.temperature import check_expansion

SHORTEST = 1e-12
"""Length of a bar, relative to its unstressed length, below which its direction is undefined."""
FOUND = "it follows from the loads; call solver.advance(...)"
IMPERFECTIONS = {"a0": 0.13, "a": 0.21, "b": 0.34, "c": 0.49, "d": 0.76}
"""Imperfection factors of the buckling curves, EN 1993-1-1, table 6.1."""
ANOTHER_BAR = "add another bar with scene.add_bar(...)"
ANOTHER_JOINT = "add another joint with scene.add_joint(...)"


@checked
@dataclass(frozen=True)
class Bar:
    """A linearly elastic, straight bar with hinges at both ends: a mast, a strut or a guy.

    Its energy is ``EA/2 (l - L0)^2 / L0``, its axial force ``EA (l - L0) / L0``, with the current
    length l and the unstressed length L0. Buckling is not modelled, only checked: see `curve`.

    Parameters
    ----------
    EA
        Axial stiffness (force).
    tension_only
        Whether it is slack, without force, when shorter than L0: a guy.
    EI
        Smallest bending stiffness (force x length squared), for the Euler load; None: unknown.
    strength
        Strength in tension, and in compression without buckling, divided by the partial factor
        (force); None: unknown. Ropes: see `Scene.set_strengths`.
    curve
        Buckling curve of EN 1993-1-1, 6.3.1, of the cross-section and steel, "a0", "a", "b", "c" or
        "d", which needs EI and strength. Or a reduction factor of the strength of your own, 0 to 1.
        None: a compressed bar has no utilisation.
    gamma_M
        Partial factor by which the strength is divided: the slenderness takes their product for
        A f_y.
    buckling_length
        Buckling length (length); None: the distance of its ends.
    section
        What it is made of, for reports. `codes.steel_bar` makes bars of steel sections, and names
        section, area, second moment of area and yield strength.
    expansion
        Coefficient of thermal expansion alpha (per kelvin), 1.2e-5 of steel, needed by temperature
        loads (`Scene.put_temperature`); None: unknown.

    Examples
    --------
    >>> mast = Bar(EA=5e5, EI=200.0, strength=300.0, curve="c")
    >>> round(mast.reduction(4.0), 2)  # of the strength, by buckling over a length of 4
    0.3
    """

    EA: Positive
    tension_only: bool = False
    EI: Positive | None = None
    strength: Positive | None = None
    curve: Literal["a0", "a", "b", "c", "d"] | float | None = None
    gamma_M: Positive = 1.0
    buckling_length: Positive | None = None
    section: str = ""
    expansion: float | None = None

    def __post_init__(self) -> None:
        check_expansion("Bar", self.expansion)
        if not isinstance(self.tension_only, bool | np.bool_):
            raise InputError(
                f"Bar: tension_only = {self.tension_only!r} must be True (a guy) or False."
            )
        if isinstance(self.curve, str):
            checks.named("buckling curve", IMPERFECTIONS, self.curve)
        elif self.curve is not None and checks.positive("Bar: curve", self.curve) > 1.0:
            raise InputError(
                f"Bar: curve = {self.curve!r} is not a reduction factor between 0 and 1."
            )
        needed = {"strength": self.strength, "EI": self.EI if isinstance(self.curve, str) else 0.0}
        lacking = [name for name, value in needed.items() if value is None]
        if self.curve is not None and lacking:
            raise InputError(f"Bar: curve = {self.curve!r} needs {' and '.join(lacking)}, too.")

    def reduction(self, length: float) -> float | None:
        """Reduction factor chi of the strength in compression, EN 1993-1-1, (6.49), of a bar of
        some length; None without a curve."""
        if not isinstance(self.curve, str):
            return self.curve
        assert self.strength is not None and self.EI is not None
        length = self.buckling_length or length
        squared = self.strength * self.gamma_M * length**2 / (np.pi**2 * self.EI)
        phi = 0.5 * (1 + IMPERFECTIONS[self.curve] * (np.sqrt(squared) - 0.2) + squared)
        return min(1.0, float(1 / (phi + np.sqrt(max(phi**2 - squared, 0.0)))))


@dataclass(frozen=True)
class JointState:
    """State of a joint; see the attributes of `Joint`."""

    first: Annotated[Array, 3]
    held: Annotated[Booleans, 3]
    position: Annotated[Array, 3]
    reaction: Annotated[Array, 3]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.flags.writeable = False


class Joint(Handle[JointState]):
    """A point off the membrane at which bars end: a hinge, free or held. Read-only.

    Made by `Scene.add_joint`, and by `Scene.add_bar` for an end given as a point in space.

    Attributes
    ----------
    name
        Name in messages, checkpoints and loads.
    first : (3,)
        Initial position (length).
    held : (3,) bool
        Held components of its displacement.
    position : (3,)
        Current position (length).
    reaction : (3,)
        Force of the support on the joint (force); zero in free directions.
    """

    first: ReadOnly[Array] = ReadOnly("state.first", ANOTHER_JOINT)
    held: ReadOnly[Booleans] = ReadOnly("state.held", ANOTHER_JOINT)
    position: ReadOnly[Array] = ReadOnly("state.position", FOUND)
    reaction: ReadOnly[Array] = ReadOnly("state.reaction", FOUND)

    def __repr__(self) -> str:
        return f"Joint({self.name!r})"


@dataclass(frozen=True)
class MeshVertex:
    """A vertex of the membrane as the end of bars, found by `Scene.vertex_at`.

    Attributes
    ----------
    number
        Its number in the mesh as given, the same on all ranks.
    place
        Stress-free position (x, y, z) (length).
    """

    number: int
    place: tuple[float, float, float] = field(compare=False)


BarEnd = Joint | MeshVertex


@dataclass(frozen=True)
class BarState:
    """State of a bar; see the attributes of `PlacedBar`."""

    bar: Bar
    start: BarEnd
    end: BarEnd
    L0: float
    points: Annotated[Array, 2, 3]

    def __post_init__(self) -> None:
        self.points.flags.writeable = False


class PlacedBar(Handle[BarState]):
    """A bar of a scene. Made by `Scene.add_bar`, and read-only.

    Attributes
    ----------
    name
        Name in tables and pictures.
    bar
        Its stiffness and strength.
    start, end
        The joints or vertices at its ends.
    L0
        Unstressed length at the present temperature (length).
    points : (2, 3)
        Current positions of its ends (length).
    """

    bar: ReadOnly[Bar] = ReadOnly("state.bar", "call scene.set_stiffness(...) or add another one")
    start: ReadOnly[BarEnd] = ReadOnly("state.start", ANOTHER_BAR)
    end: ReadOnly[BarEnd] = ReadOnly("state.end", ANOTHER_BAR)
    L0: ReadOnly[float] = ReadOnly("state.L0", "call solver.advance(L0={bar: ...})")
    points: ReadOnly[Array] = ReadOnly("state.points", FOUND)

    @property
    def length(self) -> float:
        """Current length (length)."""
        return float(np.linalg.norm(self.points[1] - self.points[0]))

    @property
    def force(self) -> float:
        """Axial force (force), tension positive."""
        force = self.bar.EA * (self.length - self.L0) / self.L0
        return max(force, 0.0) if self.bar.tension_only else force

    @property
    def slack(self) -> bool:
        """Whether it is a guy without tension."""
        return self.bar.tension_only and self.force == 0.0

    @property
    def buckling(self) -> float | None:
        """Euler load, pi^2 EI / l^2 with the buckling length l (force); None without EI."""
        length = self.bar.buckling_length or self.length
        return None if self.bar.EI is None else float(np.pi**2 * self.bar.EI / length**2)

    @property
    def utilisation(self) -> float | None:
        """Force over strength, in compression over the strength reduced by buckling; None if the
        strength is unknown, or the buckling curve of a compressed bar."""
        share = 1.0 if self.force >= 0.0 else self.bar.reduction(self.length)
        if self.bar.strength is None or share is None:
            return None
        return abs(self.force) / (share * self.bar.strength)

    def pull(self, end: BarEnd) -> Array:
        """Force (3,) of the bar on one of its ends (force)."""
        way = (self.points[1] - self.points[0]) / max(self.length, SHORTEST * self.L0)
        return self.force * (float(end == self.start) - float(end == self.end)) * way

    def __repr__(self) -> str:
        return f"PlacedBar({self.name!r}, force {self.force:.6g})"
