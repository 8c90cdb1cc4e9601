"""Limit states, design values of fabrics and cables, limits in service, and reinforced corners."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, outer_first
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, checked
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.tolerances import SAME_VALUE

Strengths = tuple[float, float]
"""Strengths in warp and weft (force per length)."""

ALL = ""
"""Key of strengths that hold for the whole membrane; not a valid part name."""

SERVICE = ("characteristic", "frequent", "quasi-permanent")
"""Serviceability limit states: limits of the user's count, strengths do not."""

LIMIT_STATES = (
    "ULS", "ULS 6.10a/b", "strength", "allowable stress", "accidental", "erection", *SERVICE,
)  # fmt: skip
"""What a combination can be for; the first is the default."""

AIR = ("pressure", "temperature", "atmosphere")
"""Names of the air's quantities in combinations and `Solver.advance`."""

SETTINGS = (*AIR, "state", "prestress", "without")
"""Names in combinations that are no loads: also the limit state, the factor of the prestress, and
what is missing."""

PERMANENT = "permanent"
"""Name among durations and temperatures of what always acts: prestress and inner pressure."""

BREAKS_AT = (0.002, 2.0)
"""Strains at which fabrics and foils break: outside, strength and stiffness have other units."""


def fits(load: str, name: str) -> bool:
    """Whether a name means a load: its own name, or the kind that this begins with."""
    return load == name or load.startswith(f"{name} ")


@dataclass(frozen=True)
class DesignStrength:
    """Design strengths of a fabric in a combination.

    Attributes
    ----------
    strength
        Characteristic strengths in warp and weft (force per length).
    factors
        Divisors by name, "gamma_M", "k_biax" ...; they multiply.
    durations
        Factors k_long of all acting loads, of which that of the leading one counts.
    """

    strength: Strengths
    factors: Mapping[str, float] = field(default_factory=dict)
    durations: Mapping[str, float] = field(default_factory=dict)

    @property
    def divisor(self) -> float:
        """Product of the factors."""
        return float(np.prod([*self.factors.values()]))

    @property
    def design(self) -> Strengths:
        """Design strengths in warp and weft (force per length)."""
        warp, weft = self.strength
        return warp / self.divisor, weft / self.divisor


@checked
@dataclass(frozen=True)
class FabricDesign:
    """Design strength of a fabric: f_d = f_k / (gamma_M k_biax k_age k_long k_temp k_size).

    The factors divide, each 1 or more, and multiply. k_long is that of the leading load: of those
    that act shorter than "permanent" the one with the largest load factor, of several the shortest.
    An accompanying load, whose factor is smaller, shortens nothing. Loads that act longer than the
    leading one are judged by the combinations that they lead, and "permanent" by one without
    shorter loads; `Solver.judge` names those that are missing.

    k_temp is that of an acting temperature load (whose name begins with "temperature"), else the
    smallest one of the acting loads: where snow lies, the wind is cold, too.

    Parameters
    ----------
    strength
        Characteristic strengths in warp and weft of uniaxial tests (force per length).
    gamma_M
        Partial factor of the material, or one for each limit state that is judged, as in ``{"ULS":
        1.4, "accidental": 1.1}``.
    biaxial, ageing, size
        Factors k_biax of biaxial stress, k_age of weather, and k_size of large panels.
    duration, temperature
        Factors k_long and k_temp by loads, or kinds that names of loads begin with. "permanent"
        stands for prestress and pressure, which always act; loads with its k_long do, too.
        `Solver.combine` refuses combinations with a load that is not named.

    Raises
    ------
    InputError
        A strength that is not positive, or a factor below 1, as if it multiplied strengths.

    Notes
    -----
    The product is that of CEN/TS 19102 and of the factors A_0 to A_3 of J. Minte (1981), which also
    apply by load case. No copy was available: neither it nor the rule for k_long was compared with
    them. Rules for timber differ: the shortest load decides by EN 1995-1-1, 3.1.3(2), the leading
    one by the time effect factors of the NDS. The latter never gives more strength. Take the values
    from tests of the fabric.

    Examples
    --------
    >>> fabric = codes.FabricDesign(
    ...     (84.0, 80.0), gamma_M=1.4, biaxial=1.2, ageing=1.1,
    ...     duration={"permanent": 1.7, "snow": 1.5, "wind": 1.0},
    ...     temperature={"permanent": 1.1, "snow": 1.0, "wind": 1.1},
    ... )
    >>> [round(one, 1) for one in fabric.of("ULS", ["snow"]).design]
    [30.3, 28.9]
    >>> fabric.of("ULS", {"snow": 1.5, "wind": 0.9}).factors["k_long"]
    1.5
    """

    strength: Strengths
    gamma_M: float | Mapping[str, float]
    biaxial: float = 1.0
    ageing: float = 1.0
    duration: Mapping[str, float] = field(default_factory=dict)
    temperature: Mapping[str, float] = field(default_factory=dict)
    size: float = 1.0

    def __post_init__(self) -> None:
        checked_pair("FabricDesign: strength", self.strength)
        for name in ("gamma_M", "biaxial", "ageing", "duration", "temperature", "size"):
            given = getattr(self, name)
            if name in ("duration", "temperature"):
                checks.collection(
                    f"FabricDesign: {name}", given, Mapping, f'{name}={{"snow": 1.5}}'
                )
                if given and PERMANENT not in given:
                    raise InputError(
                        f'FabricDesign: {name} = {given!r} lacks "{PERMANENT}", of prestress and '
                        "pressure, which always act."
                    )
            for key, value in given.items() if isinstance(given, Mapping) else [("", given)]:
                if name == "gamma_M" and key:
                    checks.one_of("FabricDesign: limit state of gamma_M", key, LIMIT_STATES)
                what = f"FabricDesign: {name}{f' of {key!r}' if key else ''}"
                if checks.positive(what, value) < 1.0:
                    raise InputError(
                        f"{what} = {value:g} is below 1; factors divide strengths: pass "
                        f"{1 / value:.3g}."
                    )

    def of(self, state: str, loads: Mapping[str, float] | Iterable[str]) -> DesignStrength:
        """The design strength in a limit state under acting loads: their factors by names, or the
        names of loads that all lead.

        Raises
        ------
        InputError
            No gamma_M for the limit state, or a load that two names of factors mean.
        """
        gamma = self.gamma_M
        acting = dict(loads) if isinstance(loads, Mapping) else dict.fromkeys(loads, 1.0)
        if isinstance(gamma, Mapping):
            key = next((one for one in gamma if fits(state, one)), state)
            gamma = checks.named("partial factor gamma_M of the limit state", gamma, key)
        found = {"gamma_M": float(gamma), "k_biax": self.biaxial, "k_age": self.ageing}
        durations = _by_load("duration", self.duration, acting)
        found["k_long"] = _of_leading(durations, acting)
        warmth = _by_load("temperature", self.temperature, acting)
        known = [k for load, k in warmth.items() if fits(load, "temperature")]
        found["k_temp"] = max(known) if known else min(warmth.values(), default=1.0)
        return DesignStrength(self.strength, found | {"k_size": self.size}, durations)

    def check_loads(self, call: str, state: str, acting: Mapping[str, float]) -> None:
        """Refuse a combination without its design value."""
        for name in ("duration", "temperature"):
            given = getattr(self, name)
            unknown = [load for load in acting if not any(fits(load, one) for one in given)]
            if given and unknown:
                raise InputError(
                    f"{call}: the fabric has no {name} factor of the load {unknown[0]!r}, so no "
                    f"design strength; add it to FabricDesign({name}=...), which has "
                    f"{', '.join(map(repr, given))}."
                )
        try:
            self.of(state, acting)
        except InputError as error:
            raise InputError(f"{call}: {error}") from None

    def table(self, combinations: Mapping[str, Mapping[str, Any]]) -> str:
        """The design strength of each combination that strengths judge, with every factor, as text.

        Examples
        --------
        >>> table = {"snow": {"snow": 1.5}, "storm": {"snow": 0.75, "wind": 1.5}}
        >>> design = codes.FabricDesign(
        ...     (84.0, 80.0), gamma_M=1.4, duration={"permanent": 1.7, "snow": 1.5, "wind": 1.0}
        ... )
        >>> print(design.table(table))
                gamma_M  k_biax  k_age  k_long  k_temp  k_size   warp   weft
        snow        1.4       1      1     1.5       1       1     40   38.1
        storm       1.4       1      1       1       1       1     60  57.14
        """
        rows = {}
        for name, given in combinations.items():
            state = str(given.get("state", LIMIT_STATES[0]))
            if state not in SERVICE:
                rows[name] = self.of(state, acting_loads(given))
        heads = [*next(iter(rows.values()), DesignStrength(self.strength)).factors, "warp", "weft"]
        wide = max(map(len, rows), default=0)
        lines = [" " * wide + "".join(f"  {head:>5}" for head in heads)]
        for name, one in rows.items():
            values = [*one.factors.values(), *one.design]
            cells = zip(heads, values, strict=True)
            lines.append(
                name.ljust(wide) + "".join(f"  {x:>{max(5, len(h))}.4g}" for h, x in cells)
            )
        return "\n".join(lines)


def acting_loads(given: Mapping[str, Any]) -> dict[str, float]:
    """Factors other than 0 of the loads in a combination, by name."""
    return {name: x for name, x in given.items() if name not in SETTINGS and x != 0.0}


def _by_load(what: str, given: Mapping[str, float], acting: Iterable[str]) -> dict[str, float]:
    """Factors of what acts, by load; none if there are none at all."""
    found = {PERMANENT: given[PERMANENT]} if PERMANENT in given else {}
    for load in acting:
        own = [name for name in given if name != PERMANENT and fits(load, name)]
        if len(own) > 1:
            raise InputError(
                f"FabricDesign: {' and '.join(map(repr, own))} are two {what} factors of the load "
                f"{load!r}; leave one out."
            )
        if own:
            found[load] = given[own[0]]
    return found


def _of_leading(durations: Mapping[str, float], acting: Mapping[str, float]) -> float:
    """k_long of the leading load, of those that act shorter than the permanent ones; without any
    the largest."""
    lasting = durations.get(PERMANENT, 1.0)
    shorter = {load: abs(acting[load]) for load, k in durations.items() if k < lasting}
    leading = max(shorter.values(), default=0.0) * (1.0 - SAME_VALUE)
    led = [durations[load] for load, size in shorter.items() if size >= leading]
    return min(led) if led else max(durations.values(), default=1.0)


@checked
@dataclass(frozen=True)
class CableDesign:
    """Design value of a cable's tension by EN 1993-1-11.

    F_Rd = min(F_uk / (1.5 gamma_R), F_k / gamma_R), (6.2), with F_uk = k_e F_min; in service k_e
    F_min times the limit of 7.2.

    Parameters
    ----------
    breaking
        Minimum breaking force F_min of the rope (force).
    proof
        Characteristic proof strength F_k, such as F_0.2k (force); None: it does not govern.
    gamma_R
        1.0, or 0.9 if measures reduce bending at the anchorages, table 6.2.
    ending
        Loss factor k_e of the end fittings, table 6.3: 1.0 of sockets, 0.9 of swaged and
        ferrule-secured ends, 0.8 of U-bolt grips.
    service
        Limit of the stress in service over the breaking strength, table 7.2: 0.45, or 0.5 where
        bending stresses are taken into account.
    construction, diameter
        What the rope is, such as "spiral strand 1x19", and its diameter (length); for reports.
    area, modulus
        Metallic area (length squared) and modulus of elasticity of the rope, not of its wires, by
        3.2.2 (force per area). They do not change results: `Cable` takes their product,
        `stiffness`, as its EA.

    Notes
    -----
    From memory, and compared with hand calculation only: compare it with your copy of the code.

    Examples
    --------
    >>> strand = codes.CableDesign(
    ...     breaking=220.0, ending=0.9, construction="spiral strand 1x19", diameter=0.016,
    ...     area=153e-6, modulus=150e6,
    ... )  # kN, m
    >>> strand.of("ULS"), strand.of("characteristic"), round(strand.stiffness)
    (132.0, 89.1, 22950)
    """

    breaking: Positive
    proof: Positive | None = None
    gamma_R: Positive = 1.0
    ending: Positive = 1.0
    service: Positive = 0.45
    construction: str = ""
    diameter: Positive | None = None
    area: Positive | None = None
    modulus: Positive | None = None

    def __post_init__(self) -> None:
        for name in ("ending", "service"):
            checks.within(f"CableDesign: {name}", getattr(self, name), 0.0, 1.0)

    @property
    def stiffness(self) -> float:
        """Metallic area times modulus (force).

        Raises
        ------
        InputError
            One of them is not given.
        """
        if self.area is None or self.modulus is None:
            raise InputError(
                f"CableDesign: the stiffness needs the metallic area and the modulus of the rope, "
                f"which are {self.area} and {self.modulus}; pass area=... and modulus=... ."
            )
        return self.area * self.modulus

    def of(self, state: str) -> float:
        """Design value in a limit state (force)."""
        broken = self.breaking * self.ending
        if state in SERVICE:
            return self.service * broken
        first = broken / (1.5 * self.gamma_R)
        return first if self.proof is None else min(first, self.proof / self.gamma_R)


@dataclass(frozen=True)
class Limits:
    """Limits in service, of `Scene.set_limits`; None and names that are missing: no limit.

    Attributes
    ----------
    deflection
        Largest displacement from the state in operation (length), by part of the mesh or joint;
        key "" for the whole membrane.
    prestress
        Smallest section force (force per length), by part; key "" for the whole membrane.
    slope
        Smallest slope for drainage (degrees).
    water
        Depth up to which water may stand (length).
    """

    deflection: Mapping[str, float] = field(default_factory=dict)
    prestress: Mapping[str, float] = field(default_factory=dict)
    slope: float | None = None
    water: float | None = None


def checked_pair(what: str, pair: Any) -> Strengths:
    """Two positive strengths."""
    if np.shape(pair) != (2,):
        raise InputError(f"{what} = {pair!r}; pass two, of warp and weft.")
    warp, weft = (checks.positive(what, x) for x in pair)
    return warp, weft


def checked_strengths(
    call: str, strengths: Any, mesh: MembraneMesh, materials: Iterable[Any] = ()
) -> dict[str, FabricDesign]:
    """Checked strengths by part, or under `ALL` those of the whole membrane; pairs are design
    strengths, with the partial factor 1."""
    given: dict[str, Any] = {ALL: strengths}
    if isinstance(strengths, Mapping):
        parts = outer_first(mesh, call, "pair of strengths", strengths)
        given = {part: strengths[part] for part in parts}
    found = {}
    for part, one in given.items():
        owner = repr(part) if isinstance(strengths, Mapping) else "the membrane"
        if isinstance(one, FabricDesign):
            _check_units(f"{call}: strength of {owner}", one.strength, materials)
            found[part] = one
        else:
            pair = checked_pair(f"{call}: strength of {owner}", one)
            found[part] = FabricDesign(pair, gamma_M=1.0)
    if not found:
        raise InputError(
            f"{call}: strengths = {strengths!r} names no part; pass those of one or more."
        )
    return found


def _check_units(what: str, pair: Strengths, materials: Iterable[Any]) -> None:
    """Refuse strengths at which none of the materials would break at a possible strain."""
    laws = [x.stiffness for x in materials if hasattr(x, "stiffness")]
    strains = [min(pair) / max(law[0, 0], law[1, 1]) for law in laws]
    low, high = BREAKS_AT
    if strains and not any(low <= strain <= high for strain in strains):
        raise InputError(
            f"{what} = {pair!r} means that the fabric breaks at a strain of {strains[0]:.2g}; have "
            "strength and stiffness the same units? 84 kN/m is 4200 N per 5 cm."
        )


def checked_cables(call: str, cables: Any, ropes: Iterable[str]) -> dict[str, float | CableDesign]:
    """Checked design values of cables and guys by their names, or under `ALL` those of all."""
    given = {} if cables is None else cables if isinstance(cables, Mapping) else {ALL: cables}
    known = dict.fromkeys(ropes)
    for name in given if isinstance(cables, Mapping) else ():
        checks.named("cable or guy", known, name)
    return {
        name: one
        if isinstance(one, CableDesign)
        else checks.positive(f"{call}: strength of the cable {name!r}", one)
        for name, one in given.items()
    }


def patch_radii(
    call: str, patches: float | Mapping[str, float] | None, mesh: MembraneMesh
) -> dict[str, float]:
    """Checked radii of reinforcement by group of points, or under `ALL` that of every corner."""
    given: dict[str, Any] = {**patches} if isinstance(patches, Mapping) else {ALL: patches}
    found = dict[str, float]()
    for name, radius in given.items():
        if isinstance(patches, Mapping):
            checks.named("group of points", mesh.points, name)
        if radius is not None:
            found[name] = checks.finite(f"{call}: patches, radius", radius)
            if found[name] < 0.0:
                raise InputError(
                    f"{call}: patches, radius = {radius:g} is negative; pass 0 or more."
                )
    return found
