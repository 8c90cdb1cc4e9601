"""Loads as forces per area of cells."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, Solver
from crms_fenicsx.results.quantities import load_label, load_values

pytestmark = pytest.mark.ranks


def test_loads_per_area(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8, material=IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0), side=4.0)
    scene.put_load((0.0, 0.3, -0.4), name="snow", per="plan")
    scene.put_wind(0.5, lambda x, n: np.where(x[0] < 2.0, 0.7, -0.9))
    scene.put_pond(10.0, level=0.1, name="water")
    np.testing.assert_allclose(load_values(scene, "snow"), 0.5, rtol=1e-12)
    wind = load_values(scene, "wind")
    assert {*np.concatenate(comm.allgather(wind)).round(12)} == {0.7, -0.9}
    np.testing.assert_allclose(load_values(scene, "water"), 1.0, rtol=1e-12)
    with pytest.raises(InputError, match="'load hail' is not known"):
        Solver(scene).draw(None, colour="load hail")
    labels = [load_label(scene, name) for name in ("snow", "wind", "water")]
    assert labels == [
        ("snow per area", "pressure"), ("c_p of wind", ""), ("water per area", "pressure"),
    ]  # fmt: skip
    scene.u.x.array[2::3] = 0.01 * scene.V.tabulate_dof_coordinates()[:, 0]
    figure = Solver(scene).draw(None, colour="load wind", directions=True)
    assert (figure is not None) == (comm.rank == 0)
    if figure is not None:
        assert [axes.get_ylabel() for axes in figure.axes[1:]] == ["c_p of wind"]
