"""Temperature changes of fabric, cables and bars: coefficients of thermal expansion, and loads.

A free body of the coefficient alpha grows by the factor 1 + alpha dT. Unstressed lengths of cables
and bars grow by it; its Green-Lagrange strain is subtracted from that of the fabric, before the
law. dT is the sum over the loads of their factors times their changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.strengths import ALL

STEEL = 1.2e-5
"""Coefficient of thermal expansion of steel (per kelvin)."""

MOST_EXPANSION, MOST_CHANGE = 1e-3, 200.0
"""Largest coefficient of expansion (per kelvin) and temperature change (kelvin): others have other
units, or are absolute."""


def check_expansion(owner: str, given: object, pair: bool = False) -> None:
    """Refuse what is no coefficient of expansion, or, where allowed, no `pair` of them."""
    if given is None:
        return
    for one in given if pair and isinstance(given, tuple) and len(given) == 2 else (given,):
        if abs(checks.finite(f"{owner}: expansion", one)) > MOST_EXPANSION:
            raise InputError(
                f"{owner}: expansion = {given!r}; use a number per kelvin, at most "
                f"{MOST_EXPANSION:g}: that of steel is {STEEL:g}."
            )


def checked_changes(
    given: float | Mapping[str, float], members: Mapping[str, Iterable[str]]
) -> dict[str, float]:
    """Changes (kelvin) of a temperature load by the names of what they mean, `ALL`: of all others;
    members: names by kind."""
    known = [*members, *(name for names in members.values() for name in names)]
    if isinstance(given, Mapping) and not given:
        raise InputError(
            "put_temperature: change = {} changes nothing; pass a number for all, or numbers by "
            "name, as in {'fabric': -30.0}."
        )
    found = {}
    for name, change in (given if isinstance(given, Mapping) else {ALL: given}).items():
        if name != ALL:
            checks.named("fabric, cable or bar", dict.fromkeys(known), name)
            if known.count(name) > 1:
                raise InputError(
                    f"put_temperature: {name!r} is the name of several things; use other names "
                    "for cables and bars."
                )
        what = f"put_temperature: change{f' of {name!r}' if name else ''}"
        if abs(checks.finite(what, change)) > MOST_CHANGE:
            raise InputError(
                f"{what} = {change!r}; pass the difference to the temperature at which lengths and "
                f"forces of the model hold, in kelvin, from -{MOST_CHANGE:g} to {MOST_CHANGE:g}."
            )
        found[name] = float(change)
    return found


def change_of(changes: Mapping[str, float], kind: str, name: str) -> float:
    """Temperature change (kelvin) of a cable, a bar or a part of the fabric."""
    return next((changes[key] for key in (name, kind, ALL) if key in changes), 0.0)


def growth(expansion: float | None, change: float) -> float:
    """Factor of the lengths of a free cable or bar at a temperature change."""
    return 1.0 + (expansion or 0.0) * change
