"""Instabilities of an equilibrium caused by bars, joints and ponds.

At an unstable state the second derivatives have negative eigenvalues, which a factorisation counts.
If there are any, a second factorisation, without a pond or without the loss of lateral stiffness by
compression of bars, tells whether that is the cause. Joints detached from the membrane, and frames
without compression, need no factorisation of the whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property

import numpy as np

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.stability import ExactTangent
from crms_fenicsx.energy.terms.bar_energy import BarEnergy
from crms_fenicsx.energy.terms.ponding import Ponding
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.bar import SHORTEST, BarEnd, Joint, PlacedBar
from crms_fenicsx.model.tolerances import TOL
from crms_fenicsx.model.versions import StateWarning

TOUCH = 1e-9
"""Rise of a given water level, relative to the membrane's size, for the check."""

WATER = (
    "the equilibrium under {!r} is not stable: where the membrane sinks a little more water "
    "gathers than it can carry; use more prestress or slope, a lower level of the pond, or a "
    "volume instead of a level."
)

MOST_JOINTS, MOST_BARS = 500, 20
"""Joints up to which their dense matrix is used, and bars searched for the unstable one."""


class _FrameStability:
    """Bars and joints of a scene in its state, the same on all ranks.

    Attributes: `least` (n,): stiffness of each joint (force/length) indistinguishable from zero;
    `compressed`: the bars under compression. Units: tolerance (force).
    """

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self.scene = scene
        self._number = {joint: k for k, joint in enumerate(scene.joints)}
        self.least = np.zeros(len(scene.joints))
        for bar in scene.bars:
            length = max(bar.length, SHORTEST * bar.L0)
            far = max(float(np.linalg.norm(bar.points, axis=1).max()) / length, 1.0)
            # by rounding of the axial stiffness, and by the tolerance
            unsure = 100 * EPSILON * far * bar.bar.EA / bar.L0 + tolerance / length
            for end in (bar.start, bar.end):
                if isinstance(end, Joint):
                    self.least[self._number[end]] += unsure
        self.compressed = [bar for bar in scene.bars if bar.force < -tolerance]

    @property
    def is_alone(self) -> bool:
        """Whether no bar ends at the membrane, no cable at a joint, and the joints are few."""
        at_joints = any(
            name is not None for cable in self.scene.cables for name in cable.state.laid.joints
        )
        return not at_joints and not self.scene.frame.vertices and self._is_small

    @property
    def _is_small(self) -> bool:
        return len(self.scene.joints) <= MOST_JOINTS

    @property
    def is_surely_stable(self) -> bool:
        """Whether no bar is compressed, and the joints are stable with the membrane held."""
        return not self.compressed and self._is_small and not len(self._falling)

    @cached_property
    def _falling(self) -> Array:
        """Joint modes (k, n, 3) of no or negative stiffness, the worst first; other ends held."""
        joints = self.scene.joints
        free = ~np.array([joint.held for joint in joints], dtype=bool).reshape(-1)
        matrix = np.diag(np.repeat(-self.least, 3))
        for bar in self.scene.bars:
            length = max(bar.length, SHORTEST * bar.L0)
            d = (bar.points[1] - bar.points[0]) / length
            slack = bar.bar.tension_only and length < (1 - TOL.slight) * bar.L0
            across = bar.force / length
            block = ((not slack) * bar.bar.EA / bar.L0 - across) * np.outer(d, d)
            block += across * np.eye(3)
            at = [(self._number[end], sign) for end, sign in ((bar.start, 1.0), (bar.end, -1.0))
                  if isinstance(end, Joint)]  # fmt: skip
            for a, sign in at:
                for b, other in at:
                    matrix[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * other * block
        values, vectors = np.linalg.eigh(matrix[np.ix_(free, free)])
        ways = np.zeros((int(np.sum(values < 0.0)), 3 * len(joints)))
        ways[:, free] = vectors[:, values < 0.0].T
        return ways.reshape(len(ways), len(joints), 3)

    def of_joints(self) -> list[StateWarning]:
        """Warnings for a frame detached from the membrane."""
        return [self._warning(dict(zip(self.scene.joints, self._falling[0], strict=True)))] if len(
            self._falling
        ) else []  # fmt: skip

    @property
    def suspects(self) -> list[BarEnd]:
        """Bar ends that may be unstable: those of the most compressed bars, and joints."""
        worst = sorted(self.compressed, key=lambda bar: bar.force / bar.length)[:MOST_BARS]
        ends = [end for bar in worst for end in (bar.start, bar.end)]
        return list(dict.fromkeys(
            end for end in [*ends, *self.scene.joints[: 2 * MOST_BARS]]
            if not (isinstance(end, Joint) and end.held.all())
        ))  # fmt: skip

    def of_ends(self, ends: Sequence[BarEnd], compliance: Array) -> StateWarning:
        """Warning from the compliance of bar ends, (3 n, 3 n)."""
        way = np.linalg.eigh(compliance)[1][:, 0].reshape(-1, 3)
        return self._warning(dict(zip(ends, way, strict=True)))

    def _warning(self, way: dict[BarEnd, Array]) -> StateWarning:
        """Warning that names the bar or joint that moves in a mode."""

        def falls(bar: PlacedBar) -> float:
            moved = way.get(bar.end, np.zeros(3)) - way.get(bar.start, np.zeros(3))
            length = max(bar.length, SHORTEST * bar.L0)
            along = moved @ (bar.points[1] - bar.points[0]) / length
            return float(bar.force / length * (moved @ moved - along**2))

        bar = min(self.compressed, key=falls, default=None)
        among: list[BarEnd] = list(way)
        if bar is not None and falls(bar) < 0.0:
            among = [end for end in (bar.start, bar.end) if end in way]
        end = max(among, key=lambda one: float(np.linalg.norm(way[one])))
        place = end.name if isinstance(end, Joint) else f"the vertex at {as_text(end.place)}"
        size = float(np.abs(way[end]).max())
        turn = as_text(np.round(way[end] / (size or 1.0), 2))
        if bar is not None and falls(bar) < 0.0:
            text = (
                f"the equilibrium is not stable: {bar.name!r}, under a compression of "
                f"{-bar.force:.4g}, gives way at {place!r}, in the direction {turn}"
            )
        else:
            text = f"nothing holds {place!r} in the direction {turn}"
        slack = [one.name for one in self.scene.bars if one.slack and end in (one.start, one.end)]
        remedy = f"tighten {', '.join(map(repr, slack))}" if slack else "add guys"
        return StateWarning(
            "instability", f"{text}; {remedy}, or add a support there, before loading it."
        )


def instabilities(system: System, tolerance: float) -> list[StateWarning]:
    """Warnings for the instabilities that bars, joints and ponds cause in a scene's state.
    Collective. Units: tolerance (force)."""
    ponds = [] if system.ponds is None else [one for one in system.ponds.ponds if one.pond.factor]
    frame = _FrameStability(system.scene, tolerance) if system.scene.bars else None
    told = []
    if frame is not None and frame.is_alone:
        told, frame = frame.of_joints(), None
    elif frame is not None and frame.is_surely_stable:
        frame = None
    if ponds or frame is not None:
        told += _by_tangents(system, ponds, frame)
        system.potential.evaluate()
        system.reset_h0()
    return told


def _by_tangents(
    system: System, ponds: list[Ponding], frame: _FrameStability | None
) -> list[StateWarning]:
    """Warnings for each suspect whose removal lowers the number of negative eigenvalues."""
    assert system.minimizer is not None
    potential, h0, told = system.potential, system.minimizer.h0, list[StateWarning]()
    springs = np.full(system.unknowns.n_owned, np.nan)
    if frame is not None and system.bars is not None and system.scene.comm.rank == 0:
        springs[system.bars.blocks.joint_blocks] = -frame.least
    with ExitStack() as stack:
        for term in () if system.ponds is None else system.ponds.ponds:
            if term.pond.given == "level":  # a dry roof exactly at its level counts as wet
                level = term.pond.level + TOUCH * system.scene.membrane.size
                stack.enter_context(_with(term, pond=replace(term.pond, level=level)))
        if system.bars is not None:  # what hardly slack guys restrain hardly moves
            stack.enter_context(_with(system.bars.energy, loose=TOL.slight))
        tangent = ExactTangent(potential, h0, springs)
        for term in ponds:
            if tangent.negative == 0:
                break
            stack.enter_context(_with(term, pond=replace(term.pond, factor=0.0)))
            before, tangent = tangent, ExactTangent(potential, h0, springs)
            if tangent.negative < before.negative:
                told.append(StateWarning("pond", WATER.format(term.pond.name)))
            before.destroy()
        if tangent.negative and frame is not None and system.bars is not None:
            # with the loss of lateral stiffness by compression
            stack.enter_context(_with(system.bars.energy, least=0.0))
            other, ends = ExactTangent(potential, h0, np.abs(springs)), frame.suspects
            if other.negative < tangent.negative:
                compliance = tangent.compliance(system.bars.blocks_of(ends))
                told.append(frame.of_ends(ends, compliance))
            other.destroy()
        tangent.destroy()
    return told


@contextmanager
def _with(term: BarEnergy | Ponding, **values: object) -> Iterator[None]:
    """Give a term's attributes other values for the block."""
    before = {name: getattr(term, name) for name in values}
    vars(term).update(values)
    try:
        yield
    finally:
        vars(term).update(before)
