"""Meshes from which forms are found, and what is measured on the forms."""

from __future__ import annotations

import numpy as np
from grids import alternating, numbered, triangles
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form
from crms_fenicsx.foundation.meshes import MembraneMesh

CORNERS = ("front left", "front right", "back right", "back left")
SIDES = ("front", "right", "back", "left")


def cylinder(comm: MPI.Intracomm, n: int, rows: int, radius: float, height: float) -> MembraneMesh:
    """A cylinder of n cells round between rings "below" and "above", diagonals alternating."""
    angles, levels = 2 * np.pi * np.arange(n) / n, np.linspace(0.0, height, rows + 1)
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in levels])
    rings = np.pad(numbered(n, rows + 1, by_rows=True), ((0, 1), (0, 0)), mode="wrap")
    first = np.stack([np.arange(n), (np.arange(n) + 1) % n], 1)
    return meshes.from_arrays(
        comm, points, triangles(rings, ~alternating(n, rows)),
        edges={"below": first, "above": first + n * rows},
        outside=meshes.AwayFrom((0.0, 0.0, height / 2)),
    )  # fmt: skip


def sail(
    comm: MPI.Intracomm, size: float, lift: float = 0.0, structured: bool = True, **law: float
) -> FoundForm:
    """A film of 2.0 with equal cables between four points 10 apart, two of them lifted."""
    mesh = meshes.rectangle(comm, 10.0, 10.0, size, structured=structured)
    return find_form(
        mesh, 2.0, fixed=CORNERS, lifted=dict.fromkeys(CORNERS[::2], (0.0, 0.0, lift)),
        cables=[FormCable(side, **law) for side in SIDES],
    )  # fmt: skip


def nodes(form: FoundForm) -> np.ndarray:
    """All of its vertices on each rank, (n, 3), some twice."""
    return np.concatenate(form.comm.allgather(form.mesh.mesh.geometry.x))


def order(sizes: object, errors: object) -> float:
    """Fitted order of convergence."""
    return float(np.polyfit(np.log(np.asarray(sizes)), np.log(np.abs(np.asarray(errors))), 1)[0])
