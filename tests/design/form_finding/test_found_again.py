"""Forms found again from themselves, and on meshes cut along lines: they stay where they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from form_meshes import CORNERS, SIDES, cylinder, nodes
from grids import grid
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    InputError,
    OrthotropicMembrane,
    PathError,
    Solver,
    meshes,
)
from crms_fenicsx.design import nets
from crms_fenicsx.design.form_finding import FormBar, FormCable, FoundForm, find_form
from crms_fenicsx.design.form_finding.linear_system import LinearSystem
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

FABRIC = OrthotropicMembrane(E1=900.0, E2=700.0, G12=30.0, nu21=0.2, thickness=1.0)
STEEL = Cable(EA=5000.0)
Case = tuple[MembraneMesh, dict[str, Any], dict[str, Any]]
"""Start mesh, arguments of `find_form`, and those that only the first time needs."""


def hypar(comm: MPI.Intracomm, stress: object = 2.0, **law: float) -> Case:
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0)
    cables = [FormCable(side, **law) for side in SIDES]
    lifted = dict.fromkeys(CORNERS[::2], (0.0, 0.0, 3.0))
    return mesh, {"stress": stress, "fixed": CORNERS, "cables": cables}, {"lifted": lifted}


def hall(comm: MPI.Intracomm, stress: object, **inner: float) -> Case:
    mesh = meshes.rectangle(comm, 36.0, 36.0, 2.4, corner=(-18.0, -18.0))
    options = {"stress": stress, "fixed": ["boundary"], "warp": (1.0, 0.5, 0.0)}
    return mesh, {**options, **inner}, {}


def half_catenoid(comm: MPI.Intracomm) -> Case:
    fixed = {"below": "xyz", "above": "z"}
    return cylinder(comm, 16, 2, 10.0, 6.0), {"stress": 2.0, "fixed": fixed}, {}


def ridge(comm: MPI.Intracomm) -> Case:
    points, cells = grid(np.arange(13.0), np.arange(13.0), by_rows=True)
    middle = np.flatnonzero(points[:, 1] == 6.0)
    edges = {"ridge": np.stack([middle[:-1], middle[1:]], 1)}
    raised = {"boundary": lambda x: np.stack([0 * x[0], 0 * x[0], 3 - 0.5 * np.abs(x[1] - 6.0)])}
    options = {"stress": 2.0, "fixed": ["boundary"], "cables": [FormCable("ridge", length=12.1)]}
    return meshes.from_arrays(comm, points, cells, edges=edges), options, {"lifted": raised}


CASES: dict[str, Callable[[MPI.Intracomm], Case]] = {
    "tension": lambda comm: hypar(comm, tension=25.0),
    "density": lambda comm: hypar(comm, force_density=2.3),
    "length": lambda comm: hypar(comm, length=10.8),
    "fabric with edge cables": lambda comm: hypar(comm, (2.1, 2.0), tension=25.0),
    "dome": lambda comm: (
        meshes.circle(comm, 10.0, 2.0), {"stress": 2.0, "fixed": ["boundary"], "rise": 14.0}, {}
    ),
    "pressure": lambda comm: hall(comm, 3.78, pressure=0.3),
    "fabric": lambda comm: hall(comm, (3.5, 4.0), pressure=0.3),
    "strong fabric": lambda comm: hall(comm, (3.0, 4.5), pressure=0.3),
    "volume": lambda comm: hall(comm, (3.0, 4.5), volume=6000.0),
    "plane of symmetry": half_catenoid,
    "ridge": ridge,
}  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize("name", CASES)
def test_found_again_it_stays(comm: MPI.Intracomm, name: str) -> None:
    mesh, options, first = CASES[name](comm)
    form = find_form(mesh, **options, **first)
    again = find_form(form.mesh, **options)
    size = float(np.ptp(nodes(form), axis=0).max())
    assert np.abs(nodes(again) - nodes(form)).max() < 1e-9 * size
    assert again.area == pytest.approx(form.area, rel=1e-9)
    assert again.deviation == pytest.approx(form.deviation, rel=1e-6)
    assert again.pressure == pytest.approx(form.pressure, rel=1e-8)
    assert again.disturbance == pytest.approx(form.disturbance, abs=0.02)
    for name in form.tensions:
        assert again.tensions[name] == pytest.approx(form.tensions[name], rel=1e-8)


def first_move(form: FoundForm, **options: Any) -> float:
    """The largest displacement in the first load step, relative to the form's size."""
    scene = form.scene(FABRIC, STEEL if form.cables else None, **options)
    step = Solver(scene).advance()
    assert step.verification is not None and step.verification.passed
    moved = form.comm.allreduce(float(np.abs(scene.u.x.array).max(initial=0.0)), op=MPI.MAX)
    return moved / scene.membrane.size


def side_turns(mesh: MembraneMesh, names: list[str]) -> np.ndarray:
    """Angles by which lines turn sideways at their vertices (degrees), on one process."""
    x, turns = mesh.mesh.geometry.x, []
    normals = SmoothSurface.of(x, np.asarray(geometry_dofmap(mesh.mesh))).normals
    ends = mesh.mesh.topology.connectivity(1, 0).array.reshape(-1, 2)
    for name in names:
        for vertex in np.unique(ends[mesh.edges[name]]):
            at = ends[mesh.edges[name]]
            sides = [x[a + b - vertex] - x[vertex] for a, b in at if vertex in (a, b)]
            if len(sides) == 2:
                a, b = (side / np.linalg.norm(side) for side in sides)
                t = (b - a) / np.linalg.norm(b - a)
                turns.append((a + b) @ np.cross(normals[vertex], t))
    return np.degrees(turns)


@pytest.mark.parametrize("stress", [3.78, (3.5, 4.0), (3.0, 4.5)])
def test_a_hall_along_its_net(comm: MPI.Intracomm, stress: object) -> None:
    """In equilibrium from the start, in its own residual stress, and with lines that are straight;
    again it stays."""
    mesh, options, _ = hall(comm, stress, pressure=0.3)
    form = find_form(mesh, **options)
    offsets = [-7.0, 0.0, 7.0]
    net = nets.sections(form.scene(FABRIC), (np.pi / 4, -np.pi / 4), offsets, shortest=True)
    cut = form.along(net)
    assert set(cut.mesh.edges) == {*form.mesh.edges, *net.paths}
    assert first_move(cut) < 1e-9
    assert cut.pressure == form.pressure and cut.supports == form.supports
    assert cut.stress.forces == form.stress.forces and cut.stress.warps == form.stress.warps
    assert cut.area == pytest.approx(form.area, rel=2e-3)
    assert cut.volume == pytest.approx(form.volume, rel=1e-2)
    assert 0.5 * form.deviation < cut.deviation < 2.0 * form.deviation
    again = find_form(cut.mesh, **options)
    assert np.abs(nodes(again) - nodes(cut)).max() < 1e-9 * 36.0
    if comm.size == 1:
        turns = side_turns(cut.mesh, list(net.paths))
        assert len(turns) > 60 and np.sqrt(np.mean(turns**2)) < 0.25


def lines_of(form: FoundForm) -> dict[str, Any]:
    """Lines in plan between vertices of the edge cables."""
    front, right, back, left = (cable.path[:, :2] for cable in form.cables)
    return {"ridge": [left[4], right[5]], "valley": [front[6], back[5]]}


def tent(comm: MPI.Intracomm, at: np.ndarray, unit: float = 1.0) -> FoundForm:
    """A sail in metres or millimetres at a place, with a bonded edge."""
    a = 10.0 * unit
    mesh = meshes.rectangle(comm, a, a, unit, corner=(at[0], at[1]), structured=True)
    cables = [
        FormCable(side, tension=25.0, hold="bonded" if side == "left" else "pocket")
        for side in SIDES
    ]
    return find_form(
        mesh, 2.0 / unit, fixed=CORNERS, cables=cables,
        lifted=dict.fromkeys(CORNERS[::2], (0.0, 0.0, 3.0 * unit)),
    )  # fmt: skip


@pytest.mark.ranks
def test_a_sail_with_edge_cables_and_masts(comm: MPI.Intracomm) -> None:
    """Cables, corners and what stands on them are carried over."""
    form = tent(comm, np.zeros(3))
    cut = form.along(lines_of(form))
    for one, other in zip(form.cables, cut.cables, strict=True):
        assert (one.name, one.tension, one.hold) == (other.name, other.tension, other.hold)
        assert other.length == pytest.approx(one.length, rel=1e-4)
    for corner in CORNERS:
        reaction = form.reactions[corner]
        np.testing.assert_allclose(cut.reactions[corner], reaction, atol=0.05)
    assert cut.area == pytest.approx(form.area, rel=1e-3)
    assert cut.disturbance < 1e-3 and cut.volume is None
    ways = [(0.5, 0.5, -6.0), (-5.0, 0.0, -6.0), (0.0, -5.0, -6.0)]
    bars = [FormBar("front left", Bar(EA=1e5), np.add((0.0, 0.0, 3.0), way)) for way in ways]
    assert first_move(cut, bars=bars, belts=Cable(EA=1500.0)) < 1e-9
    scene = cut.scene(FABRIC, STEEL)
    assert [cable.hold for cable in scene.cables] == ["pocket"] * 3 + ["bonded"]


@pytest.mark.ranks
def test_ranks_units_and_places(comm: MPI.Intracomm) -> None:
    """The same on one process, in other units, and far from the origin."""

    def cut_tent(comm: MPI.Intracomm, at: object = (0.0, 0.0), unit: float = 1.0) -> FoundForm:
        form = tent(comm, np.asarray(at), unit)
        return form.along(lines_of(form))

    here, alone = cut_tent(comm), cut_tent(MPI.COMM_SELF)
    assert here.area == pytest.approx(alone.area, rel=1e-10)
    assert here.deviation == pytest.approx(alone.deviation, rel=1e-6)
    assert here.disturbance == pytest.approx(alone.disturbance, rel=1e-4)
    small = cut_tent(comm, unit=1e3)
    assert small.area == pytest.approx(1e6 * here.area, rel=1e-6)
    assert small.deviation == pytest.approx(here.deviation, rel=1e-2)
    far = cut_tent(comm, (5e5, 1e6))
    assert far.area == pytest.approx(here.area, rel=1e-6)
    assert first_move(far) < 1e-9


def test_a_prefix_of_options_is_kept(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    make, seen = LinearSystem.__init__, []

    def noted(self: LinearSystem, *arguments: Any) -> None:
        make(self, *arguments)
        seen.append(self._pc.getOptionsPrefix())

    monkeypatch.setattr(LinearSystem, "__init__", noted)
    mesh, options, first = hypar(comm, tension=25.0)
    form = find_form(mesh, **options, **first, prefix="own_")
    form.along({"ridge": [cable.path[5, :2] for cable in form.cables[1::2]]})
    assert seen == ["own_", "own_"]


def test_lines_that_do_not_fit(comm: MPI.Intracomm) -> None:
    form = tent(comm, np.zeros(3))
    mesh, options, _ = hall(comm, 3.78, pressure=0.3)
    other = nets.sections(find_form(mesh, **options).scene(FABRIC), (0.0,), [0.0])
    for lines, error, match in (
        ({}, InputError, "along: lines"),
        (3, InputError, "lines"),
        ({"front": lines_of(form)["ridge"]}, InputError, "along: .*'front'"),
        ({"A": [(20.0, 0.0), (20.0, 10.0)]}, PathError, "'A'"),
        (other, PathError, "'A1'"),
    ):
        with pytest.raises(error, match=match):
            form.along(lines)  # type: ignore[arg-type]
