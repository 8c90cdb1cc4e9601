"""Loads on the membrane: nodal forces that keep direction and size as the shape changes, and ponds.

Wind has no potential, as its suction stays normal to the surface and varies over it. A load step is
solved with the wind's forces on the previously found shape, repeatedly, until they agree with those
on the new shape. The correction on folded cells is a separate term, `folded_pressure.FoldedWind`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.meshes.membrane_mesh import cells_of, outer_first
from crms_fenicsx.foundation.meshes.triangles import WALL, cell_normals, double_areas, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Rows
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane

Traction = Sequence[float] | Array | Callable[[Array, Array], Array]
"""Force per area: (3,), or a function of points and unit normals, both (3, n), returning (3, n)."""

Coefficient = float | Mapping[str, float] | Callable[[Array, Array], Array]
"""Pressure coefficient of the wind: a number, one for each named part of the mesh, or a function of
points and unit normals, both (3, n), returning (n,)."""

Area = Literal["surface", "plan", "material"]
"""Reference area of a load: the current surface, its plan projection, or the stress-free area."""


@dataclass(frozen=True)
class MembraneLoad:
    """A load on the membrane."""

    name: str  # name in load steps, history and checkpoints
    # (n, 3) nodal forces from this rank's cells at the factor 1 (force)
    forces: Annotated[Array, Rows.SHARES, 3] = field(repr=False)
    intensity: float  # mean force per area at the factor 1, over the whole membrane
    # (m,) force per area along the normals of this rank's cells; None for a fixed direction
    suction: Annotated[Array, Rows.CELLS] | None = field(default=None, repr=False)
    peak: float = 0.0  # velocity pressure q_p of wind (force per area): the suction is -q_p c_p
    factor: float = 0.0  # load factor, changed by load steps
    # forces (force) on joints of bars, by name
    joints: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    # (m, 3) force per stress-free area of this rank's cells, of a fixed direction; None for forces
    # on vertices and lines
    material: Annotated[Array, Rows.CELLS, 3] | None = field(default=None, repr=False)
    at_vertices: bool = False  # whether it is of forces on vertices, not on areas or lines
    weighs: bool = False  # whether it acts per stress-free area also while places shift
    # displacements of the stress-free places, as in `MembraneState`, when it was put, and the load
    # as put if they have moved since
    placed: Annotated[Array, Rows.VERTICES, 3] | None = field(default=None, repr=False)
    put: MembraneLoad | None = field(default=None, repr=False)
    # temperature changes (kelvin) by name; see `model.temperature`
    warms: Mapping[str, float] = field(default_factory=dict)
    basis: str = ""  # what its function says of itself: a dataclass its fields, others their text

    @property
    def is_active_wind(self) -> bool:
        """Whether it follows the normals, with a nonzero factor."""
        return self.suction is not None and self.factor != 0.0

    def with_current_normals(self, membrane: Membrane) -> MembraneLoad:
        """The load with forces of the current shape; unchanged if of fixed direction."""
        if self.suction is None or self.factor == 0.0:
            return self
        shape = _Shape(membrane)
        return replace(self, forces=shape.nodal(self.suction[:, None] * shape.vectors))

    def at_stress_free_places(self, membrane: Membrane) -> MembraneLoad:
        """The load on the cells where they are now in the stress-free shape; unchanged if it is one
        on vertices or lines. Collective."""
        put = self.put or self
        if put.material is None and put.suction is None:
            return self
        places = membrane.given if put.placed is None else membrane.given + put.placed
        if put.suction is not None:
            return replace(self, suction=membrane.at_places(put.suction, places), put=put)
        assert put.material is not None
        material = membrane.at_places(put.material, places)
        forces = _Shape(membrane).nodal(membrane.cell_areas[:, None] * material)
        return replace(self, forces=forces, material=material, put=put)


def described(function: object) -> str:
    """The first line of a function's docstring; of a dataclass's object that of the class, with
    its fields and what these and their objects have `computed`."""
    text = (inspect.getdoc(function) or "").partition("\n")[0] if callable(function) else ""
    if not is_dataclass(function) or isinstance(function, type):
        return text
    given = {one.name: getattr(function, one.name) for one in fields(function) if one.repr}
    told = [
        f"{name} = {_as_text(value)}" for name, value in given.items()
        if not is_dataclass(value) and value is not None and value is not False
    ]  # fmt: skip
    told += [one for x in (*given.values(), function) if (one := getattr(x, "computed", ""))]
    return ": ".join(x for x in (text.rstrip("."), ", ".join(told)) if x).replace("`", "")


def _as_text(value: Any) -> str:
    """A field's value as text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{_as_text(one)} ({name})" for name, one in value.items())
    if isinstance(value, np.ndarray | list | tuple):
        return f"({', '.join(map(_as_text, value))})"
    if value is True:
        return "yes"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class _Shape:
    """This rank's cells in the membrane's current shape."""

    def __init__(self, membrane: Membrane) -> None:
        self.membrane, self._cells = membrane, membrane.V.dofmap.list
        self._corners: Array = membrane.positions()[self._cells]
        self.vectors: Array = double_areas(self._corners) / 2  # area vectors (m, 3)

    @cached_property
    def areas(self) -> Array:
        """Areas of the cells, (m,) (length squared)."""
        return norm(self.vectors)

    @cached_property
    def centres(self) -> Array:
        """Centroids of the cells, (m, 3) (length)."""
        return np.asarray(self._corners.mean(axis=1))

    def values(
        self, what: str, function: Callable[[Array, Array], Array], due: tuple[int, ...]
    ) -> Array:
        """Values of a user's function at the cells' centroids and unit normals."""
        normals = self.vectors / self.areas[:, None]
        return checks.returned(what, function(self.centres.T, normals.T), self.centres.T, due)

    def counted(self, by: Area) -> Array:
        """Reference areas of a load, (m,)."""
        if by == "plan":
            return np.abs(self.vectors[:, 2])
        return self.membrane.cell_areas if by == "material" else self.areas

    def nodal(self, loads: Array) -> Array:
        """Forces (n, 3) on the vertices, a third of each cell's to each of its corners."""
        forces = np.zeros(self.membrane.held.shape)
        np.add.at(forces, self._cells, loads[:, None] / 3)
        return forces

    def load(self, name: str, loads: Array, suction: Array | None = None) -> MembraneLoad:
        """A load from forces (m, 3) on the cells. Collective."""
        local = np.array([np.linalg.norm(loads, axis=1).sum(), self.areas.sum()])
        total, area = self.membrane.comm.allreduce(local, op=MPI.SUM)
        intensity, placed = float(total / area), self.membrane.moved
        return MembraneLoad(name, self.nodal(loads), intensity, suction, placed=placed)


def fixed_direction_load(
    membrane: Membrane, traction: Traction, name: str = "load", per: Area = "surface"
) -> MembraneLoad:
    """A load of fixed direction on the membrane's current shape. Collective."""
    # Each vertex gets a third of a cell's load, taken at the centroid, also where a cable folds the
    # cell: the corner triangles cover the same surface up to the depth of the folds.
    shape = _Shape(membrane)
    loads = np.zeros_like(shape.vectors)
    with raised_together(membrane.comm):
        given = traction
        if callable(given):
            given = shape.values("put_load: the function", given, (3, len(loads)))
        else:
            given = checks.vector("put_load: the force per area", given)[:, None]
        loads[:] = shape.counted(per)[:, None] * given.T
    by_area = loads / membrane.cell_areas[:, None]
    load, weighs = shape.load(name, loads), per == "material"
    return replace(load, material=by_area, weighs=weighs, basis=described(traction))


def wind_load(
    membrane: Membrane, pressure: float, coefficient: Coefficient, name: str = "wind"
) -> MembraneLoad:
    """A load along the normals, which it follows as the shape changes. Collective."""
    shape = _Shape(membrane)
    suction = np.zeros(len(shape.areas))
    with raised_together(membrane.comm):
        suction[:] = -pressure * _coefficients(coefficient, membrane, shape)
    load = shape.load(name, suction[:, None] * shape.vectors, suction)
    told = f"c_p = {coefficient:g}" if isinstance(coefficient, float | int) else ""
    if isinstance(coefficient, Mapping):
        told = f"c_p = {_as_text(coefficient)}"
    told = "; ".join(
        x for x in (getattr(pressure, "basis", ""), told or described(coefficient)) if x
    )
    return replace(load, peak=float(pressure), basis=told)


def nodal_load(membrane: Membrane, forces: fem.Function, name: str = "forces") -> MembraneLoad:
    """A load of fixed direction given by forces on the vertices. Collective."""
    nodal = np.zeros(membrane.held.shape)
    with raised_together(membrane.comm):
        if not isinstance(forces, fem.Function) or forces.function_space != membrane.V:
            raise InputError(
                f"put_forces: forces = {forces!r} is not a function in the space of this scene's "
                "displacements; make it by dolfinx.fem.Function(scene.V)."
            )
        own = membrane.V.dofmap.index_map.size_local
        nodal[:own] = forces.x.array.reshape(-1, 3)[:own]
        bad = ~np.isfinite(nodal).all(axis=1)
        if bad.any():
            first = int(np.argmax(bad))
            raise InputError(
                f"put_forces: the force on the vertex {membrane.stress_free[first]} is "
                f"{nodal[first]}; forces must be finite."
            )
    total = membrane.comm.allreduce(float(norm(nodal).sum()))
    return MembraneLoad(name, nodal, total / membrane.size**2, at_vertices=True)


def line_load(
    membrane: Membrane, force: Sequence[float] | Array, edges: str, name: str = "line load"
) -> MembraneLoad:
    """A load of fixed direction along a group of edges in the current shape. Collective."""
    vector = checks.vector("put_line_load: the force per length", force)
    group = checks.named("group of edges", membrane.mesh.edges, edges)
    own = group[group < membrane.mesh.mesh.topology.index_map(1).size_local]
    ends, nodal = edge_ends(membrane.V)[own], np.zeros(membrane.held.shape)
    lengths = norm(np.diff(membrane.positions()[ends], axis=1)[:, 0])
    np.add.at(nodal, ends, (lengths[:, None] / 2 * vector)[:, None])
    total = membrane.comm.allreduce(float(lengths.sum()))
    return MembraneLoad(name, nodal, total * float(norm(vector)) / membrane.size**2)


def cable_load(
    membrane: Membrane, cables: Sequence[LaidCable], force: Array, name: str
) -> MembraneLoad:
    """A load of fixed direction (3,) along cables as they lie now (force per length), on the fabric
    and joints where they touch it; half of the length between two contacts acts at each.
    Collective."""
    nodal = np.zeros(membrane.held.shape)
    own = membrane.V.dofmap.index_map.size_local
    home = {int(v): k for k, v in enumerate(membrane.vertex_ids[:own])}
    joints: dict[str, tuple[float, float, float]] = {}
    total = 0.0
    for cable in cables:
        nodes = cable.contacts()
        steps = norm(np.diff(cable.state.positions[nodes], axis=0))
        way = np.concatenate([[0.0], np.cumsum(steps)])
        ends = {nodes[0]: 0, nodes[-1]: 1}
        known = [k for k, node in enumerate(nodes)
                 if cable.state.nodes[node].point is not None or node in ends]  # fmt: skip
        halves = np.diff(way[known]) / 2
        total += float(way[-1])
        for k, length in zip(known, np.append(halves, 0.0) + np.append(0.0, halves), strict=True):
            node, part = nodes[k], length * force
            if cable.state.nodes[node].point is not None:
                for vertex, weight in zip(*cable.interpolation(node), strict=True):
                    if vertex in home:
                        nodal[home[vertex]] += weight * part
            elif (joint := cable.state.laid.joints[ends[node]]) is not None:
                x, y, z = (part + joints.get(joint, (0.0, 0.0, 0.0))).tolist()
                joints[joint] = x, y, z
    return MembraneLoad(name, nodal, total * float(norm(force)) / membrane.size**2, joints=joints)


def _coefficients(coefficient: Coefficient, membrane: Membrane, shape: _Shape) -> Array:
    """Pressure coefficients of this rank's cells, (m,), or one for all."""
    if callable(coefficient):
        return shape.values("put_wind: the function", coefficient, shape.areas.shape)
    if not isinstance(coefficient, Mapping):
        return np.array(checks.finite("put_wind: coefficient", coefficient))
    parts = outer_first(membrane.mesh, "put_wind", "pressure coefficient", coefficient)
    values = np.full(len(shape.areas), np.nan)
    for part in parts:
        number = checks.finite(f"put_wind: coefficient of {part!r}", coefficient[part])
        values[membrane.mesh.parts[part]] = number
    if np.isnan(values).any():
        raise InputError(
            f"put_wind: coefficient names {', '.join(map(repr, coefficient))}, which leaves cells "
            f"without one, as at {shape.centres[np.argmax(np.isnan(values))]}; name all parts."
        )
    return values


@dataclass(frozen=True)
class Pond:
    """Water on a membrane.

    Attributes
    ----------
    name
        Name in load steps, history and checkpoints.
    weight
        Specific weight (force / length cubed) at the factor 1.
    given
        Which of "level" and "volume" is prescribed.
    level
        Height z of the water surface (length).
    volume
        Volume of water (length cubed).
    parts
        Names of the mesh parts it stands on; if empty, all cells whose `side` faces up.
    side
        1 if it stands on the outer side of the cells, else -1.
    factor
        Load factor of the weight, changed by load steps.
    """

    name: str
    weight: float
    given: Literal["level", "volume"]
    level: float
    volume: float
    parts: tuple[str, ...]
    side: int
    factor: float = 0.0

    def cells(self, membrane: Membrane) -> Booleans:
        """Whether water can stand on this rank's cells, (m,)."""
        if self.parts:
            return cells_of(membrane.mesh, self.parts)
        up: Booleans = self.side * cell_normals(membrane.mesh.mesh)[:, 2] > -WALL
        return up


def upper_side(pond: Pond, membrane: Membrane) -> int:
    """The side (1 or -1) of a pond's cells that faces up. Collective."""
    mesh, comm = membrane.mesh, membrane.comm
    none = InputError(
        f"put_pond: the cells of {pond.name!r} have no upper side; name the parts of the "
        'roof, as in on=["roof"].'
    )
    if not pond.parts:
        heights = cell_normals(mesh.mesh)[:, 2]
        up = comm.allreduce(float(heights.max(initial=-1.0)), op=MPI.MAX)
        down = comm.allreduce(float(-heights.min(initial=1.0)), op=MPI.MAX)
        if max(up, down) <= WALL:
            raise none
        return 1 if up > WALL else -1
    on = np.flatnonzero(pond.cells(membrane))
    corners = membrane.positions()[membrane.V.dofmap.list[on]]
    vectors = double_areas(corners)
    areas = np.linalg.norm(vectors, axis=1)
    plan, area = comm.allreduce(np.array([vectors[:, 2].sum(), areas.sum()]), op=MPI.SUM)
    if abs(plan) <= WALL * area:
        raise none
    side = 1 if plan > 0.0 else -1
    with raised_together(comm):
        turned = np.flatnonzero(side * vectors[:, 2] < -WALL * areas)
        if len(turned):
            part = next(name for name in pond.parts if on[turned[0]] in mesh.parts[name])
            raise InputError(
                f"put_pond: some cells of {pond.name!r} face the other way than most, as at "
                f"{as_text(corners[turned[0]].mean(axis=0))} in the part {part!r}, where water "
                'would hang below them; name the parts that face up, as in on=["roof"].'
            )
    return side
