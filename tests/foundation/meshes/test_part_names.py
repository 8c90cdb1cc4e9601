"""A cell of two parts counts to the inner one, whatever their order, on all ranks, or to none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped
from grids import grid
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import find_form

pytestmark = pytest.mark.ranks

FABRIC = IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0, prestress=5.0)


def zoned(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    """A square roof in two halves, with a strip along its south that lies in both."""
    points, cells = grid(np.arange(5.0), np.arange(5.0))
    centres = points[cells].mean(axis=1)
    return meshes.from_arrays(
        comm, points, cells,
        parts={
            "roof": np.arange(len(cells)), "south": np.flatnonzero(centres[:, 1] < 1.0),
            "west": np.flatnonzero(centres[:, 0] < 2.0),
            "east": np.flatnonzero(centres[:, 0] > 2.0),
        },
    )  # fmt: skip


def test_overlaps_are_known_on_all_ranks(comm: MPI.Intracomm) -> None:
    due = {
        ("east", "roof"): "east", ("east", "south"): None, ("roof", "south"): "south",
        ("roof", "west"): "west", ("south", "west"): None,
    }  # fmt: skip
    assert dict(zoned(comm).overlaps) == due
    assert not meshes.rectangle(comm, 1.0, 1.0, 0.5).overlaps


CALLS: dict[str, Callable[[Solver, Any], object]] = {
    "put_wind": lambda solver, given: solver.scene.put_wind(
        1.0, {part: -0.5 * k for k, part in enumerate(given, 1)}
    ),
    "set_strengths": lambda solver, given: solver.scene.set_strengths(
        {part: (1.0 * k, 1.0) for k, part in enumerate(given, 1)}
    ),
    "utilisation": lambda solver, given: solver.results().utilisation(
        {part: (1.0 * k, 1.0) for k, part in enumerate(given, 1)}
    ),
    "Scene": lambda solver, given: Scene(solver.scene.mesh, dict.fromkeys(given, FABRIC)),
    "find_form": lambda solver, given: find_form(
        solver.scene.mesh, dict.fromkeys(given, 2.0), fixed=["boundary"]
    ),
}


@pytest.mark.parametrize("call", CALLS)
def test_parts_that_only_share_cells_are_refused_everywhere(comm: MPI.Intracomm, call: str) -> None:
    """By name, the same words whatever the order; disjoint parts are taken."""
    scene = clamped(zoned(comm), FABRIC)
    solver, texts = Solver(scene), set[str]()
    for order in (1, -1):
        with pytest.raises(InputError, match=f"{call}: part 'east' shares.* part 'south'") as one:
            CALLS[call](solver, ["south", "east", "west"][::order])
        texts.add(str(one.value))
    assert len(texts) == 1
    with pytest.raises(InputError, match=f"{call}: the mesh has no part 'wall'; it has the parts"):
        CALLS[call](solver, ["east", "wall"])
    CALLS[call](solver, ["west", "east"])


@pytest.mark.parametrize("order", [1, -1])
def test_cells_count_to_the_inner_part(comm: MPI.Intracomm, order: int) -> None:
    """Wind on the corner and around it, against the areas; strengths and materials likewise."""
    mesh, names = zoned(comm), ["roof", "west"][::order]
    if comm.rank == comm.size - 1:
        names = names[::-1]
    stiff = {"roof": FABRIC, "west": IsotropicMembrane(E=2e3, nu=0.3, thickness=1.0, prestress=5.0)}
    scene = Scene(mesh, {name: stiff[name] for name in names})
    assert {part: scene.materials[k].E for k, part in enumerate(("roof", "west"))} == {
        "roof": 1e3, "west": 2e3
    }  # fmt: skip
    scene.fix("boundary")
    coefficient = {"roof": -0.5, "west": -1.5}
    scene.put_wind(1.0, {name: coefficient[name] for name in names})
    own = mesh.mesh.topology.index_map(2).size_local
    west = np.isin(np.arange(own), mesh.parts["west"])
    assert scene.load("wind").suction == pytest.approx(np.where(west, 1.5, 0.5))
    solver = advanced(Solver(scene))
    strengths = {"roof": (100.0, 100.0), "west": (10.0, 10.0)}
    found = solver.results().utilisation({name: strengths[name] for name in names})
    assert found == pytest.approx(np.where(west, 0.5, 0.05))
