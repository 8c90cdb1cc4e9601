"""Newton's method across the form: its matrix is what differences of forces make row by row."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from form_meshes import CORNERS, SIDES, nodes
from grids import grid
from mpi4py import MPI
from taylor import noise

from crms_fenicsx import IsotropicMembrane, meshes
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.design.form_finding.film import Film
from crms_fenicsx.design.form_finding.form_cables import edge_lines
from crms_fenicsx.design.form_finding.linear_system import Directions, LinearSystem
from crms_fenicsx.model.membrane import Membrane

FOIL = IsotropicMembrane(E=1.0, nu=0.0, thickness=1.0)


def sail(comm: MPI.Intracomm) -> tuple[Membrane, Film, list, Directions]:
    """A rough sail with a back edge that is held vertically, and cables at the others."""
    membrane = Membrane(meshes.rectangle(comm, 4.0, 3.0, 1.0, structured=True), FOIL)
    for corner in CORNERS:
        membrane.hold(corner, "xyz", new_edges=True)
    membrane.hold("back", "z", new_edges=True)
    lines = edge_lines(membrane, [FormCable(side, tension=5.0) for side in SIDES if side != "back"])
    n = len(membrane.V.dofmap.list)
    film = Film(membrane, np.full((n, 2), 2.0), np.tile([1.0, 0.0, 0.0], (n, 1)), membrane.centre)
    film.u.x.array[:] = (0.2 * noise(membrane.stress_free, 1)).ravel()
    for line in lines:
        line.measure(film.positions(), comm)
        line.tension = 5.0
    directions = Directions(membrane, film, lines)
    directions.take()
    return membrane, film, lines, directions


@pytest.mark.ranks
def test_directions_of_vertices(comm: MPI.Intracomm) -> None:
    """One across the surface, two across a cable, none where all is held."""
    membrane, _, _, directions = sail(comm)
    n = len(directions.free)
    places = membrane.stress_free[:n]
    ranks = np.einsum("nii->n", directions.across)
    x, y = places[:, 0] % 4.0 < 1e-9, places[:, 1] % 3.0 < 1e-9
    back = np.abs(places[:, 1] - 3.0) < 1e-9
    np.testing.assert_allclose(ranks[~x & ~y], 1.0)
    np.testing.assert_allclose(ranks[(x ^ y) & ~back], 2.0)
    np.testing.assert_allclose(ranks[x & y], 0.0)
    np.testing.assert_array_equal(directions.guided, back & ~x)
    np.testing.assert_array_equal(directions.on_cable, (x ^ y) & ~back)
    for projectors in (directions.across, directions.within):
        np.testing.assert_allclose(projectors @ projectors, projectors, atol=1e-12)


@pytest.mark.ranks
def test_matrices(comm: MPI.Intracomm) -> None:
    """Rows of forces across and of what places vertices; columns of displacements across and of
    those of the sheet."""
    membrane, film, lines, directions = sail(comm)
    n, all_n = len(directions.free), len(film.start)
    start, way, h = film.u.x.array.copy(), noise(membrane.stress_free, 3), 1e-5
    lengths = [line.length for line in lines]

    def forces() -> tuple[np.ndarray, np.ndarray]:
        """Of film and cables, and of the cables by their shares."""
        real, even = film.forces(), np.zeros((n, 3))
        for line, length in zip(lines, lengths, strict=True):
            line.measure(film.positions(), comm)
            real += line.tension * film.gathered(line.slope(all_n))
            line.length = length  # constant in its stiffness
            even += line.tension * film.gathered(line.slope(all_n, even=True))
        return real, even

    def slopes(way: np.ndarray) -> list[np.ndarray]:
        """Differences of these forces, and those of the sheet, by displacements (n, 3)."""
        values = []
        for sign in (1, -1):
            film.u.x.array[:] = start + sign * h * way.ravel()
            values.append(forces())
        film.u.x.array[:] = start
        before, _ = forces()
        film.sheet.x.array[:] += way.ravel()
        elastic = forces()[0] - before
        film.sheet.x.array[:] -= way.ravel()
        return [(a - b) / (2 * h) for a, b in zip(*values, strict=True)] + [elastic]

    system = LinearSystem(film, lines, directions, "test_")
    counted, within, moving = directions.counted, directions.within, directions.moving
    real, even, elastic = slopes(way)
    system.balance(counted, within, 0.0, 0.3)
    elastic_placed = np.where(directions.on_cable[:, None], 0.0, elastic)
    expected = np.einsum("nij,nj->ni", counted, real + 0.3 * elastic)
    expected += np.einsum("nij,nj->ni", within, elastic_placed + even)
    np.testing.assert_allclose(system.times(way[:n]), expected, atol=1e-7)

    film.sheet.x.array[:] = (0.1 * noise(membrane.stress_free, 5)).ravel()
    across = fem.Function(film.V)
    across.x.array[: 3 * n] = np.einsum("nij,nj->ni", moving, way[:n]).ravel()
    across.x.scatter_forward()
    by = across.x.array.reshape(-1, 3)
    system.hold(0.0, 0.0)
    expected = slopes(by)[0] + slopes(way - by)[2]
    np.testing.assert_allclose(system.times(way[:n]), expected, atol=1e-7)
    system.destroy()


def test_a_ridge_held_vertically_finds_its_place(comm: MPI.Intracomm) -> None:
    """Between two eaves 8 apart it slides from a quarter of the span to its middle."""
    n = 8
    x, cells = grid(np.linspace(0, 4, n + 1), np.linspace(0, 8, 2 * n + 1), by_rows=True)
    index = np.arange(len(x)).reshape(2 * n + 1, n + 1)
    lines = {"south": index[0], "north": index[-1], "west": index[:, 0], "east": index[:, -1]}
    lines["ridge"] = index[n // 2]
    edges = {name: np.stack([line[:-1], line[1:]], 1) for name, line in lines.items()}
    form = find_form(
        meshes.from_arrays(comm, x, cells, edges=edges), 2.0,
        fixed={"south": "xyz", "north": "xyz", "west": "x", "east": "x", "ridge": "z"},
        lifted={"ridge": (0.0, 0.0, 2.0)},
    )  # fmt: skip
    places = nodes(form)
    top = places[places[:, 2] > 1.999]
    np.testing.assert_allclose(top[:, 1], 4.0, atol=1e-3)
    assert abs(form.area / (8.0 * np.hypot(4.0, 2.0)) - 1) < 1e-6
    assert form.iterations <= 8
