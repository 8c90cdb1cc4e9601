"""Flat sails whose edge cables meet at any angle, against arcs and the polygons within them."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import CORNERS, SIDES, order
from grids import grid
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form

S = 2.0


def arc(chord: float, tension: float) -> tuple[float, float, float]:
    """Length of an arc of radius T / s, area between it and its chord, and half its angle."""
    radius = tension / S
    half = np.arcsin(chord / 2 / radius)
    return 2 * radius * half, radius**2 * (half - np.sin(2 * half) / 2), float(half)


def polygon(chord: float, tension: float, n: int) -> tuple[float, float]:
    """The same of n equal links in equilibrium with a film that is flat: exact on every mesh.

    A vertex between links l that turn by a has 2 T sin(a / 2) = s l cos(a / 2).
    """

    def gap(turn: float) -> float:
        return 2 * tension / S / np.cos(turn / 2) * np.sin(n * turn / 2) - chord

    turn = float(brentq(gap, 1e-9, np.pi / n))
    radius = tension / S / np.cos(turn / 2)
    length = 2 * n * radius * np.sin(turn / 2)
    return length, radius**2 / 2 * (n * np.sin(turn) - np.sin(n * turn))


def sail(
    comm: MPI.Intracomm, sides: tuple[float, float], tensions: tuple[float, float], n: int,
    structured: bool = True,
) -> FoundForm:  # fmt: skip
    """A rectangle of n cells along its shorter side, with equal cables on opposite sides."""
    mesh = meshes.rectangle(comm, *sides, min(sides) / n, structured=structured)
    own = dict(zip(SIDES, tensions * 2, strict=True))
    return find_form(
        mesh, S, fixed=CORNERS, cables=[FormCable(k, tension=T) for k, T in own.items()]
    )


@pytest.mark.parametrize("structured", [True, False])
@pytest.mark.parametrize(
    ("sides", "tensions"), [((12.0, 8.0), (15.0, 24.0)), ((10.0, 10.0), (10.4, 40.0))]
)
def test_sharp_corners(
    comm: MPI.Intracomm, sides: tuple[float, float], tensions: tuple[float, float], structured: bool
) -> None:
    """Corners of 17 and 1.5 degrees: area, lengths and reactions of second order."""
    exact = [arc(c, T) for c, T in zip(sides, tensions, strict=True)]
    area = sides[0] * sides[1] - 2 * sum(one[1] for one in exact)
    first, second = exact[0][2], np.pi / 2 - exact[1][2]
    pull = np.array([np.cos(first), np.sin(first)]) * tensions[0]
    pull += np.array([np.cos(second), np.sin(second)]) * tensions[1]
    counts, errors = (8, 16, 32), []
    for n in counts:
        form = sail(comm, sides, tensions, n, structured)
        links = [len(form.cables[k].path) - 1 for k in (0, 1)]
        ideal = [polygon(*side, m) for *side, m in zip(sides, tensions, links, strict=True)]
        within = sides[0] * sides[1] - 2 * sum(one[1] for one in ideal)
        assert form.area == pytest.approx(within, rel=3e-5)
        for cable, (length, _) in zip(form.cables, ideal * 2, strict=True):
            assert cable.length == pytest.approx(length, rel=1e-5)
        assert form.iterations <= 11
        assert form.disturbance < 1e-4
        away = np.linalg.norm(form.reactions["front left"][:2] + pull)
        errors.append((form.area / area - 1, form.cables[0].length / exact[0][0] - 1, away))
    for error in np.transpose(errors):
        assert order(1 / np.array(counts), error) > 1.85


@pytest.mark.parametrize(
    ("corners", "tensions", "angle"),
    [
        ([(0.0, 0.0), (10.0, -3.0), (12.0, 0.0), (10.0, 3.0)], (51.487, 25.0, 25.0, 51.487), 10.0),
        (
            [(0.0, 0.0), (5.0, -0.25), (10.0, 0.0), (9.0, 7.0), (1.0, 7.0)],
            (134.22, 134.22, 25.0, 35.0, 25.0), 170.0,
        ),
    ],
)  # fmt: skip
def test_corners_of_polygons(
    comm: MPI.Intracomm, corners: list[tuple[float, float]], tensions: tuple[float, ...],
    angle: float,
) -> None:  # fmt: skip
    """A corner of 10 and one of 170 degrees: second order on halved cells."""
    chords = np.roll(corners, -1, axis=0) - np.array(corners)
    widths = [float(np.linalg.norm(chord)) for chord in chords]
    exact = [arc(c, T) for c, T in zip(widths, tensions, strict=True)]
    way, halves = np.arctan2(*chords.T[::-1]), np.degrees([one[2] for one in exact])
    inner = np.degrees((np.pi - way + np.roll(way, 1)) % (2 * np.pi))
    assert np.abs(inner - halves - np.roll(halves, 1) - angle).min() < 0.1
    x, y = np.transpose(corners)
    plane = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    mesh, errors = meshes.polygon(comm, corners, 0.8), []
    names = range(1, len(corners) + 1)
    cables = [FormCable(f"side {k}", tension=T) for k, T in enumerate(tensions, 1)]
    for _ in range(3):
        form = find_form(mesh, S, fixed=[f"corner {k}" for k in names], cables=cables)
        links = [len(cable.path) - 1 for cable in form.cables]
        ideal = [polygon(c, T, n) for c, T, n in zip(widths, tensions, links, strict=True)]
        assert form.area == pytest.approx(plane - sum(one[1] for one in ideal), rel=3e-5)
        errors.append(form.area - plane + sum(one[1] for one in exact))
        mesh = meshes.refine(mesh)
    assert order([4, 2, 1], errors) > 1.95


def graded(comm: MPI.Intracomm, n: int) -> tuple[FoundForm, np.ndarray]:
    """A square sail of n x n cells that grow from one corner on; and their sides."""
    sides = np.linspace(0.0, 1.0, n + 1) ** 1.5 * 10.0
    points, cells = grid(sides, sides, by_rows=True)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    lines = dict(zip(SIDES, (index[0], index[:, -1], index[-1], index[:, 0]), strict=True))
    ends = zip(CORNERS, (index[0, 0], index[0, -1], index[-1, -1], index[-1, 0]), strict=True)
    mesh = meshes.from_arrays(
        comm, points, cells,
        edges={name: np.stack([line[:-1], line[1:]], 1) for name, line in lines.items()},
        point_groups={name: [number] for name, number in ends},
    )  # fmt: skip
    cables = [FormCable(side, tension=16.0) for side in SIDES]
    return find_form(mesh, S, fixed=CORNERS, cables=cables), np.diff(sides)


@pytest.mark.ranks
def test_links_keep_their_shares_of_a_cable(comm: MPI.Intracomm) -> None:
    """Also where the start mesh has them of different lengths, and with second order."""
    length, segment, _ = arc(10.0, 16.0)
    counts, errors = (12, 24), []
    for n in counts:
        form, sides = graded(comm, n)
        for cable in form.cables:
            links = np.linalg.norm(np.diff(cable.path, axis=0), axis=1)
            shares = np.sort(links) / links.sum()
            np.testing.assert_allclose(shares, np.sort(sides) / 10.0, rtol=5e-2)
        area = 100.0 - 4 * segment
        errors.append((form.area / area - 1, form.cables[0].length / length - 1))
    for error in np.transpose(errors):
        assert order(1 / np.array(counts), error) > 1.85
