"""What a solver warns of in a state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class StateWarning:
    """One thing that a state's user has been warned of.

    Attributes
    ----------
    kind
        "snap-through": no stable equilibria connect it to the states before. "instability": bars
        make its equilibrium one that is not stable. "pond": water does. "cable end": one lies under
        the membrane.
    text
        What, where and from which load on.
    loads
        Of a snap-through: the factors of each load that changed between which it was, by its
        name, and as "pressure" the pressures (force per area).
    """

    kind: Literal["snap-through", "instability", "pond", "cable end"]
    text: str
    loads: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def is_unstable(self) -> bool:
        """Whether the state's equilibrium is not stable."""
        return self.kind in ("instability", "pond")

    @property
    def lasts(self) -> bool:
        """Whether the states of later load steps have it as well."""
        return self.kind == "snap-through"

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"
