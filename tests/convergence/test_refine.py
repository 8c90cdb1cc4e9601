"""A solver on a finer mesh: everything of the scene is there, and the equilibrium is a better one.

Finer meshes that scripts make themselves are what refined ones are compared to.
"""

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    EnergyTerm,
    Friction,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)

pytestmark = pytest.mark.usefixtures("comm")

SIDE = 100.0
FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def square(comm, cells, **how):
    """The clamped square, not inflated yet."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True, **how)
    scene = Scene(mesh, FABRIC)
    scene.fix("boundary")
    return scene, Solver(scene, rtol=1e-10)


def model_2(comm, cells, y=41.0, **how):
    """A cable over the inflated square, just taut, that anchors beyond it pull down."""
    scene, solver = square(comm, cells, **how)
    solver.advance(pressure=0.01)
    cable = scene.lay_cable(Cable(EA=32000.0), [(-80.0, y, 0.0), (180.0, y, 0.0)], name="ridge")
    solver.advance(move={cable: (0.0, 0.0, -15.0)})
    return scene, solver


def numbers(solver):
    scene = solver.scene
    found = {**scene.energies, "energy": scene.energy, "volume": scene.volume}
    for cable in scene.cables:
        found |= {f"T {cable.name}": cable.tension, f"L0 {cable.name}": cable.L0}
    found["reaction"] = solver.reactions("boundary").total[2]
    return found


def agree(found, expected, rtol):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=rtol, abs=rtol * 1e2), name


def test_refined_square_is_that_of_the_finer_mesh(comm):
    _, solver = square(comm, 4)
    solver.advance(pressure=0.01)
    _, finer = square(comm, 8)
    finer.advance(pressure=0.01)
    agree(numbers(solver.refine()), numbers(finer), 1e-7)


def test_cable_laid_just_taut_on_the_inflated_square_is_so_on_the_finer_mesh(comm):
    """Its length is measured on the finer mesh's equilibrium, not carried over with its error."""
    _, solver = model_2(comm, 4)
    coarse = solver.scene.cable("ridge").L0
    finer = solver.refine()
    scene, _ = model_2(comm, 8)
    cable, expected = finer.scene.cable("ridge"), scene.cable("ridge")
    assert cable.L0 == pytest.approx(expected.L0, rel=1e-6)
    assert abs(cable.L0 - coarse) > 2e-5 * coarse
    assert cable.tension == pytest.approx(expected.tension, rel=1e-5)
    assert np.allclose(cable.positions[[0, -1]], expected.positions[[0, -1]])
    assert solver.scene.cable("ridge").L0 == coarse  # the coarse scene is as it was


ENERGY, TENSION = 17.2705919334, 257.58202092
"""Of the square of 8 cells a side, refined, with `model_2`'s cable, by one process."""


def test_levels_are_the_same_on_any_number_of_processes(comm):
    """And however the cells are shared out; the first figures are of one process."""

    def scattered(midpoints):
        return np.random.default_rng(3).integers(0, comm.size, len(midpoints))

    finer = [model_2(comm, 8, **how)[1].refine() for how in ({}, {"ranks": scattered})]
    agree(numbers(finer[1]), numbers(finer[0]), 1e-8)
    found = numbers(finer[0])
    assert found["energy"] == pytest.approx(ENERGY, rel=1e-8)
    assert found["T ridge"] == pytest.approx(TENSION, rel=1e-8)
    assert finer[0].scene.mesh.mesh.topology.index_map(2).size_global == 512


def halves(comm, cells, **how):
    """A square of two materials, one of them under pressure, with loads of all kinds."""
    lines = np.linspace(0.0, SIDE, cells + 1)
    x = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
    grid = np.arange(len(x)).reshape(cells + 1, cells + 1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    left = x[triangles].mean(axis=1)[:, 0] < SIDE / 2
    lower = np.stack([grid[0, :-1], grid[0, 1:]], axis=1)
    mesh = meshes.from_arrays(
        comm, x, triangles, edges={"front": lower}, point_groups={"corner": [0]},
        parts={"left": np.flatnonzero(left), "right": np.flatnonzero(~left)},
    )  # fmt: skip
    woven = OrthotropicMembrane(
        E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0,
        warp=lambda x: np.stack([1.0 + 0 * x[0], 0.01 * x[0], 0 * x[0]]),
    )  # fmt: skip
    scene = Scene(mesh, {"left": FABRIC, "right": woven}, pressure_on=["left", "right"])
    scene.fix("front")
    scene.fix("boundary", "z")
    scene.fix(lambda x: (x[0] < 1.0) | (x[0] > SIDE - 1.0), "xy")
    scene.fix(lambda x: x[1] > SIDE - 1.0, "y")
    scene.put_load((0.0, 0.0, -0.002), name="weight", per="material")
    scene.put_load(lambda x, n: np.stack([0 * x[0], 0 * x[0], -1e-5 * x[0]]), name="snow")
    scene.put_wind(0.004, {"left": -0.5, "right": 0.4})
    solver = Solver(scene, rtol=1e-10)
    solver.advance(pressure=0.01, load={"weight": 1.0, "snow": 1.5, "wind": 0.5})
    return scene, solver


def test_parts_supports_and_loads_are_those_of_the_finer_mesh(comm):
    _, solver = halves(comm, 4)
    scene, expected = halves(comm, 8)
    finer = solver.refine()
    agree(numbers(finer), numbers(expected), 1e-6)
    assert [(load.name, load.factor) for load in finer.scene.loads] == [
        (load.name, load.factor) for load in scene.loads
    ]
    assert finer.scene.held.sum() <= scene.held.size
    held = [comm.allreduce(s.held[: s.V.dofmap.index_map.size_local].sum())
            for s in (finer.scene, scene)]  # fmt: skip
    assert held[0] == held[1]
    assert comm.allreduce(len(finer.scene.mesh.points["corner"])) >= 1
    finer.advance(load={"weight": 0.0, "snow": 0.0})  # it goes on like any other


def several(comm, cells):
    """Three cables of different kinds on the inflated square, one of them moved, over a floor."""
    scene, solver = square(comm, cells)
    solver.advance(pressure=0.01)
    scene.lay_cable(Cable(EA=2e4), [(0.0, 20.0), (SIDE, 35.0)], sleeve=True, name="sleeved")
    scene.lay_cable(
        Cable(EA=3e4, friction=Friction(0.3, static=0.4)), [(30.0, 0.0), (41.0, SIDE)],
        layer=2, L0=101.0, name="rough",
    )  # fmt: skip
    scene.lay_cable(Cable(EA=3e4), [(15.0, 62.0), (90.0, 71.0)], tension=100.0, name="tied")
    scene.remove(scene.lay_cable(Cable(EA=1.0), [(0.0, 50.0), (SIDE, 50.0)]))
    scene.floor(-30.0)
    solver.advance(pressure=0.012, move={scene.cable("sleeved").start: (-1.0, 8.0, -3.0)})
    return scene, solver


def test_cables_keep_their_data(comm):
    scene, solver = several(comm, 6)
    expected = several(comm, 12)[0]
    finer = solver.refine().scene
    assert [c.name for c in finer.cables] == ["sleeved", "rough", "tied"]
    for new, old, other in zip(finer.cables, scene.cables, expected.cables, strict=True):
        assert (new.cable, new.sleeve, new.layer) == (old.cable, old.sleeve, old.layer)
        assert new.ends == old.ends
        assert new.L0 == pytest.approx(other.L0, rel=1e-5)
        assert new.tension == pytest.approx(other.tension, rel=0.02)
    for k in (0, 1):  # anchors
        assert np.allclose(finer.cables[k].positions[[0, -1]], scene.cables[k].positions[[0, -1]])
    assert finer.cable("rough").L0 == 101.0
    assert finer.cable("tied").L0 != scene.cable("tied").L0  # its length here, at its tension
    assert finer.floor_level == -30.0
    assert finer.lay_cable(Cable(EA=1.0), [(0.0, 90.0), (SIDE, 90.0)]).name == "cable 5"


def test_length_that_a_load_step_has_given_is_kept(comm):
    scene, solver = model_2(comm, 4)
    solver.advance(L0={scene.cable("ridge"): 260.0})
    assert solver.refine().scene.cable("ridge").L0 == 260.0


def test_ends_on_a_curved_boundary_move_out_to_it(comm):
    """Where the coarse mesh has the chord, and just taut is longer."""
    scene = Scene(meshes.spherical_cap(comm, 20.0, 10.0, 6.0), IsotropicMembrane(8e5, 0.3, 1e-3))
    scene.fix("boundary")
    cable = scene.lay_cable(Cable(EA=3e4), meshes.great_circle(20.0, 10.0, 0.3, 5.0))
    solver = Solver(scene)
    solver.advance(pressure=0.4)
    radii = [np.hypot(*cable.positions[k, :2]) for k in (0, -1)]
    finer = solver.refine()
    new = finer.scene.cables[0]
    assert new.ends == ("held", "held")
    for end, was in zip((0, -1), radii, strict=True):
        now = np.hypot(*new.positions[end, :2])
        assert 20.0 - now < 0.5 * (20.0 - was) + 1e-9
        across = np.array([-np.sin(0.3), np.cos(0.3)])
        assert new.positions[end, :2] @ across == pytest.approx(5.0, abs=0.02)  # on its line
    sphere = 25.0
    half = np.sqrt(20.0**2 - 5.0**2)
    exact = 2 * sphere * np.arcsin(half / sphere)
    assert abs(new.L0 - exact) < 0.5 * abs(cable.L0 - exact)


def edged(comm, cells):
    """A square with a free side, in the sleeve of which a cable carries its weight."""
    scene = Scene(square(comm, cells)[0].mesh, FABRIC)
    for name in ("left", "right", "front"):
        scene.fix(name)
    scene.put_load((0.0, 0.0, -0.002), name="weight", per="material")
    scene.lay_cable(Cable(EA=3e3), [(0.0, SIDE), (SIDE, SIDE)], L0=100.0)
    solver = Solver(scene, rtol=1e-10)
    solver.advance(load=1.0)
    return scene.cables[0], solver


def test_cable_in_the_sleeve_of_a_free_edge(comm):
    """It stays in the edge, with its new vertices."""
    cable, solver = edged(comm, 4)
    expected, _ = edged(comm, 8)
    finer = solver.refine().scene.cables[0]
    assert cable.in_edge
    assert finer.in_edge
    assert len([node for node in finer.nodes if node.kind == "vertex"]) == 9
    assert finer.tension == pytest.approx(expected.tension, rel=1e-6)


def test_new_vertices_go_where_a_function_says(comm):
    """A flat mesh for a shallow arch, whose new vertices lie in it: the finer one is an arch."""
    _, solver = square(comm, 4)
    solver.advance(pressure=0.001)

    def arch(x):
        return np.stack([x[0], x[1], 0.1 * np.sin(np.pi * x[0] / SIDE)])

    heights = solver.refine(project=arch).scene.membrane.stress_free[:, 2]
    highest = comm.allreduce(float(heights.max(initial=0.0)), op=MPI.MAX)
    assert highest == pytest.approx(0.1, rel=1e-9)  # half-way between vertices of the middle


def refused_step(comm):
    fabric = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
    scene = Scene(square(comm, 2)[0].mesh, fabric, strain="step")
    scene.fix("boundary")
    return Solver(scene)


class Springs(EnergyTerm):
    """Springs from all vertices to the ground."""

    name = "springs"

    def sums(self, x, out):
        own = x[: self.unknowns.n_vertices]
        out[0] = 0.01 * np.vdot(own, own)

    def add_gradient(self, x, sums, g):
        n = self.unknowns.n_vertices
        g[:n] += 0.02 * x[:n]


def refused_term(comm):
    scene, solver = square(comm, 2)
    scene.add_term(Springs())
    return solver


def refused_cable(comm, **data):
    scene, solver = square(comm, 4)
    solver.advance(pressure=0.01)
    scene.lay_cable(Cable(EA=1e3, **data), [(0.0, 40.0), (SIDE, 40.0)], name="tie")
    return solver


def refused_support(comm):
    scene, solver = square(comm, 2)
    scene.held[:, 2] = True
    return solver


REFUSED = {
    "strain": (refused_step, 'strain="step"'),
    "law": (lambda comm: refused_cable(comm, law="step"), 'tie. has law="step"'),
    "term": (refused_term, "the term 'springs' of your own"),
    "support": (refused_support, "otherwise than scene.fix"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_carried_over_is_refused(comm, name):
    make, message = REFUSED[name]
    solver = make(comm)
    with pytest.raises(InputError, match=message):
        solver.refine()


@pytest.mark.parametrize("factor", [1.0, 2.0, None])
def test_load_by_a_function_from_a_checkpoint(comm, tmp_path_factory, factor):
    """The script gives the function again; another one, or none, is refused."""

    def snow(factor):
        return lambda x, n: np.stack([0 * x[0], 0 * x[0], -1e-5 * factor * x[0]])

    folder = comm.bcast(str(tmp_path_factory.mktemp("run")))
    scene, solver = square(comm, 2)
    solver.advance(pressure=0.01)
    scene.put_load(snow(1.0), name="snow")
    solver.advance(load=1.0)
    solver.save(folder)
    again, loaded = square(comm, 2)
    if factor is not None:
        again.put_load(snow(factor), name="snow")
    loaded.load(folder)
    if factor == 1.0:
        agree(numbers(loaded.refine()), numbers(solver.refine()), 1e-8)
        return
    with pytest.raises(InputError, match="'snow', a function or forces on vertices"):
        loaded.refine()


def test_cable_from_a_checkpoint_is_laid_as_it_was_laid(comm, tmp_path_factory):
    """On the inflated square, whose shape the checkpoint has; and loads are put there."""
    folder = comm.bcast(str(tmp_path_factory.mktemp("run")))
    scene, solver = model_2(comm, 4)
    scene.put_load((0.0, 0.0, -0.001), name="weight", per="material")
    scene.put_wind(0.004, -0.5)
    solver.advance(load={"weight": 1.0, "wind": 0.5})
    solver.save(folder)
    _, loaded = square(comm, 4)
    loaded.load(folder)
    again = comm.bcast(str(tmp_path_factory.mktemp("again")))
    loaded.save(again)
    _, twice = square(comm, 4)
    twice.load(again)
    expected = numbers(solver.refine())
    agree(numbers(loaded.refine()), expected, 1e-8)
    agree(numbers(twice.refine()), expected, 1e-8)
