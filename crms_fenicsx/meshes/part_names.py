"""Parts of a mesh by the names that users give: which of them a cell counts to."""

from __future__ import annotations

from collections.abc import Iterable

from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.runtime.errors import InputError


def outer_first(mesh: MembraneMesh, call: str, what: str, names: Iterable[object]) -> list[str]:
    """Order parts so that one inside another comes after it: its cells count to the inner one.

    Collective when a mesh is first asked, which making its scene does.
    """
    given = sorted(names, key=repr)
    for part in given:
        if part not in mesh.parts:
            known = ", ".join(sorted(mesh.parts)) or "(none)"
            raise InputError(f"{call}: the mesh has no part {part!r}; it has the parts {known}.")
    around = dict.fromkeys(map(str, given), 0)
    for (one, other), inner in mesh.overlaps.items():
        if one in around and other in around:
            if inner is None:
                raise InputError(
                    f"{call}: part {one!r} shares cells with part {other!r}, which has a {what} as "
                    f"well, and neither is inside the other; give each cell one {what}."
                )
            around[inner] += 1
    return sorted(around, key=lambda part: around[part])
