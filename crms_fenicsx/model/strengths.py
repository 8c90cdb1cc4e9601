"""Strengths of the fabric, which section forces are compared with."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError

Strengths = tuple[float, float]
"""In warp and weft (force per length)."""

ALL = ""
"""What the strengths are known by that belong to the whole membrane; no name of a part."""


def checked_strengths(
    call: str, strengths: Strengths | Mapping[str, Strengths], parts: Collection[str]
) -> dict[str, Strengths]:
    """Strengths by part, or under `ALL` those of the whole membrane.

    Parameters
    ----------
    call
        What they are given to, for messages.
    strengths
        One pair, or one of each part by its name.
    parts
        Names of the mesh's parts.

    Raises
    ------
    InputError
        A part that does not exist, or strengths that are not two positive numbers.
    """
    given = strengths if isinstance(strengths, Mapping) else {ALL: strengths}
    found = {}
    for part, pair in given.items():
        if part not in parts and isinstance(strengths, Mapping):
            known = ", ".join(sorted(parts)) or "(none)"
            raise InputError(f"{call}: the mesh has no part {part!r}; it has the parts {known}.")
        owner = repr(part) if isinstance(strengths, Mapping) else "the membrane"
        if np.shape(pair) != (2,):
            raise InputError(
                f"{call}: strengths of {owner} = {pair!r}; give two, of warp and weft."
            )
        warp, weft = (checks.positive(f"{call}: strength of {owner}", x) for x in pair)
        found[part] = (warp, weft)
    if not found:
        raise InputError(
            f"{call}: strengths = {strengths!r} names no part; give those of one or more."
        )
    return found
