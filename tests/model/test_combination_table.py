"""Tables of combinations know what was left out of them, and why."""

from __future__ import annotations

import pytest

from crms_fenicsx import InputError, codes
from crms_fenicsx.model.combination_table import BY_HAND, CombinationTable


def table() -> CombinationTable:
    variable = ["snow", "wind x", "wind y"]
    return codes.combinations(codes.en1990, ["weight"], variable, state=["ULS", "frequent"])


def test_reasons_are_kept() -> None:
    found = table()
    count = len(found)
    found.leave_out(lambda one: one["snow"] and one["wind y"], "no snow in the south")
    del found["ULS: 1.35 weight"]
    assert len(found) + len(found.left_out) == count
    assert found.left_out["ULS: 1.35 weight"] == BY_HAND
    assert found.left_out["ULS: 1 weight + 1.5 snow + 0.9 wind y"] == "no snow in the south"
    more = found | {"service": {"snow": 1.0, "state": "characteristic"}}
    assert more.left_out == found.left_out and more.actions == found.actions
    assert len(more) == len(found) + 1 and len(more.formed) == count + 1
    assert "service" not in found


def test_a_reason_must_be_given_for_some_combination() -> None:
    for which, why in ((lambda one: True, ""), (lambda one: False, "none")):
        with pytest.raises(InputError, match="leave_out"):
            table().leave_out(which, why)


def test_the_leading_load_has_the_largest_factor() -> None:
    found = table()
    assert found.leading("ULS: 1.35 weight + 1.5 wind x + 0.75 snow") == "wind"
    assert found.leading("ULS: 1.35 weight + 1.5 snow + 0.9 wind y") == "snow"
    assert found.leading("ULS: 1.35 weight") == ""
    assert found.leading("frequent: 1 weight + 0.2 wind x") == "wind"


def test_factors_of_loads_by_hand() -> None:
    """EN 1990, tables A1.1 and A1.2(B); ASCE 7-16, 2.3.1."""
    rows = {row[0]: row[1:] for row in table().actions}
    assert rows["weight"][:2] == ("permanent", "1.35 or 1")
    assert rows["snow"][:5] == ("snow", "1.5", 0.5, 0.2, 0.0)
    assert rows["wind y"][:5] == ("wind", "1.5", 0.6, 0.2, 0.0)
    tight = codes.combinations(
        codes.en1990, ["weight"], ["snow"], prestress=(1.35, 1.0), state="characteristic"
    )
    assert [row[:3] for row in tight.actions] == [
        ("weight", "permanent", "1"), ("prestress", "prestress", "1.35 or 1"), ("snow", "snow", "1")
    ]  # fmt: skip
    american = codes.combinations(codes.asce7_16, ["dead"], ["snow", "wind"])
    rows = {row[0]: row[1:] for row in american.actions}
    assert rows["dead"][1] == "1.4, 1.2 or 0.9"
    assert rows["snow"][1] == "1.6 or 0.5" and rows["wind"][1] == "1 or 0.5"
    assert american.rules == (
        ("strength", "ASCE 7-16, 2.3.1", "1.4, 1.2 or 0.9", "by load", "by load"),
    )
