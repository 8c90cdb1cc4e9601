"""Roofs sewn in the place of a form's membrane: what they keep, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    EnergyTerm,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
    patterns,
)
from crms_fenicsx.analysis.scene.scene import place_stress_free
from crms_fenicsx.design.form_finding import FormBar, FormCable, FoundForm, find_form
from crms_fenicsx.foundation.runtime.arrays import Array

pytestmark = pytest.mark.filterwarnings("ignore:flatten")  # of few columns of cells

FABRIC = OrthotropicMembrane(E1=900.0, E2=700.0, G12=30.0, nu21=0.15, thickness=1.0)
FILM = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)  # alike whichever way strips are cut
STEEL, BELT = Cable(EA=30e3), Cable(EA=1500.0)
MAST, GUY = Bar(EA=6e5), Bar(EA=4e4, tension_only=True)
STRESS = 3.0
CORNERS = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 14.0), (0.0, 10.0)]
PLAN = np.array(CORNERS)
HEIGHTS = (5.0, 2.5, 5.0, 2.5, 2.5)
SNOW = 0.6


def five_point_sail(comm: MPI.Intracomm, size: float) -> FoundForm:
    """A sail of 10 x 14 m over five corners, its edges with a tenth of sag."""
    tops = np.column_stack([PLAN, HEIGHTS])
    spans = np.linalg.norm(tops - np.roll(tops, -1, axis=0), axis=1)
    return find_form(
        meshes.polygon(comm, CORNERS, size),
        STRESS,
        fixed=[f"corner {k}" for k in range(1, 6)],
        lifted={f"corner {k + 1}": (0.0, 0.0, z) for k, z in enumerate(HEIGHTS)},
        cables=[
            FormCable(f"side {k + 1}", tension=STRESS * L * (1 / 0.8 + 0.05))
            for k, L in enumerate(spans)
        ],
    )


def on_masts(found: FoundForm) -> Scene:
    """The sail on a mast and two guys at each corner, with belts, under snow and wind at rest."""
    bars = []
    for k, (place, z) in enumerate(zip(PLAN, HEIGHTS, strict=True)):
        out = place - PLAN.mean(axis=0)
        out /= np.linalg.norm(out)
        aside, corner = np.array([-out[1], out[0]]), f"corner {k + 1}"
        bars.append(FormBar(corner, MAST, (*(place + 0.3 * out), 0.0), name=f"mast {k + 1}"))
        for side in (0.5, -0.5):
            bars.append(FormBar(corner, GUY, (*(place + z * (0.9 * out + side * aside)), 0.0)))
    scene = found.scene(FILM, STEEL, bars=bars, belts=BELT)
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    scene.put_wind(0.5, lambda x, n: -0.8 * n[2], name="wind")
    scene.put_load((0.0, 0.0, -0.012), name="weight", per="material")
    scene.put_line_load((0.0, 0.0, -0.1), "side 1", name="gutter")
    forces = fem.Function(scene.V)
    forces.x.array.reshape(-1, 3)[scene.vertices("corner 4"), 2] = -0.7
    scene.put_forces(forces, name="lamp")
    scene.put_cable_load((0.0, 0.0, -0.02), [scene.cable("side 2")], name="ice")
    scene.put_joint_load({scene.joint("start of mast 1"): (0.0, 0.0, -2.0)}, name="block")
    return scene


def cut_in_strips(found: FoundForm, width: float) -> patterns.Pattern:
    """Strips along the long way, compensated for the form's forces."""
    seams = patterns.strips(found.mesh, "side 5", "side 2", width)
    pieces = patterns.cut(found.mesh, seams)
    return patterns.flatten(pieces, FILM, shrink=patterns.shrink_for(FILM, STRESS))


def forces_of(scene: Scene) -> dict[str, float]:
    """Forces of edge cables and bars, these from their places and lengths alone."""
    own = {k.name: k.tension for k in scene.cables if "belt" not in k.name}
    for bar in scene.bars:
        length = float(np.linalg.norm(bar.points[1] - bar.points[0]))
        own[bar.name] = bar.bar.EA * (length / bar.L0 - 1.0)
    return own


def farthest(one: dict[str, float], other: dict[str, float]) -> float:
    """The largest relative difference of forces."""
    assert list(one) == list(other)
    return max(abs(force / other[name] - 1.0) for name, force in one.items())


@pytest.mark.ranks
def test_five_point_sail_keeps_its_forces(comm: MPI.Intracomm) -> None:
    """Prestressed and under snow, the sewn sail's edges, masts and guys carry what those of the
    form do, and the bars carry the snow: outline in plan, without what the code computed."""
    found = five_point_sail(comm, 0.5)
    scene = on_masts(found)
    sewn = patterns.sew(cut_in_strips(found, 4.0), scene=scene)
    assert [cable.hold for cable in sewn.cables] == ["pocket"] * 5 + ["bonded"] * 5
    solvers = [advanced(Solver(one)) for one in (scene, sewn)]
    assert farthest(forces_of(sewn), forces_of(scene)) < 0.004
    for solver in solvers:
        solver.advance(load={"snow": 1.0}, steps=2)
    assert farthest(forces_of(sewn), forces_of(scene)) < 0.02
    sides = [cable.path[:, :2] for cable in found.cables]
    sides = [side if np.allclose(side[0], at) else side[::-1]
             for side, at in zip(sides, PLAN, strict=True)]  # fmt: skip
    x, y = np.concatenate([side[:-1] for side in sides]).T
    plan = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    pulls = np.zeros(3)
    for name, force in forces_of(sewn).items():
        if not name.startswith("side"):
            foot, head = sewn.bar(name).points
            pulls += force * (foot - head) / np.linalg.norm(foot - head)
    assert pulls == pytest.approx([0.0, 0.0, SNOW * plan], abs=2e-3 * SNOW * plan)


@pytest.mark.slow
def test_differences_fall_with_the_width(comm: MPI.Intracomm) -> None:
    """Under snow, in strips of as many columns of cells, whose distortion falls with the square."""
    most = []
    for width, size in ((4.0, 0.5), (2.0, 0.25)):
        found = five_point_sail(comm, size)
        scene = on_masts(found)
        sewn = patterns.sew(cut_in_strips(found, width), scene=scene)
        for one in (scene, sewn):
            advanced(Solver(one), load={"snow": 1.0}, steps=2)
        most.append(farthest(forces_of(sewn), forces_of(scene)))
    assert most[0] < 0.02 and most[1] < 0.2 * most[0]


@pytest.mark.ranks
@pytest.mark.parametrize(("x", "slant", "within"), [(4.3, 0.1, 1e-3), (5.0, 0.0, 1e-6)])
def test_flat_sail_is_its_form(comm: MPI.Intracomm, x: float, slant: float, within: float) -> None:
    """Flat pieces have no distortion: edges have T = s R, as arcs of radius R have. The cut moves
    no vertex onto the second seam, and two of the edges onto the first."""
    span, sag = 10.0, 1.0
    tension = STRESS * (span**2 / (8 * sag) + sag / 2)
    found = find_form(
        meshes.rectangle(comm, span, span, 0.5, structured=True),
        STRESS,
        fixed=["front left", "front right", "back right", "back left"],
        cables=[FormCable(side, tension=tension) for side in ("front", "right", "back", "left")],
    )
    seam = patterns.plane_section(found.mesh, (x, 5.0, 0.0), (1.0, slant, 0.0), name="seam")
    shrink = patterns.shrink_for(FABRIC, STRESS)
    pattern = patterns.flatten(patterns.cut(found.mesh, [seam]), FABRIC, shrink=shrink)
    scene = patterns.sew(pattern, scene=found.scene(FABRIC, STEEL))
    advanced(Solver(scene))
    assert [k.tension for k in scene.cables] == pytest.approx(4 * [tension], rel=within)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("sides", "width"), [(("side 5", "side 2"), 1.0), (("side 4", "side 5"), 2.5)]
)
def test_sails_are_cut_where_edges_curve_inward(
    comm: MPI.Intracomm, sides: tuple[str, str], width: float
) -> None:
    """Beside each other, strips narrower than the sag of the edges end at these; from the corner of
    two edges they fan out. All of the surface is cut, and fits the roll, its parts do."""
    found = five_point_sail(comm, 0.7)
    pieces = patterns.cut(found.mesh, patterns.strips(found.mesh, *sides, width))
    assert pieces.area == pytest.approx(found.area, rel=1e-3)
    pattern = patterns.flatten(pieces, FILM, warp="seams")
    assert max(one.width for one in pattern.flat) < width


def totals(scene: Scene) -> dict[str, Array]:
    """Resultants of all loads on the membrane."""
    return {load.name: scene.comm.allreduce(load.forces.sum(axis=0)) for load in scene.loads}


@pytest.mark.ranks
def test_loads_are_kept(comm: MPI.Intracomm) -> None:
    """Their resultants and factors; weight is that of the flat pieces."""
    found = five_point_sail(comm, 0.7)
    scene = on_masts(found)
    Solver(scene).advance(load={"snow": 0.3})
    scene.put_pond(10.0, level=1.0, name="pond")
    scene.floor(-1.0)
    pattern = cut_in_strips(found, 3.0)
    sewn = patterns.sew(pattern, scene=scene)
    before, after = totals(scene), totals(sewn)
    for name in ("snow", "wind", "gutter", "lamp", "ice"):
        np.testing.assert_allclose(after[name], before[name], rtol=1e-3, atol=1e-3)
    assert after["weight"] == pytest.approx([0.0, 0.0, -0.012 * pattern.area])
    assert before["weight"] == pytest.approx([0.0, 0.0, -0.012 * found.area])
    assert after["gutter"][2] == pytest.approx(-0.1 * found.cables[0].length)
    assert after["lamp"] == pytest.approx([0.0, 0.0, -0.7])
    assert sewn.factors == scene.factors and sewn.factors["snow"] == 0.3
    assert sewn.loads.load("block").joints == scene.loads.load("block").joints
    assert sewn.ponds == scene.ponds and sewn.floor_level == -1.0
    assert [load.basis for load in sewn.loads] == [load.basis for load in scene.loads]


@pytest.mark.ranks
def test_what_judges_and_how_it_was_made_is_kept(comm: MPI.Intracomm) -> None:
    """Options of the scene, strengths and limits, air, edges held over their length, and cables
    along lines of the mesh with their clamps."""
    mesh = meshes.rectangle(comm, 6.0, 6.0, 1.0)
    ends = np.array([[(0, 3), (6, 3)], [(2.9, 0), (3.1, 6)], [(1.4, 0), (1.6, 6)]])
    lines = dict(zip(("A", "B", "seam"), ends, strict=True))
    mesh = meshes.along(mesh, lines)
    scene = Scene(mesh, FABRIC, pressure="lagged", penalty=0.2)
    scene.fix("boundary")
    anchor = scene.add_joint((7.0, 3.0, -0.5), name="anchor", held="xyz")
    a = scene.lay_cable(STEEL, [(0.0, 3.0, 0.0), anchor], along="A", hold="pocket", tension=2.0)
    b = scene.lay_cable(BELT, along="B", hold="bonded", layer=1)
    scene.clamp(a, b, slip=5.0)
    scene.set_strengths((80.0, 70.0), cables=100.0, patches=0.3)
    scene.set_limits(deflection=0.2)
    scene.air.update(pressure=0.2)
    pieces = patterns.cut(mesh, [patterns.edge_line(mesh, "seam")])
    pattern = patterns.flatten(pieces, FABRIC, warp=(1.0, 0.0, 0.0))
    sewn = patterns.sew(pattern, scene=scene, penalty=0.3)
    assert (sewn.pressure_law, sewn.penalty, sewn.pressure) == ("lagged", 0.3, 0.2)
    assert sewn.design.of_cable("A", "ULS") == 100.0 and sewn.design.limits == scene.design.limits
    assert sewn.membrane.strengths == scene.membrane.strengths
    assert sewn.membrane.patches == scene.membrane.patches
    edges = sewn.mesh.edges["boundary"]
    assert sewn.held[sewn.vertices("boundary")].all()
    assert np.array_equal(np.flatnonzero(sewn.membrane.held_edges), np.sort(edges))
    for one in scene.cables:
        other = sewn.cable(one.name)
        assert other.L0 == pytest.approx(one.L0, rel=1e-12)
        assert (other.hold, other.layer, other.cable) == (one.hold, one.layer, one.cable)
        np.testing.assert_allclose(other.line[[0, -1]], one.line[[0, -1]], atol=1e-12)
    (clamp,), (was,) = sewn.clamps, scene.clamps
    assert (clamp.name, clamp.slip) == (was.name, was.slip)
    assert clamp.at == pytest.approx(was.at)
    found = [advanced(Solver(s)).scene.cable("A").tension for s in (scene, sewn)]
    assert found[1] == pytest.approx(found[0], rel=1e-6)  # pieces that were flat already


def square(comm: MPI.Intracomm) -> tuple[Scene, patterns.Pieces]:
    """A held square with a seam, and its pieces."""
    mesh = meshes.rectangle(comm, 6.0, 6.0, 1.0, structured=True)
    scene = Scene(mesh, FABRIC)
    scene.fix("boundary")
    seam = patterns.plane_section(mesh, (3.1, 3.0, 0.0), (1.0, 0.0, 0.0), name="seam")
    return scene, patterns.cut(mesh, [seam])


def across(scene: Scene) -> None:
    scene.lay_cable(STEEL, [(0.0, 2.5), (6.0, 3.5)], name="purlin")


def moved(scene: Scene) -> None:
    scene.u.x.array.reshape(-1, 3)[scene.vertices("front right"), 2] = 0.1


class Nothing(EnergyTerm):
    """A term of one's own, without energy."""

    name = "snow cannon"

    def sums(self, x: Any, out: Any) -> None:
        out[0] = 0.0

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        pass


def with_term(scene: Scene) -> None:
    scene.add_term(Nothing())


def slid(scene: Scene) -> None:
    place_stress_free(scene, scene.membrane.stress_free * 1.01)


def barred(scene: Scene) -> None:
    head = scene.vertex_at((3.0, 3.0, 0.0))
    scene.add_bar(MAST, head, (3.0, 3.0, -3.0), name="prop")


def pinned(scene: Scene) -> None:
    scene.fix(lambda x: np.hypot(x[0] - 3.0, x[1] - 3.0) < 0.1)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (across, "'purlin' lies across cells.*found.along"),
        (moved, r"the support at \(6, 0, 0\) has been moved"),
        (with_term, "'snow cannon' is a term of your own"),
        (slid, "lines of the mesh have slid"),
        (barred, r"the end of 'prop' at \(3, 3, 0\) is a vertex that the cut moved.*point group"),
        (pinned, r"the support at \(3, 3, 0\) is a vertex that the cut moved"),
    ],
)
def test_what_cannot_be_kept_is_refused(
    comm: MPI.Intracomm, spoil: Callable[[Scene], None], message: str
) -> None:
    """By name, with the remedy, before anything is computed."""
    scene, pieces = square(comm)
    spoil(scene)
    with pytest.raises(InputError, match=message):
        patterns.sew(patterns.flatten(pieces, FABRIC), scene=scene)


@pytest.mark.ranks
def test_other_scenes_are_refused(comm: MPI.Intracomm) -> None:
    """Of another mesh, with lines that slide, and what is no scene."""
    _, pieces = square(comm)
    other, _ = square(comm)
    pattern = patterns.flatten(pieces, FABRIC)
    with pytest.raises(InputError, match=r"not cut from the mesh of this scene; cut scene\.mesh"):
        patterns.sew(pattern, scene=other)
    with pytest.raises(InputError, match="scene"):
        patterns.sew(pattern, scene=pieces)  # type: ignore[arg-type]
    mesh = meshes.along(meshes.rectangle(comm, 6.0, 6.0, 1.0), {"A": [(0.0, 3.0), (6.0, 3.3)]})
    scene = Scene(mesh, FABRIC)
    scene.fix("boundary")
    scene.lay_cable(STEEL, along="A")
    whole = patterns.flatten(patterns.cut(mesh, []), FABRIC)
    with pytest.raises(InputError, match=r"'A' slides sideways with a line.*pocket"):
        patterns.sew(whole, scene=scene)


@pytest.mark.ranks
def test_pieces_and_supports_are_in_the_order_of_counting(comm: MPI.Intracomm) -> None:
    """In results, checks and messages, beyond nine of them."""
    mesh = meshes.rectangle(comm, 22.0, 4.0, 1.0, structured=True)
    seams = [
        patterns.plane_section(mesh, (2.0 * k, 2.0, 0.0), (1.0, 0.0, 0.0), name=f"seam {k}")
        for k in range(1, 11)
    ]
    pattern = patterns.flatten(patterns.cut(mesh, seams), FABRIC, warp="seams")
    scene = patterns.sew(pattern)
    for seam in pattern.pieces.lines:
        scene.fix(seam)
    scene.fix("boundary")
    pieces = [f"piece {k}" for k in range(1, 12)]
    scene.set_strengths(dict.fromkeys(reversed(pieces), (80.0, 70.0)))
    summary = advanced(Solver(scene), pressure=0.3).summary()
    assert [*summary.parts][1:] == pieces
    judged = [check.member for check in summary.checks if check.what.startswith("fabric")]
    assert judged == [piece for piece in pieces for _ in ("warp", "weft")]
    groups = [name for name in summary.supports if name.startswith("seam")]
    assert groups == [f"seam {k}" for k in range(1, 11)]
    with pytest.raises(InputError, match=r"seam 1, seam 2, .*seam 10"):
        scene.vertices("seam 11")
