"""Tables of load combinations that know what they follow from and what was left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.strengths import acting_loads

Entry = dict[str, object]
"""A combination: factors of loads and settings by name."""

Line = tuple[str | float | None, ...]
"""A row of `CombinationTable.actions` or `CombinationTable.rules`."""

BY_HAND = "left out by hand"
"""Reason of combinations that were deleted without one."""


class CombinationTable(dict[str, Entry]):
    """Load combinations by name, for `Solver.combine`, with what a report tells of them.

    A dictionary: combinations may be deleted, ``del table[name]``, and others added, ``table |
    {...}``. A report lists those that are missing, with the reason where `leave_out` gave one.

    Attributes
    ----------
    actions
        Loads: name, kind, partial factor in ultimate limit states, psi_0, psi_1, psi_2, clause.
    rules
        Limit states: name, clause, factors of permanent, leading and accompanying loads.
    formed
        All combinations that were formed, also those left out.
    """

    def __init__(
        self, table: Mapping[str, Entry], actions: tuple[Line, ...] = (),
        rules: tuple[Line, ...] = (), formed: Mapping[str, Entry] | None = None,
        reasons: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(table)
        self.actions, self.rules = actions, rules
        self.formed = dict(table if formed is None else formed)
        self._reasons = dict(reasons or {})

    @property
    def left_out(self) -> dict[str, str]:
        """Why combinations were left out, by name."""
        missing = (name for name in self.formed if name not in self)
        return {name: self._reasons.get(name, BY_HAND) for name in missing}

    def leave_out(self, which: Callable[[Mapping[str, Any]], object], why: str) -> None:
        """Leave out the combinations for which a function is true, with a reason for the report.

        Parameters
        ----------
        which
            Function of a combination, the factors of all loads by name and its settings.
        why
            The reason.

        Raises
        ------
        InputError
            No reason, or no such combination.

        Examples
        --------
        >>> table = codes.combinations(codes.en1990, ["weight"], ["snow", "wind x", "wind y"])
        >>> table.leave_out(lambda one: one["snow"] and one["wind y"], "drifts, see snow y")
        >>> len(table), len(table.left_out)
        (12, 4)
        """
        found = [name for name, one in self.items() if which(one)]
        if not found or not why:
            raise InputError(
                f"leave_out: {len(found)} combinations, with the reason {why!r}; pass a function "
                "that is true for some, and why they need no calculation."
            )
        for name in found:
            del self[name]
            self._reasons[name] = why

    def __or__(self, other: Mapping[str, Any]) -> CombinationTable:  # type: ignore[override]
        """The table with further combinations."""
        joined, formed = super().__or__(dict(other)), self.formed | dict(other)
        return CombinationTable(joined, self.actions, self.rules, formed, self._reasons)

    def leading(self, name: str) -> str:
        """Kind of the variable load with the largest factor in a combination, or its name if it has
        none; "" without any."""
        kinds = {str(row[0]): str(row[1]) for row in self.actions}
        sizes = {
            load: abs(x) for load, x in acting_loads(self.formed[name]).items()
            if kinds.get(load) != "permanent"
        }  # fmt: skip
        first = max(sizes, key=sizes.__getitem__, default="")
        return kinds.get(first, first)
