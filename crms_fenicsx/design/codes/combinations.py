"""Load combinations by EN 1990 and ASCE 7, as tables for `Solver.combine`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import checked
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.combination_table import CombinationTable, Line
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.model.strengths import SERVICE, fits

Psi = tuple[float, float, float]
"""Combination factors psi_0, psi_1 and psi_2 of a variable action."""

PSI: dict[str, Psi] = {
    "imposed A": (0.7, 0.5, 0.3),
    "imposed B": (0.7, 0.5, 0.3),
    "imposed C": (0.7, 0.7, 0.6),
    "imposed D": (0.7, 0.7, 0.6),
    "imposed E": (1.0, 0.9, 0.8),
    "imposed H": (0.0, 0.0, 0.0),
    "snow": (0.5, 0.2, 0.0),
    "snow above 1000 m": (0.7, 0.5, 0.2),
    "wind": (0.6, 0.2, 0.0),
    "temperature": (0.6, 0.5, 0.0),
}
"""EN 1990, table A1.1; "imposed H": roofs, "snow": up to 1000 m above sea level."""


@dataclass(frozen=True)
class CombinationRules:
    """Combinations of a standard.

    Attributes
    ----------
    name
        Name of the standard.
    kinds
        Kinds of variable loads; for EN 1990 with their factors psi.
    states
        Limit states, such as "ULS" or "strength"; the first one is the default.
    """

    name: str
    kinds: Mapping[str, Psi | None]
    states: tuple[str, ...]

    def __repr__(self) -> str:
        return self.name


en1990 = CombinationRules(
    "EN 1990",
    PSI,
    ("ULS", "ULS 6.10a/b", "erection", "accidental", *SERVICE),
)
"""EN 1990: "ULS" is expression (6.10) with table A1.2(B), as is "erection", a transient situation
(6.4.3.2) with the loads of its duration; "accidental" (6.11b) with psi_1 of the leading load;
"characteristic" (6.14b), "frequent" (6.15b), "quasi-permanent" (6.16b)."""

_ASCE_KINDS: dict[str, None] = dict.fromkeys(("live", "roof live", "snow", "rain", "wind"))
asce7_16 = CombinationRules("ASCE 7-16", _ASCE_KINDS, ("strength", "allowable stress"))
"""ASCE 7-16: sections 2.3.1 and 2.4.1, without seismic loads."""
asce7_22 = CombinationRules("ASCE 7-22", _ASCE_KINDS, ("strength", "allowable stress"))
"""ASCE 7-22: sections 2.3.1 and 2.4.1, without seismic loads."""
asce7 = asce7_22
"""The latest edition of ASCE 7 included."""

STRENGTH = {
    "ASCE 7-16": {"snow": 1.6, "rain": 1.6, "with snow": 0.5},
    "ASCE 7-22": {"snow": 1.0, "rain": 1.6, "with snow": 0.3},
}
"""Load factors of snow and rain in 2.3.1, leading; and of snow as an accompanying load."""

ALLOWABLE = {"ASCE 7-16": {"snow": 1.0, "rain": 1.0}, "ASCE 7-22": {"snow": 0.7, "rain": 1.0}}
"""Load factors of snow and rain in 2.4.1; of rain as quoted from 7-22 in one place."""


Pressure = (
    Mapping[str, float] | FanControl | Sequence[FanControl] | Callable[[Mapping[str, float]], Any]
)
"""Inner pressure by loads, by controls of fans, or by an office's own rule."""


@checked
def combinations(
    rules: CombinationRules,
    permanent: Sequence[str],
    variable: Sequence[str] | Mapping[str, str],
    *,
    state: str | Sequence[str] | None = None,
    prestress: Sequence[float] = (1.0,),
    pressure: Pressure | None = None,
    accidents: Mapping[str, Mapping[str, object]] | None = None,
    also: Mapping[str, object] | None = None,
) -> CombinationTable:
    """Return a standard's table of load combinations, for `Solver.combine`.

    All permanent loads share one factor, the unfavourable or the favourable one. One variable load
    of each kind acts at a time, as wind comes from one direction; each kind leads in turn. Every
    combination names all loads, with the factor 0 if they do not act.

    Parameters
    ----------
    rules
        `en1990`, `asce7_16`, `asce7_22`, or `asce7`, the newest one.
    permanent
        Names of permanent loads. Prestress and inner pressure belong to the initial state of the
        combinations.
    variable
        Names of variable loads that begin with their kind ("snow", "snow drifted", "wind x"), or a
        mapping of names to kinds, out of ``rules.kinds``.
    state
        One or several of ``rules.states``; by default the first, the ultimate limit state.
    prestress
        Partial factors gamma_P of the prestress in ultimate limit states and erection, (6.10), such
        as unfavourable and favourable ``(1.35, 1.0)``. In other states it is 1.
    pressure
        Inner pressure to which fans rise under loads, by name or kind (force per area): of the
        loads that act the highest one. Other combinations keep the pressure that they start from.
        Or a `FanControl`, or several, by which the pressure follows the factors in all
        combinations. Or a rule of your own: a function of the factors of the variable loads that
        act, by name, which returns a pressure, such a control, or None to keep the pressure.
    accidents
        What happens in the state "accidental", by name, as entries of a combination:
        ``{"A5 torn": {"without": ["A5"]}, "fans fail": {"pressure": 0.0}}``.
    also
        Further entries of all combinations, such as ``{"temperature": 1.05}``.

    Returns
    -------
    CombinationTable
        A dictionary: factors of the loads and the limit "state", by names of combinations such as
        "ULS: 1.35 weight + 1.5 snow + 0.9 wind x". Reports of these combinations list the partial
        and combination factors, and what was left out of the table.

    Raises
    ------
    InputError
        No rules, an unknown state or kind, no loads at all, a repeated name, a factor or pressure
        that is not positive, fans that follow no load here, two values for one thing, or accidents
        without the state "accidental" or the reverse.

    Examples
    --------
    >>> variable = ["snow", "wind x", "wind y"]
    >>> table = codes.combinations(
    ...     codes.en1990, ["weight"], variable,
    ...     state=["ULS", "characteristic"], prestress=(1.2, 1.0),
    ... )
    >>> found = solver.combine(table)
    """
    states = [state or rules.states[0]] if state is None or isinstance(state, str) else [*state]
    for one in states:
        checks.one_of(f"combinations: state of {rules.name}", one, rules.states)
    kinds = _kinds(rules, permanent, variable)
    also, fans = also or {}, _rule({} if pressure is None else pressure, kinds)
    checks.collection("combinations: also", also, Mapping, 'also={"temperature": 1.05}')
    _check_once(also, pressure is not None, accidents or {}, states)
    checks.collection("combinations: prestress", prestress, Sequence, "prestress=(1.35, 1.0)", 1)
    tight = [checks.positive("combinations: prestress", one) for one in prestress]
    table: dict[str, dict[str, object]] = {}
    for one in states:
        happens = accidents or {} if one == "accidental" else {"": {}}
        american = rules is not en1990
        makers = _american(rules.name, one, kinds) if american else _european(one, kinds)
        scaled = tight if one in PRESTRESSED else [1.0]
        for event, factor, (steady, factors) in product(happens, scaled, makers):
            named = {name: steady for name in permanent} | factors
            words = [event] if event else []
            words += [f"{factor:g} prestress"] if factor != 1.0 else []
            words += [f"{x:g} {name}" for name, x in named.items() if x]
            given: dict[str, object] = {
                **named, **{name: 0.0 for name in kinds if name not in factors}, "state": one,
            }  # fmt: skip
            given |= {"prestress": factor} if factor != 1.0 else {}
            raised = fans(factors)
            given |= {} if raised is None else {"pressure": raised}
            table[f"{one}: {' + '.join(words) or 'no load'}"] = {**given, **also, **happens[event]}
    actions = _actions(rules.name, permanent, kinds, states, tight)
    return CombinationTable(table, actions, tuple(_rule_of(rules.name, one) for one in states))


PRESTRESSED = ("ULS", "ULS 6.10a/b", "erection", "strength")
"""States with a partial factor of the prestress."""

RULES: dict[str, tuple[str, str, str, str]] = {
    "ULS": ("6.4.3.2, (6.10), table A1.2(B)", "1.35 or 1", "1.5", "1.5 psi_0"),
    "ULS 6.10a/b": (
        "6.4.3.2, (6.10a) and (6.10b), table A1.2(B)",
        "1.35 or 1; b: 0.85 x 1.35 or 1",
        "1.5 psi_0; b: 1.5",
        "1.5 psi_0",
    ),
    "erection": ("6.4.3.2, (6.10), table A1.2(B)", "1.35 or 1", "1.5", "1.5 psi_0"),
    "accidental": ("6.4.3.3, (6.11b), table A1.3", "1", "psi_1", "psi_2"),
    "characteristic": ("6.5.3, (6.14b), table A1.4", "1", "1", "psi_0"),
    "frequent": ("6.5.3, (6.15b), table A1.4", "1", "psi_1", "psi_2"),
    "quasi-permanent": ("6.5.3, (6.16b), table A1.4", "1", "psi_2", "psi_2"),
    "strength": ("2.3.1", "1.4, 1.2 or 0.9", "by load", "by load"),
    "allowable stress": ("2.4.1", "1 or 0.6", "by load", "by load"),
}
"""Clauses of limit states, and factors of permanent, leading and accompanying loads, as text."""


def _rule_of(standard: str, state: str) -> Line:
    clause, *factors = RULES[state]
    return state, f"{standard}, {clause}", *factors


def _actions(
    standard: str, permanent: Sequence[str], kinds: Mapping[str, str], states: Sequence[str],
    prestress: Sequence[float],
) -> tuple[Line, ...]:  # fmt: skip
    """Rows of `CombinationTable.actions`."""
    european, table = standard == en1990.name, f"{standard}, table A1.2(B)"
    clause = ", ".join(RULES[one][0] for one in states)
    none = (None,) * 3
    ultimate = any(one in PRESTRESSED for one in states)
    steady, first = ("1.35 or 1", "1.5") if ultimate else ("1", "1")
    if not european:
        steady, table = "; ".join(RULES[one][1] for one in states), f"{standard}, {clause}"
    found: list[Line] = [(name, "permanent", steady, *none, table) for name in permanent]
    if any(one != 1.0 for one in prestress):
        given = " or ".join(f"{one:g}" for one in prestress)
        found.append(("prestress", "prestress", given, *none, "gamma_P as given"))
    for name, kind in kinds.items():
        if european:
            source = f"{standard}, table A1.1{' and table A1.2(B)' if ultimate else ''}"
            found.append((name, kind, first, *PSI[kind], source))
        else:
            found.append((name, kind, _factors_of(standard, kind, states), *none, table))
    return tuple(found)


def _factors_of(standard: str, kind: str, states: Sequence[str]) -> str:
    """All factors of a kind of load in ASCE 7, the largest first, as text."""
    rows = [row for state in states for _, row in _american(standard, state, {kind: kind})]
    return " or ".join(f"{x:g}" for x in sorted({x for row in rows for x in row.values()})[::-1])


def _rule(
    pressure: Pressure, kinds: Mapping[str, str]
) -> Callable[[Mapping[str, float]], object | None]:
    """Inner pressure as a function of the factors of variable loads."""
    what = "combinations: pressure"
    if callable(pressure):
        return lambda factors: _checked_rule(pressure(dict(factors)), dict(factors))
    if isinstance(pressure, Mapping):
        steady = {k: checks.positive(f"{what} of {k!r}", p) for k, p in pressure.items()}
        names = list(steady)
    else:
        example = 'pressure={"snow": 0.6}'
        fans = (pressure,) if isinstance(pressure, FanControl) else pressure
        checks.collection(what, fans, Sequence, example, 1)
        names = [checks.of_type(what, one, FanControl).load for one in fans]
    for name in names:
        if not any(fits(load, name) for load in kinds):
            raise InputError(
                f"{what} of {name!r}, but there is no variable load of that name or kind."
            )
    if not isinstance(pressure, Mapping):
        return lambda factors: pressure
    return lambda factors: max(
        (p for name, p in steady.items() if any(fits(x, name) for x in factors)), default=None
    )


def _checked_rule(found: Any, factors: Mapping[str, float]) -> object | None:
    """The pressure that a rule of the user returns."""
    if found is None or isinstance(found, FanControl):
        return found
    return checks.positive(f"combinations: the pressure of the rule for {factors}", found)


def _check_once(
    also: Mapping[str, object], pressure: bool,
    accidents: Mapping[str, Mapping[str, object]], states: Sequence[str],
) -> None:  # fmt: skip
    """Refuse two values of one thing, and accidents without their state."""
    checks.collection(
        "combinations: accidents", accidents, Mapping, '{"torn": {"without": ["A5"]}}'
    )
    for name, one in accidents.items():
        example = '{"without": ["A5"]}'
        checks.collection(f"combinations: accident {name!r}", one, Mapping, example, 1)
    if bool(accidents) != ("accidental" in states):
        raise InputError(
            f"combinations: accidents = {dict(accidents)!r} and the states {list(states)!r}; pass "
            'both, accidents and the state "accidental", or neither.'
        )
    twice = [
        name for name in also if name in ("state", "prestress") or (name == "pressure" and pressure)
    ]
    if twice:
        raise InputError(f"combinations: {twice[0]!r} in also has its own argument; pass it there.")


def _kinds(
    rules: CombinationRules, permanent: Sequence[str], variable: Sequence[str] | Mapping[str, str]
) -> dict[str, str]:
    """The kind of each variable load; names must be unique."""
    checks.collection("combinations: permanent", permanent, Sequence, 'permanent=["weight"]')
    if not isinstance(variable, Mapping):
        checks.collection("combinations: variable", variable, Sequence, 'variable=["snow"]')
    names = [checks.text("combinations: a load", name) for name in (*permanent, *variable)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"combinations: the load {twice!r} is listed twice.")
    if not names:
        raise InputError("combinations: there are no loads, permanent or variable.")
    found = {}
    for name in variable:
        given = variable[name] if isinstance(variable, Mapping) else name
        fitting = [
            kind for kind in rules.kinds
            if given == kind or (given is name and name.startswith(f"{kind} "))
        ]  # fmt: skip
        if not fitting:
            raise InputError(
                f"combinations: the variable load {name!r} has the kind {given!r}, which "
                f"{rules.name} does not have; name one of {', '.join(map(repr, rules.kinds))}, as "
                f"in variable={{{name!r}: {next(iter(rules.kinds))!r}}}."
            )
        found[name] = max(fitting, key=len)
    return found


def _european(state: str, kinds: Mapping[str, str]) -> list[tuple[float, dict[str, float]]]:
    """Factors of permanent and variable loads, EN 1990, 6.4.3, 6.5.3 and table A1.2(B)."""
    found: list[tuple[float, dict[str, float]]] = []
    steady: tuple[float, ...]
    psi = {name: PSI[kind] for name, kind in kinds.items()}
    groups: dict[str, list[str | None]] = {}
    for name, kind in kinds.items():
        groups.setdefault(kind, [None]).append(name)
    for chosen in product(*groups.values()):  # at most one load of each kind acts
        acting = tuple(name for name in chosen if name is not None)
        for lead in acting or (None,):
            others = {name: psi[name] for name in acting if name != lead}
            if state == "characteristic":
                steady, first, rest = (1.0,), 1.0, {k: p[0] for k, p in others.items()}
            elif state in ("accidental", "frequent", "quasi-permanent"):
                index = 2 if state == "quasi-permanent" else 1
                steady, first = (1.0,), psi[lead][index] if lead is not None else 0.0
                rest = {k: p[2] for k, p in others.items()}
            else:  # reduced: 6.10b, with the recommended xi = 0.85, table A1.2(B)
                steady = (0.85 * 1.35 if state == "ULS 6.10a/b" else 1.35, 1.0)
                first, rest = 1.5, {k: 1.5 * p[0] for k, p in others.items()}
            for factor in steady:
                _add(found, factor, ({} if lead is None else {lead: first}) | rest)
            if state == "ULS 6.10a/b":
                for factor in (1.35, 1.0):
                    _add(found, factor, {name: 1.5 * psi[name][0] for name in acting})
    return found


def _american(
    edition: str, state: str, kinds: Mapping[str, str]
) -> list[tuple[float, dict[str, float]]]:
    """Factors of permanent and variable loads, ASCE 7, 2.3.1 and 2.4.1."""
    roof = ("roof live", "snow", "rain")
    found: list[tuple[float, dict[str, float]]] = []
    if state == "strength":
        own = STRENGTH[edition]
        lead = {"roof live": 1.6, "snow": own["snow"], "rain": own["rain"]}
        by = {"roof live": 0.5, "snow": own["with snow"], "rain": 0.5}
        rows: list[tuple[float, dict[str, float]]] = [(1.4, {})]
        rows += [(1.2, {"live": 1.6, one: by[one]}) for one in roof]
        rows += [(1.2, {one: lead[one], "live": 1.0}) for one in roof]
        rows += [(1.2, {one: lead[one], "wind": 0.5}) for one in roof]
        rows += [(1.2, {"wind": 1.0, "live": 1.0, one: by[one]}) for one in roof]
        rows += [(0.9, {"wind": 1.0})]
    else:
        part = {"roof live": 1.0, **ALLOWABLE[edition]}
        rows = [(1.0, {}), (1.0, {"live": 1.0})]
        rows += [(1.0, {one: part[one]}) for one in roof]
        rows += [(1.0, {"live": 0.75, one: 0.75 * part[one]}) for one in roof]
        rows += [(1.0, {"wind": 0.6})]
        rows += [(1.0, {"live": 0.75, "wind": 0.45, one: 0.75 * part[one]}) for one in roof]
        rows += [(0.6, {"wind": 0.6})]
    present = set(kinds.values())
    for steady, factors in rows:
        acting = {kind: factor for kind, factor in factors.items() if kind in present}
        choices = [[name for name, kind in kinds.items() if kind == one] for one in acting]
        for names in product(*choices):
            _add(found, steady, dict(zip(names, acting.values(), strict=True)))
    return found


def _add(
    found: list[tuple[float, dict[str, float]]], steady: float, factors: dict[str, float]
) -> None:
    """Add a combination without duplicates; loads with the factor 0 do not act."""
    acting = {name: round(factor, 12) for name, factor in factors.items() if factor}
    if (one := (round(steady, 12), acting)) not in found:
        found.append(one)
