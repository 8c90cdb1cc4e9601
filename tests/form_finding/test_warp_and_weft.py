"""Section forces that differ along warp and weft."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import nodes, order
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.form_finding import find_form

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
