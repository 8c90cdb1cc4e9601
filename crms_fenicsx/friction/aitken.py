"""Which part of a change of friction forces is taken, between two passes.

The forces are brought to those of the state that they lead to, and this can go back and forth among
few states, where nodes begin to slide or to touch. The part is found by Aitken's rule for vectors
(B. M. Irons and R. C. Tuck, Int. J. Numer. Meth. Engng 1, 1969).
"""

from __future__ import annotations

from collections.abc import Hashable

from crms_fenicsx.runtime.arrays import Array


class AitkenRelaxation:
    """Part of a change that is taken."""

    def __init__(self, least: float) -> None:
        self.least = least
        self._part = 1.0
        self._last: tuple[Hashable, Array] | None = None

    def factor(self, what: Hashable, change: Array) -> float:
        """The part of a change (n,) to take; the one before counts if it was of the same."""
        if self._last is not None and self._last[0] == what:
            bend = change - self._last[1]
            size = float(bend @ bend)
            if size > 0.0:
                part = -self._part * float(self._last[1] @ bend) / size
                self._part = min(max(part, self.least), 1.0)
        self._last = what, change
        return self._part
