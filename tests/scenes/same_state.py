"""Comparison of states of scenes, field by field: a field that is added is compared as well."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass

import numpy as np

from crms_fenicsx.analysis.scene.state import SceneState


def assert_same_state(
    one: SceneState, other: SceneState, but: Collection[str] = (), rtol: float = 0.0
) -> None:
    """All that files keep is the same, to the last digit or to `rtol`, but for some parts."""
    for field in fields(SceneState):
        if "UNSAVED" not in str(field.type) and field.name not in but:
            assert_same(getattr(one, field.name), getattr(other, field.name), field.name, rtol)


def assert_same(one: object, other: object, what: str, rtol: float = 0.0) -> None:
    """Two objects have the same attributes, to the last digit, or numbers to `rtol`, relative to 1
    or the largest in their array."""
    assert type(one) is type(other), what
    if isinstance(one, np.ndarray | float) and rtol:
        size = np.nanmax(np.abs(other), initial=1.0)
        np.testing.assert_allclose(one, other, rtol, rtol * size, err_msg=what)
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, what)
    elif isinstance(one, Mapping):  # of cables, joints and bars the names
        assert isinstance(other, Mapping)
        assert [*map(repr, one)] == [*map(repr, other)], what
        assert_same([*one.values()], [*other.values()], what, rtol)
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), what
        for k, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{what}[{k}]", rtol)
    elif hasattr(one, "__dict__"):
        for name in [f.name for f in fields(one)] if is_dataclass(one) else vars(one):
            assert_same(getattr(one, name), getattr(other, name), f"{what}.{name}", rtol)
    else:
        assert one == other or one != one, what
