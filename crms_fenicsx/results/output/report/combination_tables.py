"""Tables of partial and combination factors, and of combinations that are left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from crms_fenicsx.analysis.steps.load_cases import Combination
from crms_fenicsx.model.combination_table import CombinationTable
from crms_fenicsx.results.output.report.page import PagePart, PageSection, Paragraph, Table

FORMED = (
    "Loads of one kind exclude each other, all permanent loads have one factor, and each variable "
    "load leads in turn. Factors are the recommended values of the standard."
)


def tables_of(states: Mapping[str, Combination]) -> tuple[CombinationTable, ...]:
    """The tables that combinations are of, each once."""
    found = {id(one.table): one.table for one in states.values() if one.table is not None}
    return tuple(found.values())


def combination_sections(tables: Sequence[CombinationTable]) -> list[PageSection]:
    """What the combinations of tables follow from."""
    actions = dict.fromkeys(
        tuple(f"{x:g}" if isinstance(x, float) else x for x in row)
        for one in tables for row in one.actions
    )  # fmt: skip
    rules = dict.fromkeys(row for one in tables for row in one.rules)
    formed = {name: entry for one in tables for name, entry in one.formed.items()}
    left_out = {name: why for one in tables for name, why in one.left_out.items()}
    rows = []
    for row in rules:
        own = [name for name, entry in formed.items() if entry.get("state") == row[0]]
        rows.append((*row, len(own), sum(name not in left_out for name in own)))
    heads = "Load|Kind|Partial factor|psi_0|psi_1|psi_2|From".split("|")
    states = "Limit state|From|Permanent|Leading|Accompanying|Formed|Computed".split("|")
    body: list[PagePart] = []
    if actions:
        body += [Table("Partial and combination factors", heads, list(actions), "factors")]
    if rows:
        body += [Table("Combinations by limit state", states, rows), Paragraph(FORMED)]
    if left_out:
        body.append(Table(
            "Combinations that were not computed", ("Combination", "Reason"),
            list(left_out.items()), "left_out", small=True,
        ))  # fmt: skip
    return [PageSection("Loads in combination", body, 3)] if body else []
