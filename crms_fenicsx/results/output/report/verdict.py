"""The verdict of a report: what is judged in each limit state, and objections to states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.model.strengths import ALL, LIMIT_STATES, SERVICE
from crms_fenicsx.results.design_checks import LEAST, DesignCheck, governing_of
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.page import (
    WHOLE,
    Units,
    Verdict,
    number,
    per_cent,
    place,
    shown,
)
from crms_fenicsx.results.summary import DesignTable

NAMES = {
    "fabric": ("Membrane", " of its strength"),
    "fabric warp": ("Membrane, warp", " of its strength"),
    "fabric weft": ("Membrane, weft", " of its strength"),
    "strain": ("Membrane, strain", " of the limit"),
    "cable": ("Cable tension", " of its strength"),
    "bar tension": ("Bar in tension", " of its resistance"),
    "bar compression": ("Bar in compression", " of its resistance"),
    "deflection": ("Deflection", " of the limit"),
    "prestress": ("Least prestress", ""),
    "slope": ("Least slope", ""),
    "ponding": ("Ponding", " of the limit"),
}
"""What is judged: its name, and what its utilisation is relative to."""

OF_MEMBRANE = (
    "fabric", "fabric warp", "fabric weft", "strain", "deflection", "prestress", "slope", "ponding",
)  # fmt: skip
"""What is judged of the membrane or its parts."""

KINDS = {
    **dict.fromkeys(("cable", "bar tension", "bar compression"), "force"),
    **dict.fromkeys(("fabric", "fabric warp", "fabric weft", "prestress"), "stress"),
    **dict.fromkeys(("deflection", "ponding"), "length"),
    "slope": "angle",
}
"""Kinds of the effects' units; the strain has none."""

MOST = 8
"""Number of members or combinations that a sentence names."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Judged(DesignCheck):
    """A check in a state of the report, of what is in `NAMES`."""

    state: str  # limit state
    case: str  # name of the combination


def judged(cases: Iterable[Case], strain: float) -> list[Judged]:
    """All that is judged in the cases: the limit of strain, and the checks of their summaries."""
    found = list[Judged]()
    for case in cases:
        largest = case.summary.membrane.largest["strain 1"].value
        every = [DesignCheck("strain", ALL, largest, strain), *case.summary.checks]
        found += [Judged(**vars(one), state=case.state, case=case.name) for one in every]
    return found


def governing(found: Iterable[Judged]) -> list[Judged]:
    """The largest utilisation of each limit state and kind of check, and the largest of each."""
    of = dict[tuple[str, str], list[Judged]]()
    for one in found:
        of.setdefault((one.state, one.what), []).append(one)
    most = [governing_of(own, lambda one: one.share) for own in of.values()]
    order, states = [*NAMES], ["", *LIMIT_STATES]
    rows = sorted(most, key=lambda one: order.index(one.what))
    return sorted(rows, key=lambda one: states.index(one.state))


def verdict_on(cases: Sequence[Case], size: float, strain: float, units: Units) -> Verdict:
    """The verdict, with all objections to the structure or its results, grouped by limit state,
    and what is not judged; `strain` is the limit of the major principal strain."""
    count = states_of(cases)
    reasons = [*_doubts(cases), *_excess(judged(cases, strain), size, units)]
    unjudged = [*_unjudged(cases)]
    told = [*_reinforced(cases, units), *_rain(cases, size, units), *_unserved(cases)]
    refined, coarse = _refined(cases)
    missing = [case.name for case in cases if case.summary.in_equilibrium and not case.verification]
    if reasons:
        moved = [case.name for case in cases if not case.summary.in_equilibrium]
        text = f"Not in equilibrium: {listed(moved)}" if moved else (
            "Not acceptable as it stands, for the reasons below"
        )  # fmt: skip
        return Verdict(text, [*reasons, *unjudged, *refined, *told], "failed")
    if missing:
        text = f"Not verified in this run: {listed(missing)}"
        return Verdict(text, [*unjudged, *refined, *told], "doubtful")
    used = any(case.summary.checks for case in cases)
    what = "no strain or utilisation" if used else "no strain"
    but = ", but not everything is judged" if unjudged else ""
    text = f"Verified{but}: {count} passed all checks of equilibrium, and {what}"
    wet = any(case.summary.hollows for case in cases)
    look = "doubtful" if coarse or wet or unjudged else ""
    return Verdict(f"{text} is beyond its limit", (*unjudged, *refined, *told), look)


def _unjudged(cases: Sequence[Case]) -> Iterator[str]:
    """What has no design value, and limit states without limits."""
    found = DesignTable.of({case.name: case.summary for case in cases}).unjudged
    kinds = dict[str, list[str]]()
    for one in found:
        kind, _, name = one.partition(" ")
        kinds.setdefault(kind, []).append(name)
    named = [
        f"{'membrane part' if kind == 'fabric' else kind}{'s' * (len(names) > 1)} {listed(names)}"
        if any(names) else "the membrane" for kind, names in kinds.items()
    ]  # fmt: skip
    if named:
        yield f"Not judged in ultimate limit states, without a design value: {'; '.join(named)}."
    if "bar" in kinds:
        yield "A bar in compression needs a buckling curve besides its strength."
    served = [case for case in cases if case.state in SERVICE]
    if served and not any(one.what not in ("cable", "strain") for case in served
                          for one in case.summary.checks):  # fmt: skip
        yield "Serviceability is not judged: no limit of deflection, prestress, slope or water."


def _unserved(cases: Sequence[Case]) -> Iterator[str]:
    """Note on combinations of ultimate limit states only."""
    states = {case.state for case in cases if case.state and not case.stage}
    if states and not states & {*SERVICE}:
        yield "No combination is for serviceability, which is not judged here."


def states_of(cases: Sequence[Case]) -> str:
    """The cases in words, as "4 combinations, 8 stages and the base state"."""
    stages = sum(case.stage > 0 for case in cases)
    base = sum(not case.stage and not case.state for case in cases)  # is of no limit state
    if len(cases) == 1:
        return "the state"
    kinds = {"combination": len(cases) - stages - base, "stage": stages}
    found = [counted(n, kind) for kind, n in kinds.items() if n] + ["the base state"] * bool(base)
    every = f"all {found[0]}" if max(kinds.values()) > 1 else found[0]
    return " and ".join(x for x in (", ".join([every, *found[1:-1]]), *found[1:][-1:]) if x)


def listed(names: Sequence[str]) -> str:
    """Up to `MOST` names, and the number of the others."""
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    return ", ".join(names[:MOST]) + more


def _excess(found: Sequence[Judged], size: float, units: Units) -> Iterator[str]:
    """What exceeds its limit: a sentence for each limit state and kind of check, which names the
    members, the most utilised one first, and this one's effect and limit."""
    beyond = [one for one in found if not one.passed]
    for first in governing(beyond):
        own = [one for one in beyond if (one.state, one.what) == (first.state, first.what)]
        most = dict[str, Judged]()
        for one in sorted(own, key=lambda one: -one.share):
            most.setdefault(one.member, one)
        every = {one.member for one in found if (one.state, one.what) == (first.state, first.what)}
        name, of = NAMES[first.what]
        shares = {one.member: "" if one.what in LEAST else f" {per_cent(one.share)}" for one in own}
        members = [f"{one.member or WHOLE}{shares[one.member]} ({one.case})"
                   for one in most.values()]  # fmt: skip
        where = f"{first.state}: " if first.state else ""
        count = f", {len(most)} of {len(every)}" if len(every) > 1 else ""
        side, of = ("below", "") if first.what in LEAST else ("beyond", of)
        at = "" if first.at is None else f" at x; y; z = {place(first.at, size)}"
        effect, limit = (with_unit(first.what, x, units) for x in (first.effect, first.limit))
        yield (
            f"{where}{name}{count} {side} the limit: {listed(members)}{of}; {effect}{at}, "
            f"limit {limit}."
        )


def with_unit(what: str, value: float, units: Units) -> str:
    """An effect or limit of a kind of check with its unit; the strain in per cent."""
    kind = KINDS.get(what, "")
    unit = {"": " %", "angle": "°"}.get(kind) or units.plain(kind)
    return f"{number(value if kind else 100.0 * value)}{unit}"


def _rain(cases: Sequence[Case], size: float, units: Units) -> Iterator[str]:
    """Note on where rain would stand."""
    wet = [case for case in cases if case.summary.hollows]
    if wet:
        most = governing_of(wet, lambda case: case.summary.hollows[0].depth)
        deepest = most.summary.hollows[0]
        yield (
            f"Rain would stand in {len(wet)} of {len(cases)} states, up to "
            f"{shown(units.exact(deepest.depth))}{units.plain('length')} deep at x; y; z = "
            f"{place(deepest.at, size)} ({most.name}): check the roof for ponding."
        )


def _doubts(cases: Sequence[Case]) -> Iterator[str]:
    """Reasons why states are unusable, each with the combinations that share it."""
    shared = dict[str, list[str]]()
    for case in cases:
        for reason in _doubts_on(case):
            shared.setdefault(reason, []).append(case.name)
    for reason, names in shared.items():
        yield f"{listed(names)}: {reason}"


def _doubts_on(case: Case) -> Iterator[str]:
    summary, checked, volume = case.summary, case.verification, case.volume
    if not summary.in_equilibrium:
        yield "the scene has been changed since its last load step, or there was none."
    for one in () if checked is None else checked.failed:
        where = f"{one.name} at {one.where}" if one.where else one.name
        yield (
            f"no verified equilibrium: the check of {where} is {one.value:.2g}, its limit "
            f"{one.limit:.2g}."
        )
    for warning in summary.warnings:
        yield f"{warning}."
    if volume is not None and volume < 0.0:
        yield "the roof has turned inside out: it lies on the other side of its supports."
    elif volume is not None and volume < 0.5:
        yield f"the roof has collapsed: {per_cent(volume)} of its inner volume is left."
    elif case.turned > 0.01:
        yield f"{per_cent(case.turned)} of the membrane has turned over."


def _refined(cases: Sequence[Case]) -> tuple[list[str], bool]:
    """Note on what finer cells may change of the largest utilisation, and whether it may then be
    above 1."""
    found = [
        (one.value * (1.0 + (part.change or 0.0)), one.value, case.name, part.change or 0.0)
        for case in cases if case.state not in SERVICE for part in case.summary.parts.values()
        if (one := part.largest.get("utilisation")) is not None
    ]  # fmt: skip
    if not found:
        return [], False
    # the one that governs, unless another may exceed the strength
    beyond = [one for one in found if one[1] <= 1.0 < one[0]]
    most, value, name, change = governing_of(found, lambda one: one[1])
    if beyond and not value <= 1.0 < most:
        most, value, name, change = governing_of(beyond, lambda one: one[0])
    text = (
        f"{name}: the membrane is loaded to {per_cent(value)} of its strength; finer cells may "
        f"change this by {per_cent(change)}"
    )
    near = value <= 1.0 < most
    return [f"{text}; refine the mesh there to judge it." if near else f"{text}."], near


def _reinforced(cases: Sequence[Case], units: Units) -> list[str]:
    """Note on the corners where plain fabric is not judged."""
    every = {name: one.patch for case in cases for name, one in case.summary.patches.items()}
    if not every:
        return []
    radii = [patch.radius for patch in every.values()]
    span = number(min(radii))
    if number(max(radii)) != span:
        span += f" to {number(max(radii))}"
    span += units.plain("length")
    assumed = [name for name, patch in every.items() if not patch.given]
    most, name, where = governing_of(
        ((one.utilisation, case.name, corner)
         for case in cases for corner, one in case.summary.patches.items()),
        lambda one: one[0],
    )  # fmt: skip
    text = (
        f"Corners to be reinforced ({listed([*every])}): within a radius of {span} the plain "
        "fabric is not judged, as its utilisation depends on the mesh there; on this one it is "
        f"{per_cent(most)} ({where}, {name})."
    )
    if assumed:
        text += (
            " Radii that were not given are a twentieth of the distance to the next corner: "
            f"{listed(assumed)}."
        )
    return [text]
