"""The film: its forces and stiffness are derivatives, and those of the slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from taylor import noise
from term_scene import ISOTROPIC, irregular_square

from crms_fenicsx.design.form_finding.film import Film
from crms_fenicsx.model.membrane import Membrane

ORIGIN = np.array([50.0, 40.0, -10.0])
WARP = np.array([1.0, 0.4, 0.3])


def film_on(comm: MPI.Intracomm, forces: tuple[float, float]) -> tuple[Film, Membrane]:
    """A film on a displaced square, with another shape as its reference."""
    membrane = Membrane(irregular_square(comm, 20.0), ISOTROPIC)
    n = len(membrane.V.dofmap.list)
    film = Film(membrane, np.tile(forces, (n, 1)), np.tile(WARP, (n, 1)), ORIGIN)
    film.u.x.array[:] = (4.0 * noise(membrane.stress_free, 1)).ravel()
    film.reference.x.array[:] = film.u.x.array + (1.0 * noise(membrane.stress_free, 2)).ravel()
    return film, membrane


def work_one_by_one(membrane: Membrane, forces: tuple[float, float], way: np.ndarray) -> float:
    """This rank's share of the virtual work of the film's stress, cell after cell."""
    total = 0.0
    for dofs in membrane.V.dofmap.list:
        x, v = membrane.positions()[dofs], way[dofs]
        sides, changes = (x[1:] - x[0]).T, (v[1:] - v[0]).T
        normal = np.cross(*sides.T)
        area, normal = np.linalg.norm(normal) / 2, normal / np.linalg.norm(normal)
        w = WARP - (WARP @ normal) * normal
        w /= np.linalg.norm(w)
        across = np.cross(normal, w)
        stress = forces[0] * np.outer(w, w) + forces[1] * np.outer(across, across)
        total += area * float(np.sum(stress * (changes @ np.linalg.pinv(sides))))
    return total


@pytest.mark.parametrize("forces", [(2.0, 2.0), (3.0, 1.0)])
def test_forces_are_those_of_cells(comm: MPI.Intracomm, forces: tuple[float, float]) -> None:
    film, membrane = film_on(comm, forces)
    way = noise(membrane.stress_free, 3)
    own = film.forces(False)
    work = comm.allreduce(float(np.vdot(own, way[: len(own)])))
    assert work == pytest.approx(comm.allreduce(work_one_by_one(membrane, forces, way)), rel=1e-10)


@pytest.mark.ranks
def test_forces_are_derivatives(comm: MPI.Intracomm) -> None:
    """Of the area, and where the rim stays of the volume."""
    film, membrane = film_on(comm, (2.0, 2.0))
    all_ways, start, h = noise(membrane.stress_free, 3), film.u.x.array.copy(), 1e-4
    inside = all_ways.copy()
    inside[membrane.vertices("boundary")] = 0.0
    n = len(film.growth())
    for function, slope, way in (
        (film.area, film.forces(False) / 2.0, all_ways),
        (film.volume, film.growth(), inside),
    ):
        values = []
        for sign in (1, -1):
            film.u.x.array[:] = start + sign * h * way.ravel()
            values.append(function())
        film.u.x.array[:] = start
        expected = (values[0] - values[1]) / (2 * h)
        assert comm.allreduce(float(np.vdot(slope, way[:n]))) == pytest.approx(expected, rel=1e-7)


@pytest.mark.ranks
@pytest.mark.parametrize("forces", [(2.0, 2.0), (3.0, 1.0)])
def test_stiffness_is_a_derivative(comm: MPI.Intracomm, forces: tuple[float, float]) -> None:
    """With the elasticity that holds vertices, and a pressure."""
    film, membrane = film_on(comm, forces)
    way, start, h, p = noise(membrane.stress_free, 3), film.u.x.array.copy(), 1e-4, 0.07
    film.assemble(film.matrix, exact=True, pressure=p, modulus=film.modulus)
    film.matrix.assemble()
    x, y = film.matrix.createVecs()
    n = len(film.growth())
    x.array[:] = way[:n].ravel()
    film.matrix.mult(x, y)
    values = []
    for sign in (1, -1):
        film.u.x.array[:] = start + sign * h * way.ravel()
        values.append(film.forces(True) - p * film.growth())
    expected = (values[0] - values[1]) / (2 * h)
    error = comm.allreduce(float(np.sum((y.array.reshape(-1, 3) - expected) ** 2)))
    assert error < 1e-12 * comm.allreduce(float(np.sum(expected**2)))
