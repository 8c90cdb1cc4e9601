"""The verdict on a structure, on the report's first page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.page import Verdict, number, per_cent, place

COLLAPSED, TURNED = 0.5, 0.01
"""Fraction of the base volume below which a roof has collapsed; fraction of its area above which it
has turned over."""


@dataclass(frozen=True)
class Limits:
    """Limits of strain and tension."""

    strain: float = 0.1  # largest principal strain of the membrane
    cables: Mapping[str, float] = field(default_factory=dict)  # strengths of cables, by name


def verdict_on(cases: Sequence[Case], limits: Limits, size: float) -> Verdict:
    """The verdict, with all objections to the structure or its results."""
    reasons, count = [], f"All {len(cases)} combinations" if len(cases) > 1 else "The state"
    for case in cases:
        reasons += [f"{case.name}: {reason}" for reason in (*_doubts(case), *_excess(case, limits))]
        reasons += [f"{case.name}: {reason}" for reason in _used_fabric(case, size)]
    wet = [case for case in cases if case.summary.hollows]
    rain = []
    if wet:
        most = max(wet, key=lambda case: case.summary.hollows[0].depth)
        deepest = most.summary.hollows[0]
        rain.append(
            f"Rain would stand in {len(wet)} of {len(cases)} combinations, up to "
            f"{number(deepest.depth)} deep at x; y; z = {place(deepest.at, size)} ({most.name}): "
            "the roof is to be checked for ponding."
        )
    told, (refined, coarse) = [*_reinforced(cases), *rain], _refined(cases)
    missing = [case.name for case in cases if case.summary.in_equilibrium and not case.verification]
    if reasons:
        moved = [case.name for case in cases if not case.summary.in_equilibrium]
        text = f"Not in equilibrium: {', '.join(moved)}" if moved else (
            "Not acceptable as it stands, for the reasons below"
        )  # fmt: skip
        return Verdict(text, [*reasons, *told], "failed")
    if missing:
        return Verdict(f"Not verified in this run: {', '.join(missing)}", told, "doubtful")
    used = any("utilisation" in case.summary.membrane.largest for case in cases)
    what = "no strain or utilisation" if used else "no strain"
    text = f"Verified: {count[:1].lower() + count[1:]} passed all checks of equilibrium, and {what}"
    notes = [] if used else [
        "Strengths of the membrane were not given: its utilisation is not checked."
    ]  # fmt: skip
    bars = [bar for case in cases for bar in case.summary.bars.values()]
    unchecked = dict.fromkeys(x.name for x in bars if x.force < 0.0 and x.utilisation is None)
    if unchecked:
        notes.append(
            "Buckling is not checked, as no curve was given, of bars in compression: "
            f"{', '.join(unchecked)}."
        )
    look = "doubtful" if wet or coarse else ""
    return Verdict(f"{text} is beyond its limit", (*notes, *refined, *told), look)


def _doubts(case: Case) -> Iterator[str]:
    """Reasons why a state is unusable."""
    summary, checked, change = case.summary, case.verification, case.change
    if not summary.in_equilibrium:
        yield "the scene has been changed since its last load step, or there was none."
    for one in () if checked is None else checked.failed:
        yield f"no verified equilibrium: the check of {_check(one)}."
    for warning in summary.warnings:
        yield f"{warning}."
    if change.volume is not None and change.volume < 0.0:
        yield "the roof has turned inside out: it lies on the other side of its supports."
    elif change.volume is not None and change.volume < COLLAPSED:
        yield f"the roof has collapsed: of its inner volume {per_cent(change.volume)} are left."
    elif change.turned > TURNED:
        yield f"{per_cent(change.turned)} of the membrane have turned over."


def _check(one: object) -> str:
    name, value, limit, where = (getattr(one, x) for x in ("name", "value", "limit", "where"))
    return f"{name}{f' at {where}' if where else ''} is {value:.2g}, its limit {limit:.2g}"


def _excess(case: Case, limits: Limits) -> Iterator[str]:
    """Strains, cables and bars beyond their limits."""
    strain = case.summary.membrane.largest["strain 1"].value
    if strain > limits.strain:
        yield f"the membrane is strained to {per_cent(strain)}, limit {per_cent(limits.strain)}."
    for name, cable in case.summary.cables.items():
        if cable.largest > limits.cables.get(name, float("inf")):
            share = cable.largest / limits.cables[name]
            yield f"the cable {name} is used to {per_cent(share)} of its strength."
    for name, bar in case.summary.bars.items():
        if bar.utilisation is not None and bar.utilisation > 1.0:
            how = "tension" if bar.force > 0.0 else "compression"
            yield f"the bar {name} is used to {per_cent(bar.utilisation)} in {how}."


def _used_fabric(case: Case, size: float) -> Iterator[str]:
    """Parts of the membrane beyond their strengths."""
    parts = case.summary.parts
    for name, part in parts.items():
        one = part.largest.get("utilisation")
        if one is not None and one.value > 1.0 and (name or len(parts) == 1):
            of = f"its part {name}" if name else "the membrane"
            yield (
                f"{of} is used to {per_cent(one.value)} of its strength at x; y; z = "
                f"{place(one.at, size)}; finer cells may change this by "
                f"{per_cent(part.change or 0.0)}."
            )


def _refined(cases: Sequence[Case]) -> tuple[list[str], bool]:
    """Note on what finer cells may change of the largest utilisation, and whether it may then be
    above 1."""
    found = [
        (one.value * (1.0 + (part.change or 0.0)), one.value, case.name, part.change or 0.0)
        for case in cases for part in case.summary.parts.values()
        if (one := part.largest.get("utilisation")) is not None
    ]  # fmt: skip
    if not found:
        return [], False
    most, value, name, change = max(found)
    text = (
        f"{name}: the membrane is used to {per_cent(value)} of its strength; finer cells may "
        f"change this by {per_cent(change)}"
    )
    near = value <= 1.0 < most
    return [f"{text}, and are needed there to tell." if near else f"{text}."], near


def _reinforced(cases: Sequence[Case]) -> list[str]:
    """Note on the corners where plain fabric is not judged."""
    every = {name: one.patch for case in cases for name, one in case.summary.patches.items()}
    if not every:
        return []
    radii = [patch.radius for patch in every.values()]
    span = number(min(radii))
    if number(max(radii)) != span:
        span += f" to {number(max(radii))}"
    assumed = [name for name, patch in every.items() if not patch.given]
    most, name, where = max(
        (one.utilisation, case.name, corner)
        for case in cases for corner, one in case.summary.patches.items()
    )  # fmt: skip
    text = (
        f"Corners to be reinforced ({', '.join(every)}): within a radius of {span} the plain "
        "fabric is not judged, as its utilisation depends on the mesh there; on this one it is "
        f"{per_cent(most)} ({where}, {name})."
    )
    if assumed:
        text += (
            " Radii that were not given are a twentieth of the distance to the next corner: "
            f"{', '.join(assumed)}."
        )
    return [text]
