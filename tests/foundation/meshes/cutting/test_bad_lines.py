"""Lines that a mesh cannot be cut along: named, with a remedy, on all ranks; ends that move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import InputError, PathError, PathWarning, meshes
from crms_fenicsx.foundation.meshes.edge_table import edges_of, whole_line
from crms_fenicsx.foundation.meshes.membrane_mesh import gathered

ACROSS = [(0.0, 1.0), (4.0, 1.2)]

BAD = {
    "no lines": ({}, "one line or more"),
    "not a mapping": ([ACROSS], "pass a mapping of names to routes"),
    "no name": ({"": ACROSS}, "name of a line"),
    "a name that exists": ({"left": ACROSS}, "'left' already; choose another name"),
    "one point": ({"A": [(0.0, 1.0)]}, "line 'A': path: .*two or more points"),
    "not finite": ({"A": [(0.0, np.nan), (4.0, 1.0)]}, "line 'A': path: point 0 .*not finite"),
    "of four coordinates": ({"A": np.zeros((2, 4))}, r"line 'A': path: .*\(2, 4\)"),
    "beyond the rim": (
        {"A": [(-1.0, 1.0), (4.0, 1.0)]},
        "line 'A': route point 0 .*leaves the membrane.* move it",
    ),
    "in space, beside the surface": (
        {"A": [(0.0, 1.0, 0.0), (2.0, 1.0, 0.5), (4.0, 1.0, 0.0)]},
        "line 'A': route point 1 .*leaves the membrane",
    ),
    "ends inside": (
        {"A": [(0.0, 1.0), (2.0, 1.5)]},
        r"line 'A' ends inside the surface at \(2, 1.5, 0\).*lead it to the rim",
    ),
    "back on itself": (
        {"A": [(0.0, 1.0), (3.0, 1.0), (0.0, 1.0)]},
        "line 'A'.*(back|itself)",
    ),
    "across itself": (
        {"A": [(0.0, 1.0), (3.0, 1.0), (3.0, 2.5), (1.5, 2.5), (1.5, 0.0)]},
        "line 'A' comes back to .*two lines",
    ),
    "closed": (
        {"A": [(1.0, 1.0), (3.0, 1.0), (3.0, 2.0), (1.0, 2.0), (1.0, 1.0)]},
        "line 'A' (comes back|ends inside)",
    ),
    "side by side": (
        {"A": ACROSS, "B": [(0.0, 1.003), (4.0, 1.203)]},
        "lines? '[AB]' and the line '[AB]' run side by side.*lead them apart",
    ),
    "twice the same": ({"A": ACROSS, "B": ACROSS}, "run side by side"),
}


def flat(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    return meshes.rectangle(comm, 4.0, 3.0, size=0.4)


@pytest.mark.ranks
@pytest.mark.parametrize("what", BAD)
def test_bad_lines_are_named(comm: MPI.Intracomm, what: str) -> None:
    lines: Any
    lines, text = BAD[what]
    with pytest.raises(InputError, match=text) as raised:
        meshes.along(flat(comm), lines)
    assert len(set(comm.allgather(str(raised.value)))) == 1


def row(mesh: meshes.MembraneMesh, name: str) -> Any:
    """Places (k, 3) of a row, from its end with the smaller x on; on rank 0 only."""
    surface, _ = gathered(mesh)
    if mesh.comm.rank:
        return None
    x = surface.points[whole_line("test", name, edges_of(surface.edges[name]))]
    return x if x[0, 0] < x[-1, 0] else x[::-1]


@pytest.mark.parametrize("gap", [0.05, -0.05, 0.0])
def test_an_end_near_another_line_is_moved_there(comm: MPI.Intracomm, gap: float) -> None:
    lines = {"A": [(0.0, 1.5), (4.0, 1.5)], "B": [(2.1, 0.0), (2.2, 1.5 - gap)]}
    cut = meshes.along(flat(comm), lines)
    one, other = row(cut, "A"), row(cut, "B")
    if comm.rank == 0:
        assert np.abs(one - other[-1]).sum(axis=1).min() == 0.0  # a common vertex
        np.testing.assert_allclose(other[-1], (2.2, 1.5, 0.0), atol=1e-3)
    with pytest.raises(PathError, match="'B' ends inside"):
        meshes.along(flat(comm), lines | {"B": [(2.1, 0.0), (2.2, 1.4)]})


def test_ends_that_nearly_meet_are_merged(comm: MPI.Intracomm) -> None:
    """At the rim, where the first line's stays, at a corner, and inside; straight over cells."""
    lines = {
        "A": [(1.5, 0.0), (1.0, 1.5)],
        "B": [(1.55, 0.0), (4.0, 2.97)],
        "C": [(1.02, 1.53), (1.0, 3.0)],
    }
    cut = meshes.along(flat(comm), lines)
    a, b, c = (row(cut, name) for name in lines)
    if comm.rank == 0:
        np.testing.assert_allclose(a[-1], (1.5, 0.0, 0.0), atol=1e-9)
        np.testing.assert_array_equal(b[0], a[-1])
        np.testing.assert_allclose(b[-1], (4.0, 3.0, 0.0), atol=1e-9)
        assert np.abs(c[:, None] - a[0]).sum(axis=2).min() == 0.0
        np.testing.assert_allclose(b[:, 1], (b[:, 0] - 1.5) * 3.0 / 2.5, atol=2e-2)


def test_small_angles_are_told(comm: MPI.Intracomm) -> None:
    """Where lines are closer than the cells are long; the mesh is valid."""
    lines = {"A": ACROSS, "B": [(0.0, 1.05), (4.0, 1.25)]}
    with pytest.warns(PathWarning, match="smallest angle of the cells is .* degrees, at"):
        cut = meshes.along(flat(comm), lines)
    assert {"A", "B"} < set(cut.edges)
