"""Tables of the checks of equilibrium."""

from __future__ import annotations

from collections.abc import Sequence

from crms_fenicsx.analysis.verification.report import Check
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.results.design_checks import governing_of
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.page import Table, per_cent
from crms_fenicsx.results.output.report.results_tables import Row
from crms_fenicsx.results.output.report.verdict import listed, states_of

MEANINGS = {
    "Forces balance at every free point, cable and joint": (
        "unbalanced forces", "unbalanced forces of the membrane", "unbalanced forces of cables",
        "unbalanced forces of bars", "sideways balance",
    ),
    "Reactions equal the loads, in forces and moments": (
        "sum of supports and loads", "moment of supports and loads",
    ),
    "Supports and anchors keep their places": (
        "supports off their place", "depth below the floor", "ends of cables off their place",
        "ends of bars off their place",
    ),
    "Forces of cables and bars follow from their elongations": (
        "tension against length", "compression", "slack cable too short", "pull at the ends",
        "forces of bars",
    ),
    "Cables lie on the membrane and on each other, and press on them only": (
        "nodes off their edges", "breaks in the path", "crossing cables apart",
        "clamps that hold nothing", "pull on the membrane", "depth below the membrane",
        "depth below another cable", "depth in a cable beside",
    ),
    "Nothing but friction, clamps and pockets holds cables sideways": (
        "held by a line of the mesh", "held by vertices", "held where its line stays",
        "sideways force without friction",
    ),
    "Friction stays within its bounds": (
        "friction beyond its bound", "friction along beyond its bound", "negative dissipation",
    ),
    "The energy changes by the work of the forces": (
        "virtual work", "scatter of the energy", "values not finite",
    ),
}  # fmt: skip
"""What checks mean, with their names."""


CHECKED = (
    "Each state of equilibrium was checked without use of the solver: the forces on every part of "
    "the structure balance; reactions of the supports equal the loads, in forces and moments; each "
    "cable has the tension that follows from its length, and lies on the membrane where it is in "
    "contact; the deformation energy agrees with the work of the forces. A doubtful check means "
    "that the mesh is coarse there, or that forces of one part are too small beside the others to "
    "be accurate, not that the state is not in equilibrium."
)
"""What the checks are, and what a doubtful one means."""


def verification(cases: Sequence[Case]) -> Table:
    """Checks of all cases."""
    rows: list[Row] = []
    for case in cases:
        if case.verification is None:
            rows.append((case.name, _unchecked(case), None, None, None, ""))
            continue
        for one in case.verification.checks:
            verdict = "passed" if one.passed else "failed" if one.binding else "doubtful"
            rows.append((case.name, one.name, one.where or None, one.value, one.limit, verdict))
    columns = ("Combination", "Check", "Cable", "Value", "Limit", "Verdict")
    return Table("Checks of the equilibria", columns, rows, "verification", headings=2)


def verdicts(cases: Sequence[Case]) -> Table:
    """Verdicts, with the cases that share each."""
    shared: dict[tuple[int | None, str], list[str]] = {}
    for case in cases:
        found = case.verification
        if found is None:
            shared.setdefault((None, _unchecked(case)), []).append(case.name)
            continue
        names = [check.name for check in found.failed]
        verdict = "failed: " if found.failed else "verified"
        if case.summary.warnings and not found.failed:
            verdict, names = "equilibrium, but ", [str(one) for one in case.summary.warnings]
        key = len(found.checks), verdict + ", ".join(names)
        shared.setdefault(key, []).append(case.name)
    rows: list[Row] = [
        (states_of(cases) if len(names) == len(cases) > 1
         else listed(names), *key)
        for key, names in shared.items()
    ]  # fmt: skip
    return Table("Verdicts", ("Combination", "Checks", "Verdict"), rows)


def nearest_to_limits(cases: Sequence[Case]) -> Table:
    """What was checked, in words, each where it is nearest to its limit."""
    meaning = {name: words for words, names in MEANINGS.items() for name in names}
    found = dict[str, list[tuple[Case, Check]]]()
    for case in cases:
        for check in case.verification.checks if case.verification else ():
            words = meaning.get(check.name, check.name)
            found.setdefault(words, []).append((case, check))
    rows: list[Row] = []
    for words in sorted(found, key=lambda words: [*MEANINGS, words].index(words)):
        failed = [one for one in found[words] if not one[1].passed]
        case, check = governing_of(failed or found[words], lambda one: _share(one[1]))
        verdict = "met" if check.passed else "failed" if check.binding else "doubtful"
        rows.append((words, verdict, per_cent(_share(check)), case.name, check.where or None))
    columns = ("Requirement", "Result", "Largest share of its tolerance", "Combination", "Member")
    return Table("Requirements of equilibrium", columns, rows)


def _share(check: Check) -> float:
    return check.value / check.limit if check.limit > 0.0 else float(not check.passed)


def _unchecked(case: Case) -> str:
    """Reason for missing checks of a case."""
    return "not verified in this run" if case.summary.in_equilibrium else UNBALANCED
