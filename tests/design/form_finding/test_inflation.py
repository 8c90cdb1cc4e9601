"""Air domes by pressure, rise or volume: caps of spheres."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import nodes, order
from mpi4py import MPI

from crms_fenicsx import ConvergenceError, meshes
from crms_fenicsx.design.form_finding import find_form

RADIUS = 10.0


def cap(rise: float) -> tuple[float, float, float]:
    """Radius, area and volume of a cap of a sphere."""
    return (
        (RADIUS**2 + rise**2) / (2 * rise),
        np.pi * (RADIUS**2 + rise**2),
        np.pi * rise / 6 * (3 * RADIUS**2 + rise**2),
    )


@pytest.mark.parametrize("rise", [4.0, 14.0])
def test_domes_are_caps(comm: MPI.Intracomm, rise: float) -> None:
    """From a flat mesh, also beyond a hemisphere: p = 2 s / R, with second order."""
    sizes, errors = (2.0, 1.0), []
    radius, area, volume = cap(rise)
    for size in sizes:
        mesh = meshes.circle(comm, RADIUS, size)
        form = find_form(mesh, 2.0, fixed=["boundary"], rise=rise)
        assert nodes(form)[:, 2].max() == pytest.approx(rise, rel=1e-10)
        assert form.volume is not None
        errors.append(
            [form.pressure * radius / 4.0 - 1, form.area / area - 1, form.volume / volume - 1]
        )
        by_volume = find_form(mesh, 2.0, fixed=["boundary"], volume=form.volume)
        # vertices lie elsewhere in the surface, which makes a part of the mesh's error
        assert by_volume.pressure == pytest.approx(form.pressure, rel=5e-3 * size)
        assert by_volume.volume == pytest.approx(form.volume, rel=1e-10)
    assert np.abs(errors[-1]).max() < 0.004 * rise
    for error in np.transpose(errors):
        assert order(sizes, error) > 1.5


@pytest.mark.ranks
def test_domes_by_pressure(comm: MPI.Intracomm) -> None:
    """Those below the hemisphere, whose pressure is the largest."""
    mesh = meshes.circle(comm, RADIUS, 1.0)
    form = find_form(mesh, 2.0, fixed=["boundary"], pressure=0.3)
    R = 2 * 2.0 / 0.3
    assert nodes(form)[:, 2].max() == pytest.approx(R - np.sqrt(R**2 - RADIUS**2), rel=0.01)
    with pytest.raises(ConvergenceError, match="pressure too high"):
        find_form(mesh, 2.0, fixed=["boundary"], pressure=0.5)


def test_a_closed_film_is_a_sphere(comm: MPI.Intracomm) -> None:
    """Of a volume; held at one point."""
    points = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    x = [np.array(point, float) for point in points]
    cells = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    for _ in range(3):
        middle: dict[tuple[int, int], int] = {}
        finer = []
        for cell in cells:
            between = []
            for a, b in zip(cell, (*cell[1:], cell[0]), strict=True):
                key = (min(a, b), max(a, b))
                if key not in middle:
                    middle[key] = len(x)
                    x.append((x[a] + x[b]) / np.linalg.norm(x[a] + x[b]))
                between.append(middle[key])
            finer += [(cell[k], between[k], between[k - 1]) for k in range(3)] + [tuple(between)]
        cells = finer
    mesh = meshes.from_arrays(
        comm, np.array(x) * [1.0, 1.3, 0.8], np.array(cells), outside=meshes.AwayFrom((0, 0, 0)),
        point_groups={"foot": [5]},
    )  # fmt: skip
    form = find_form(mesh, 2.0, fixed=["foot"], volume=4 / 3 * np.pi * 8.0)
    assert form.pressure == pytest.approx(2.0, rel=0.02)
    assert form.area == pytest.approx(16 * np.pi, rel=0.01)
