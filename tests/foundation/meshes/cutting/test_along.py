"""Meshes cut along lines."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.foundation.meshes.edge_table import edges_of, whole_line
from crms_fenicsx.foundation.meshes.membrane_mesh import gathered


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
