"""Prescribed section forces of a form, and materials with these as prestress."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.membrane_mesh import outer_first
from crms_fenicsx.foundation.meshes.triangles import cell_normals
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.materials import IsotropicMembrane, MembraneMaterial, OrthotropicMembrane

Stress = float | Sequence[float] | Mapping[str, float | Sequence[float]]
"""Section force or (along warp, along weft), of the membrane or by part (force per length)."""
Direction = Sequence[float]
Materials = MembraneMaterial | Mapping[str, MembraneMaterial]
WHOLE = ""
"""Name of the whole membrane among the parts."""
NORMAL = 1e-10
"""1 - cosine up to which directions are equal, or a direction is normal to a cell."""
ALONG_X = (1.0, 0.0, 0.0)
"""Default warp of a form and of a material."""


@dataclass(frozen=True)
class PrescribedStress:
    """Section forces along warp and weft, of the membrane or its parts."""

    # section forces (s1, s2) (force per length) by part; key `WHOLE` for the whole membrane
    forces: dict[str, tuple[float, float]]
    # warp directions in space by part; None if not given: along x, if needed
    warps: dict[str, Direction | None]
    cell_forces: Array  # cell_forces (n, 2), directions (n, 3): of the local cells
    directions: Array

    @classmethod
    def of(
        cls,
        mesh: MembraneMesh,
        stress: Stress,
        warp: Direction | Mapping[str, Direction] | Mapping[str, Direction | None] | None,
    ) -> PrescribedStress:
        """Check the user's arguments. Collective."""
        by_part = dict(stress) if isinstance(stress, Mapping) else {WHOLE: stress}
        forces = {}
        for part, value in by_part.items():
            what = f"find_form: stress{_of(part)}"
            s1, s2 = checks.pair(what, value)
            forces[part] = checks.positive(what, s1), checks.positive(what, s2)
        given: dict[str, Direction | None] = (
            dict(warp) if isinstance(warp, Mapping) else dict.fromkeys(forces, warp)
        )
        if given.keys() != forces.keys():
            raise InputError(
                f"find_form: warp is given for {_names(given)}, but stress for {_names(forces)}; "
                "both must be for the same parts, or the warp for all."
            )
        for part, direction in given.items():
            if direction is not None:
                checks.direction(f"find_form: warp{_of(part)}", direction)
        number = _part_numbers(mesh, list(forces))
        values = np.array(list(forces.values()))
        along = [ALONG_X if given[part] is None else given[part] for part in forces]
        ways = np.array(along, dtype=float)
        cell_forces, directions = values[number], ways[number]
        with raised_together(mesh.comm):
            across = np.einsum("ni,ni->n", cell_normals(mesh.mesh), directions)
            normal = np.abs(across) > (1 - NORMAL) * np.linalg.norm(directions, axis=1)
            bad = np.flatnonzero(normal & (np.ptp(cell_forces, axis=1) > 0.0))
            if len(bad):
                raise InputError(
                    f"find_form: the warp direction {directions[bad[0]]} is normal to the start "
                    "mesh somewhere."
                )
        return cls(forces, given, cell_forces, directions)

    def tensors(self, mesh: MembraneMesh) -> Array:
        """Section forces of a mesh's cells as tensors in space, (n, 3, 3)."""
        s1, s2 = self.cell_forces.T[:, :, None, None]
        n, d = cell_normals(mesh.mesh), self.directions
        w = d - np.sum(d * n, axis=1)[:, None] * n
        length = np.linalg.norm(w, axis=1)[:, None]
        w = w / np.maximum(length, 1e-300)
        flat = np.eye(3) - n[:, :, None] * n[:, None, :]
        return np.asarray(s2 * flat + (s1 - s2) * w[:, :, None] * w[:, None, :])

    def materials(self, material: Materials) -> Materials:
        """Materials with these section forces as prestress."""
        if WHOLE in self.forces:
            if not isinstance(material, Mapping):
                return self._stressed(material, WHOLE, WHOLE)
            return {part: self._stressed(own, WHOLE, part) for part, own in material.items()}
        if not isinstance(material, Mapping):
            material = dict.fromkeys(self.forces, material)
        if material.keys() != self.forces.keys():
            raise InputError(
                f"FoundForm.scene: materials are given for {_names(material)}, but the form has "
                f"section forces of {_names(self.forces)}."
            )
        return {part: self._stressed(own, part, part) for part, own in material.items()}

    def _stressed(self, material: MembraneMaterial, part: str, owner: str) -> MembraneMaterial:
        if not isinstance(material, IsotropicMembrane | OrthotropicMembrane):
            raise InputError(
                f"FoundForm.scene: the material{_of(owner)} is a {type(material).__name__}, "
                "whose prestress cannot be set; use an IsotropicMembrane or OrthotropicMembrane."
            )
        s1, s2 = self.forces[part]
        prestress, given = s1 if s1 == s2 else (s1, s2), self.warps[part]
        if isinstance(material, IsotropicMembrane) and s1 != s2:
            raise InputError(
                f"FoundForm.scene: the material{_of(owner)} is isotropic, but has the section "
                f"forces {(s1, s2)} along warp and weft; use an OrthotropicMembrane."
            )
        if isinstance(material, IsotropicMembrane) or (given is None and s1 == s2):
            return dataclasses.replace(material, prestress=prestress)
        x, y, z = (float(value) for value in (ALONG_X if given is None else given))
        if not _named_alike(material.warp, (x, y, z)):
            raise InputError(
                f"FoundForm.scene: the material{_of(owner)} has the warp {material.warp}, but the "
                f"form {(x, y, z)}; pass it to find_form only."
            )
        return dataclasses.replace(material, prestress=prestress, warp=(x, y, z))


def _named_alike(own: object, form: tuple[float, float, float]) -> bool:
    """Whether a material's warp is the default or that of the form."""
    if callable(own):
        return False
    a, b = np.asarray(own, dtype=float), np.asarray(form)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(np.array_equal(a, ALONG_X) or abs(a @ b) >= (1 - NORMAL) * size)


def _of(part: str) -> str:
    return f" of part {part!r}" if part != WHOLE else ""


def _names(parts: Mapping[str, object]) -> str:
    return ", ".join(map(repr, parts)) if WHOLE not in parts else "the whole membrane"


def _part_numbers(mesh: MembraneMesh, parts: list[str]) -> Integers:
    """Index of the part of each local cell, (n,). Collective."""
    n = mesh.mesh.topology.index_map(2).size_local
    if parts == [WHOLE]:
        return np.zeros(n, dtype=np.int64)
    ordered = outer_first(mesh, "find_form", "stress", parts)
    number = np.full(n, -1)
    with raised_together(mesh.comm):
        for part in ordered:
            number[mesh.parts[part]] = parts.index(part)
        if (number < 0).any():
            raise InputError(
                f"find_form: {np.count_nonzero(number < 0)} cells are in none of the parts with a "
                f"stress, {_names(dict.fromkeys(parts))}."
            )
    return number
