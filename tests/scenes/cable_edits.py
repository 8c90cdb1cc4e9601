"""Writing single values into a laid cable's arrays, which are read-only."""

from __future__ import annotations

from typing import Any

from crms_fenicsx.model.laid_cable import LaidCable


def put(cable: LaidCable, name: str, where: Any, value: Any) -> None:
    """Replace an array of the cable's state by one with a value at some of its indices."""
    array = getattr(cable.state, name).copy()
    array[where] = value
    cable.update(**{name: array})
