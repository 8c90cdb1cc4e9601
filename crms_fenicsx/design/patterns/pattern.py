"""The cutting pattern: the flat pieces of a roof."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.design.patterns.compensation import (
    EdgeShrink,
    Shrink,
    shrinks_of,
    warp_moduli,
    width_in_tension,
)
from crms_fenicsx.design.patterns.flattening import (
    FlatProblem,
    ProblemOf,
    Sides,
    aligned,
    columns_of,
    conformal,
    double_areas_in_plane,
    fine_energies,
    flat_shapes,
    limit_of,
)
from crms_fenicsx.design.patterns.pieces import COLUMNS, Piece, Pieces
from crms_fenicsx.foundation.meshes.membrane_mesh import outer_first
from crms_fenicsx.foundation.meshes.triangles import closest
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, PatternWarning, raised_together
from crms_fenicsx.model.materials import MembraneMaterial, check_warp

Warp = Literal["seams"] | tuple[float, float, float] | Callable[[Array], Array]
Materials = MembraneMaterial | Mapping[str, MembraneMaterial]

WARNED_STRAIN = 1e-3
"""Estimated strain of a piece above which too few columns of cells are warned of."""


@dataclass(frozen=True)
class FlatPiece:
    """A flat piece, as it is cut.

    Attributes
    ----------
    piece
        The piece in space.
    shape
        Flat places (n, 2) of its vertices (length): x along the warp, seen from outside.
    shrink
        Mean compensation (2,) along warp and weft.
    strains
        Distortion: strains (E11, E22, 2 E12) of the cells (m, 3) in the form, less the wanted ones.
    """

    piece: Piece
    shape: Array = field(repr=False)
    shrink: Array
    strains: Array = field(repr=False)
    problem_of: ProblemOf = field(repr=False, compare=False)

    @cached_property
    def energy(self) -> float:
        """Energy of the distortion per area of the form (force per length), extrapolated to
        infinitely fine cells on first use."""
        own = self.problem_of(self.piece, self.shape).energy(self.shape)
        found = fine_energies(self.piece, self.shape, self.problem_of)
        return max(own - found[0] + limit_of(found), 0.0) / self.piece.area

    @property
    def name(self) -> str:
        """Name of the piece."""
        return self.piece.name

    @property
    def area(self) -> float:
        """Area of the flat piece (length squared)."""
        return float(double_areas_in_plane(self.shape, self.piece.triangles).sum()) / 2

    @property
    def length(self) -> float:
        """Extent along the warp (length)."""
        return float(np.ptp(self.shape[:, 0]))

    @property
    def width(self) -> float:
        """Extent across the warp (length), along the roll's width."""
        return float(np.ptp(self.shape[:, 1]))

    @property
    def distortion(self) -> float:
        """Largest strain of the distortion."""
        return float(np.abs(self.strains).max())

    def largest_width(self, force: float) -> float:
        """`patterns.largest_width` (length) for its mean curvature and a section force (force per
        length)."""
        moduli = warp_moduli(self.problem_of(self.piece, self.shape).stiffness)
        modulus = float(self.piece.areas @ moduli) / self.piece.area
        return width_in_tension(modulus, force, self.piece.curvature)


@dataclass(frozen=True)
class _CutOptions:
    """Options of a pattern; see `flatten`."""

    warp: Warp | None = None
    shrinks: Mapping[str, Shrink] = field(default_factory=dict)
    """By names of pieces and parts; "" stands for all."""
    edges: Mapping[str, EdgeShrink] = field(default_factory=dict)
    equal: bool = True
    limit: float | None = None
    factors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Additional stretches along warp and weft by pieces, as found by `adjust`."""


@dataclass(frozen=True, repr=False)
class Pattern:
    """The flat pieces of a roof, the same on all ranks.

    Attributes
    ----------
    pieces
        Pieces in space and the joints between them.
    material
        The fabric.
    flat
        Flat pieces.
    made
        Options they were made with.
    """

    pieces: Pieces
    material: Materials
    flat: tuple[FlatPiece, ...]
    made: _CutOptions

    def __repr__(self) -> str:
        """One line; not collective."""
        worst = max(self.flat, key=lambda one: one.distortion)
        return (
            f"Pattern({len(self.flat)} pieces, area {self.area:.6g}, strained up to "
            f"{worst.distortion:.2g} in {worst.name})"
        )

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        return self.pieces.comm

    @property
    def area(self) -> float:
        """Area of all flat pieces (length squared)."""
        return sum(one.area for one in self.flat)

    def seam_lengths(self) -> dict[str, Array]:
        """Lengths (k, 2) of each seam's segments, on both sides (length).

        Examples
        --------
        >>> one, other = pattern.seam_lengths()["seam 1"].sum(axis=0)
        """
        joints = self.pieces.joints
        lengths = np.zeros(joints.pieces.shape)
        for k, one in enumerate(self.flat):
            own = joints.pieces == k
            sides = one.shape[joints.ends[own]]
            lengths[own] = np.hypot(*(sides[:, 1] - sides[:, 0]).T)
        names = np.array(joints.seams)
        return {seam: lengths[names == seam] for seam in dict.fromkeys(joints.seams)}

    @collective
    def adjusted(self, factors: Mapping[str, tuple[float, float]]) -> Pattern:
        """Return the pattern cut for further stretches of its pieces. Collective.

        Parameters
        ----------
        factors
            Further stretches along warp and weft, by pieces, 1.01 for 1 %.

        Returns
        -------
        Pattern
            New pattern of the same pieces.
        """
        both = {}
        for one in self.flat:
            before, after = (
                each.get(one.name, (1.0, 1.0)) for each in (self.made.factors, factors)
            )
            both[one.name] = (before[0] * after[0], before[1] * after[1])
        return _made_pattern(self.pieces, self.material, replace(self.made, factors=both))


@collective
def flatten(
    pieces: Pieces,
    material: Materials,
    *,
    warp: Warp | None = None,
    shrink: Shrink | Mapping[str, Shrink] | None = None,
    edges: Mapping[str, EdgeShrink] | None = None,
    equal: bool = True,
    limit: Positive | None = None,
) -> Pattern:
    """Lay pieces flat with the least strain energy, and compensate them. Collective.

    A flat piece takes its form in space with the strain of the compensation and, where the form is
    doubly curved, the least possible energy of further strains (J. Linhard, R. Wuechner,
    K.-U. Bletzinger, Introducing cutting patterns in form finding and structural analysis, 2008).
    The search starts from a conformal map. All flat pieces have the warp along x.

    Parameters
    ----------
    pieces
        Pieces from `cut`.
    material
        The fabric, or one for each part of the mesh.
    warp
        "seams", along the seams of each piece; a direction in space (3,); or a function that
        returns directions (3, n) for points (3, n), averaged over each piece. By default the warp
        of an orthotropic material, for others "seams".
    shrink
        Compensation of all pieces, or by names of pieces or parts; none by default.
    edges
        De-compensation, by names of edge groups.
    equal
        Whether both sides of a seam are cut to equal length; it costs .02 % of the energy.
    limit
        Largest accepted strain of the distortion.

    Raises
    ------
    InputError
        On all ranks: an invalid argument, or a piece strained beyond `limit`; the message tells
        how many strips would do.
    ConvergenceError
        On all ranks: a piece that does not lie flat.

    Warns
    -----
    PatternWarning
        Fewer than 8 columns of cells across a doubly curved piece, for which strains, and the
        scatter of section forces in the sewn roof, are overestimated.

    Notes
    -----
    A strip of width W on a surface of Gaussian curvature K has the strain ``|K| W**2 / 12`` and the
    energy ``E t K**2 W**4 / 1440`` per area, with E t along the warp. Energies are extrapolated
    from the piece's cells and finer ones: to 1 % with 8 columns of cells, to 6 % with 4.

    Examples
    --------
    >>> shrink = patterns.shrink_for(fabric, 2.0)
    >>> pattern = patterns.flatten(pieces, fabric, shrink=shrink)
    """
    if warp is not None and not (isinstance(warp, str) and warp == "seams"):
        check_warp("flatten", warp)
    for name, one in (edges or {}).items():
        checks.named("group of edges", pieces.surface.edges, name)
        checks.of_type(f"flatten: edges[{name!r}]", one, EdgeShrink)
    shrinks = shrinks_of(shrink, pieces.surface.parts)
    return _made_pattern(
        pieces, material, _CutOptions(warp, shrinks, edges or {}, bool(equal), limit)
    )


def _made_pattern(pieces: Pieces, material: Materials, made: _CutOptions) -> Pattern:
    """The pattern of checked options. Collective."""
    comm = pieces.comm
    stiffness, warps = of_cells(pieces, material, made.warp)
    problem_of = partial(_problem, pieces, stiffness, made)
    mine = range(comm.rank, len(pieces.pieces), comm.size)
    problems, starts, sides, stretches = {}, {}, {}, {}
    with raised_together(comm):
        for k in mine:
            piece = pieces.pieces[k]
            start = aligned(piece, conformal(piece.points, piece.triangles), warps)
            problems[k] = problem = problem_of(piece, start)
            mean = piece.areas @ problem.wanted / piece.area
            stretches[k] = np.sqrt(1.0 + 2.0 * mean[:2])
            start = start / stretches[k]
            for _ in range(2):  # the conformal map rotates its ends
                start = aligned(piece, problem.solve(start), warps)
            row, side = np.nonzero(pieces.joints.pieces == k)
            ends = pieces.joints.ends[row, side]
            starts[k], sides[k] = start, Sides(row, ends, np.where(side == 0, 1.0, -1.0))
    joints = len(pieces.joints.seams) if made.equal else 0
    shapes = flat_shapes(problems, starts, sides, joints, comm)
    found = {}
    for k, problem in problems.items():
        found[k] = 1.0 - 1.0 / stretches[k], problem.strains(shapes[k]) - problem.wanted
    every = {k: one for part in comm.allgather(found) for k, one in part.items()}
    flat = tuple(
        FlatPiece(piece, shapes[k] - shapes[k].min(axis=0), shrink, strains, problem_of)
        for k, piece in enumerate(pieces.pieces)
        for shrink, strains in [every[k]]
    )
    _check(comm, flat, made.limit)
    return Pattern(pieces, material, flat, made)


def of_cells(pieces: Pieces, material: Materials, warp: Warp | None) -> tuple[Array, Array | None]:
    """Stiffness (m, 3, 3) and warp (m, 3) of all cells; None as the warp if along seams."""
    surface = pieces.surface
    m, centres = len(surface.cells), surface.points[surface.cells].mean(axis=1)
    given: list[tuple[Integers, object]] = [(np.arange(m), material)]
    if isinstance(material, Mapping):
        named = outer_first(pieces.mesh, "flatten", "material", material)
        given = [(surface.parts[part], material[part]) for part in named]
    stiffness, warps = np.zeros((m, 3, 3)), np.zeros((m, 3))
    along_seams = isinstance(warp, str)
    for cells, own in given:
        if not isinstance(own, MembraneMaterial):
            raise InputError(
                f"flatten: material = {own!r} is not a material; pass that of the fabric."
            )
        stiffness[cells] = own.stiffness
        direction = own.warp if warp is None else warp
        if direction is None:
            along_seams = True
        elif not along_seams:
            found = direction(centres[cells].T) if callable(direction) else direction
            given_warps = np.asarray(found, dtype=float).T
            if given_warps.shape not in ((3,), (len(cells), 3)):
                raise InputError(
                    f"flatten: the function of the warp returned an array of shape "
                    f"{given_warps.T.shape}; it must return directions of shape (3, {len(cells)})."
                )
            warps[cells] = given_warps
    if not stiffness.any(axis=(1, 2)).all():
        raise InputError("flatten: there are cells without a material; every part needs one.")
    return stiffness, None if along_seams else warps


def _problem(
    pieces: Pieces, stiffness: Array, made: _CutOptions, piece: Piece, flat: Array
) -> FlatProblem:
    """The flattening problem of a piece near flat coordinates (n, 2)."""
    first, last = int(flat[:, 0].argmin()), int(flat[:, 0].argmax())
    return FlatProblem(
        piece.name, piece.points, piece.triangles, stiffness[piece.cells],
        _wanted(pieces, piece, flat, made), np.array([2 * first, 2 * first + 1, 2 * last + 1]),
    )  # fmt: skip


def _wanted(pieces: Pieces, piece: Piece, start: Array, made: _CutOptions) -> Array:
    """Wanted strains (m, 3) of a piece's cells, from its flat shape to the form."""
    centres = start[piece.triangles].mean(axis=1)
    along = (centres[:, 0] - start[:, 0].min()) / np.ptp(start[:, 0])
    parts = np.zeros((len(along), 2))
    for name in sorted(made.shrinks, key=lambda name: (name != "", name == piece.name)):
        own = pieces.surface.parts[name] if name else piece.cells
        inside = np.isin(piece.cells, own)
        parts[inside] = made.shrinks[name].at(along)[inside]
    stretches = np.array(made.factors.get(piece.name, (1.0, 1.0))) / (1.0 - parts)
    wanted = np.column_stack([(stretches**2 - 1.0) / 2.0, np.zeros(len(along))])
    for name, edge in made.edges.items():
        for run in piece.edges:
            if run.name == name:
                wanted += _edge_strains(piece, run.vertices, start, wanted, edge)
    return wanted


def _edge_strains(
    piece: Piece, run: Integers, start: Array, wanted: Array, edge: EdgeShrink
) -> Array:
    """Change of the wanted strains (m, 3) by the de-compensation of an edge."""
    a, b, places = piece.points[run[:-1]], piece.points[run[1:]], piece.points
    segments = np.stack([a, b, b], axis=1)
    gaps = np.stack([closest(np.broadcast_to(s, (len(places), 3, 3)), places)[2]
                     for s in segments], axis=1)  # fmt: skip
    away = gaps.min(axis=1)[piece.triangles]
    corner = np.take_along_axis(piece.triangles, away.argmin(axis=1)[:, None], axis=1)[:, 0]
    nearest, near = gaps.argmin(axis=1)[corner], np.maximum(1.0 - away.min(axis=1) / edge.band, 0.0)
    t = np.diff(start[run], axis=0)[nearest]
    t /= np.hypot(*t.T)[:, None]
    tt = np.stack([t[:, 0] ** 2, t[:, 1] ** 2, t[:, 0] * t[:, 1]], axis=1)
    own = (1.0 / (1.0 - edge.part) ** 2 - 1.0) / 2.0
    excess = near * (own - np.einsum("ni,ni->n", wanted, tt))
    return np.asarray(excess[:, None] * tt * (1.0, 1.0, 2.0))


def _check(comm: MPI.Intracomm, flat: tuple[FlatPiece, ...], limit: float | None) -> None:
    """Refuse pieces distorted beyond the limit; warn on rank 0 of too few columns of cells across
    curved pieces."""
    told = [
        f"{one.name} ({one.width:.4g} wide) by {one.distortion:.2g}: cut it into "
        f"{math.ceil(math.sqrt(one.distortion / limit))} strips"
        for one in flat
        if limit is not None and one.distortion > limit
    ]
    if told:
        raise InputError(
            f"flatten: pieces are strained by more than {limit:g} to lie flat: {'; '.join(told)}."
        )
    curved = [one for one in flat if abs(one.piece.curvature) * one.width**2 / 12 > WARNED_STRAIN]
    columns = {one.name: columns_of(one.piece, one.shape) for one in curved}
    name = min(columns, key=lambda name: columns[name], default="")
    if comm.rank == 0 and curved and round(columns[name]) < COLUMNS / 2:
        warnings.warn(
            f"flatten: there are {columns[name]:.0f} columns of cells across {name}, which is "
            "curved in two directions: its strains, and the scatter of section forces in the sewn "
            f"roof, are overestimated; refine the mesh to {COLUMNS} columns.",
            PatternWarning,
            stacklevel=4,
        )
