"""Cables along mesh edges, with prescribed tension, or with tension sought for a length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.foundation.dofs.layout import vertex_dofs
from crms_fenicsx.foundation.meshes.membrane_mesh import rows_of, vertex_ids
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.cable import HOLDS, Hold
from crms_fenicsx.model.membrane import Membrane


@dataclass(frozen=True)
class FormCable:
    """A cable along mesh edges, given by its tension, force density or length.

    The tension is constant over the whole length, as in a cable that slides freely.

    Parameters
    ----------
    group
        Edge group of the mesh: one continuous line of edges, along the rim or inside the membrane.
    tension
        Tension T (force).
    force_density
        T / L, with the length L of the whole cable (force per length): n times the usual force
        density of one of n equal links.
    length
        L (length); T is found.
    hold
        Attachment of the scene's cable to the fabric, as in `Scene.lay_cable`: "sleeve", "pocket",
        "bonded", as belts and bolt ropes are, or "outside", for one that presses on the outer side,
        such as a valley cable. A cable along the rim that is not bonded lies in a pocket. It does
        not change the form.

    Raises
    ------
    InputError
        None or several of the three are given, one is not positive, or an unknown attachment.

    Examples
    --------
    >>> FormCable("front", tension=25.0)
    FormCable(group='front', tension=25.0, force_density=None, length=None, hold='sleeve')
    >>> FormCable("left", length=10.5)
    FormCable(group='left', tension=None, force_density=None, length=10.5, hold='sleeve')
    """

    group: str
    tension: float | None = None
    force_density: float | None = None
    length: float | None = None
    hold: Hold = "sleeve"

    def __post_init__(self) -> None:
        laws = ("tension", "force_density", "length")
        given = [name for name in laws if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                f"FormCable: {self.group!r} has {' and '.join(given) or 'nothing'} prescribed; "
                "expected one of tension, force_density and length."
            )
        checks.positive(f"FormCable: {given[0]} of {self.group!r}", getattr(self, given[0]))
        checks.one_of(f"FormCable: hold of {self.group!r}", self.hold, HOLDS)


@dataclass(frozen=True)
class FormCableFound:
    """A cable of a found form.

    Attributes
    ----------
    name
        Name of its edge group.
    tension
        Tension (force).
    length
        Length (length).
    path
        Positions of its vertices from end to end (length), (k, 3).
    hold
        Attachment to the fabric, as given.
    """

    name: str
    tension: float
    length: float
    path: Array = field(repr=False)
    hold: Hold = "sleeve"

    @property
    def force_density(self) -> float:
        """Tension over length (force per length)."""
        return self.tension / self.length


@dataclass
class EdgeLine:
    """Edges of a cable; each keeps its share of the cable's length."""

    cable: FormCable  # prescribed data
    ids: Integers  # (k,) vertices from end to end, numbered as in the mesh given
    # (m, 2) vertices of this rank's owned edges, by local degree of freedom, along the cable
    edges: Indices
    shares: Array  # (m,) shares of these edges in the start mesh's length
    tension: float = 0.0  # current tension (force)
    length: float = 0.0  # current length of the whole cable (length)
    _sides: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def measure(self, x: Array, comm: MPI.Intracomm) -> None:
        """Measure edges and length at positions x (n, 3). Collective."""
        self._sides = x[self.edges[:, 1]] - x[self.edges[:, 0]]
        self.length = comm.allreduce(float(np.linalg.norm(self._sides, axis=1).sum()))

    @property
    def equation(self) -> tuple[float, float]:
        """Error of the prescribed length or force density, and its reference value."""
        if self.cable.length is not None:
            return self.length - self.cable.length, self.cable.length
        force = (self.cable.force_density or 0.0) * self.length
        return force - self.tension, force

    def slope(self, n: int, *, even: bool = False) -> Array:
        """This rank's share of the gradient of the length by its n vertices, (n, 3); an `even` one
        with each edge's pull scaled by its length over its nominal length."""
        lengths = self.shares * self.length if even else np.linalg.norm(self._sides, axis=1)
        pulls, slope = self._sides / lengths[:, None], np.zeros((n, 3))
        np.add.at(slope, self.edges[:, 1], pulls)
        np.add.at(slope, self.edges[:, 0], -pulls)
        return slope

    def tangents(self, n: int) -> Array:
        """This rank's share of tangent vectors of the cable at its n vertices, (n, 3)."""
        along = np.zeros((n, 3))
        for end in self.edges.T:
            np.add.at(along, end, self._sides)
        return along

    def add_stiffness(self, A: PETSc.Mat, *, even: bool = False) -> None:
        """Add the derivative of `slope`, of an `even` one at constant length, which is positive
        definite, times the tension."""
        lengths, block = self.shares * self.length, np.eye(3)
        if not even:
            lengths = np.linalg.norm(self._sides, axis=1)
            t = self._sides / lengths[:, None]
            block = block - t[:, :, None] * t[:, None, :]
        blocks = block * (self.tension / lengths)[:, None, None]
        signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
        values = np.einsum("ij,nab->niajb", signs, blocks).reshape(len(blocks), 36)
        A.setValuesBlockedLocalRCV(self.edges, self.edges, values, PETSc.InsertMode.ADD)


def edge_lines(membrane: Membrane, cables: Sequence[FormCable]) -> list[EdgeLine]:
    """Edges of each cable. Collective."""
    mesh, topology = membrane.mesh, membrane.mesh.mesh.topology
    with raised_together(mesh.comm):
        for cable in cables:
            checks.of_type("find_form: a cable", cable, FormCable)
            checks.named("edge group", mesh.edges, cable.group)
    dof_of = vertex_dofs(membrane.V)
    ends = topology.connectivity(1, 0).array.reshape(-1, 2)
    ids, owned = vertex_ids(mesh.mesh), topology.index_map(1).size_local
    taken = np.zeros(len(ends), dtype=bool)
    lines = []
    rows = rows_of(mesh, "find_form", [cable.group for cable in cables])
    for cable, row in zip(cables, rows, strict=True):
        own = mesh.edges[cable.group]
        own = own[own < owned]
        with raised_together(mesh.comm):
            if taken[own].any():
                raise InputError(f"find_form: {cable.group!r} has edges of another cable.")
        chain = np.array(row, dtype=np.int64)
        number = np.argsort(chain)
        at = number[np.searchsorted(chain, ids[ends[own]], sorter=number)]
        edges = dof_of[np.where(at[:, :1] < at[:, 1:], ends[own], ends[own][:, ::-1])]
        sides = membrane.stress_free[edges[:, 1]] - membrane.stress_free[edges[:, 0]]
        lengths = np.linalg.norm(sides, axis=1)
        shares = lengths / mesh.comm.allreduce(float(lengths.sum()))
        lines.append(EdgeLine(cable, chain, edges, shares))
        taken[own] = True
    return lines


def places_of(membrane: Membrane, ids: Integers) -> Array:
    """Current positions (length) of vertices numbered as in the mesh given. Collective."""
    n = membrane.V.dofmap.index_map.size_local
    own, x = membrane.vertex_ids[:n], membrane.positions()[:n]
    here = np.isin(own, ids)
    found = membrane.comm.allgather((own[here], x[here]))
    numbers = np.concatenate([numbers for numbers, _ in found])
    order = np.argsort(numbers)
    places = np.concatenate([places for _, places in found])[order]
    return np.asarray(places[np.searchsorted(numbers[order], ids)])
