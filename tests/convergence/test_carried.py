"""What is beside, on and under a membrane goes over to finer meshes: bars, water, air, friction.

Closed forms, and finer meshes that scripts make themselves.
"""

import numpy as np
import pytest
from mpi4py import MPI
from octant import ET, NU, RADIUS, octant, stretch
from scipy.optimize import brentq
from scipy.special import j0, j1

from crms_fenicsx import (
    Bar,
    Cable,
    ConvergenceError,
    EnergyTerm,
    FanControl,
    Friction,
    InputError,
    IsotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.convergence.finer_cables import through_vertices
from crms_fenicsx.convergence.finer_scene import finer_scene
from crms_fenicsx.surface.points import EdgePoint, VertexPoint
from crms_fenicsx.surface.uniform_refinement import UniformRefinement

pytestmark = pytest.mark.usefixtures("comm")

SIDE = 100.0
FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def square(comm, cells, **laws):
    scene = Scene(meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True), FABRIC, **laws)
    scene.fix("boundary")
    return scene, Solver(scene, rtol=1e-10)


def given(lam):
    """Pressure that a sphere of this stretch needs."""
    return ET / (1 - NU) * (lam**2 - 1) / (lam * RADIUS)


START = brentq(lambda lam: given(lam) - 1.0, 1.0, 1.2)


def on_sphere(x):
    return RADIUS * x / np.linalg.norm(x, axis=0)


def test_sealed_sphere_converges_to_the_closed_form(comm):
    """The gas law counts from the volume that each mesh has at sealing."""
    scene = octant(comm, 4)
    solver = Solver(scene)
    solver.advance(pressure=1.0)
    scene.seal(volume=np.pi / 6 * (START * RADIUS) ** 3)
    solver.advance(temperature=1.1)
    study = solver.convergence(
        project=on_sphere,
        quantities={"p": lambda s: s.scene.pressure, "stretch": lambda s: stretch(s.scene)},
    )
    for name, closed in (("p", 2.53297), ("stretch", 1.045309)):
        found = study[name]
        assert found.order == pytest.approx(2.0, abs=0.15)
        assert abs(found.limit - closed) <= found.bar + 1e-5 * closed
        assert abs(found.limit - closed) < 0.1 * abs(found.values[-1] - closed)
    assert study.finest.scene.air.temperature == 1.1


@pytest.mark.parametrize("by", ["level", "volume"])
def test_pond_converges_to_the_closed_form(comm, by):
    k, tension, radius, h0 = 1.5, 2.0, 3.0, 1e-3
    soft = IsotropicMembrane(E=1e-6, nu=0.3, thickness=1.0, prestress=tension, wrinkling=False)
    scene = Scene(meshes.ellipse(comm, radius, radius, 1.0), soft)
    scene.fix("boundary")
    volume = np.pi * radius**2 * h0 * 2 / k * j1(k) / j0(k)
    amount = {"level": h0} if by == "level" else {"volume": volume}
    scene.put_pond(tension * (k / radius) ** 2, **amount)
    solver = Solver(scene)
    solver.advance(load=1.0)

    def water(solver):
        (pond,) = solver.scene.ponds
        return pond.volume if by == "level" else pond.level

    found = solver.convergence(quantities={"water": water})["water"]
    closed = volume if by == "level" else h0
    assert found.order == pytest.approx(2.0, abs=0.3)
    assert abs(found.limit - closed) <= found.bar
    assert abs(found.limit - closed) < 0.2 * abs(found.values[-1] - closed)


def test_truss_beside_the_membrane_is_as_it_was(comm):
    """Von Mises' truss knows nothing of the mesh; its anchors have been moved."""
    scene, solver = square(comm, 2)
    top = scene.add_joint((0.0, 150.0, 1.0), name="top", held="y")
    for x, name in ((-4.0, "left"), (4.0, "right")):
        scene.add_bar(Bar(EA=1000.0), (x, 150.0, 0.0), top, name=name)
    scene.put_joint_load({top: (0.0, 0.0, -1.0)}, name="P")
    solver.advance(load={"P": 5.0}, move={scene.bar("left").start: (0.1, 0.0, 0.0)})
    solver.advance(L0={scene.bar("right"): 4.2})
    finer = solver.refine()
    for bar in scene.bars:
        other = finer.scene.bar(bar.name)
        assert (other.bar, other.L0) == (bar.bar, pytest.approx(bar.L0, rel=1e-12))
        assert other.force == pytest.approx(bar.force, rel=1e-7)
    assert np.allclose(finer.scene.joint("top").position, top.position, atol=1e-7)
    foot = finer.scene.bar("left").start
    assert np.allclose(foot.position, (-3.9, 150.0, 0.0))
    assert np.allclose(foot.reaction, scene.bar("left").start.reaction, rtol=1e-6, atol=1e-9)
    finer.advance(load={"P": 0.0}, move={foot: (-0.1, 0.0, 0.0)})  # it goes on
    assert finer.scene.joint("top").position[2] > 0.0


class Anchored(EnergyTerm):
    """A spring from the membrane's middle to the ground."""

    name = "anchored"

    def __init__(self, scene):
        away = np.abs(scene.membrane.stress_free - (50.0, 50.0, 0.0)).max(axis=1)
        own = np.arange(len(away)) < scene.V.dofmap.index_map.size_local
        self.mine = (away < 1e-6) & own
        self.u, self.forces = np.zeros((2, len(away), 3))

    def sums(self, x, out):
        self.unknowns.read_vertices(x, self.u)
        out[0] = 0.5 * np.vdot(self.u[self.mine], self.u[self.mine])

    def add_gradient(self, x, sums, g):
        self.forces[self.mine] = self.u[self.mine]
        self.unknowns.add_to_vertices(self.forces, g)


def furnished(comm, cells):
    """A square with a guyed mast under it, cables to its top, a spring, water and sealed air."""
    scene, solver = square(comm, cells)
    scene.add_term(Anchored(scene))
    solver.advance(pressure=0.01)
    at = comm.allreduce(
        [tuple(x) for x, X in zip(scene.positions(), scene.membrane.stress_free, strict=True)
         if np.allclose(X, (25.0, 50.0, 0.0))]
    )[0]  # fmt: skip
    scene.add_bar(Bar(EA=2e3), scene.vertex_at(at), (25.0, 50.0, -40.0), name="tie")
    top = scene.add_joint((130.0, 50.0, 30.0), name="top")
    scene.add_bar(Bar(EA=5e4), (130.0, 50.0, 0.0), top, name="mast")
    for y, name in ((30.0, "a"), (70.0, "b")):
        scene.add_bar(Bar(EA=2e4, tension_only=True), top, (150.0, y, 0.0), name=name)
    scene.lay_cable(Cable(EA=3e4), [(-20.0, 40.0, 0.0), top], name="stay")
    scene.put_pond(1e-4, level=8.0)
    solver.advance(L0={scene.cable("stay"): 0.998 * scene.cable("stay").L0}, pressure=0.011)
    scene.seal(volume=1e6, atmosphere=1.0)
    solver.advance(load={"pond": 1.0}, temperature=1.01)
    return scene, solver


def numbers(scene):
    found = {**scene.energies, "pressure": scene.pressure, "volume": scene.volume}
    found |= {bar.name: bar.force for bar in scene.bars}
    found |= {f"L0 {bar.name}": bar.L0 for bar in scene.bars}
    found |= {cable.name: cable.tension for cable in scene.cables}
    found |= {f"top {k}": x for k, x in enumerate(scene.joint("top").position)}
    found |= {f"water {pond.name}": pond.volume for pond in scene.ponds}
    return found


def agree(found, expected, rtol):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=rtol, abs=rtol), name


def test_all_together_is_as_on_the_finer_mesh(comm):
    """But for the cable's length, which a load step has given."""
    scene, solver = furnished(comm, 4)
    finer = solver.refine(terms=Anchored).scene
    script, other = furnished(comm, 8)
    other.advance(L0={script.cable("stay"): scene.cable("stay").L0})
    agree(numbers(finer), numbers(script), 2e-4)
    assert finer.bar("tie").L0 == pytest.approx(script.bar("tie").L0, rel=1e-6)  # measured again
    assert abs(finer.bar("tie").L0 / scene.bar("tie").L0 - 1) > 1e-4


def test_all_together_from_a_checkpoint(comm, tmp_path_factory):
    """It knows the states in which bars were placed, the cable was laid and the air sealed."""
    folder = comm.bcast(str(tmp_path_factory.mktemp("run")))
    _, solver = furnished(comm, 4)
    solver.save(folder)
    scene, loaded = square(comm, 4)
    scene.add_term(Anchored(scene))
    loaded.load(folder)
    expected = numbers(solver.refine(terms=Anchored).scene)
    agree(numbers(loaded.refine(terms=Anchored).scene), expected, 1e-7)


@pytest.mark.parametrize("failures", [1, 2])
def test_without_equilibrium_at_once_it_goes_there_by_increments(comm, failures, caplog):
    """From the state before, with all that there is; the equilibrium is the same."""
    _, solver = furnished(comm, 4)
    expected = numbers(solver.refine(terms=Anchored).scene)
    solved = []

    def solve(scene):
        if scene.ponds and scene.ponds[0].factor == 1.0 and len(solved) < failures:
            solved.append(scene)
            raise ConvergenceError("no equilibrium here.")
        Solver(scene).advance()

    with caplog.at_level("WARNING", logger="crms_fenicsx"):
        finer = finer_scene(solver.scene, UniformRefinement.of, solve, Anchored)
    assert [int(r.message.split()[-2]) for r in caplog.records] == [1, 4][:failures]
    agree(numbers(finer), expected, 1e-5)


def test_without_equilibrium_from_the_stress_free_shape(comm):
    """Nothing was put on it later: it begins there, and supports come to where they are."""
    scene, solver = square(comm, 4)
    scene.put_load((0.0, 0.0, 1e-4), name="lift")
    solver.advance(pressure=0.01, load=1.0, move={"left": (-0.5, 0.0, 1.0)})
    failed = []

    def solve(finer):
        if not failed:
            failed.append(finer)
            raise ConvergenceError("no equilibrium here.")
        Solver(finer).advance()

    finer = finer_scene(scene, UniformRefinement.of, solve)
    expected = solver.refine().scene
    assert finer.energy == pytest.approx(expected.energy, rel=1e-7)
    assert np.allclose(finer.u.x.array, expected.u.x.array, atol=1e-4)


def model_2(comm, cells):
    """A cable over a line of vertices, just taut on the inflated square, that anchors pull down."""
    scene, solver = square(comm, cells)
    solver.advance(pressure=0.01)
    cable = scene.lay_cable(Cable(EA=32000.0), [(-80.0, 50.0, 0.0), (180.0, 50.0, 0.0)])
    solver.advance(move={cable: (0.0, 0.0, -15.0)})
    return scene, solver


def test_cable_that_was_laid_by_increments_is_measured_on_each_mesh(comm):
    """Its length stays one that follows from the mesh, not one that a load step has given."""
    scene, _ = model_2(comm, 2)
    failed = []

    def solve(finer):
        if finer.cables and not failed:
            failed.append(finer)
            raise ConvergenceError("no equilibrium here.")
        Solver(finer, rtol=1e-10).advance()

    by_increments = finer_scene(scene, UniformRefinement.of, solve)
    levels = [
        finer_scene(finer, UniformRefinement.of, solve)
        for finer in (by_increments, model_2(comm, 4)[0])
    ]
    cables = [finer.cables[0] for finer in levels]
    assert cables[0].L0 == pytest.approx(cables[1].L0, rel=1e-9)
    assert cables[0].tension == pytest.approx(cables[1].tension, rel=1e-6)
    assert abs(cables[0].L0 / by_increments.cables[0].L0 - 1) > 1e-5


def test_cable_that_passes_close_by_vertices_goes_through_them(comm):
    """On the sides of the second mesh's equilibrium the third one's catches it between edges."""
    _, solver = model_2(comm, 4)
    with_caught = solver.refine().refine().scene.cables[0]
    assert with_caught.tension == pytest.approx(253.39934, rel=1e-6)  # as laid on this mesh


def test_path_through_close_vertices():
    path = [EdgePoint((0, 1), 0.01), EdgePoint((1, 2), 0.98), EdgePoint((2, 3), 0.01),
            EdgePoint((3, 4), 0.5), VertexPoint(5), EdgePoint((6, 7), 0.99)]  # fmt: skip
    middle = [VertexPoint(2), *path[3:5]]
    assert through_vertices(path, ("held", "tied")) == [path[0], *middle, path[5]]
    assert through_vertices(path, ("off", "tied")) == [VertexPoint(0), *middle, path[5]]
    assert through_vertices(path, ("held", "off")) == [path[0], *middle, VertexPoint(7)]


def test_what_has_been_taken_away_since(comm, caplog):
    """Its state has no equilibrium any more: the cable is laid on the coarse mesh's shape."""
    scene, solver = square(comm, 4)
    scene.put_load((0.0, 0.0, 0.04), name="lift")
    solver.advance(pressure=0.01, load=1.0)
    scene.lay_cable(Cable(EA=3e3), [(0.0, 40.0), (SIDE, 40.0)])
    scene.remove_load("lift")
    solver.advance()
    with caplog.at_level("WARNING", logger="crms_fenicsx"):
        finer = solver.refine().scene
    assert "lift has been taken away since" in caplog.text
    assert finer.cables[0].L0 == pytest.approx(scene.cables[0].L0, rel=0.02)
    assert finer.cables[0].L0 > 1.03 * SIDE  # not as under the pressure alone


def rough(comm, cells):
    """A cable over the inflated square, drawn in at one end against friction along it."""
    scene, solver = square(comm, cells)
    solver.advance(pressure=0.01)
    cable = scene.lay_cable(
        Cable(EA=2e3, friction=Friction(0.0, along=0.3)),
        [(-10.0, 41.0, -5.0), (110.0, 41.0, -5.0)], L0=130.0,
    )  # fmt: skip
    solver.advance(L0={cable: 120.0}, steps=2)
    solver.advance(move={cable.end: (8.0, 0.0, 0.0)}, steps=2)
    return cable, solver


def test_friction_along_a_cable_goes_on_from_where_it_rested(comm):
    """Its tension varies as in a run of the same steps on the finer mesh."""
    coarse, solver = rough(comm, 8)
    expected, _ = rough(comm, 16)
    finer = solver.refine().scene.cables[0]
    ratio = expected.tensions[-1] / expected.tensions[0]
    assert ratio > 1.05
    assert finer.tensions[-1] / finer.tensions[0] == pytest.approx(ratio, rel=0.01)
    assert finer.tension == pytest.approx(expected.tension, rel=2e-3)
    middles = [np.interp(np.linspace(0, 1, 9), np.linspace(0, 1, len(c.tensions)), c.tensions)
               for c in (finer, expected)]  # fmt: skip
    assert np.allclose(middles[0], middles[1], rtol=0.02)
    assert len(finer.tensions) > len(coarse.tensions)


def test_pressure_by_fans_is_a_number(comm):
    scene, solver = square(comm, 2)
    scene.put_load((0.0, 0.0, -0.001), name="snow")
    solver.advance(pressure=0.01)
    solver.advance(load=1.0, pressure=FanControl("snow", [0.0, 1.0], [0.01, 0.012]))
    finer = solver.refine()
    assert finer.scene.pressure == pytest.approx(0.012)
    scene.set_strengths((5.0, 4.0))
    assert solver.refine().scene.membrane.strengths == scene.membrane.strengths


def free_edges(comm, cells):
    """The paper's pressure on a sheet that is held on two sides: it follows the surface."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True)
    scene = Scene(mesh, FABRIC, pressure="step")
    scene.fix("left")
    scene.fix("right")
    solver = Solver(scene)
    solver.advance(pressure=0.005)
    return scene, solver


def test_pressure_of_the_paper_where_edges_are_free(comm):
    """There it is the follower pressure, whatever the number of steps."""
    _, solver = free_edges(comm, 4)
    expected, _ = free_edges(comm, 8)
    finer = solver.refine().scene
    assert finer.pressure_law == "step"
    heights = [s.comm.allreduce(float(s.positions()[:, 2].max(initial=-1.0)), op=MPI.MAX)
               for s in (finer, expected)]  # fmt: skip
    assert heights[0] == pytest.approx(heights[1], rel=1e-5)


def refused(comm, how):
    scene, solver = square(comm, 2, pressure="step" if how == "step" else "total")
    if how == "step":
        solver.advance(pressure=0.01)
    else:
        scene.add_term(Anchored(scene))
    return solver


REFUSED = {
    "step": ({}, 'pressure="step" and no free edges'),
    "none": ({}, "the term 'anchored' of your own is made for this mesh; give a function"),
    "kind": ({"terms": 3.0}, "terms = 3.0; give a function"),
    "name": ({"terms": lambda scene: []}, r"terms returned \[\]; it must return the terms"),
}


@pytest.mark.parametrize("how", REFUSED)
def test_what_cannot_be_carried_over_is_refused(comm, how):
    arguments, message = REFUSED[how]
    solver = refused(comm, how)
    with pytest.raises(InputError, match=message):
        solver.refine(**arguments)


def test_terms_without_any(comm):
    _, solver = square(comm, 2)
    with pytest.raises(InputError, match="no term has been added"):
        solver.refine(terms=Anchored)


def inflated_under_cable(comm, cells, y=41.0):
    """A square inflated under a cable that lies on it, from flat."""
    scene, solver = square(comm, cells)
    scene.lay_cable(Cable(EA=32000.0), [(0.0, y), (SIDE, y)], L0=SIDE, name="ridge")
    solver.advance(pressure=0.01)
    return scene, solver


def test_cable_in_tension_starts_on_its_line_and_in_contact(comm):
    """With the coarse mesh's tension, so that the first solve is near the finer equilibrium."""
    scene, _ = inflated_under_cable(comm, 5)
    was, found = scene.cable("ridge"), []

    def solve(finer):
        (cable,) = finer.cables
        steps = np.linalg.norm(np.diff(cable.positions[cable.contacts()], axis=0), axis=1)
        found.append((cable.lifted.sum(), steps.sum()))
        Solver(finer).advance()

    finer = finer_scene(scene, UniformRefinement.of, solve)
    ((lifted, length),) = found
    assert not was.lifted.any()
    assert lifted == 0
    assert length == pytest.approx(was.length, rel=1e-4)
    assert finer.cable("ridge").tension == pytest.approx(was.tension, rel=0.03)


def moved_edge(comm, cells):
    """A cable on an inflated square to an edge that is then moved away under its anchor."""
    scene, solver = square(comm, cells)
    solver.advance(pressure=0.01)
    scene.lay_cable(Cable(EA=1e4), [(0.0, 50.0), (SIDE, 57.0)], L0=103.14)
    solver.advance()
    solver.advance(move={"left": (-0.1, 0.0, 0.2)})
    return scene.cables[0], solver


def test_cable_whose_edge_has_been_moved_beyond_its_anchor(comm):
    """It runs from there to the edge and slides along it, as on the finer mesh of a script."""
    expected, _ = moved_edge(comm, 8)
    was, solver = moved_edge(comm, 4)
    cable = solver.refine().scene.cables[0]
    assert cable.ends == expected.ends == was.ends == ("off", "held")
    assert cable.nodes[1].kind == expected.nodes[1].kind == "rail"
    assert np.array_equal(cable.positions[0], (0.0, 50.0, 0.0))
    assert cable.tension == pytest.approx(expected.tension, rel=0.01)


def test_levels_with_all_that_there_is_are_those_of_one_process(comm):
    """Bars, cables to joints, water, sealed air and an added term, divided anyhow."""
    _, alone = furnished(MPI.COMM_SELF, 4)
    _, shared = furnished(comm, 4)
    for one, other in (
        (alone.refine(terms=Anchored), shared.refine(terms=Anchored)),
        (alone.adapt(0.6, terms=Anchored), shared.adapt(0.6, terms=Anchored)),
    ):
        agree(numbers(other.scene), numbers(one.scene), 1e-8)


@pytest.mark.parametrize("method", ["refine", "adapt", "convergence"])
def test_errors_name_the_method_that_was_called(comm, method):
    scene, solver = square(comm, 2)
    scene.add_term(Anchored(scene))
    solver.advance(pressure=0.01)
    with pytest.raises(InputError, match=f"^{method}: the term 'anchored' of your own"):
        getattr(solver, method)()
