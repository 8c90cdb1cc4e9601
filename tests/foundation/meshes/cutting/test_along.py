"""Meshes cut along lines."""

from __future__ import annotations

import numpy as np
import pytest
from grids import Floats
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edges_of, whole_line
from crms_fenicsx.foundation.meshes.membrane_mesh import gathered
from crms_fenicsx.foundation.meshes.surface import check_shapes

RADIUS, HEIGHT = 12.0, 5.0
BALL = (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT)


def test_two_lines_on_a_rectangle(comm: MPI.Intracomm) -> None:
    """Straight rows through a common vertex; area, parts and sides are kept."""
    flat = meshes.rectangle(comm, 4.0, 3.0, size=0.4)
    routes = {"A": [(0.0, 1.0), (4.0, 2.0)], "B": [(1.0, 0.0), (2.0, 3.0)]}
    surface, _ = gathered(meshes.along(flat, routes))
    if comm.rank:
        return
    assert set(surface.edges) == {"A", "B", "boundary", "front", "back", "left", "right"}
    rows = {}
    for name, (start, end) in routes.items():
        rows[name] = whole_line("test", name, edges_of(surface.edges[name]))
        x = surface.points[rows[name]]
        ends = {tuple(np.round(x[k, :2], 9)) for k in (0, -1)}
        assert ends == {start, end}
        side = np.subtract(end, start)
        away = (x[:, 0] - start[0]) * side[1] - (x[:, 1] - start[1]) * side[0]
        np.testing.assert_allclose(away, 0.0, atol=1e-9)
    assert len(set(rows["A"]) & set(rows["B"])) == 1
    a, b, c = surface.points[surface.cells].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert areas.min() > 0.0
    np.testing.assert_allclose(areas.sum(), 12.0, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")  # a coarse mesh
def test_lines_that_cross_beside_an_edge(comm: MPI.Intracomm) -> None:
    """Each meets the edge at a place of its own, and the other one within the distance of one."""
    mesh = meshes.rectangle(comm, 3.0, 3.0, 1.0, structured=True)
    lines = {"A": [(1.3, 0.0), (1.9, 3.0)], "B": [(2.40105, 0.0), (0.0, 1.0 + 1.50105 / 0.9)]}
    cut = meshes.along(mesh, lines)
    assert {"A", "B"} < set(cut.edges)


def arc(start: float, end: float, n: int = 200) -> Floats:
    """A great circle (n, 3) of the dome between two places on its rim, given by their angles."""
    centre = np.array([0.0, 0.0, HEIGHT - BALL])
    p, q = (RADIUS * np.array([np.cos(t), np.sin(t), 0.0]) - centre for t in (start, end))
    way = np.arccos(p @ q / BALL**2)
    t = np.linspace(0.0, 1.0, n)[:, None]
    places = (np.sin((1.0 - t) * way) * p + np.sin(t * way) * q) / np.sin(way)
    return np.asarray(centre + places)


@pytest.mark.ranks
@pytest.mark.parametrize("shape", ["cap", "air hall", "ellipse", "form"])
def test_new_vertices_lie_on_the_surface_of_the_shape(comm: MPI.Intracomm, shape: str) -> None:
    """And on its rim, which a form keeps; old ones stay."""
    line = np.array([(-1.9999, -1.0), (1.9999, 1.3)])
    if shape == "cap":
        mesh, line = meshes.spherical_cap(comm, RADIUS, HEIGHT, size=2.0), arc(0.1, 2.9)
    elif shape == "air hall":
        mesh = meshes.air_hall(comm, 4.0, 6.0, 1.5, size=0.5, corner=(-2.0, -3.0))
    else:
        mesh, line = meshes.ellipse(comm, 2.0, 1.5, size=0.4), np.array([(-1.999, 0.0), (1.6, 0.9)])
        if shape == "form":
            mesh = find_form(mesh, stress=1.0, fixed=["boundary"], pressure=0.3).mesh
    given, _ = gathered(mesh)
    new, _ = gathered(meshes.along(mesh, {"A": line}))
    if comm.rank:
        return
    assert mesh.project is not None
    check_shapes(new.points, new.cells)
    table = EdgeTable.of(new.cells)
    on_rim = np.isin(np.arange(len(new.points)), table.vertices[table.counts == 1])
    away = np.linalg.norm(mesh.project(new.points.T, on_rim).T - new.points, axis=1)
    assert away.max() < 1e-9
    kept = np.isin(new.points.view("f8,f8,f8"), given.points.view("f8,f8,f8"))
    assert kept.sum() > 0.4 * len(given.points)


@pytest.mark.ranks
def test_a_form_found_from_a_cap_does_not_keep_its_sphere(comm: MPI.Intracomm) -> None:
    cap = meshes.spherical_cap(comm, 2.0, 0.4, size=0.5)
    form = find_form(cap, stress=1.0, fixed=["boundary"], pressure=0.6).mesh
    given, _ = gathered(form)
    assert form.project is None
    for finer in (meshes.along(form, {"A": [(-1.99, 0.0), (1.99, 0.0)]}), meshes.refine(form)):
        new, _ = gathered(finer)
        if comm.rank == 0:
            x, old = new.points, given.points
            near = [np.linalg.norm(old[:, :2] - p[:2], axis=1).argmin() for p in x]
            assert np.abs(x[:, 2] - old[near, 2]).max() < 0.35  # the next vertex of the form
            assert x[:, 2].max() > 0.98 * old[:, 2].max() > 0.6
