"""Changing the parameters of a scene's materials, for parameter studies, without recompiling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.ufl_material import UflMembrane

BUILT_IN = ("psi", "warp")
"""Fields compiled into forms or stored on the mesh, which cannot change."""


def numbers(material: MembraneMaterial) -> dict[str, Any]:
    """The fields of a material that may change, by name."""
    own = {field.name: getattr(material, field.name) for field in fields(material)}  # type: ignore[arg-type]
    return {name: value for name, value in own.items() if name not in BUILT_IN}


def with_numbers(material: MembraneMaterial, saved: Mapping[str, Any]) -> MembraneMaterial:
    """Return the material with the fields `numbers`, as read from a file."""
    own = {name: tuple(one) if isinstance(one, list) else one for name, one in saved.items()}
    if own == numbers(material):
        return material
    changed: MembraneMaterial = replace(material, **own)  # type: ignore[type-var]
    if set(own) != set(numbers(material)) or changed.law != material.law:
        raise ValueError(f"expected a material like {material}, found {own}")
    return changed


def checked_materials(
    membrane: Membrane, material: MembraneMaterial | Mapping[str, MembraneMaterial]
) -> dict[int, MembraneMaterial]:
    """Checked new materials of a membrane, by material number."""
    if isinstance(material, Mapping):
        checks.collection("set_material: material", material, Mapping, '{"roof": ...}', 1)
        number = {part: k for k, part in membrane.parts.items()}
        kind = "material of a part"
        found = {checks.named(kind, number, part): one for part, one in material.items()}
    else:
        found = dict.fromkeys(membrane.materials, material)
    for k, new in found.items():
        _check_alike(membrane.owner_of_material(k), membrane.materials[k], new)
    return {
        k: new if new.dT == membrane.materials[k].dT
        else with_numbers(new, numbers(new) | {"dT": membrane.materials[k].dT})
        for k, new in found.items()
    }  # fmt: skip


def _check_alike(owner: str, old: MembraneMaterial, new: MembraneMaterial) -> None:
    """Refuse a new material that differs in more than its parameters."""
    if new is old:
        return
    reason = ""
    if type(new) is not type(old):
        reason = f"is not of the same class, {type(old).__name__}"
    elif isinstance(old, UflMembrane):
        reason = "has a density of your own, whose numbers are compiled into its forms"
    elif new.law != old.law:
        reason = f"has wrinkling={not getattr(old, 'wrinkling', True)}, unlike before"
    elif new.warp is not old.warp and (
        callable(new.warp) or callable(old.warp) or not np.array_equal(new.warp, old.warp)  # type: ignore[arg-type]
    ):
        reason = f"has the warp {new.warp!r} in place of {old.warp!r}"
    if reason:
        raise InputError(
            f"set_material: the material {new!r} of {owner} {reason}; pass one with other numbers "
            "only, or make another Scene(...)."
        )
