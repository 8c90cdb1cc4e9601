"""Parts of a mesh by the names that users give: all of them there, and no cell in two."""

from __future__ import annotations

from collections.abc import Iterable

from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.runtime.errors import InputError


def check_parts(mesh: MembraneMesh, call: str, what: str, names: Iterable[object]) -> None:
    """Refuse parts that do not exist, or that give cells two of something.

    Collective when a mesh is first asked, which making its scene does.

    Parameters
    ----------
    mesh
        The mesh.
    call
        What the parts are given to, for messages.
    what
        What each of them gets: "material".
    names
        Of the parts; their order does not count.

    Raises
    ------
    InputError
        On all ranks: a part that does not exist, or two with common cells, by name.
    """
    given = sorted(names, key=repr)
    for part in given:
        if part not in mesh.parts:
            known = ", ".join(sorted(mesh.parts)) or "(none)"
            raise InputError(f"{call}: the mesh has no part {part!r}; it has the parts {known}.")
    for one, other in mesh.overlaps:
        if one in given and other in given:
            raise InputError(
                f"{call}: part {one!r} shares cells with part {other!r}, which has a {what} as "
                f"well; give each cell one {what}."
            )
