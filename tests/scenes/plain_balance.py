"""Energy and forces of a flat sheet of foil under pressure and cables along rows of its mesh, by
numpy alone: of the formulas of the invariants, differentiated by complex steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx import IsotropicMembrane, LaidCable, Scene

Numbers = NDArray[np.complex128]
STEP = 1e-30


def forces(scene: Scene, cables: Sequence[LaidCable]) -> tuple[float, float, float]:
    """Energy; the largest force on a free vertex; and the largest sideways force on a vertex of a
    row between its ends, or in any direction of the plane on one of two rows. On one rank."""
    membrane = scene.membrane
    (fabric,) = membrane.materials.values()
    assert isinstance(fabric, IsotropicMembrane)
    X, x = membrane.stress_free.astype(complex), scene.positions().astype(complex)
    at = {int(v): k for k, v in enumerate(membrane.vertex_ids)}
    rows = [[at[k.support[0]] for k in c.state.nodes if k.kind == "vertex"] for c in cables]

    def energy() -> complex:
        total = membrane_energy(x, X, scene.V.dofmap.list, fabric)
        for cable, row in zip(cables, rows, strict=True):
            steps = np.diff(x[row], axis=0)
            stretch = np.sqrt((steps**2).sum(axis=1)).sum() - cable.L0
            total += cable.cable.EA / (2 * cable.L0) * stretch**2
        a, b, c = (x[scene.V.dofmap.list[:, k]] for k in range(3))
        volume = (a * np.cross(b, c)).sum() / 6
        return complex(total - scene.pressure * volume)

    def derivative(places: Numbers, k: int, j: int) -> float:
        before = places[k, j]
        places[k, j] += STEP * 1j
        found = energy().imag / STEP
        places[k, j] = before
        return found

    free = np.argwhere(~membrane.held)
    force = max(abs(derivative(x, k, j)) for k, j in free)
    sideways = 0.0
    for row in rows:
        for i in range(1, len(row) - 1):
            pull = np.array([derivative(X, row[i], j) for j in range(2)])
            tangent = (X[row[i + 1]] - X[row[i - 1]]).real[:2]
            across = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
            crossing = sum(row[i] in other for other in rows) > 1
            sideways = max(sideways, np.linalg.norm(pull) if crossing else abs(pull @ across))
    return energy().real, force, float(sideways)


def membrane_energy(
    x: Numbers, X: Numbers, cells: NDArray[np.int32], fabric: IsotropicMembrane
) -> complex:
    """Strain energy of flat cells by the tension field theory."""
    (a, b), (A, B) = ([p[cells[:, k]] - p[cells[:, 0]] for k in (1, 2)] for p in (x, X))
    g11, g12, g22 = ((p * q).sum(axis=1) for p, q in ((a, a), (a, b), (b, b)))
    G11, G12, G22 = ((p * q).sum(axis=1) for p, q in ((A, A), (A, B), (B, B)))
    D = G11 * G22 - G12**2
    I1 = (g11 * G22 - 2 * g12 * G12 + g22 * G11) / D
    I2 = (g11 * g22 - g12**2) / D
    root = np.sqrt(I1**2 / 4 - I2)
    first, second = ((I1 / 2 + sign * root - 1) / 2 for sign in (1, -1))
    nu, stiffness = fabric.nu, fabric.E * fabric.thickness
    taut = stiffness / (2 * (1 - nu**2)) * (first**2 + second**2 + 2 * nu * first * second)
    wrinkled = np.where(first.real > 0, stiffness / 2 * first**2, 0.0)
    psi = np.where((second + nu * first).real >= 0, taut, wrinkled)
    return complex((np.sqrt(D) / 2 * psi).sum())
