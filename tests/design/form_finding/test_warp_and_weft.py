"""Section forces that differ along warp and weft."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import cylinder, nodes, order
from mpi4py import MPI
from scipy.optimize import brentq, minimize_scalar

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import find_form

SLOPE = 1e-4


def wave(comm: MPI.Intracomm, size: float, stress: object, warp: object) -> float:
    """Relative height of the middle of a strip between two waves, 6 long and 4 wide."""
    mesh = meshes.rectangle(comm, 6.0, 4.0, size, structured=True)
    form = find_form(
        mesh, stress, fixed=["boundary"], warp=warp,
        lifted={"boundary": lambda x: SLOPE * np.stack([0 * x[0], 0 * x[0],
                np.sin(np.pi * x[0] / 6.0) * (np.abs(x[1] - 2.0) > 1.999)])},
    )  # fmt: skip
    x = nodes(form)
    middle = np.argmin(np.hypot(x[:, 0] - 3.0, x[:, 1] - 2.0))
    return float(x[middle, 2]) / SLOPE


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("stress", "warp", "ratio"),
    [
        ((4.0, 1.0), (1.0, 0.0, 0.0), 4.0),
        ((4.0, 1.0), (0.0, 1.0, 0.3), 0.25),
        (3.0, (1, 1, 1), 1.0),
    ],
)
def test_small_slopes(comm: MPI.Intracomm, stress: object, warp: object, ratio: float) -> None:
    """``s_x z_xx + s_y z_yy = 0``, with second order."""
    exact = 1 / np.cosh(np.pi / 6.0 * np.sqrt(ratio) * 2.0)
    errors = [wave(comm, size, stress, warp) / exact - 1 for size in (1.0, 0.5, 0.25)]
    assert abs(errors[-1]) < 0.01
    assert order((1.0, 0.5, 0.25), errors) > 1.7


def test_forms_that_the_forces_do_not_allow_are_near(comm: MPI.Intracomm) -> None:
    """Along a hypar different forces do not balance; what is missing is small, and told."""
    deviations = []
    for stress in ((2.0, 2.0), (2.2, 2.0), (4.0, 2.0)):
        mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0, structured=True)
        form = find_form(
            mesh, stress, fixed=["boundary"],
            lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                    0.04 * (x[0] - 5.0) * (x[1] - 5.0)])},
        )  # fmt: skip
        deviations.append(form.deviation)
    assert deviations[0] < 1e-3
    assert 0 < deviations[1] < deviations[2] < 0.02


@pytest.mark.parametrize(
    ("stress", "warp", "across"), [((4.0, 2.0), (0, 1, 0), 2.0), ((4.0, 2.0), (1, 0, 0), 4.0)]
)
def test_vaults(
    comm: MPI.Intracomm, stress: tuple[float, float], warp: tuple[int, int, int], across: float
) -> None:
    """Of radius (section force across) / pressure, whatever it is along: they balance exactly.

    The radius of 10, span of 12 and rise of 2 are in the rim, which is on the vault.
    """
    sizes, errors, deviations = (2.0, 1.0, 0.5), [], []
    half = np.arcsin(0.6)

    def arc(x: np.ndarray) -> np.ndarray:
        turn = half * (x[0] / 6.0 - 1.0)
        return np.stack([6.0 + 10.0 * np.sin(turn) - x[0], 0 * x[0], 10.0 * np.cos(turn) - 8.0])

    for size in sizes:
        form = find_form(
            meshes.rectangle(comm, 12.0, 8.0, size, structured=True), stress, fixed=["boundary"],
            lifted={"boundary": arc}, warp=warp, pressure=across / 10.0,
        )  # fmt: skip
        x = nodes(form)
        errors.append(np.abs(np.hypot(x[:, 0] - 6.0, x[:, 2] + 8.0) / 10.0 - 1.0).max())
        deviations.append(form.deviation)
    assert errors[-1] < 4e-5
    assert order(sizes, errors) > 1.8
    assert order(sizes, deviations) > 1.5


def nearest_neck(meridian: float, hoop: float) -> tuple[float, float]:
    """Neck of a surface between rings of R = 10, 8 apart, and its deviation, by a closed form.

    With hoop forces h the meridian's are m = h + C / r, as d(r m) = h dr, and r m is the constant F
    along the axis times the slope ds / dz. So h r + C = F cosh(h z / F), a catenary that is shifted
    by C. Of these surfaces, all in equilibrium, it is the one whose m is nearest to that
    prescribed in the mean square over the surface.
    """
    radius, half = 10.0, 4.0
    z = np.linspace(-half, half, 401)

    def surface(C: float) -> tuple[np.ndarray, np.ndarray]:
        rho, low = hoop * radius + C, hoop * half / 1.1997  # where the cosh has its tangent
        F = brentq(lambda F: F * np.cosh(hoop * half / F) - rho, low, rho)
        return (F * np.cosh(hoop * z / F) - C) / hoop, np.cosh(hoop * z / F)

    def missed(C: float) -> float:
        r, slope = surface(C)
        return float(np.sum((C / r - (meridian - hoop)) ** 2 * r * slope))

    guess = (meridian - hoop) * radius
    C = float(minimize_scalar(missed, bracket=(0.9 * guess, guess)).x)
    r = surface(C)[0]
    return float(r.min()), float(np.abs(C / r - (meridian - hoop)).max()) / max(meridian, hoop)


@pytest.mark.parametrize("stress", [(2.2, 2.0), (4.0, 2.0)])
def test_surfaces_of_revolution(comm: MPI.Intracomm, stress: tuple[float, float]) -> None:
    """Nothing has different constant forces there; what is found is the nearest equilibrium."""
    neck, deviation = nearest_neck(*stress)
    catenoid = brentq(lambda a: a * np.cosh(4.0 / a) - 10.0, 4.0 / 1.1997, 10.0)
    assert neck > catenoid + 0.09
    sizes, errors = np.array([16, 32, 64]), []
    for n in sizes:
        form = find_form(
            cylinder(comm, n, n // 4, 10.0, 8.0), stress, fixed=["boundary"], warp=(0, 0, 1)
        )
        errors.append(np.hypot(*nodes(form)[:, :2].T).min() / neck - 1)
        assert form.deviation < deviation
    assert abs(errors[-1]) < 2.5e-4
    assert form.deviation > 0.7 * deviation
    assert order(1 / sizes, errors) > 1.8
