"""Strengths of fabrics, their partial factors under some loads, and reinforced corners."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, outer_first
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError

Strengths = tuple[float, float]
"""Strengths in warp and weft (force per length)."""

ALL = ""
"""Key of strengths that hold for the whole membrane; not a valid part name."""


def checked_strengths(
    call: str, strengths: Strengths | Mapping[str, Strengths], mesh: MembraneMesh
) -> dict[str, Strengths]:
    """Checked strengths by part, or under `ALL` those of the whole membrane."""
    given: dict[str, Any] = {ALL: strengths}
    if isinstance(strengths, Mapping):
        parts = outer_first(mesh, call, "pair of strengths", strengths)
        given = {part: strengths[part] for part in parts}
    found = {}
    for part, pair in given.items():
        owner = repr(part) if isinstance(strengths, Mapping) else "the membrane"
        if np.shape(pair) != (2,):
            raise InputError(
                f"{call}: strengths of {owner} = {pair!r}; pass two, of warp and weft."
            )
        warp, weft = (checks.positive(f"{call}: strength of {owner}", x) for x in pair)
        found[part] = (warp, weft)
    if not found:
        raise InputError(
            f"{call}: strengths = {strengths!r} names no part; pass those of one or more."
        )
    return found


def checked_factors(
    call: str, factors: Mapping[str, float] | None, loads: Iterable[str]
) -> dict[str, float]:
    """Checked partial factors of the strengths, by the names of the acting loads."""
    given = {} if factors is None else factors
    checks.collection(f"{call}: factors", given, Mapping, '{"snow": 1.6}')
    known = {name: name for name in loads}
    return {
        checks.named("load", known, name): checks.positive(f"{call}: factor of {name!r}", value)
        for name, value in given.items()
    }


def patch_radii(
    call: str, patches: float | Mapping[str, float] | None, mesh: MembraneMesh
) -> dict[str, float]:
    """Checked radii of reinforcement by group of points, or under `ALL` that of every corner."""
    given: dict[str, Any] = {**patches} if isinstance(patches, Mapping) else {ALL: patches}
    found = dict[str, float]()
    for name, radius in given.items():
        if isinstance(patches, Mapping):
            checks.named("group of points", mesh.points, name)
        if radius is not None:
            found[name] = checks.finite(f"{call}: patches, radius", radius)
            if found[name] < 0.0:
                raise InputError(
                    f"{call}: patches, radius = {radius:g} is negative; pass 0 or more."
                )
    return found
