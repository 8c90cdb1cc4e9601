"""The roof sewn from the pieces of a cutting pattern, compared with the wanted form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.patterns.conformal import cell_sides_in_plane
from crms_fenicsx.design.patterns.pattern import Materials, Pattern
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.model.materials import IsotropicMembrane, MembraneMaterial, OrthotropicMembrane
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.solver import Solver

SLOPE = 1e-12
"""Prestress of a `UflMembrane`, relative to its reference modulus, that counts as none."""


@collective
def sew(pattern: Pattern, material: Materials | None = None, **options: Any) -> Scene:
    """Make a scene of the pieces of a pattern, sewn along the seams. Collective.

    Cells are stress-free in the flat pieces. The scene starts in the form, with the strains due to
    the cut, without supports, loads and cables. Its mesh has the form's groups, the seams as groups
    of edges and the pieces as parts.

    Parameters
    ----------
    pattern
        The pattern.
    material
        The fabric, or one for each part; by default the pattern's. Its warp and prestress are
        ignored, as the pieces set the warp and the cut the prestress.
    **options
        Options of `Scene`.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    InputError
        On all ranks: no pattern, step-wise strain, or a `UflMembrane` with a prestress in its
        density.

    Examples
    --------
    >>> scene = patterns.sew(pattern)
    >>> scene.fix("boundary")
    >>> Solver(scene).advance(pressure=0.3)
    """
    if not isinstance(pattern, Pattern):
        raise InputError(f"sew: pattern = {pattern!r}; give what patterns.flatten returned.")
    checks.same(pattern.comm, "sew", material=material)
    given = pattern.material if material is None else material
    for one in given.values() if isinstance(given, Mapping) else [given]:
        if isinstance(one, UflMembrane) and (
            np.abs(one.prestress_vector).max() > SLOPE * one.reference_modulus
        ):
            raise InputError(
                f"sew: the density of {one!r} has the slope {one.prestress_vector} at zero strain, "
                "a prestress, which comes from the cut; subtract it from psi."
            )
    fabric: Any = (
        {part: relaxed(one) for part, one in given.items()}
        if isinstance(given, Mapping)
        else relaxed(given)
    )
    return Scene(pattern.pieces.mesh, fabric, frames=frames_of(pattern), **options)


def relaxed(material: MembraneMaterial) -> MembraneMaterial:
    """The material without its prestress."""
    if isinstance(material, IsotropicMembrane | OrthotropicMembrane):
        return replace(material, prestress=0.0)
    return material


def frames_of(pattern: Pattern) -> Array:
    """Images (n, 2, 3) of the flat pieces' unit vectors along warp and weft in this rank's cells:
    columns of the deformation gradient from flat shape to form."""
    surface, mesh = pattern.pieces.surface, pattern.pieces.mesh.mesh
    frames = np.zeros((len(surface.cells), 2, 3))
    for one in pattern.flat:
        x = one.piece.points[one.piece.triangles]
        sides = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)
        gradient = sides @ np.linalg.inv(cell_sides_in_plane(one.shape, one.piece.triangles))
        frames[one.piece.cells] = np.swapaxes(gradient, 1, 2)
    own = np.asarray(mesh.topology.original_cell_index, dtype=np.int64)
    with raised_together(pattern.comm):
        assert (np.sort(surface.cells[own]) == np.sort(cell_vertex_ids(mesh))).all()
    return frames[own]


@dataclass(frozen=True)
class SewnPiece:
    """Results of a piece in the sewn roof.

    Attributes
    ----------
    name
        Name of the piece.
    mean, spread, least, largest
        Section forces (2,) along warp and weft (force per length): mean and standard deviation over
        the current area, least and largest of the cells.
    deviation
        Largest distance of vertices from the form, along its normal (length).
    wrinkled
        Share of the area that is wrinkled or slack.
    stretch
        Mean stretches (2,) along warp and weft relative to the form.
    """

    name: str
    mean: Array
    spread: Array
    least: Array
    largest: Array
    deviation: float
    wrinkled: float
    stretch: Array


@dataclass(frozen=True)
class Comparison:
    """Comparison of a sewn roof with the form and the wanted forces.

    Attributes
    ----------
    wanted
        Wanted section forces (2,) along warp and weft (force per length), or None.
    pieces
        Results of each piece.
    whole
        Results of all pieces together.
    cells
        Cells of the cut surface (m, 4): section forces along warp and weft, distance from the form,
        and whether they are wrinkled or slack.
    """

    wanted: Array | None
    pieces: tuple[SewnPiece, ...] = field(repr=False)
    whole: SewnPiece
    cells: Array = field(repr=False)

    def __str__(self) -> str:
        """Table of all pieces."""
        head = f"{'':12} {'warp mean':>10} {'sd':>8} {'least':>8} {'weft mean':>10} {'sd':>8} "
        head += f"{'least':>8} {'off form':>9} {'wrinkled':>9}"
        rows = [head]
        if self.wanted is not None:
            warp, weft = self.wanted
            rows.append(f"{'wanted':12} {warp:10.4g} {'':8} {'':8} {weft:10.4g}")
        for one in (*self.pieces, self.whole):
            a, b = (f"{one.mean[k]:10.4g} {one.spread[k]:8.3g} {one.least[k]:8.3g}" for k in (0, 1))
            rows.append(f"{one.name:12} {a} {b} {one.deviation:9.3g} {one.wrinkled:9.1%}")
        return "\n".join(rows)


@collective
def compare(
    solver: Solver, pattern: Pattern, forces: float | tuple[float, float] | None = None
) -> Comparison:
    """Compare a sewn roof with the wanted form and forces. Collective.

    Parameters
    ----------
    solver
        Solver of a scene made by `sew`, in the state to compare.
    pattern
        The pattern.
    forces
        Wanted section forces along warp and weft, or one for both (force per length).

    Returns
    -------
    Comparison
        Section forces, deviation and wrinkles, by pieces and in all.

    Raises
    ------
    InputError
        On all ranks: a solver of another scene.
    """
    if not isinstance(solver, Solver) or not isinstance(pattern, Pattern):
        raise InputError("compare: give the solver of a sewn roof and its pattern.")
    checks.same(pattern.comm, "compare", forces=forces)
    if solver.scene.mesh is not pattern.pieces.mesh:
        raise InputError(
            "compare: the solver's scene is not sewn of these pieces; give that of "
            "patterns.sew(pattern), or of an adjusted one."
        )
    values = _cells(solver)
    wanted = None if forces is None else np.broadcast_to(np.asarray(forces, float), (2,)).copy()
    pieces = tuple(_piece_results(one.name, values[one.piece.cells]) for one in pattern.flat)
    return Comparison(wanted, pieces, _piece_results("all", values), values[:, 1:5])


def _cells(solver: Solver) -> Array:
    """Values (m, 8) of all cells of the cut surface, on all ranks: area, section forces along warp
    and weft, deviation, 1 if wrinkled, stretches from the form, and the form's area. Collective."""
    results, scene = solver.results(), solver.scene
    membrane = scene.membrane
    assert membrane.frames is not None
    n = len(results.areas)
    own = np.asarray(scene.mesh.mesh.topology.original_cell_index[:n], dtype=np.int64)
    dofs = scene.V.dofmap.list[:n]
    u = scene.u.x.array.reshape(-1, 3)[dofs]
    X = membrane.stress_free[dofs]
    normal = np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    area = np.linalg.norm(normal, axis=1)
    off = np.abs(np.einsum("nki,ni->nk", u, normal / area[:, None])).max(axis=1)
    frames = membrane.frames[:n]
    sides = np.stack([X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]], axis=1)
    moved = sides + np.stack([u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]], axis=1)
    G = np.einsum("nai,nbi->nab", frames, frames)
    parts = np.einsum("nki,nai->nka", sides, np.linalg.solve(G, frames))
    images = np.linalg.solve(parts, moved)
    stretch = np.linalg.norm(images, axis=2) / np.linalg.norm(frames, axis=2)
    found = np.column_stack(
        [results.areas, results.warp_weft[:, :2], off, results.state < 2, stretch, area / 2]
    )
    values = np.zeros((scene.mesh.mesh.topology.index_map(2).size_global, found.shape[1]))
    for rows, part in solver.comm.allgather((own, found)):
        values[rows] = part
    return values


def _piece_results(name: str, values: Array) -> SewnPiece:
    """Results of a piece, from its cell values (m, 8)."""
    share, forces, form = values[:, 0] / values[:, 0].sum(), values[:, 1:3], values[:, 7]
    mean = share @ forces
    return SewnPiece(
        name, mean, np.sqrt(share @ (forces - mean) ** 2), forces.min(axis=0), forces.max(axis=0),
        float(values[:, 3].max()), float(share @ values[:, 4]), form @ values[:, 5:7] / form.sum(),
    )  # fmt: skip
