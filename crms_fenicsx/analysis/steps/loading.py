"""Check the loads of `Solver.advance`: factors, pressure, fans and sealed air."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import NoReturn, TypeVar

import numpy as np
from dolfinx.fem import locate_dofs_topological

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.movements import Move, Movements, checked_movements
from crms_fenicsx.energy.terms.pressure import rim_of
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import EPSILON
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.changed_materials import numbers, with_numbers
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import UFL_LAW
from crms_fenicsx.model.membrane_load import MembraneLoad, Pond
from crms_fenicsx.model.sealed_air import FanControl, SealedAir
from crms_fenicsx.model.temperature import MOST_CHANGE

LoadT = TypeVar("LoadT", MembraneLoad, Pond)


def between(first: float, last: float, share: float) -> float:
    """Load at a share of the step, exactly zero if only rounding is left."""
    value = first + share * (last - first)
    rounding = 4 * EPSILON * max(abs(first), abs(last))
    return 0.0 if abs(value) <= rounding else value


@dataclass(frozen=True)
class _InnerPressure:
    """Inner pressure over a call of `Solver.advance`."""

    # first, last: pressure at start and end (force per area); with fans, in addition to theirs
    first: float
    last: float
    fans: tuple[FanControl, ...] = ()  # controls of the fans
    air: tuple[SealedAir, SealedAir] | None = None  # at start and end, if any

    @property
    def acts(self) -> bool:
        """Whether there is inner pressure at the end."""
        return self.last != 0.0 or bool(self.fans) or self.air is not None

    def apply(self, scene: Scene, share: float) -> None:
        """Set the pressure at a share of the step, after the other loads. Collective."""
        if self.air is not None:
            first, last = self.air
            sealed = replace(
                last,
                temperature=between(first.temperature, last.temperature, share),
                atmosphere=between(first.atmosphere, last.atmosphere, share),
            )
            scene.air.update(sealed=sealed, pressure=sealed.pressure(scene.volume))
        elif self.fans:
            rest = between(self.first, self.last, share)
            scene.air.update(pressure=FanControl.highest(self.fans, scene.factors) + rest)
        else:
            scene.air.update(pressure=between(self.first, self.last, share))


def _checked_pressure(
    scene: Scene,
    pressure: float | FanControl | Sequence[FanControl] | None,
    temperature: float | None,
    atmosphere: float | None,
) -> _InnerPressure:
    """Check the inner pressure given to `Solver.advance`."""
    air, given = scene.air.sealed, {"temperature": temperature, "atmosphere": atmosphere}
    for name, value in given.items():
        if value is not None and air is None:
            raise InputError(
                f"advance: {name} = {value!r}, but the air is not sealed; call "
                "scene.seal(volume=...) first, or set the pressure."
            )
    if air is not None:
        if pressure is not None:
            raise InputError(
                f"advance: pressure = {pressure!r}, but the air is sealed, and its pressure "
                "follows from its volume; call scene.unseal() first."
            )
        changed = {
            name: checks.positive(f"advance: {name}", value)
            for name, value in given.items()
            if value is not None
        }
        if not 0.5 <= changed.get("temperature", 1.0) <= 2.0:
            raise InputError(
                f"advance: temperature = {temperature!r}; pass the air's absolute temperature over "
                "that at sealing, from 0.5 to 2: 1.07 for 20 degrees more at 293 K."
            )
        return _InnerPressure(scene.pressure, scene.pressure, air=(air, replace(air, **changed)))
    if isinstance(pressure, FanControl | Sequence) and not isinstance(pressure, str):
        fans = (pressure,) if isinstance(pressure, FanControl) else tuple(pressure)
        checks.collection("advance: pressure", fans, Sequence, "[FanControl(...), ...]", 1)
        for one in fans:
            checks.of_type(f"advance: an item of pressure = {pressure!r}", one, FanControl)
        offset = scene.pressure - FanControl.highest(fans, scene.factors)
        return _InnerPressure(offset, 0.0, fans=fans)
    last = scene.pressure if pressure is None else checks.finite("advance: pressure", pressure)
    return _InnerPressure(scene.pressure, last)


@dataclass(frozen=True)
class _Length:
    """Unstressed length of a cable or bar over a call of `Solver.advance`."""

    one: LaidCable | PlacedBar
    first: float  # at the temperature before the call (length)
    last: float  # the same at the end
    warm: tuple[float, float] = (0.0, 0.0)  # thermal strains at start and end

    def at(self, share: float) -> float:
        """Length at a share of the step (length)."""
        return (self.first + share * (self.last - self.first)) * self.growth(0.0, share)

    def growth(self, before: float, share: float) -> float:
        """Factor by which its temperature scales it between two shares of the step."""
        strains = [between(*self.warm, one) for one in (before, share)]
        return (1.0 + strains[1]) / (1.0 + strains[0])


@dataclass(frozen=True)
class Target:
    """Initial and target loads of a call of `Solver.advance`."""

    pressure: _InnerPressure  # inner pressure
    # first and last factor of each changed load, by name
    factors: dict[str, tuple[float, float]]
    movements: Movements  # of supports and anchors
    lengths: list[_Length]  # of cables and bars
    warm: tuple[int, ...]  # numbers of the materials whose temperature changes

    def is_first_load(self, scene: Scene) -> bool:
        """Whether the call applies the first loads or ponds."""
        new = any(last != 0.0 for _, last in self.factors.values())
        return new and not any(scene.factors.values())

    def apply(self, scene: Scene, first: SceneState, before: float, share: float) -> None:
        """Set the loads at `share` of the step from state `first`, from share `before` on."""
        scene.loads.replace_each(partial(self._at, share))
        self.pressure.apply(scene, share)
        self.movements.apply(scene, first, before, share)
        for given in self.lengths:
            one, length = given.one, given.at(share)
            law = one.state.law if isinstance(one, LaidCable) else None
            if law is not None and law.axial is not None:
                # the parts between clamps scale alike, and what gets warmer does everywhere
                alike = length / one.L0 if law.parts is not None else given.growth(before, share)
                one.update(axial=replace(law.axial, rest=law.axial.rest * alike))
            one.update(L0=length)
        for number in self.warm:
            material, dT = scene.materials[number], scene.loads.warming(number)
            scene.materials[number] = with_numbers(material, numbers(material) | {"dT": dT})
        if self.warm:
            scene.versions.change_model()

    def ponds(self, scene: Scene, share: float) -> tuple[Pond, ...]:
        """The scene's ponds at a share of the step."""
        return tuple(self._at(share, pond) for pond in scene.ponds)

    def _at(self, share: float, load: LoadT) -> LoadT:
        """A load or pond at a share of the step."""
        if load.name not in self.factors:
            return load
        return replace(load, factor=between(*self.factors[load.name], share))


def checked_target(
    scene: Scene,
    pressure: float | FanControl | Sequence[FanControl] | None = None,
    move: Mapping[object, Move] = MappingProxyType({}),
    L0: Mapping[object, float] = MappingProxyType({}),
    load: float | Mapping[str, float] | None = None,
    steps: int = 1,
    temperature: float | None = None,
    atmosphere: float | None = None,
) -> Target:
    """Check the loads and return their initial and target values. Collective."""
    scene.membrane.check_finite("advance")
    braced = scene.frame.vertices and any(joint.held.any() for joint in scene.joints)
    if not braced and not scene.comm.allreduce(int(scene.held.any())):
        raise InputError(
            "advance: no part of the membrane is held; hold its boundary with "
            'scene.fix("boundary").'
        )
    inner = _checked_pressure(scene, pressure, temperature, atmosphere)
    factors = {} if load is None else _factors(scene, load)
    _check_wind(scene, factors)
    for name, given in (("move", move), ("L0", L0)):
        checks.collection(f"advance: {name}", given, Mapping, f"{name}={{what: value}}")
    scene.frame.check_held(name for cable in scene.cables for name in cable.state.laid.joints)
    movements = checked_movements(scene, move, steps)
    if inner.acts:
        _check_rim(scene)
    lengths = _warmed(scene, factors, _lengths(scene, L0))
    return Target(inner, factors, movements, lengths, _warmed_materials(scene, factors))


def _changes(
    scene: Scene, factors: Mapping[str, tuple[float, float]], one: LaidCable | PlacedBar | int
) -> tuple[float, float]:
    """First and last temperature change (kelvin) of a cable, a bar or a material."""
    first, last = 0.0, 0.0
    for load, change in scene.loads.warmings(one):
        ends = factors.get(load.name, (load.factor, load.factor))
        first, last = first + ends[0] * change, last + ends[1] * change
    if abs(last) > MOST_CHANGE:
        name = scene.membrane.parts.get(one, "the fabric") if isinstance(one, int) else one.name
        raise InputError(
            f"advance: the temperature of {name} changes by {last:g} K, the sum of factors times "
            f"changes; the law of thermal expansion holds up to {MOST_CHANGE:g} K: pass factors "
            "such as 1.0, and the kelvins to put_temperature."
        )
    return first, last


def _lengths(scene: Scene, L0: Mapping[object, float]) -> list[_Length]:
    """Unstressed lengths of cables and bars that are given."""
    found = []
    for key, length in sorted(L0.items(), key=lambda item: repr(item[0])):  # same on all ranks
        if not isinstance(key, LaidCable | PlacedBar):
            raise InputError(f"advance: L0 of {key!r}; expected a laid cable or a bar.")
        if isinstance(key, LaidCable) and key.cable.law == "step":
            raise InputError(
                f"advance: {key.name!r} has the step-wise law (2.2-2), which has no unstressed "
                'length; use Cable(law="total").'
            )
        length = checks.positive(f"advance: L0 of {key.name!r}", length)
        checks.own("advance", "cable or bar", key, (*scene.cables, *scene.bars))
        found.append(_Length(key, key.L0, length))
    return found


def _warmed(
    scene: Scene, factors: Mapping[str, tuple[float, float]], given: list[_Length]
) -> list[_Length]:
    """Lengths that are given or change with the temperature, with their thermal strains."""
    own = {length.one: length for length in given}
    members: list[LaidCable | PlacedBar] = [*scene.cables, *scene.bars]
    for one in members:
        first, last = _changes(scene, factors, one)
        if first == last:
            continue
        data, kind = (one.cable, "cable") if isinstance(one, LaidCable) else (one.bar, "bar")
        if isinstance(data, Cable) and data.law == "step":
            raise InputError(
                f"advance: a temperature change of {one.name!r}, which has the step-wise law "
                '(2.2-2) without an unstressed length; use Cable(law="total").'
            )
        if data.expansion is None:
            _refuse_unknown(f"the {kind} {one.name!r}", one.name)
        length = own.get(one, _Length(one, one.L0, one.L0))
        own[one] = replace(length, warm=(data.expansion * first, data.expansion * last))
    return [*own.values()]


def _warmed_materials(scene: Scene, factors: Mapping[str, tuple[float, float]]) -> tuple[int, ...]:
    """Numbers of the materials whose temperature changes."""
    found = []
    for number, material in scene.materials.items():
        first, last = _changes(scene, factors, number)
        if first == last:
            continue
        owner = scene.membrane.owner_of_material(number)
        if material.law == UFL_LAW or scene.strain_law == "step":
            why = "a UflMembrane" if material.law == UFL_LAW else 'strain="step"'
            raise InputError(
                f"advance: a temperature change of {owner} with {why}, which has no thermal "
                'strain; leave the fabric out by scene.put_temperature({"cables": ...}), or use '
                'an IsotropicMembrane or OrthotropicMembrane with strain="total".'
            )
        if material.expansion is None:
            _refuse_unknown(owner, scene.membrane.parts.get(number, "fabric"))
        found.append(number)
    return tuple(found)


def _refuse_unknown(owner: str, name: str) -> NoReturn:
    raise InputError(
        f"advance: a temperature change of {owner}, whose thermal expansion is unknown; pass "
        f"its expansion=..., 0.0 if it does not count, or put_temperature({{{name!r}: 0.0, ...}})."
    )


def _factors(scene: Scene, load: float | Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """First and last factors of loads and ponds, by name."""
    present = scene.factors
    if not present:
        raise InputError(
            f"advance: load = {load!r}, but the scene has no loads; add one with "
            "scene.put_load, scene.put_wind or scene.put_pond."
        )
    if not isinstance(load, Mapping):
        only = next(iter(present))
        if len(present) > 1:
            names = ", ".join(map(repr, present))
            raise InputError(
                f"advance: load = {load!r}, but there are the loads {names}; write "
                f"load={{{only!r}: {load!r}}}."
            )
        return {only: (present[only], checks.finite("advance: load", load))}
    found = {
        name: (
            checks.named("load", present, name),
            checks.finite(f"advance: load of {name!r}", factor),
        )
        for name, factor in load.items()
    }
    for pond in scene.ponds:
        if found.get(pond.name, (0.0, 0.0))[1] < 0.0:
            raise InputError(
                f"advance: load of {pond.name!r} = {load[pond.name]:g}, of water, which cannot "
                "pull; use 0 or more."
            )
    return found


def _check_wind(scene: Scene, factors: Mapping[str, tuple[float, float]]) -> None:
    """Refuse wind with a pressure that is integrated step by step."""
    for load in scene.loads:
        if load.suction is not None and scene.pressure_law != "total":
            _, factor = factors.get(load.name, (0.0, load.factor))
            if factor != 0.0:
                raise InputError(
                    f"advance: load of {load.name!r} = {factor:g}, a wind that follows the "
                    f'surface, with pressure="{scene.pressure_law}"; use pressure="total", or put '
                    "the wind in a fixed direction with scene.put_load."
                )


def has_free_rim(scene: Scene) -> bool:
    """Whether lagged pressure acts on a membrane with free edges. Collective."""
    if scene.pressure_law != "lagged" or scene.pressure == 0.0:
        return False
    return bool(scene.comm.allreduce(len(rim_of(scene.membrane).free)))


def _check_rim(scene: Scene) -> None:
    """Refuse follower pressure without a potential: its rim must be held or slide in planes."""
    if scene.pressure_law != "total":
        return
    rim = rim_of(scene.membrane)
    with raised_together(scene.comm):
        if len(rim.free):
            boundary = locate_dofs_topological(
                scene.V, 1, scene.mesh.edges["boundary"], remote=False
            )
            place = scene.membrane.stress_free[rim.free[0]]
            what, remedy = (
                (
                    "whose boundary is free at",
                    'scene.fix("boundary"), or in a plane of symmetry in its normal direction, as '
                    'by scene.fix(group, "y")',
                )
                if rim.free[0] in boundary
                else (
                    "whose cells under pressure end, or meet in a seam, at",
                    'scene.fix, or leave walls without pressure: Scene(..., pressure_on=["roof"])',
                )
            )
            raise InputError(
                f"advance: pressure on a membrane {what} {as_text(place)}: the follower pressure "
                f'needs it held ({remedy}); with free edges use Scene(..., pressure="lagged").'
            )
        edges = scene.membrane.open_edges
        sliding = {(int(a), int(b)) for a, b in edges.ids[np.isin(edges.numbers, rim.sliding)]}
        for cable in scene.cables:
            for node in cable.state.nodes:
                ids = node.interpolation()[0] if node.kind == "fold" else ()
                if tuple(sorted(ids)) in sliding:
                    raise InputError(
                        f"advance: pressure on a membrane whose edge slides in a plane, but "
                        f"{cable.name!r} runs over it and folds it; let the cable end there."
                    )
