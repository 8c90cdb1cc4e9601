"""The roof sewn from the pieces of a pattern, compared with the wanted form, and adjusted to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Any

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.patterns.flattening import gradients
from crms_fenicsx.design.patterns.kept import keep, kept_options
from crms_fenicsx.design.patterns.pattern import Materials, Pattern
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, Whole, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, InputError, raised_together
from crms_fenicsx.model.materials import IsotropicMembrane, MembraneMaterial, OrthotropicMembrane
from crms_fenicsx.model.tolerances import UNSTRAINED
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.solver import Solver


@collective
def sew(
    pattern: Pattern,
    material: Materials | None = None,
    *,
    scene: Scene | None = None,
    **options: Any,
) -> Scene:
    """Make a scene of the pieces of a pattern, sewn along the seams. Collective.

    Cells are stress-free in the flat pieces. The scene starts in the form, with the strains due to
    the cut. Its mesh has the form's groups, the seams as groups of edges and the pieces as parts.

    Parameters
    ----------
    pattern
        The pattern.
    material
        The fabric, or one for each part; by default the pattern's. Its warp and prestress are
        ignored, as the pieces set the warp and the cut the prestress.
    scene
        A scene of the form whose membrane the pieces replace, and of which the sewn one keeps all
        else: supports; bars and cables with their unstressed lengths, joints, anchors and clamps;
        loads and pressure with their factors, ponds and floor; strengths and limits. Lengths of
        cables follow the vertices that the cut moves along them, by some .01 %. Seams are groups of
        edges along which more cables and belts can be laid. Without it the sewn scene has the
        membrane only.
    **options
        Options of `Scene`; by default those of `scene`.

    Raises
    ------
    InputError
        On all ranks: no pattern, step-wise strain, a `UflMembrane` with a prestress in its
        density, or a scene of another mesh or with something that the sewn one cannot keep: cables
        across cells or that slide with lines of the mesh, supports that have moved, terms of your
        own, or a bar whose end the cut has moved.

    Examples
    --------
    >>> roof = found.scene(fabric)
    >>> sewn = patterns.sew(pattern, scene=roof)
    >>> step = Solver(sewn).advance()
    """
    given = pattern.material if material is None else material
    for one in given.values() if isinstance(given, Mapping) else [given]:
        if isinstance(one, UflMembrane) and (
            np.abs(one.prestress_vector).max() > UNSTRAINED * one.reference_modulus
        ):
            raise InputError(
                f"sew: the density of {one!r} has the slope {one.prestress_vector} at zero strain, "
                "a prestress, which comes from the cut; subtract it from psi."
            )
    fabric: Any = _relaxed(given)
    if isinstance(given, Mapping):
        fabric = {part: _relaxed(one) for part, one in given.items()}
    if scene is not None:
        options = kept_options(scene, pattern.pieces) | options
    sewn = Scene(pattern.pieces.mesh, fabric, frames=frames_of(pattern), **options)
    if scene is not None:
        keep(scene, sewn, pattern.pieces)
    return sewn


def _relaxed(material: object) -> object:
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
        frames[one.piece.cells] = np.swapaxes(gradients(one.piece, one.shape), 1, 2)
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

    Examples
    --------
    >>> sewn = patterns.sew(pattern)
    >>> sewn.fix("boundary")
    >>> solver = Solver(sewn)
    >>> step = solver.advance()
    >>> found = patterns.compare(solver, pattern, forces=2.0)
    >>> found.whole.mean.round(1)
    array([2., 2.])
    """
    if solver.scene.mesh.edges is not pattern.pieces.mesh.edges:  # which all its scenes share
        raise InputError(
            "compare: the solver's scene is not sewn from these pieces; use that of "
            "patterns.sew(pattern), or of an adjusted one."
        )
    values = _cells(solver)
    wanted = None if forces is None else np.array(checks.pair("compare: forces", forces))
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
    sides = X[:, 1:] - X[:, :1]
    normal = np.cross(sides[:, 0], sides[:, 1])
    area = np.linalg.norm(normal, axis=1)
    off = np.abs(np.einsum("nki,ni->nk", u, normal / area[:, None])).max(axis=1)
    frames = membrane.frames[:n]
    moved = sides + (u[:, 1:] - u[:, :1])
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


Build = Callable[[Pattern], Solver]
"""Function that sews a pattern, applies supports and loads and returns the solver."""


@dataclass(frozen=True)
class Adjusted:
    """An adjusted pattern.

    Attributes
    ----------
    pattern
        The pattern.
    solver
        Solver of the roof sewn from it.
    comparisons
        Comparisons before each update and at the end.
    errors
        Largest relative difference from the target in each comparison.
    """

    pattern: Pattern
    solver: Solver = field(repr=False)
    comparisons: tuple[Comparison, ...] = field(repr=False)
    errors: tuple[float, ...]


@collective
def adjust(
    pattern: Pattern,
    build: Build,
    *,
    forces: float | tuple[float, float] | None = None,
    each: bool = False,
    tolerance: Positive = 1e-4,
    updates: Whole = 10,
) -> Adjusted:
    """Adjust compensation until the sewn roof meets its target. Collective.

    With `forces` the target is the mean section forces. On a pneumatic roof these follow from
    pressure and shape, and compensation changes the shape: leave `forces` out there, and the target
    is the mean lengths of the form along warp and weft.

    Parameters
    ----------
    pattern
        Initial pattern.
    build
        Function of a pattern that sews it, applies supports and loads, and returns the solver.
    forces
        Wanted section forces along warp and weft, or one for both (force per length).
    each
        Whether to adjust the compensation of each piece by its own means.
    tolerance
        Largest difference of the mean lengths, or of the mean forces relative to the larger wanted
        one.
    updates
        Largest number of updates.

    Returns
    -------
    Adjusted
        The pattern, its solver, and the comparisons on the way.

    Raises
    ------
    InputError
        On all ranks: invalid arguments, or a `build` that returns another roof.
    ConvergenceError
        On all ranks: a roof that misses the target after all updates.

    Examples
    --------
    >>> def build(pattern):
    ...     scene = patterns.sew(pattern)
    ...     scene.fix("boundary")
    ...     solver = Solver(scene)
    ...     solver.advance()
    ...     return solver
    >>> patterns.adjust(pattern, build, forces=(2.0, 2.0)).pattern
    """
    comm = pattern.comm
    if forces is not None and isinstance(pattern.material, Mapping):
        raise InputError("adjust: the roof has several materials; adjust its form, without forces.")
    found: list[Comparison] = []
    errors: list[float] = []
    names = [one.name for one in pattern.flat]
    # logarithms of the additional stretches, and the changes required at each iterate
    places: list[Array] = [np.zeros(2 * len(names) if each else 2)]
    changes: list[Array] = []
    while True:
        with raised_together(comm):
            solver = build(pattern)
            if not isinstance(solver, Solver):
                raise InputError(f"adjust: build returned {solver!r}, expected a Solver.")
        found.append(compare(solver, pattern, forces))
        judged = found[-1].pieces if each else (found[-1].whole,)
        errors.append(max(_error(found[-1].wanted, one) for one in judged))
        if errors[-1] <= tolerance:
            return Adjusted(pattern, solver, tuple(found), tuple(errors))
        if len(errors) > updates:
            raise ConvergenceError(
                f"adjust: after {updates} updates of the compensation the roof still differs by "
                f"{errors[-1]:.2g} from the wanted one (before: {errors[0]:.2g})."
            )
        changes.append(
            np.array([_change(pattern.material, found[-1].wanted, one) for one in judged]).ravel()
        )
        step = _accelerated(places, changes)
        places.append(places[-1] + step)
        pairs = [(warp, weft) for warp, weft in np.exp(step).reshape(-1, 2)]
        pattern = pattern.adjusted(dict(zip(names, cycle(pairs), strict=False)))


def _accelerated(places: list[Array], changes: list[Array]) -> Array:
    """Next step of the fixed-point iteration with Anderson acceleration (D. G. Anderson, J. ACM 12,
    1965), which learns how flexible the roof's edges are."""
    depth = min(len(places) - 1, len(changes[-1]), 3)
    if depth == 0:
        return changes[-1]
    x, r = (np.diff(np.array(one[-depth - 1 :]), axis=0).T for one in (places, changes))
    parts, *_ = np.linalg.lstsq(r, changes[-1], rcond=None)
    return np.asarray(changes[-1] - (x + r) @ parts)


def _change(material: object, wanted: Array | None, got: SewnPiece) -> tuple[float, float]:
    """Logarithms of the additional stretches along warp and weft if the edges were rigid."""
    stretch = got.stretch  # a piece that is too short is cut longer, hence stretched less
    if wanted is not None:
        assert isinstance(material, MembraneMaterial)
        stretch = 1.0 + np.linalg.solve(material.stiffness[:2, :2], wanted - got.mean)
    warp, weft = map(float, np.log(stretch))
    return warp, weft


def _error(wanted: Array | None, got: SewnPiece) -> float:
    """Largest relative error of the section forces, or of the lengths."""
    if wanted is None:
        return float(np.abs(got.stretch - 1.0).max())
    return float(np.abs(got.mean - wanted).max() / np.abs(wanted).max())
