"""Loads of fixed direction: forces of cells, deflection, reactions, cables, steps, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, clamped, square
from dolfinx import fem
from taylor import OnMesh, gradient_order, noise
from term_scene import (
    ISOTROPIC,
    SIDE,
    cable_square,
    corners,
    directions,
    displaced,
    irregular_square,
    on_mesh,
)

from crms_fenicsx import Cable, ConvergenceError, InputError, Scene, Solver
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.energy.terms.nodal_forces import NodalForces
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.model.membrane_load import fixed_direction_load


def lifted_scene(comm):
    return clamped(irregular_square(comm, 20.0), ISOTROPIC)


def wavy(points, normals):
    return np.sin(0.1 * points) + 2 * normals * points[:1]


def owned_sum(scene, forces):
    """Forces of all ranks' cells on the owned vertices, (n, 3)."""
    unknowns = Unknowns(scene.V)
    vector, g = unknowns.vector()
    unknowns.add_to_vertices(forces, g)
    unknowns.add_ghosts(vector)
    return g[: unknowns.n_owned].copy()


def forces_one_by_one(scene, traction):
    """The slow twin of `fixed_direction_load`: cell after cell."""
    forces = np.zeros((len(scene.held), 3))
    _, now = corners(scene)
    for dofs, (a, b, c) in zip(scene.V.dofmap.list, now, strict=False):
        area = np.cross(b - a, c - a) / 2
        size = np.linalg.norm(area)
        point, normal = ((a + b + c) / 3)[:, None], (area / size)[:, None]
        for dof in dofs:
            forces[dof] += traction(point, normal)[:, 0] * size / 3
    return forces


@pytest.mark.parametrize("moved", [0.0, 5.0])
def test_forces_of_the_current_shape(comm, moved):
    scene = lifted_scene(comm)
    scene.u.x.array[:] = moved * noise(scene.V.tabulate_dof_coordinates(), 4).ravel()
    load = fixed_direction_load(scene.membrane, wavy)
    np.testing.assert_allclose(load.forces, forces_one_by_one(scene, wavy), atol=1e-10)


def test_a_vector_is_a_force_on_every_cell(comm):
    scene = lifted_scene(comm)
    load = fixed_direction_load(scene.membrane, (1.0, -2.0, 0.5))
    twin = forces_one_by_one(scene, lambda x, n: np.array([[1.0], [-2.0], [0.5]]))
    np.testing.assert_allclose(load.forces, twin, atol=1e-12)
    assert load.intensity == pytest.approx(np.sqrt(5.25), rel=1e-12)


def test_gradient_and_energy(comm):
    """Linear: the energy is minus the forces' work, and a Taylor remainder is nothing at all."""
    scene = lifted_scene(comm)
    load = fixed_direction_load(scene.membrane, wavy)
    term = NodalForces(len(scene.held))
    term.take([replace(load, factor=0.5), replace(load, factor=0.2)])
    f = OnMesh(Unknowns(scene.V), scene.u, [term])
    X = f.unknowns.X[: f.unknowns.n_owned]
    forces = owned_sum(scene, load.forces)
    x = 3 * noise(X, 1)
    energy, g = f.value(x)
    np.testing.assert_allclose(g, -0.7 * forces, atol=1e-12)
    assert energy == pytest.approx(-0.7 * f.dot(forces, x), rel=1e-11)


@pytest.mark.ranks
def test_gradient_beside_cables(comm):
    """With all other terms around it, and ghosts, tied and fold points among the unknowns."""
    system = cable_square(comm)
    system.scene.put_load(wavy)
    system.scene.loads.replace_each(lambda load: replace(load, factor=0.01))
    system.prepare()
    system.read_scene()
    f = on_mesh(system)
    assert any(isinstance(term, NodalForces) for term in f.potential.terms)
    x = displaced(f.unknowns, 0.3)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def test_a_scene_without_a_load_has_none(comm):
    names = {term.name for term in cable_square(comm).potential.terms}
    assert "dead load" not in names


@pytest.mark.ranks
def test_supports_carry_the_load(comm):
    """The reactions balance weight to the solver's tolerance; so do they with cables that fold."""
    scene = clamped(irregular_square(comm), ISOTROPIC)
    scene.put_load((0.0, 0.0, -0.01))
    cable = scene.lay_cable(Cable(32000.0), [(0, 31), (SIDE, 52)], hold="sleeve", L0=SIDE)
    solver = advanced(Solver(scene), load=1.0)
    assert cable.tension > 1.0
    total = solver.reactions("boundary").total
    np.testing.assert_allclose(total, [0.0, 0.0, 0.01 * SIDE**2], atol=1e-6)
    assert scene.energies["dead load"] < 0.0


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["structured", "unstructured"])
def test_line_load(comm, kind):
    """Half of each edge at both of its ends, on any mesh; what holds the sheet carries it."""
    scene = Scene(square(comm, 6, kind), ISOTROPIC)
    for group in ("left", "right"):
        scene.fix(group)
    scene.u.x.array.reshape(-1, 3)[:, 2] = 0.75 * scene.membrane.stress_free[:, 0]
    scene.put_line_load((0.0, 0.3, -0.2), "front")  # along x: 100 long, and 125 on the slope
    forces = owned_sum(scene, scene.load("line load").forces).reshape(-1, 3)
    own = scene.positions()[: len(forces)]
    off = own[:, 1] > 1e-9 * SIDE
    assert not forces[off].any()
    ends = np.isin(own[:, 0], (0.0, SIDE)) & ~off
    total = comm.allreduce(forces.sum(axis=0))
    np.testing.assert_allclose(total, np.array([0.0, 0.3, -0.2]) * 125.0, rtol=1e-12, atol=1e-12)
    at_ends = comm.allreduce(forces[ends].sum(axis=0))
    np.testing.assert_allclose(at_ends, total / 6, rtol=1e-9, atol=1e-12)
    solver = advanced(Solver(scene), load=1.0)
    carried = sum(solver.reactions(group).total for group in ("left", "right"))
    np.testing.assert_allclose(carried, -total, atol=1e-6)


@pytest.mark.parametrize(
    "force, edges, message",
    [
        ((0.0, np.nan, 0.0), "left", "the force per length"),
        ((0.0, 1.0), "left", "the force per length"),
        (
            (0.0, 0.0, 1.0),
            "nowhere",
            "no group of edges 'nowhere'; there are 'boundary'",
        ),
        ((0.0, 0.0, 1.0), None, "no group of edges None"),
    ],
)
def test_bad_line_loads(comm, force, edges, message):
    scene = lifted_scene(comm)
    with pytest.raises(InputError, match=message):
        scene.put_line_load(force, edges)
    assert len(scene.loads) == 0


@pytest.mark.parametrize("per", ["surface", "plan", "material"])
def test_area_that_a_load_is_counted_by(comm, per):
    """A wavy sheet that is sheared to a slope, cell after cell."""
    scene = lifted_scene(comm)
    X = scene.membrane.stress_free
    u = np.zeros_like(X)
    u[:, 0], u[:, 2] = 0.5 * X[:, 0], 2.0 * X[:, 0]
    scene.u.x.array[:] = u.ravel()
    scene.put_load((0.0, 0.0, -0.3), name="snow", per=per)
    before, now = corners(scene)
    area = 0.0
    for old, new in zip(before, now, strict=True):
        of_old, of_new = (np.cross(c[1] - c[0], c[2] - c[0]) / 2 for c in (old, new))
        area += {
            "surface": np.linalg.norm(of_new), "plan": abs(of_new[2]), "material":
            np.linalg.norm(of_old),
        }[per]  # fmt: skip
    area = comm.allreduce(area)
    total = comm.allreduce(scene.load("snow").forces.sum(axis=0))
    np.testing.assert_allclose(total, [0.0, 0.0, -0.3 * area], atol=1e-10 * area)


def test_load_steps_and_history(comm):
    scene = lifted_scene(comm)
    solver = advanced(Solver(scene), pressure=0.005)
    scene.put_load((0.0, 0.0, -0.001))
    solver.advance(load=2.0, steps=2)
    solver.advance(pressure=0.01)
    np.testing.assert_allclose(solver.history["load"], [np.nan, 1.0, 2.0, 2.0])
    np.testing.assert_allclose(solver.history["pressure"], [0.005, 0.005, 0.005, 0.01])
    assert scene.load("load").factor == 2.0


def test_no_equilibrium_leaves_the_load_of_the_last_good_state(comm, monkeypatch):
    scene = lifted_scene(comm)
    solver = Solver(scene, max_halvings=1)
    scene.put_load((0.0, 0.0, -0.001))
    solver.advance(load=0.5)
    monkeypatch.setattr(
        Minimizer, "solve", lambda self, *_: Outcome(False, "no", 1.0, 0.0, 1, 1, 1)
    )
    with pytest.raises(ConvergenceError):
        solver.advance(load=1.0)
    assert scene.load("load").factor == 0.5


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("force", "message"),
    [
        ((0.0, 1.0), "three finite numbers"),
        ((0.0, 1.0, np.nan), "three finite numbers"),
        (lambda x, n: n[:2], r"shape \(3, "),
        (lambda x, n: "wind", "type"),
        (lambda x, n: np.where(x[:1] > 70, np.inf, n), "finite numbers"),
    ],
)
def test_bad_forces(comm, force, message):
    scene = lifted_scene(comm)
    with pytest.raises(InputError, match=message):
        scene.put_load(force)
    assert len(scene.loads) == 0


def test_names_of_loads(comm):
    """A name is taken once, and is free again when its load is taken away."""
    scene = lifted_scene(comm)
    scene.put_load((0.0, 0.0, -0.001), name="snow")
    scene.put_load((0.0, 0.0, -0.002), name="weight")
    with pytest.raises(InputError, match="a load 'snow' already"):
        scene.put_load((0.0, 0.0, -0.003), name="snow")
    solver = Solver(scene)
    with pytest.raises(InputError, match="there are the loads 'snow', 'weight'"):
        solver.advance(load=1.0)
    with pytest.raises(InputError, match=r"no load 'rain'.*'snow', 'weight'"):
        solver.advance(load={"rain": 1.0})
    solver.advance(load={"snow": 1.0})
    assert [load.factor for load in scene.loads] == [1.0, 0.0]
    scene.remove_load("snow")
    with pytest.raises(InputError, match="no load 'snow'"):
        scene.remove_load("snow")
    scene.put_load((0.0, 0.0, -0.004), name="snow")
    assert [load.name for load in scene.loads] == ["weight", "snow"]
    assert scene.load("snow").factor == 0.0


def test_bad_factors(comm):
    scene = lifted_scene(comm)
    with pytest.raises(InputError, match=r"add one with scene\.put_load"):
        Solver(scene).advance(load=1.0)
    scene.put_load((0.0, 0.0, 1.0))
    with pytest.raises(InputError, match="load = nan is not finite"):
        Solver(scene).advance(load=np.nan)


@pytest.mark.ranks
def test_forces_from_elsewhere(comm):
    """Nodal forces of a load, given as a function, are that load; what is copied stays."""
    found = []
    for from_elsewhere in (False, True):
        scene = lifted_scene(comm)
        if from_elsewhere:
            forces = fem.Function(scene.V)
            own = owned_sum(scene, fixed_direction_load(scene.membrane, (0.01, 0.0, 0.02)).forces)
            forces.x.array[:] = np.nan  # those of ghosts do not count
            forces.x.array[: own.size] = own.ravel()
            scene.put_forces(forces, name="push")
            forces.x.array[:] = 0.0
        else:
            scene.put_load((0.01, 0.0, 0.02), name="push")
        solver = Solver(scene)
        step = solver.advance(pressure=0.01, load={"push": 0.5})
        found.append((step.energy, *solver.reactions("boundary").total))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-7)


@pytest.mark.ranks
def test_forces_that_cannot_be_put(comm):
    scene = lifted_scene(comm)
    other = fem.Function(fem.functionspace(scene.mesh.mesh, ("Lagrange", 1)))
    for forces in (other, None, np.zeros((4, 3))):
        with pytest.raises(InputError, match="is not a function in the space of this scene's"):
            scene.put_forces(forces)
    forces = fem.Function(scene.V)
    forces.x.array[:] = np.inf
    with pytest.raises(InputError, match=r"the force on the vertex .* is \[inf inf inf\]"):
        scene.put_forces(forces)
    assert not scene.loads
