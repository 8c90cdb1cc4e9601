"""The paper's incremental, edge-aligned strain: plain cells, folded cells, state between steps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from taylor import gradient_order
from term_scene import (
    STIFF,
    STIFF_FABRIC,
    cable_square,
    directions,
    displaced,
    moved,
    on_mesh,
    straight,
)

from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import InputError

MATERIALS = pytest.mark.parametrize("material", [STIFF, STIFF_FABRIC], ids=["isotropic", "fabric"])
TERMS = ("StepMembraneEnergy", "StepFoldedMembraneEnergy")


def stepped(comm, material, **options):
    """The square with cables in the middle of a second step: the first has been committed."""
    system = cable_square(comm, material, strain="step", **options)
    f = on_mesh(system, *(TERMS if options.get("taut", True) else TERMS[:1]))
    first = displaced(f.unknowns, 0.3)
    f.value(first)
    f.potential.commit()
    return f, first


@pytest.mark.ranks
@MATERIALS
def test_gradient(comm, material) -> None:
    f, first = stepped(comm, material)
    x = first + displaced(f.unknowns, 0.2, stretch=1.02, seed=3)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.05), name


@MATERIALS
def test_rigid_motion_in_a_step_costs_nothing(comm, material) -> None:
    f, first = stepped(comm, material)
    before, _ = f.value(first)
    after, _ = f.value(moved(f.unknowns, first))
    assert after == pytest.approx(before, rel=1e-9)


@MATERIALS
def test_straight_folds_change_nothing(comm, material) -> None:
    """Cells whose sides pass through fold points without a kink are plain cells.

    At small strain: a folded cell's x axis may lie along another side.
    """
    values = []
    for taut in (True, False):
        system = cable_square(comm, material, strain="step", taut=taut)
        f = on_mesh(system, *(TERMS if taut else TERMS[:1]))
        values.append(f.value(1e-4 * straight(system))[0])
    assert values[0] == pytest.approx(values[1], rel=1e-4)


def corner(ik, ij, kj):
    x = (ik**2 + ij**2 - kj**2) / (2 * ik)
    return x, np.sqrt(ij**2 - x**2)


def test_plain_cells_follow_the_equations(comm) -> None:
    """(2.3-6 ... 2.3-14) cell by cell, for two steps from the stress-free shape."""
    system = cable_square(comm, STIFF, strain="step", taut=False)
    f = on_mesh(system, "StepMembraneEnergy")
    V, mesh = system.scene.V, system.scene.mesh.mesh
    shapes = [np.zeros_like(f.potential.x)]
    for size in (0.3, 0.4):
        energy, _ = f.value(displaced(f.unknowns, size))
        f.potential.commit()
        shapes.append(f.potential.x.copy())
    expected = 0.0
    for cell in range(mesh.topology.index_map(2).size_local):
        X = mesh.geometry.x[geometry_dofmap(mesh)[cell]]
        blocks = f.unknowns.vertex_blocks()[V.dofmap.cell_dofs(cell)]
        stress = np.zeros(3)
        for old, new in itertools.pairwise(shapes):
            sides = []
            for x in (old, new):
                i, k, j = X + x[blocks]
                sides.append([np.linalg.norm(v) for v in (k - i, j - i, j - k)])
            a, (x_j, y_j) = sides[0][0], corner(*sides[0])
            a1, (x_j1, y_j1) = sides[1][0], corner(*sides[1])
            du_k, du_j, dv_j, S = a1 - a, x_j1 - x_j, y_j1 - y_j, a * y_j / 2
            b_k, b_j, c_k, c_j = y_j, 0.0, -x_j, a
            B = np.array([[b_k, b_j, 0], [0, 0, c_j], [c_k, c_j, b_j]]) / (2 * S)
            eps = B @ [du_k, du_j, dv_j]
            d_stress = STIFF.stiffness @ eps
            expected += 0.5 * (stress + stress + d_stress) @ eps * S
            stress = stress + d_stress
    assert energy == pytest.approx(comm.allreduce(expected), rel=1e-10)


def test_wrinkling_is_refused(comm) -> None:
    with pytest.raises(InputError, match="wrinkling=False"):
        cable_square(comm, strain="step")
