"""Masts and guys that replace supports of a found form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.model.bar import Bar
from crms_fenicsx.model.tolerances import SAME_PLACE

BALANCED = 1e-9
"""Part of a reaction that bars may leave, and relative size of singular values taken as zero."""


@dataclass(frozen=True)
class FormBar:
    """A bar (mast, guy or tie) that replaces a form's support at a point, with others there.

    Parameters
    ----------
    group
        The support: a point group with one vertex.
    bar
        Properties of the bar.
    foot
        Place (3,) of the other end (length), which is anchored.
    name
        Name in results, by default "bar 1", "bar 2" ...
    force
        Axial force (force), tension positive; by default such that the support's bars balance the
        reaction.

    Raises
    ------
    InputError
        Not a `Bar`, an invalid foot, or a force that is not finite or compresses a guy.
    """

    group: str
    bar: Bar
    foot: Sequence[float]
    name: str | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        checks.of_type("FormBar: bar", self.bar, Bar)
        checks.vector(f"FormBar: foot of {self.label}", self.foot)
        if self.force is not None:
            self.unstressed(1.0, checks.finite(f"FormBar: force of {self.label}", self.force))

    @property
    def label(self) -> str:
        """Name in messages."""
        return repr(self.name) if self.name else f"a bar of {self.group!r}"

    def unstressed(self, length: float, force: float) -> float:
        """Unstressed length (length) of a bar from its length under a force.

        Raises
        ------
        InputError
            A guy under compression, or a force beyond its stiffness.
        """
        if force <= (0.0 if self.bar.tension_only else -self.bar.EA):
            what = "a guy" if self.bar.tension_only else f"a bar of EA = {self.bar.EA:g}"
            raise InputError(
                f"FormBar: {self.label} would have the force {force:.6g}, which {what} cannot "
                "have; move its foot, or change its force or Bar."
            )
        return length / (1.0 + force / self.bar.EA)


def add_bars(scene: Scene, reactions: Mapping[str, Array], bars: Sequence[FormBar]) -> None:
    """Add bars in place of supports at points. Collective. Shapes: reactions (3,)."""
    frame = scene.frame
    for group in dict.fromkeys(bar.group for bar in bars):
        own = [bar for bar in bars if bar.group == group]
        vertex = frame.vertex_in_group(group)
        rank, dof = frame.home(vertex)
        held = scene.comm.bcast(
            bool(scene.held[dof].any()) if scene.comm.rank == rank else None, rank
        )
        if held:
            raise InputError(
                f"FoundForm.scene: another support holds {group!r} as well; bars replace supports "
                "of points in one group."
            )
        place = frame.place_of(vertex)
        ways = np.array([bar.foot for bar in own], dtype=float) - place
        lengths = np.linalg.norm(ways, axis=1)
        if lengths.min() <= SAME_PLACE * scene.membrane.size:
            bar = own[int(np.argmin(lengths))]
            raise InputError(
                f"FoundForm.scene: {bar.label} has its foot at {as_text(place)}, where {group!r} "
                "is."
            )
        forces = _bar_forces(reactions[group], ways / lengths[:, None], own)
        for bar, length, force in zip(own, lengths, forces, strict=True):
            L0 = bar.unstressed(float(length), float(force))
            scene.add_bar(bar.bar, bar.foot, vertex, L0=L0, name=bar.name)


def _bar_forces(reaction: Array, ways: Array, bars: Sequence[FormBar]) -> Array:
    """Forces (n,) of bars along `ways` (n, 3) that sum to a reaction (force)."""
    group = bars[0].group
    found = np.array([np.nan if bar.force is None else bar.force for bar in bars])
    asked = np.isnan(found)
    rest = reaction - found[~asked] @ ways[~asked]
    solved, _, rank, _ = np.linalg.lstsq(ways[asked].T, rest, rcond=BALANCED)
    found[asked] = solved
    left = reaction - found @ ways
    if rank < np.count_nonzero(asked):
        raise InputError(
            f"FoundForm.scene: the forces of {np.count_nonzero(asked)} bars at {group!r} do not "
            "follow from its reaction; set the force of some, or move their feet."
        )
    if np.linalg.norm(left) > BALANCED * max(np.linalg.norm(reaction), np.abs(found).max()):
        raise InputError(
            f"FoundForm.scene: the bars at {group!r} leave {as_text(left)} of its reaction "
            f"{as_text(reaction)}; add a bar, or put a foot in the direction of the rest."
        )
    return found
