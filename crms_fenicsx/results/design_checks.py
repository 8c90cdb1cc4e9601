"""Checks of the design: effects against design values and limits, and what governs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.strengths import ALL, SERVICE
from crms_fenicsx.model.tolerances import SAME_VALUE
from crms_fenicsx.results.cable_and_bar_results import Force
from crms_fenicsx.results.membrane_results import MembraneResults
from crms_fenicsx.results.recovered_values import (
    JudgedUtilisation,
    patches,
    recovered,
    reinforced,
)

Item = TypeVar("Item")

LASTING = "quasi-permanent"
"""State in which prestress must remain, and water must drain."""

LEAST = ("prestress", "slope")
"""What must not fall below its limit."""


@dataclass(frozen=True, repr=False)
class Extreme:
    """An extreme value.

    Attributes
    ----------
    value
        The value.
    at
        Its present place on the surface (length).
    """

    value: float
    at: Force

    def __repr__(self) -> str:
        return f"{self.value:.4g} at ({', '.join(f'{x:.4g}' for x in self.at)})"


@dataclass(frozen=True, repr=False)
class DesignCheck:
    """A check of the design in one combination.

    Attributes
    ----------
    what
        Of ultimate limit states "fabric warp", "fabric weft", "fabric" (isotropic), "cable", "bar
        tension", "bar compression"; of serviceability "deflection", "prestress", "slope",
        "ponding", and "cable" with the limit of the stress in service.
    member
        Part of the mesh ("" for the whole membrane), cable, bar or joint.
    effect
        Section force at the place that governs (force per length), tension, force of the bar
        without its sign (force), displacement, depth of water (length), or slope (degrees).
    limit
        Design value or limit of the effect, with the same unit; a bar's with its buckling.
    at
        Present place (length); None for cables, bars and joints.
    """

    what: str
    member: str
    effect: float
    limit: float
    at: Force | None = None

    @property
    def share(self) -> float:
        """Effect over limit, or of prestress and slope limit over effect; 1 is the most allowed."""
        over, under = (self.limit, self.effect) if self.what in LEAST else (self.effect, self.limit)
        if over <= 0.0:
            return 0.0
        return over / under if under > 0.0 else np.inf

    @property
    def passed(self) -> bool:
        """Whether the effect is within its limit."""
        return self.share <= 1.0

    def __repr__(self) -> str:
        """One line."""
        sign = ">=" if self.what in LEAST else "<="
        word = f"{self.what} {self.member}".strip()
        share = f"{self.share:.1%}" if self.share < 10.0 else "more than 1000%"
        text = f"{word}: {self.effect:.4g} {sign} {self.limit:.4g}, {share}"
        return text if self.at is None else f"{text} at {as_text(self.at)}"


def checks_of(
    scene: Scene,
    results: MembraneResults,
    found: Any,
    used: JudgedUtilisation | None,
    extremes: Mapping[tuple[str, str], Extreme],
    drainage: tuple[float, Force] | None,
) -> tuple[DesignCheck, ...]:
    """All checks of the present state, whose `Summary` is found but for them, with its utilisation
    if there are strengths, and the least slope of its drainage if that is limited. Collective."""
    checks = [] if used is None else [*_fabric(results, used)]
    for cable in found.cables.values():
        if cable.strength is not None:
            checks.append(DesignCheck("cable", cable.name, cable.largest, cable.strength))
    for bar in found.bars.values():
        if bar.utilisation is not None and bar.force != 0.0:
            how, size = "tension" if bar.force > 0.0 else "compression", abs(bar.force)
            checks.append(DesignCheck(f"bar {how}", bar.name, size, size / bar.utilisation))
    if found.state in SERVICE:
        checks = [*_limits(scene, found, extremes, drainage), *checks]
    return tuple(checks)


def _fabric(results: MembraneResults, used: JudgedUtilisation) -> Iterator[DesignCheck]:
    """Checks of the parts' fabric, along warp and weft each where it is most utilised, and of
    isotropic material. Collective."""
    dofs = results.membrane.V.dofmap.list[: len(results.state)]
    for part in results.design:
        cells = slice(None) if part == ALL else results.parts[part]
        places = results.surface.points[dofs[cells]].reshape(-1, 3)
        for k, what in enumerate(("fabric warp", "fabric weft", "fabric")):
            ratios = np.where(used.patched, np.nan, used.ratios[:, :, k])[cells]
            if not results.comm.allreduce(int(np.isfinite(ratios).sum())):
                continue
            most = extreme(results.comm, ratios.ravel(), places, largest=True)
            there = (ratios.ravel() == most.value) & (places == most.at).all(axis=1)
            own = np.repeat(used.limits[cells, k], 3)[there]
            limit = results.comm.allreduce(float(own.min(initial=np.inf)), op=MPI.MIN)
            yield DesignCheck(what, part, most.value * limit, limit, most.at)


def governing_of(items: Iterable[Item], size: Callable[[Item], float]) -> Item:
    """The first of the items whose size is the largest, up to the solver's tolerance: mirrored
    combinations govern together, and all tables name the first."""
    every = [(size(one), one) for one in items]
    most = max(x for x, _ in every)
    return next(one for x, one in every if x == most or most - x <= SAME_VALUE * abs(most))


def extreme(comm: MPI.Intracomm, values: Array, places: Array, *, largest: bool) -> Extreme:
    """Largest or least value on all ranks, ties broken by the least place; NaN ignored."""
    sign = 1.0 if largest else -1.0
    own = (-np.inf, (0.0, 0.0, 0.0))
    ranked = np.where(np.isnan(values), -np.inf, sign * values)
    if len(ranked):
        ties = np.flatnonzero(ranked == ranked.max())
        k = int(ties[np.lexsort(places[ties].T[::-1])[0]])
        own = (float(ranked[k]), tuple(places[k].tolist()))
    value, at = min(comm.allgather(own), key=lambda one: (-one[0], one[1]))
    return Extreme(sign * value, at)


def _limits(
    scene: Scene,
    found: Any,
    extremes: Mapping[tuple[str, str], Extreme],
    drainage: tuple[float, Force] | None,
) -> Iterator[DesignCheck]:
    """Checks of the limits in service."""
    limits = scene.design.limits
    given = {"deflection": limits.deflection, "prestress": limits.prestress}
    for (what, name), one in extremes.items():
        if name in given[what]:
            joint = name != ALL and name not in scene.mesh.parts
            at = None if joint else one.at
            yield DesignCheck(what, name, one.value, given[what][name], at)
    if limits.slope is not None and drainage is not None:
        yield DesignCheck("slope", ALL, drainage[0], limits.slope, drainage[1])
    if limits.water is not None:
        deepest = found.hollows[0] if found.hollows else None
        depth, at = (0.0, None) if deepest is None else (deepest.depth, deepest.at)
        yield DesignCheck("ponding", ALL, depth, limits.water, at)


def in_service(
    scene: Scene, results: MembraneResults
) -> dict[tuple[str, str], tuple[Array, Array]]:
    """This rank's values and present places (k, 3) that limits in service are for, by "deflection"
    or "prestress" and the name of a part or joint; none without a state in operation. Collective.

    Of prestress: minor principal section forces recovered at vertices out of reinforcement."""
    base, limits, membrane = scene.case.base, scene.design.limits, scene.membrane
    if base is None:
        return {}
    moved = np.linalg.norm(membrane.u.x.array.reshape(-1, 3) - base.membrane.u, axis=1)
    places, n = membrane.positions(), len(results.state)
    dofs = membrane.V.dofmap.list[:n]
    found = {}
    for name in {ALL: None, **limits.deflection}:
        if name == ALL or name in results.parts:
            own = np.unique(dofs[results.parts[name]] if name else dofs)
            found["deflection", name] = moved[own], places[own]
    for joint, before in base.frame.joints.items():
        if joint.name in limits.deflection and joint in scene.joints:
            way = np.linalg.norm(joint.position - before.position, keepdims=True)
            found["deflection", joint.name] = way, joint.position[None]
    if limits.prestress and scene.case.state == LASTING:
        least = recovered(results, "true force 2")
        least[reinforced(membrane.stress_free, patches(scene))[dofs]] = np.nan
        for name in limits.prestress:
            cells = results.parts[name] if name else np.arange(n)
            values = least[cells].ravel(), places[dofs[cells]].reshape(-1, 3)
            found["prestress", name] = values
    return found
