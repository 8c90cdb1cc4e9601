"""What follows the stress-free mesh as it moves with lines that slide: loads, laws with a history,
and files for ParaView."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bent_rows import bent_mesh, bent_row
from mpi4py import MPI
from vtu_file import read_vtu

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver
from crms_fenicsx.analysis.scene.scene import place_stress_free
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array


def vault(comm: MPI.Intracomm, cells: int = 8, bow: float = 0.0) -> Scene:
    """The prestressed vault, held at its rim, without a cable."""
    material = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0, wrinkling=False)
    scene = Scene(bent_mesh(comm, cells, bow, wide=(cells // 4,)), material)
    scene.fix("boundary")
    return scene


@pytest.mark.ranks
def test_weight_draws_no_line_aside(comm: MPI.Intracomm) -> None:
    """A cable in the middle of a vault stays there under a load aside that the fabric carries alike
    on both sides: to .001 of its width, on a mesh whose line bows out to .1 of it as well."""
    tensions = []
    for bow in (0.0, 0.4):
        scene = vault(comm, bow=bow)
        scene.put_load((0.0, 0.02, -0.1), per="material")
        cable = scene.lay_cable(Cable(EA=500.0), along="A2", hold="sleeve", L0=8.15)
        step = Solver(scene).advance(pressure=0.4, load=1.0)
        assert step.verification.verdict == "verified"
        assert np.abs(cable.state.positions[:, 1] - 2.0).max() < 0.004
        tensions.append(cable.tension)
    assert tensions[0] == pytest.approx(tensions[1], rel=5e-3)


@pytest.mark.ranks
def test_a_step_wise_cable_goes_on_with_its_line(comm: MPI.Intracomm) -> None:
    """It slides as far as one with the total law, and its tension follows its own law."""
    for law in ("total", "step"):
        scene = vault(comm, bow=0.3)
        cable = scene.lay_cable(Cable(EA=500.0, law=law), along="A2", tension=5.0)
        start, solver = cable.length, Solver(scene)
        step = solver.advance(pressure=0.2)
        assert step.verification.verdict == "verified"
        assert np.abs(cable.state.positions[:, 1] - 2.0).max() < 2e-3
        if law == "step":
            assert cable.tension == pytest.approx(5.0 + 500.0 * (cable.length / start - 1.0))


class Remembering(EnergyTerm):
    """A term without energy that has a history."""

    name = "memory"
    has_history = True

    def sums(self, x: Array, out: Array) -> None:
        out[0] = 0.0

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        pass


def test_terms_with_a_history_hold_the_mesh(comm: MPI.Intracomm) -> None:
    scene = vault(comm)
    scene.add_term(Remembering())
    with pytest.raises(InputError, match="'memory', a term with a history, cannot follow"):
        place_stress_free(scene, scene.membrane.stress_free)


@pytest.mark.ranks
def test_files_hold_the_places_of_each_step(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """The surface, its displacements and the cable's line of two load steps, read back."""
    folder = Path(comm.bcast(str(tmp_path)))
    scene, cable = bent_row(comm, rigid=False, bow=0.4)
    solver = Solver(scene, results=folder)
    due = []
    for pressure in (0.2, 0.6):
        solver.advance(pressure=pressure)
        n = scene.V.dofmap.index_map.size_local
        now = np.concatenate(comm.allgather(scene.positions()[:n]))
        free = np.concatenate(comm.allgather(scene.membrane.stress_free[:n]))
        due.append((now, now - free, cable.line))
    assert np.linalg.norm(due[1][1] - due[0][1], axis=1).max() > 0.01
    if comm.rank == 0:
        for k, (now, displacement, line) in enumerate(due):
            surface = read_vtu(folder / "steps" / f"surface_{k:06d}.vtu")
            order, due_order = (np.lexsort(x.round(6).T) for x in (surface.points, now))
            assert np.abs(surface.points[order] - now[due_order]).max() < 1e-12
            found = surface.point_data["displacement"][order]
            assert np.abs(found - displacement[due_order]).max() < 1e-12
            cables = read_vtu(folder / "steps" / f"cables_{k:06d}.vtu")
            assert np.abs(cables.points - line).max() < 1e-12


class Noted(EnergyTerm):
    """A term without energy that notes the stress-free places it is attached to."""

    name = "noted"

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        self.places = unknowns.X[: unknowns.n_vertices].copy()

    def sums(self, x: Array, out: Array) -> None:
        out[:] = 0.0

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        pass


@pytest.mark.ranks
def test_terms_are_attached_to_the_moved_places(comm: MPI.Intracomm) -> None:
    scene, _ = bent_row(comm, rigid=False)
    term = Noted()
    scene.add_term(term)
    first = scene.membrane.stress_free.copy()
    Solver(scene).advance(pressure=0.2)
    own = len(term.places)
    assert comm.allreduce(float(np.abs(scene.membrane.stress_free - first).max())) > 0.05
    np.testing.assert_array_equal(term.places, scene.membrane.stress_free[:own])


def test_a_floor_stays_where_it_is(comm: MPI.Intracomm) -> None:
    """Bounds follow stress-free places that rise, and sizes of shifts those that move apart."""
    scene, _ = bent_row(comm, rigid=False)
    scene.floor(-1.0)
    solver = Solver(scene)
    solver.advance(pressure=0.2)
    system = solver.system
    before = system.unknowns.shift_sizes.copy()
    place_stress_free(scene, 1.01 * scene.membrane.stress_free)
    system.renew_base()
    bounds, unknowns = system.unknowns.bounds, system.unknowns
    assert bounds is not None
    free = np.isfinite(bounds[0][: unknowns.n_vertices, 2])
    levels = (bounds[0] + unknowns.X)[: unknowns.n_vertices, 2]
    assert free.any()
    np.testing.assert_allclose(levels[free], -1.0, atol=1e-12)
    np.testing.assert_allclose(unknowns.shift_sizes, 1.01 * before, rtol=1e-12)
    assert system.potential.damping is not None
    np.testing.assert_array_equal(system.potential.damping.springs.sizes, unknowns.shift_sizes)
