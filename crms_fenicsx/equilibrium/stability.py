"""Whether bars, joints and ponds make an equilibrium one that is not stable, and which.

The energy falls on some way from such a state. A factorisation of all second derivatives tells
whether there is one; where there is, another one without a pond, or without what compression takes
off the bars' stiffness sideways, tells whether it is their doing. Joints that have nothing to do
with the membrane, and frames without compression, need no factorisation.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from crms_fenicsx.energies.ponding import Ponding
from crms_fenicsx.equilibrium.frame_stability import FrameStability
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.stability import ExactTangent
from crms_fenicsx.model.state_warning import StateWarning


def instabilities(system: System, tolerance: float) -> list[StateWarning]:
    """What bars, joints and ponds make unstable in a scene's state. Collective.

    Units: tolerance (force).
    """
    ponds = [] if system.ponds is None else [one for one in system.ponds.ponds if one.pond.factor]
    frame = FrameStability(system.scene, tolerance) if system.scene.bars else None
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
    system: System, ponds: list[Ponding], frame: FrameStability | None
) -> list[StateWarning]:
    """What is unstable by the numbers of negative eigenvalues with it and without it."""
    assert system.minimizer is not None
    potential, h0, told = system.potential, system.minimizer.h0, list[StateWarning]()
    springs = np.full(system.unknowns.n_owned, np.nan)
    if frame is not None and system.bars is not None and system.scene.comm.rank == 0:
        springs[system.bars.blocks.joint_blocks] = -frame.least
    with ExitStack() as stack:
        if system.ponds is not None:
            stack.enter_context(system.ponds.raised())
        if system.bars is not None:
            stack.enter_context(system.bars.with_hardly_slack())
        tangent = ExactTangent(potential, h0, springs)
        for term in ponds:
            if tangent.negative == 0:
                break
            assert system.ponds is not None
            stack.enter_context(system.ponds.without(term))
            before, tangent = tangent, ExactTangent(potential, h0, springs)
            if tangent.negative < before.negative:
                told.append(_of_pond(term.pond.name))
            before.destroy()
        if tangent.negative and frame is not None and system.bars is not None:
            stack.enter_context(system.bars.without_compression())
            other, ends = ExactTangent(potential, h0, np.abs(springs)), frame.suspects
            if other.negative < tangent.negative:
                compliance = tangent.compliance(system.bars.blocks_of(ends))
                told.append(frame.of_ends(ends, compliance))
            other.destroy()
        tangent.destroy()
    return told


def _of_pond(name: str) -> StateWarning:
    return StateWarning(
        "pond",
        f"the equilibrium under {name!r} is not stable: where the membrane sinks a little more "
        "water gathers than it can carry; give it more prestress or slope, or the pond a lower "
        "level, or a volume instead of one.",
    )
