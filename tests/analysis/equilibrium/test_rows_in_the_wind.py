"""Rows that slide with their cables: contacts under wind, spans, and ends that slide on the rim."""

from __future__ import annotations

import numpy as np
import pytest
from grids import Floats, alternating, grid, numbered
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes, nets
from crms_fenicsx.analysis.equilibrium.row_sliding import _spans

RADIUS, HEIGHT, SIZE = 20.0, 10.0, 3.0
SIDE, CELLS, ROW = 100.0, 20, 6


def dome(comm: MPI.Comm) -> tuple[Scene, list[LaidCable]]:
    """A dome of 40 m under two families of three cables on lines of its mesh."""
    lines = {
        f"{family}{k}": nets.great_circle(RADIUS, HEIGHT, angle, 9.0 * (k - 1))
        for family, angle in (("A", np.pi / 6), ("B", -np.pi / 6))
        for k in range(3)
    }
    mesh = meshes.spherical_cap(comm, radius=RADIUS, height=HEIGHT, size=SIZE, lines=lines)
    scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    scene.fix("boundary")
    return scene, [scene.lay_cable(Cable(EA=30e3), along=name) for name in lines]


def wind(points: Floats, normals: Floats) -> Floats:
    return np.interp(points[0], [-RADIUS, 0.0, RADIUS], [0.8, -1.0, -0.3])


def in_the_wind(scene: Scene, slide: bool) -> int:
    """Inflate the dome, then let the wind blow; return the iterations in the wind."""
    solver = Solver(scene, slide=slide)
    solver.advance(pressure=0.4)
    scene.put_wind(0.75, wind)
    return solver.advance(load=1.0, steps=2).outcome.iterations


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_rows_slide_and_lift_off_in_the_wind(comm: MPI.Intracomm) -> None:
    scene, cables = dome(comm)
    iterations = in_the_wind(scene, True)
    assert iterations < 150
    spans = [span for cable in cables for span in _spans(cable)]
    assert spans, "some cable lifts off"
    held, others = dome(comm)
    in_the_wind(held, False)
    T, S = (np.array([one.tension for one in some]) for some in (cables, others))
    assert T.max() == pytest.approx(S.max(), rel=0.05)
    assert np.abs(T - S).max() > 1e-3 * T.max(), "they have slid"
    if comm.size > 1:
        return
    # vertices of rows lie under the spans above them, which are not below the fabric, also those
    # that another row shares
    x = scene.membrane.positions()
    local = {v: k for k, v in enumerate(scene.membrane.vertex_ids.tolist())}
    for vertices, start, end in spans:
        chord = (end - start) / np.linalg.norm(end - start)
        for place in x[[local[v] for v in vertices.tolist()]]:
            up = place - (0.0, 0.0, HEIGHT - (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT))
            up -= chord * (up @ chord)
            up /= np.linalg.norm(up)
            aside = np.cross(chord, up) @ (place - start)
            assert abs(aside) < 0.1 * SIZE
            assert up @ (place - start) < 0.05 * SIZE


@pytest.mark.parametrize("size", [1.1, 0.8])
def test_the_order_of_loads_does_not_matter(comm: MPI.Intracomm, size: float) -> None:
    """Where cables cross below one that has lifted off, either has the same places in the end."""
    found = []
    for parts in (({"pressure": 0.6}, {"load": 1.0}), ({"pressure": 0.6, "load": 1.0},)):
        lines = {
            f"{family}{k}": nets.great_circle(6.4, 2.7, angle, offset)
            for family, angle in (("A", 0.35), ("B", -0.95))
            for k, offset in enumerate((-2.1, 1.7))
        }
        mesh = meshes.spherical_cap(comm, radius=6.4, height=2.7, size=size, lines=lines)
        scene = Scene(mesh, IsotropicMembrane(E=620.0, nu=0.28, thickness=1.0))
        scene.fix("boundary")
        cables = [scene.lay_cable(Cable(EA=9e3), along=name) for name in lines]
        scene.put_wind(0.9, lambda points, _: -0.4 - 0.2 * points[0] - 0.03 * points[1])
        solver = Solver(scene)
        lengths = {cable: 0.99 * cable.L0 for cable in cables}
        for k, part in enumerate(parts):
            solver.advance(**part, L0={} if k else lengths)  # type: ignore[arg-type]
        found.append([cable.tension for cable in cables])
        shared = set.intersection(
            *(
                {v for cable in cables if cable.name[0] == family for v in _row(cable)}
                for family in "AB"
            )
        )
        off = {v for cable in cables for span in _spans(cable) for v in span[0].tolist()}
        assert shared & off
    assert found[1] == pytest.approx(found[0], rel=1e-4)


def _row(cable: LaidCable) -> list[int]:
    return [node.support[0] for node in cable.state.nodes if node.kind == "vertex"]


def square(comm: MPI.Comm, start: float, end: float) -> Scene:
    """A flat square with a line from x = 0 to x = 100, at these y on its rim."""
    at = np.linspace(0.0, SIDE, CELLS + 1)
    points, cells = grid(at, at, other=alternating(CELLS, CELLS))
    points = np.asarray(points)
    line = start + (end - start) * points[:, 0] / SIDE
    row = points[:, 1] / SIDE * CELLS
    points[:, 1] = np.where(
        row <= ROW, line * row / ROW, line + (SIDE - line) * (row - ROW) / (CELLS - ROW)
    )
    numbers = numbered(CELLS + 1, CELLS + 1)[:, ROW]
    edges = {"A1": np.stack([numbers[:-1], numbers[1:]], axis=1)}
    scene = Scene(
        meshes.from_arrays(comm, points, cells, edges=edges),
        IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08),
    )
    scene.fix("boundary")
    return scene


@pytest.mark.ranks
@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_ends_slide_along_the_rim_to_anchors_beyond(comm: MPI.Intracomm) -> None:
    """The energy is least at 13.9345 and 40.6815, over rim points at which the line is fixed."""
    scene = square(comm, 14.0, 41.0)
    anchors = [(-15.0, 10.0, 0.0), (115.0, 45.0, -5.0)]
    cable = scene.lay_cable(Cable(EA=32e3), anchors, along="A1", L0=134.0, hold="sleeve")
    solver = Solver(scene)

    def ends() -> Floats:
        return np.asarray(cable.state.positions[[1, -2]])

    solver.advance(pressure=0.01)
    first = ends()
    np.testing.assert_allclose(first[:, 1], [13.9345, 40.6821], atol=3e-4)
    np.testing.assert_allclose(first[:, [0, 2]], [[0.0, 0.0], [SIDE, 0.0]], atol=1e-9)
    move = {cable.start: (0.0, 1.0, 0.0), cable.end: (0.0, -1.0, 0.5)}
    solver.advance(move=move)
    assert np.all(np.abs(ends() - first)[:, 1] > 0.3)
    solver.advance(move={end: tuple(-np.array(way)) for end, way in move.items()})
    np.testing.assert_allclose(ends(), first, atol=2e-3)


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_ends_on_the_rim_itself_stay(comm: MPI.Intracomm) -> None:
    scene = square(comm, 14.0, 41.0)
    cable = scene.lay_cable(Cable(EA=32e3), along="A1", L0=103.0)
    Solver(scene).advance(pressure=0.01)
    np.testing.assert_allclose(cable.state.positions[[1, -2], 1], [14.0, 41.0], atol=1e-12)
