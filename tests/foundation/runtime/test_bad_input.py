"""Careless input is refused before anything is computed, with what, value and remedy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bad_calls import snapshot

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    PathError,
    PenaltyWarning,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.model.friction import Friction

NAN = float("nan")
MATERIAL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
CABLE = Cable(EA=32000.0)
ACROSS = [(0.0, 47.0), (100.0, 52.0)]
"""A path across the square through cells' interiors, its ends on the boundary."""


@pytest.fixture(scope="module")
def square(comm):
    return meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)


@pytest.fixture
def scene(square) -> Scene:
    """The clamped square."""
    scene = Scene(square, MATERIAL)
    scene.fix("boundary")
    return scene


def refused(
    call: Callable[[], object], *words: str, kind: type[Exception] = InputError, scene: Any = None
) -> None:
    """Assert that a call raises `kind` itself with all these words and changes nothing."""
    before = snapshot(scene) if scene is not None else None
    with pytest.raises(kind) as error:
        call()
    assert type(error.value) is kind
    for word in words:
        assert word in str(error.value)
    if scene is not None:
        assert snapshot(scene) == before


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may be solved."""

    def solve(*arguments: object) -> None:
        raise AssertionError("a solve was begun")

    monkeypatch.setattr(EquilibriumSearch, "find", solve)


class Recorder:
    """Stands for the files: counts what is written."""

    written = 0

    def write(self, *arguments: object) -> None:
        self.written += 1


def refused_load(scene: Scene, *words: str, **loads: Any) -> None:
    """Assert that `advance` refuses the loads, with nothing changed or written."""
    solver = Solver(scene)
    solver._recorder = Recorder()  # type: ignore[assignment]
    refused(lambda: solver.advance(**loads), "advance", *words, scene=scene)
    assert solver.steps == [] and solver._recorder.written == 0


@pytest.mark.parametrize("nu", [-1.0, 1.0, 1.5])
def test_poissons_ratio(nu: Any) -> None:
    refused(lambda: IsotropicMembrane(300.0, nu, 0.08), "nu", repr(nu))


def test_orthotropic_stiffness_is_definite() -> None:
    E1, E2 = 140.0, 1394.0
    limit = (E2 / E1) ** 0.5
    OrthotropicMembrane(E1, E2, 12.0, 0.99 * limit, 1.0)
    for nu21 in (1.001 * limit, -1.001 * limit, 2.0 * limit):
        refused(
            lambda nu21=nu21: OrthotropicMembrane(E1, E2, 12.0, nu21, 1.0),
            "nu21", repr(nu21), "indefinite", "nu12",
        )  # fmt: skip


@pytest.mark.parametrize("warp", [(0.0, 0.0, 0.0), (1.0, 0.0), (NAN, 0.0, 0.0), "x", None])
def test_warp_directions(warp: Any) -> None:
    make = lambda: OrthotropicMembrane(140.0, 1394.0, 12.0, 0.065, 1.0, warp=warp)  # noqa: E731
    refused(make, "warp", repr(warp))


@pytest.mark.parametrize("prestress", [(1.0, 2.0, 3.0), NAN, "x", -0.1, (0.1, 0.2)])
def test_prestress(prestress: Any) -> None:
    refused(lambda: IsotropicMembrane(300.0, 0.25, 0.08, prestress=prestress), str(prestress))


@pytest.mark.parametrize("value", [-0.1, NAN, np.inf, "0.3", None, [0.3]])
def test_coefficient_of_a_cable(value: Any) -> None:
    refused(lambda: Cable(1.0, friction=value), "friction" if value != -0.1 else "mu", str(value))


def test_bad_friction() -> None:
    refused(lambda: Friction(0.5, static=0.4), "static = 0.4", "mu = 0.5", "at least")
    for choices in ({"static": 0.6}, {"along": 0.1}):
        refused(lambda c=choices: Friction(0.5, law="step", **c), "step", "0.", "coulomb")  # type: ignore[misc]
    refused(lambda: Friction(0.5, tolerance=0.2), "tolerance = 0.2", "0.1", "0.003")
    Friction(0.5, static=0.5, law="step")  # what says nothing else is no contradiction
    assert Friction(0.5, static=0.6).at_rest == 0.6 and Friction(0.5).at_rest == 0.5
    assert Friction(0.0, static=0.1).any and not Friction(0.0).any and Friction(0.0, along=0.1).any


def test_friction_of_a_cable() -> None:
    """A number is short for a `Friction`; zero is none."""
    assert (
        Cable(1.0, friction=0.3).sideways
        == Friction(0.3)
        == Cable(1.0, friction=Friction(0.3)).sideways
    )
    assert Cable(1.0).sideways is Cable(1.0, friction=0).sideways is None
    assert Cable(1.0, friction=Friction(0.0, along=0.2)).sideways is None
    assert Cable(1.0, friction=Friction(0.1, along=0.2)).along == 0.2
    assert Cable(1.0, friction=0.3).along == 0.0


@pytest.mark.ranks
def test_floor_above_the_membrane(scene: Scene) -> None:
    refused(lambda: scene.floor(1.0), "z = 0", "z = 1", "lower", scene=scene)
    scene.floor(0.0)


@pytest.mark.ranks
def test_groups_and_directions(scene: Scene) -> None:
    refused(lambda: scene.fix("rim"), "'rim'", "boundary", "front left", scene=scene)
    refused(lambda: scene.fix("left", "xq"), "'xq'", "x, y and z", scene=scene)
    refused(lambda: scene.fix("left", ""), "''", "x, y and z", scene=scene)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("marker", "words"),
    [
        (lambda x: None, "object"),
        (lambda x: True, "shape ()"),
        (lambda x: x[0], "float64"),
        (lambda x: x > 0, "shape (3"),
        (lambda x: x[0] > 1e6, "no vertex"),
    ],
)
def test_marker_functions(scene: Scene, marker: Any, words: str) -> None:
    refused(lambda: scene.fix(marker), "marker", words, scene=scene)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("path", "words"),
    [
        ([(0.0, 50.0), (130.0, 50.0)], ("point 1", "(130, 50)", "30 outside", "(100, 50, 0)")),
        ([(-3.0, 50.0), (100.0, 50.0)], ("point 0", "leaves the membrane", "anchor")),
        ([(0.0, 50.0), (NAN, 50.0)], ("path", "nan", "finite")),
        ([(0.0, 50.0)], ("shape (1, 2)", "two or more")),
        ([(0.0, 50.0), (0.0, 50.0)], ("points 0 and 1", "remove one")),
        ([(0.0, 52.0), (80.0, 54.0), (0.0, 56.0)], ("'cable 1'", "point 1", "cut off", "wider")),
        ([(0.0, 50.0), (90.0, 50.0, 0.0)], ("list of points",)),
        ([[0.0, 1.0, 2.0, 3.0]] * 2, ("shape (2, 4)",)),
        ("left", ("'left'", "list of points")),
        (None, ("neither path nor along",)),
        ([(0.0, 50.0, 0.0), (50.0, 50.0, 30.0), (100.0, 50.0, 0.0)], ("point 1", "only the first")),
        ([(0.0, 50.0, 0.0), (50.0, 50.0, -30.0)], ("point 1", "30 inside", "outside")),
    ],
)
def test_paths(scene: Scene, path: Any, words: tuple[str, ...]) -> None:
    refused(lambda: scene.lay_cable(CABLE, path), *words, kind=PathError, scene=scene)


@pytest.mark.parametrize("value", [0.0, -1.0, NAN, "x"])
@pytest.mark.parametrize("name", ["L0", "tension"])
def test_length_and_tension_at_laying(scene: Scene, name: str, value: Any) -> None:
    lay = lambda: scene.lay_cable(CABLE, ACROSS, name="ridge", **{name: value})  # noqa: E731
    refused(lay, "lay_cable", "'ridge'", name, repr(value), "pass", scene=scene)


def test_what_a_cable_is_called_and_made_of(scene: Scene) -> None:
    refused(
        lambda: scene.lay_cable(32000.0, ACROSS), "cable is of type float", "Cable", scene=scene
    )
    refused(
        lambda: scene.lay_cable(CABLE, ACROSS, L0=99.0, tension=1.0), "both", "one", scene=scene
    )
    for name in (3, ""):
        refused(
            lambda name=name: scene.lay_cable(CABLE, ACROSS, name=name), repr(name), scene=scene
        )
    scene.lay_cable(CABLE, ACROSS, name="cable 2")
    below = [(0.0, 20.0), (100.0, 22.0)]
    refused(lambda: scene.lay_cable(CABLE, below, name="cable 2"), "'cable 2'", scene=scene)
    assert scene.lay_cable(CABLE, below).name == "cable 3"


@pytest.mark.parametrize("pressure", [NAN, float("inf"), "a", (0.0, 1.0)])
@pytest.mark.usefixtures("idle")
def test_pressure_is_a_number(scene: Scene, pressure: Any) -> None:
    refused_load(scene, "pressure", repr(pressure), "pass", pressure=pressure)


@pytest.mark.ranks
@pytest.mark.parametrize("vector", [(0, 0, NAN), (0, 0), "up", None, 3.0, ((0, 0, 1),)])
@pytest.mark.usefixtures("idle")
def test_movements_are_vectors(scene: Scene, vector: Any) -> None:
    refused_load(scene, "move of 'left'", repr(vector), "three", move={"left": vector})


@pytest.mark.usefixtures("idle")
def test_what_can_be_moved(scene: Scene) -> None:
    up = (0.0, 0.0, 1.0)
    other = Scene(scene.mesh, MATERIAL)
    other.fix("boundary")
    foreign = other.lay_cable(CABLE, ACROSS)
    tied = scene.lay_cable(CABLE, [(30.0, 47.0), (100.0, 52.0)], name="tied")
    refused_load(scene, "3", "a laid cable", move={3: up})
    refused_load(scene, "Cable", "a laid cable", move={CABLE: up})
    refused_load(scene, "mapping", "move={", move=[("left", up)])
    refused_load(scene, "not a cable of this scene", move={foreign: up})
    refused_load(scene, "not a cable of this scene", move={foreign.end: up})
    refused_load(scene, "start of 'tied'", "scene.fix", "anchor", move={tied.start: up})
    refused_load(scene, "start of 'tied'", "scene.fix", "anchor", move={tied: up})
    scene.held[:] = False
    scene.fix("left")
    refused_load(scene, "'right'", "not held", "scene.fix('right', 'z')", move={"right": up})
    scene.fix("right", "z")
    refused_load(scene, "not held in x,", "scene.fix('right', 'x')", move={"right": (1, 0, 1)})


@pytest.mark.usefixtures("idle")
def test_held_vertices_stay_above_the_floor(scene: Scene) -> None:
    scene.floor(-1.0)
    words = "the vertex at", "z = -1.5", "floor z = -1", "move it less"
    refused_load(scene, *words, move={"left": (0.0, 0.0, -1.5)})
    refused_load(scene, *words, move={"left": (0.0, 0.0, -0.5), "boundary": (0.0, 0.0, -1.0)})


@pytest.mark.usefixtures("idle")
def test_lengths_to_reach(scene: Scene) -> None:
    other = Scene(scene.mesh, MATERIAL)
    other.fix("boundary")
    foreign = other.lay_cable(CABLE, ACROSS)
    cable = scene.lay_cable(CABLE, ACROSS, name="ridge")
    stepwise = scene.lay_cable(Cable(1.0, law="step"), [(0.0, 20.0), (100.0, 22.0)], name="paper")
    for value in (0.0, -1.0, NAN, "x", None):
        refused_load(scene, "L0 of 'ridge'", repr(value), "pass", L0={cable: value})
    refused_load(scene, "mapping", "L0={", L0=90.0)
    refused_load(scene, "'left'", "laid cable", L0={"left": 90.0})
    refused_load(scene, "not a cable or bar of this scene", L0={foreign: 90.0})
    refused_load(scene, "'paper'", "step-wise", 'law="total"', L0={stepwise: 90.0})


@pytest.mark.usefixtures("idle")
def test_something_is_held(square) -> None:
    refused_load(Scene(square, MATERIAL), "no part", 'scene.fix("boundary")', pressure=0.01)


@pytest.mark.parametrize("directions", ["x", "y"])
@pytest.mark.usefixtures("idle")
def test_follower_pressure_needs_a_held_boundary(square, directions: str) -> None:
    words = "boundary is free", 'scene.fix("boundary")', 'pressure="lagged"'
    scene = Scene(square, MATERIAL)
    scene.fix("left")
    refused_load(scene, *words, pressure=0.01)
    scene.fix("boundary", directions)
    refused_load(scene, *words, pressure=0.01)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"rtol": 0.0}, ("rtol = 0.0", "between 0 and 1")),
        ({"rtol": 1.0}, ("rtol = 1.0", "between 0 and 1")),
    ],
)
def test_solver_settings(scene: Scene, arguments: Any, words: tuple[str, ...]) -> None:
    refused(lambda: Solver(scene, **arguments), "Solver", *words)


def two_parts(comm) -> meshes.MembraneMesh:
    """A square of four cells; the parts "left" and "right" share none, "all" has all."""
    points = [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)]
    cells = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    parts = {"left": [2, 3], "right": [0, 1], "all": [0, 1, 2, 3]}
    return meshes.from_arrays(comm, points, cells, parts=parts)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("material", "words"),
    [
        (None, ("material", "None", "IsotropicMembrane")),
        ("fabric", ("material", "'fabric'", "IsotropicMembrane")),
        ({"roof": MATERIAL}, ("'roof'", "all, left, right")),
        ({"left": 300.0}, ("'left'", "300.0", "Membrane")),
        ({"left": MATERIAL}, ("cells have no material", "every part")),
        ({}, ("cells have no material", "every part")),
    ],
)
def test_materials_of_parts(comm, material: Any, words: tuple[str, ...]) -> None:
    refused(lambda: Scene(two_parts(comm), material), "Scene", *words)


def test_stepwise_strain_has_no_wrinkles(square) -> None:
    words = 'strain="step"', "wrinkling=True", "wrinkling=False"
    refused(lambda: Scene(square, MATERIAL, strain="step"), *words)


@pytest.mark.ranks
@pytest.mark.parametrize("where", [3, None, ["left", "right"], np.array([1, 2])])
def test_where_to_fix(scene: Scene, where: Any) -> None:
    refused(lambda: scene.fix(where), repr(where), "one group", scene=scene)


@pytest.mark.parametrize(
    ("factor", "happens"), [(9e-4, "unstable"), (1.1, "lock"), (100.0, "lock")]
)
def test_penalty_outside_the_sound_range_warns(square, factor: float, happens: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Scene(square, MATERIAL, penalty=factor)
    assert len(caught) == (1 if square.comm.rank == 0 else 0)  # said once, not by every rank
    for warning in caught:
        assert warning.category is PenaltyWarning and warning.filename == __file__
        for word in (f"{factor:g}", "0.001 ... 1", happens):
            assert word in str(warning.message)


@pytest.mark.parametrize("arguments", [{"penalty": 1e-3}, {"penalty": 1.0}, {"literal_penalty": 9}])
def test_penalty_in_the_sound_range_does_not_warn(square, arguments: Any) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Scene(square, MATERIAL, **arguments)
    assert [warning for warning in caught if warning.category is PenaltyWarning] == []


@pytest.mark.ranks
@pytest.mark.usefixtures("idle")
def test_displacements_that_are_not_finite(scene: Scene) -> None:
    everywhere = scene.V.tabulate_dof_coordinates()
    at = np.flatnonzero(np.abs(everywhere - (50.0, 25.0, 0.0)).max(axis=1) < 1e-9)  # on some ranks
    scene.u.x.array[3 * at + 1] = NAN
    words = "scene.u", "nan", "50", "25", "finite"
    refused_load(scene, *words, pressure=0.01)
    refused(lambda: scene.lay_cable(CABLE, ACROSS), "lay_cable", *words, scene=scene)
    refused(lambda: scene.floor(-1.0), "floor", *words, scene=scene)


@pytest.mark.parametrize(
    ("warp", "words"),
    [
        ((0.0, 0.0, 2.0), ("normal to the membrane", "nowhere normal")),
        (lambda x: np.where(x[0] < 30, [[0.0], [0.0], [1.0]], [[1.0], [0.0], [0.0]]), ("normal",)),
        (lambda x: np.full_like(x, NAN), ("not finite", "must return")),
        (lambda x: np.ones(3), ("shape (3,)", "must return")),
        (lambda x: None, ("shape ()", "must return")),
    ],
)
def test_warp_lies_in_the_surface(square, warp: Any, words: tuple[str, ...]) -> None:
    scene = Scene(square, OrthotropicMembrane(140.0, 1394.0, 12.0, 0.065, 1.0, warp=warp))
    scene.fix("boundary")
    solver = Solver(scene)
    refused(lambda: solver.advance(pressure=0.01), "warp", *words, scene=scene)


class Nested:
    class Error(Exception):
        """Known by this name here only."""


Nested.Error.__qualname__ = "elsewhere.<locals>.Error"


@pytest.mark.ranks
@pytest.mark.parametrize(
    "error",
    [IndexError("no row 7"), UnicodeDecodeError("utf-8", b"", 0, 1, "?"), Nested.Error("local")],
)
def test_an_error_on_one_rank_reaches_all(scene: Scene, error: Exception) -> None:
    """A marker function that fails on the last rank's vertices only."""
    comm = scene.comm

    def marker(x: np.ndarray) -> np.ndarray:
        if comm.rank == comm.size - 1:
            raise error
        return x[0] == 0.0

    before = snapshot(scene)
    with pytest.raises((type(error), RuntimeError)) as caught:
        scene.fix(marker)
    assert str(error) in str(caught.value)
    assert snapshot(scene) == before


def test_edges_are_held_before_cables_are_laid(comm) -> None:
    mesh = meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("left")
    scene.lay_cable(Cable(EA=32000.0), [(0.0, 50.0), (100.0, 52.0)])
    scene.fix("left")  # nothing new
    refused(lambda: scene.fix("right"), "'right'", "cables", "first", scene=scene)
