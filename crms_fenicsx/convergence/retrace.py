"""The states in which things were put on a scene, gone through again on the finer mesh."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.checkpoint.stages import stages_of
from crms_fenicsx.convergence.carrier import Carrier
from crms_fenicsx.convergence.finer_cables import laid_first, lay_again
from crms_fenicsx.convergence.finer_frame import FinerFrame, standing
from crms_fenicsx.convergence.loading import Loading
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.model.bar_state import JointState
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.stage import Stage, same
from crms_fenicsx.runtime.errors import ConvergenceError
from crms_fenicsx.scene import Scene

logger = logging.getLogger("crms_fenicsx")

INCREMENTS = (1, 4, 16)
"""Increments in which loads are brought on, from the state before, that have led to no equilibrium
from the coarse mesh's state; one is what a script does there."""


class Retrace:
    """Brings the finer scene to the states in which things were put on the coarse one.

    Parameters
    ----------
    carrier
        Carries shapes over.
    terms
        The added terms for the finer scene.
    solve
        Finds the equilibrium of a scene at the loads that it has.

    Attributes
    ----------
    stages
        These states, in their order.
    """

    def __init__(
        self, carrier: Carrier, terms: Iterable[EnergyTerm], solve: Callable[[Scene], object]
    ) -> None:
        self._carrier, self._solve = carrier, solve
        self._coarse, self._finer = carrier.coarse, carrier.finer
        self._terms = {term.name: term for term in terms}
        self._cables: dict[str, LaidCable] = {}
        self._frame = FinerFrame(self._coarse, self._finer)
        self._sealed: list[tuple[Stage, tuple[float, Stage]]] = []
        self.stages = stages_of(self._coarse)

    def all(self) -> None:
        """Go through all of them, to the current one. Collective."""
        for stage in self.stages:
            self._go_to(stage)
            self._put(stage)
        self._go_to(self._coarse.stage(), last=True)

    def _put(self, stage: Stage) -> None:
        """Put on the finer scene what was put on a stage, at which it is. Collective."""
        coarse, finer = self._coarse, self._finer
        for load in coarse.loads:
            if load.again is not None and load.stage is not None and same(load.stage, stage):
                finer.add_load(load.again(finer.membrane))
        self._sealed.append((stage, (finer.volume, finer.stage())))
        self._frame.place(stage)
        for cable in coarse.cables:
            if cable.laying is not None and same(cable.laying.stage, stage):
                first = laid_first(cable, finer, self._carrier.refinement)
                self._cables[cable.name] = first
                finer.remove(first)

    def _go_to(self, stage: Stage, last: bool = False) -> None:
        """Bring the finer scene to a state of the coarse one, in equilibrium. Collective.

        Where it finds none in one step it goes there by increments, from the state before.

        Parameters
        ----------
        stage
            The state.
        last
            Whether it is the current one; before others the cables are taken away again.
        """
        whole, finer = stage if last else standing(self._coarse, stage), self._finer
        if not self._take(stage, whole, last):
            return
        try:
            self._solve(finer)
        except ConvergenceError as error:
            self._approach(whole, error)
        if not last:
            self._remove_cables()

    def _take(self, stage: Stage, whole: Stage, last: bool) -> bool:
        """Give the finer scene the shape and all that there is of a state; whether to solve it."""
        coarse, finer = self._coarse, self._finer
        self._carrier.take_state(stage.u, stage.cables)
        self._take_loads(whole)
        self._frame.take(whole.joints, whole.bars)
        moved = coarse.comm.allreduce(bool(stage.u.any()), op=MPI.LOR) or any(
            (joint.position != joint.first).any() for joint in finer.joints
        )
        if not last and not (moved and stage.number):
            return False
        if gone := self._gone(whole):
            logger.warning(
                "finer mesh: %s has been taken away since other things were put on the scene; "
                "these are put on the shape of the coarse mesh.", ", ".join(gone),
            )  # fmt: skip
            return False
        self._take_terms(whole)
        for cable in coarse.cables:
            if cable.name in whole.cables:
                self._lay_again(cable, whole)
        return True

    def _gone(self, stage: Stage) -> list[str]:
        """Names of what there was at a state, and is not any more."""
        finer, cables = self._finer, [cable.name for cable in self._coarse.cables]
        loads, bars = [load.name for load in finer.loads], [bar.name for bar in finer.bars]
        acting = [name for name, factor in stage.factors.items() if factor != 0.0]
        gone = [name for name in acting if name not in loads]
        gone += [name for name in stage.cables if name not in cables]
        gone += [name for name in stage.bars if name not in bars]
        return gone + [name for name in stage.terms if name not in self._terms]

    def _take_loads(self, stage: Stage) -> None:
        """Give the finer scene the loads of a state, air, water and floor."""
        finer = self._finer
        finer._pressure, finer._ponds = stage.pressure, stage.ponds
        finer._air, finer._sealed_on = self._air(stage)
        finer._loads = tuple(
            replace(load, factor=stage.factors.get(load.name, 0.0)) for load in finer.loads
        )
        finer._terms = ()  # until all that they stand on is there
        finer._floor_level = stage.floor
        if stage.floor is not None:
            heights = finer.u.x.array[2::3]
            np.maximum(heights, stage.floor - finer.membrane.stress_free[:, 2], out=heights)

    def _take_terms(self, stage: Stage) -> None:
        """Give the finer scene the added terms of a state. Collective."""
        self._finer._terms = ()
        for name in stage.terms:
            self._finer.add_term(self._terms[name])

    def _lay_again(self, cable: LaidCable, stage: Stage) -> None:
        """Lay a cable on the finer mesh as it was in a state. Collective."""
        first, state = self._cables.get(cable.name), stage.cables[cable.name]
        lay_again(cable, state, first, self._finer, self._carrier.refinement)

    def _air(self, stage: Stage) -> tuple[SealedAir | None, Stage | None]:
        """The air of a state, with the volume that the finer mesh had gained at its sealing."""
        on = stage.sealed_on
        if stage.air is None or on is None:
            return None, None
        gained, there = next(found for known, found in self._sealed if same(known, on))
        return replace(stage.air, gained=gained), there

    def _remove_cables(self) -> None:
        for cable in self._finer.cables:
            self._finer.remove(cable)

    def _approach(self, whole: Stage, error: ConvergenceError) -> None:
        """Go to a state from the one before it by increments, as users would do. Collective."""
        finer, goal = self._finer, Loading.of(self._finer)
        for steps in INCREMENTS:
            logger.warning("finer mesh: %s Going there again by %d increment(s).", error, steps)
            self._remove_cables()
            start = self._back(whole, goal)
            try:
                for k in range(steps):
                    start.take(finer, goal, (k + 1) / steps)
                    self._solve(finer)
            except ConvergenceError as again:
                error = again
            else:
                return
        raise error

    def _back(self, whole: Stage, goal: Loading) -> Loading:
        """Bring the finer scene to the state before one, with all that is to be there.

        Collective.
        """
        earlier = [stage for stage in self.stages if stage.number < whole.number]
        finer, was = self._finer, standing(self._coarse, earlier[-1]) if earlier else None
        if was is None:
            finer.u.x.array[:] = 0.0
            finer._pressure = 0.0
            finer._loads = tuple(replace(load, factor=0.0) for load in finer.loads)
        else:
            self._go_to(earlier[-1])
        bars = {b.name: b.placing.first for b in self._coarse.bars if b.placing is not None}
        joints = {j.name: JointState(j.first.copy(), np.zeros(3)) for j in self._coarse.joints}
        if was is not None:
            joints |= {joint.name: joint.state for joint in finer.joints}
            bars |= was.bars
        self._frame.take(joints, bars)
        finer._ponds = tuple(
            replace(pond, factor=finer.factors.get(pond.name, 0.0)) for pond in whole.ponds
        )
        finer._air, finer._sealed_on = goal.sealed(finer)
        self._take_terms(whole)
        for cable in self._coarse.cables:
            if was is not None and cable.name in was.cables:
                self._lay_again(cable, was)
            elif cable.name in whole.cables:
                laid, known = laid_first(cable, finer, self._carrier.refinement), self._cables
                laid.laying = known[cable.name].laying
                laid.update(L0=known[cable.name].L0)  # on the same shape: but for rounding it is
        return Loading.of(finer)
