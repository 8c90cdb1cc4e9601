"""Find the form of a membrane from section forces, cables, supports and inner pressure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from crms_fenicsx.design.form_finding.form_cables import EdgeLine, FormCable, edge_lines
from crms_fenicsx.design.form_finding.found_form import FoundForm, found_on
from crms_fenicsx.design.form_finding.stresses import Direction, PrescribedStress, Stress
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, Positive, Prefix, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.model.materials import IsotropicMembrane
from crms_fenicsx.model.membrane import Membrane

Lift = Sequence[float] | Callable[[Array], Array]
"""A displacement (3,), or a function of start positions (3, n) that returns (3, n)."""


@collective
def find_form(
    mesh: MembraneMesh,
    stress: Stress,
    *,
    fixed: Sequence[str] | Mapping[str, str],
    lifted: Mapping[str, Lift] | None = None,
    cables: Sequence[FormCable] = (),
    warp: Direction | Mapping[str, Direction] | None = None,
    pressure: Finite | None = None,
    volume: Positive | None = None,
    rise: Positive | None = None,
    prefix: Prefix = "crms_form_",
) -> FoundForm:
    """Find the equilibrium of prescribed section forces, cables and inner pressure. Collective.

    The membrane has no stiffness: its section forces are prescribed and independent of strain. Free
    edges need a cable.

    Parameters
    ----------
    mesh
        Start mesh, such as a flat one; it is not changed.
    stress
        Section force (force per length), equal in all directions or (along warp, along weft), for
        the membrane or for each part by name.
    fixed
        Held groups of edges or points, or by group the held directions out of "xyz".
    lifted
        Displacement of held groups from the start mesh to their final places (length).
    cables
        Cables along mesh edges.
    warp
        Warp direction in space, or of each part, projected on the surface; by default along x. A
        scene of the form takes it over, whether or not the section forces differ.
    pressure
        Inner pressure (force per area), acting outward. The rim must be held.
    volume
        Volume (length cubed) enclosed by the membrane and the cone from its rim to the rim's
        centre, for a plane rim its plane; the pressure is found.
    rise
        Height (length) of the highest vertex above the rim's centre; the pressure is found.
    prefix
        Prefix of the linear solver's PETSc options.

    Returns
    -------
    FoundForm
        The form as a mesh, with the data to analyse it.

    Raises
    ------
    InputError
        On all ranks: invalid arguments, a free edge without a cable, or pressure within a rim that
        is not held.
    ConvergenceError
        On all ranks: no such form exists, or none was found.

    Notes
    -----
    Updates of the reference strategy lead from a distant start into the convergence range of
    Newton's method. Newton's method balances the forces across the surface and across cables, and
    only places the vertices within the surface and along cables, where an elastic sheet that moves
    none then holds them. A start mesh that is a form already, or nearly, keeps its vertices.

    Examples
    --------
    >>> corners = ["front left", "front right", "back right", "back left"]
    >>> rims = [FormCable("front", length=10.5)]
    >>> rims += [FormCable(side, tension=25.0) for side in ("right", "back", "left")]
    >>> lifted = {"back left": (0.0, 0.0, 2.0)}
    >>> hung = find_form(mesh, 2.0, fixed=corners, lifted=lifted, cables=rims)
    >>> scene = hung.scene(IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0), Cable(EA=8e3))
    """
    _check_inflation(pressure=pressure, volume=volume, rise=rise)
    if lifted is not None:
        checks.collection("find_form: lifted", lifted, Mapping, '{"mast": (0.0, 0.0, 5.0)}')
    checks.collection("find_form: cables", cables, Sequence, "[FormCable(...)]")
    prescribed = PrescribedStress.of(mesh, stress, warp)
    membrane = Membrane(mesh, IsotropicMembrane(E=1.0, nu=0.0, thickness=1.0))
    supports = _hold(membrane, fixed)
    lift = _lifts(membrane, lifted or {})
    lines = edge_lines(membrane, cables)
    _check_free_edges(membrane, lines)
    return found_on(
        "find_form", membrane, prescribed, supports, lines, lift, prefix,
        pressure=pressure, volume=volume, rise=rise,
    )  # fmt: skip


def _check_inflation(**inflations: float | None) -> None:
    """Refuse more than one quantity that gives the pressure."""
    named = [name for name, value in inflations.items() if value is not None]
    if len(named) > 1:
        raise InputError(
            f"find_form: expected one of {', '.join(inflations)}, found {' and '.join(named)}."
        )


def _hold(membrane: Membrane, fixed: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Hold groups; return the held directions by group. Collective."""
    if isinstance(fixed, str) or not isinstance(fixed, Sequence | Mapping) or not fixed:
        raise InputError(
            f'find_form: fixed = {fixed!r}, expected the groups to hold, as in ["boundary"].'
        )
    supports = dict(fixed) if isinstance(fixed, Mapping) else dict.fromkeys(fixed, "xyz")
    for group, directions in supports.items():
        if not isinstance(group, str):
            raise InputError(f"find_form: fixed has {group!r}, expected names of groups.")
        membrane.hold(group, directions, new_edges=True)
    held = membrane.comm.allreduce(membrane.held.any(axis=0).astype(int))
    free = "".join(letter for letter, count in zip("xyz", held, strict=True) if not count)
    if free:
        raise InputError(
            f"find_form: fixed = {fixed!r} holds nothing along {free}; hold a group there too."
        )
    return supports


def _lifts(membrane: Membrane, lifted: Mapping[str, Lift]) -> Array:
    """Displacements of this rank's owned vertices, (n, 3). Collective."""
    lift = np.full_like(membrane.stress_free, np.nan)
    for group, by in lifted.items():
        dofs = membrane.vertices(group)
        with raised_together(membrane.comm):
            places = membrane.stress_free[dofs]
            if callable(by):
                what = f"find_form: the function that lifts {group!r}"
                ways = checks.returned(what, by(places.T), places.T, places.T.shape).T
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
                        f"{as_text(places[k])}, which {what}; hold lifted groups at one place."
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
    ends = edge_ends(membrane.V)[edges]
    fixed = np.asarray(membrane.held[ends].any(axis=2))
    free = ends[~fixed.all(axis=1)]
    count = membrane.comm.allreduce(len(free))
    places = membrane.comm.allgather(membrane.stress_free[free[:1]].mean(axis=1))
    if count:
        place = as_text(np.concatenate(places)[0])
        raise InputError(
            f"find_form: {count} edges at the rim are neither held nor supported by a cable, one "
            f"at {place}; the film would draw them in. Fix them, or add a FormCable."
        )
