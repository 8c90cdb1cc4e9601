"""Find the form of a membrane from its section forces, cables, supports and inner pressure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.form_finding.cables import (
    EdgeLine,
    FormCable,
    edge_lines,
    places_of,
    vertex_dofs,
)
from crms_fenicsx.form_finding.film import Film
from crms_fenicsx.form_finding.found_form import FormCableFound, FoundForm, largest_part
from crms_fenicsx.form_finding.inflation import Inflation
from crms_fenicsx.form_finding.search import FormSearch
from crms_fenicsx.form_finding.stresses import Direction, PrescribedStress, Stress
from crms_fenicsx.meshes import MembraneMesh
from crms_fenicsx.meshes.membrane_mesh import moved
from crms_fenicsx.model.materials import IsotropicMembrane
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, as_text, collective, raised_together

Lift = Sequence[float] | Callable[[Array], Array]
"""A displacement (3,), or a function of start places (3, n) that returns (3, n) of them."""


@collective
def find_form(
    mesh: MembraneMesh,
    stress: Stress,
    *,
    fixed: Sequence[str] | Mapping[str, str],
    lifted: Mapping[str, Lift] | None = None,
    cables: Sequence[FormCable] = (),
    warp: Direction | Mapping[str, Direction] = (1.0, 0.0, 0.0),
    pressure: float | None = None,
    volume: float | None = None,
    rise: float | None = None,
    prefix: str = "crms_form_",
) -> FoundForm:
    """Find the equilibrium of prescribed section forces, cables and inner pressure. Collective.

    The membrane has no stiffness here: its section forces are what is given, whatever its
    strain. Free edges need a cable.

    Parameters
    ----------
    mesh
        Where to start, such as a flat mesh. It stays as it is.
    stress
        Section force (force per length), equal in all directions or (along warp, along weft), of
        the membrane or of each part by its name.
    fixed
        Groups of edges or points that are held, or by group the directions in which they are, out
        of "xyz".
    lifted
        Movement of held groups from the start mesh to where they belong (length).
    cables
        Cables along edges of the mesh.
    warp
        Direction of the warp in space, or of each part; its projection on the surface counts.
    pressure
        Inner pressure (force per area) to the membrane's outer side. The rim must be held.
    volume
        Volume (length cubed) that the membrane encloses with the cone from its rim to the rim's
        centre, which of a plane rim is its plane; the pressure is found.
    rise
        Height (length) of the highest vertex over the rim's centre; the pressure is found.
    prefix
        Prefix of the linear solver's options in PETSc's options database.

    Returns
    -------
    FoundForm
        The form as a mesh, and what is needed to analyse it.

    Raises
    ------
    InputError
        On all ranks: an argument that cannot be used, a free edge without a cable, or pressure
        within a rim that is not held.
    ConvergenceError
        On all ranks: there is no such form, or none is found.

    Notes
    -----
    Some updates of the reference (see `Film`) lead from afar to where Newton's method converges.

    Examples
    --------
    >>> found = find_form(
    ...     mesh, 2.0, fixed=["masts", "corners"], lifted={"masts": (0.0, 0.0, 5.0)},
    ...     cables=[FormCable("north", tension=30.0), FormCable("south", length=21.5)],
    ... )
    >>> scene = found.scene(IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0), {"north": Cable(8e3)})
    """
    given: dict[str, Any] = {
        "stress": stress, "fixed": fixed, "lifted": lifted, "cables": cables, "warp": warp,
        "pressure": pressure, "volume": volume, "rise": rise, "prefix": prefix,
    }  # fmt: skip
    if not isinstance(mesh, MembraneMesh):
        raise InputError(f"find_form: mesh is of type {type(mesh).__name__}; give a MembraneMesh.")
    checks.same(mesh.comm, "find_form", **given)
    inflations = {"pressure": pressure, "volume": volume, "rise": rise}
    inflations = {name: value for name, value in inflations.items() if value is not None}
    if len(inflations) > 1:
        raise InputError(
            f"find_form: {' and '.join(inflations)} are given; give one of pressure, volume, rise."
        )
    for name, value in inflations.items():
        (checks.finite if name == "pressure" else checks.positive)(f"find_form: {name}", value)
    prescribed = PrescribedStress.of(mesh, stress, warp)
    membrane = Membrane(mesh, IsotropicMembrane(E=1.0, nu=0.0, thickness=1.0))
    supports = _hold(membrane, fixed)
    lift = _lifts(membrane, lifted or {})
    lines = edge_lines(membrane, cables)
    _check_free_edges(membrane, lines)
    centre = _rim_centre(membrane, lift, bool(inflations))
    film = Film(membrane, prescribed.cell_forces, prescribed.directions, centre)
    n = membrane.V.dofmap.index_map.size_local
    inflation = Inflation(film, pressure, volume, rise, centre, ~membrane.held[:n, 2])
    search = FormSearch(membrane, film, lines, inflation, prefix)
    try:
        search.run(lift)
    finally:
        search.destroy()
    shape = moved(mesh, membrane.V, membrane.positions())
    residual = film.section_forces(search.holding) - prescribed.tensors(shape)
    found = tuple(
        FormCableFound(line.cable.group, line.tension, length, places_of(membrane, line.ids))
        for line, length in zip(lines, search.lengths, strict=True)
    )
    return FoundForm(
        shape, prescribed, residual, largest_part(residual, film.largest, mesh.comm), supports,
        found, film.area(), film.volume() if inflations else None, inflation.pressure,
        search.iterations,
    )  # fmt: skip


def _hold(membrane: Membrane, fixed: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Hold groups; return the directions by group. Collective."""
    if isinstance(fixed, str) or not isinstance(fixed, Sequence | Mapping) or not fixed:
        raise InputError(
            f'find_form: fixed = {fixed!r}; give the groups that are held, as in ["boundary"].'
        )
    supports = dict(fixed) if isinstance(fixed, Mapping) else dict.fromkeys(fixed, "xyz")
    for group, directions in supports.items():
        if not isinstance(group, str):
            raise InputError(f"find_form: fixed has {group!r}; give names of groups of the mesh.")
        membrane.hold(group, directions, new_edges=True)
    free = "xyz"
    for number, letter in enumerate("xyz"):
        if membrane.comm.allreduce(bool(membrane.held[:, number].any()), op=MPI.LOR):
            free = free.replace(letter, "")
    if free:
        raise InputError(
            f"find_form: fixed = {fixed!r} holds nothing along {free}; hold a group there too."
        )
    return supports


def _lifts(membrane: Membrane, lifted: Mapping[str, Lift]) -> Array:
    """Movement of this rank's owned vertices, (n, 3). Collective."""
    lift = np.full_like(membrane.stress_free, np.nan)
    for group, by in lifted.items():
        dofs = membrane.vertices(group)
        with raised_together(membrane.comm):
            places = membrane.stress_free[dofs]
            if callable(by):
                ways = np.asarray(by(places.T), dtype=float)
                if ways.shape != places.T.shape or not np.isfinite(ways).all():
                    raise InputError(
                        f"find_form: the function that lifts {group!r} returned an array of shape "
                        f"{ways.shape} or with values that are not finite; it must return "
                        f"displacements of shape {places.T.shape}."
                    )
                ways = ways.T
            else:
                ways = np.tile(checks.vector(f"find_form: lifted[{group!r}]", by), (len(dofs), 1))
            for bad, what in (
                (~membrane.held[dofs] & (ways != 0.0), "is not held in that direction"),
                (~np.isnan(lift[dofs]) & (lift[dofs] != ways), "another group moves elsewhere"),
            ):
                if bad.any():
                    k = int(np.argmax(bad.any(axis=1)))
                    raise InputError(
                        f"find_form: {group!r} is lifted by {as_text(ways[k])} at "
                        f"{as_text(places[k])}, which {what}; hold what is lifted, to one place."
                    )
            lift[dofs] = ways
    return np.nan_to_num(lift, nan=0.0)


def _check_free_edges(membrane: Membrane, lines: Sequence[EdgeLine]) -> None:
    """Refuse free edges without a cable. Collective."""
    topology = membrane.mesh.mesh.topology
    edges = membrane.mesh.edges["boundary"]
    edges = edges[edges < topology.index_map(1).size_local]
    held = [membrane.mesh.edges[line.cable.group] for line in lines]
    edges = np.setdiff1d(edges, np.concatenate([*held, np.zeros(0, np.int32)]))
    ends = vertex_dofs(membrane)[topology.connectivity(1, 0).array.reshape(-1, 2)[edges]]
    free = ends[~membrane.held[ends].any(axis=2).all(axis=1)]
    count = membrane.comm.allreduce(len(free))
    places = membrane.comm.allgather(membrane.stress_free[free[:1]].mean(axis=1))
    if count:
        place = as_text(np.concatenate(places)[0])
        raise InputError(
            f"find_form: {count} edges at the rim are neither held nor have a cable, one at "
            f"{place}; the film would draw them in. Fix them, or give them a FormCable."
        )


def _rim_centre(membrane: Membrane, lift: Array, inflated: bool) -> Array:
    """Mean place of the rim of what is closed, or of all vertices without a rim. Collective."""
    edges = membrane.open_edges
    ends = np.unique(edges.vertices)
    if inflated:
        free = ends[~membrane.held[ends].all(axis=1)]
        places = membrane.comm.allgather(membrane.stress_free[free[:1]])
        if sum(map(len, places)):
            raise InputError(
                "find_form: there is pressure, but the rim is not held in all directions at "
                f"{as_text(np.concatenate(places)[0])}; hold the rim."
            )
    own = ends[ends < membrane.V.dofmap.index_map.size_local]
    places = (membrane.stress_free + lift)[own]
    total = membrane.comm.allreduce(np.array([*places.sum(axis=0), len(own)]))
    return np.asarray(total[:3] / total[3]) if total[3] else membrane.centre
