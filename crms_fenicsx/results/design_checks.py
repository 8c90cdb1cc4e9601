"""Checks of the design: effects against design values and limits, and what governs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.strengths import ALL, SERVICE
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.results.cable_and_bar_results import Force
from crms_fenicsx.results.membrane_results import MembraneResults
from crms_fenicsx.results.recovered_values import patches, recovered, reinforced

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
    extremes: Mapping[tuple[str, str], Extreme],
    drainage: tuple[float, Force] | None,
) -> tuple[DesignCheck, ...]:
    """All checks of the present state, whose `Summary` is found but for them, with the least slope
    of its drainage if that is limited. Collective."""
    checks = _strengths(scene, results, found)
    if found.state in SERVICE:
        checks = [*_limits(scene, found, extremes, drainage), *checks]
    return tuple(checks)


def _strengths(scene: Scene, results: MembraneResults, found: Any) -> list[DesignCheck]:
    """Checks of fabric, cables and bars by their strengths. Collective."""
    checks = []
    for part in results.design:
        own = found.parts.get(part, found.parts[ALL])
        if "utilisation" in own.largest:
            checks.append(_fabric(results, part, own.largest["utilisation"]))
    for cable in found.cables.values():
        if cable.strength is not None:
            checks.append(DesignCheck("cable", cable.name, cable.largest, cable.strength))
    for bar in found.bars.values():
        if bar.utilisation is not None and bar.force != 0.0:
            how, size = "tension" if bar.force > 0.0 else "compression", abs(bar.force)
            checks.append(DesignCheck(f"bar {how}", bar.name, size, size / bar.utilisation))
    return checks


def _fabric(results: MembraneResults, part: str, used: Extreme) -> DesignCheck:
    """The check of a part's fabric at its largest utilisation, in the direction that governs there:
    that of the larger ratio in the cells around. Collective."""
    membrane, n = results.membrane, len(results.state)
    limits: Array = np.full((n, 2), np.nan)
    for name, one in results.design.items():
        limits[slice(None) if name == ALL else results.parts[name]] = one.design
    dofs = membrane.V.dofmap.list[:n]
    away = np.linalg.norm(results.surface.points[dofs] - np.array(used.at), axis=2)
    there = (away <= SAME_PLACE * membrane.size).any(axis=1) & np.isfinite(limits[:, 0])
    there &= np.isin(np.arange(n), results.parts[part]) if part != ALL else True
    ratios = results.warp_weft[there, :2] / limits[there]
    plain = np.where(membrane.isotropic[there], 1.0, 0.0)
    weights = results.stress_free_areas[there]
    own = np.array([*np.nan_to_num(weights @ ratios), weights @ plain])
    warp, weft, isotropic = results.comm.allreduce(own)
    least = limits[there].min(axis=0, initial=np.inf)
    bounds = [results.comm.allreduce(float(x), op=MPI.MIN) for x in least]
    if isotropic > 0.0:
        what, limit = "fabric", min(bounds)
    else:
        what, limit = ("fabric warp", bounds[0]) if warp >= weft else ("fabric weft", bounds[1])
    return DesignCheck(what, part, used.value * limit, limit, used.at)


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
