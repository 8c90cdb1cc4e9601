"""Lengths of cables on a dome: just taut on the smooth surface or on the facets, and along the
shortest way between two places."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped, sheet
from dome import HEIGHT, RADIUS
from dome import dome as cap
from numpy.testing import assert_allclose

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, nets

EA = 30e3
TENSION = 13.743
"""Of a cable over the crown, just taut, at 0.4 kPa: `benchmarks/cable_convergence.py`."""


def dome(comm, size: float) -> Scene:
    """The cap of demos/cable_net.py."""
    return clamped(cap(comm, size), IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))


def over(scene: Scene, **how):
    """A cable over the crown, or beside it."""
    return scene.lay_cable(Cable(EA), nets.great_circle(RADIUS, HEIGHT, 0.3, 0.0), **how)


def arc_between(start: np.ndarray, end: np.ndarray) -> float:
    """Length of the great circle between two points of the sphere."""
    centre = np.array([0.0, 0.0, HEIGHT - 25.0])
    a, b = start - centre, end - centre
    return 25.0 * np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


@pytest.mark.ranks
def test_length_on_a_dome(comm) -> None:
    scene = dome(comm, 3.0)
    facets, surface = over(scene, measured_on="facets"), over(scene)
    ends = surface.state.positions[[0, -1]]  # where it is held, on chords of the rim
    arc = arc_between(*ends)
    assert facets.L0 == pytest.approx(facets.length, rel=1e-14)
    assert facets.L0 < arc * (1 - 1e-3)
    assert surface.L0 == pytest.approx(arc, rel=1e-4)
    assert surface.tension == 0.0 and surface.length == facets.length


def test_tension_converges_from_near(comm) -> None:
    """At sizes at which one that is just taut on the facets has tensions too high by a third."""
    for size, rtol in ((3.0, 0.025), (1.4, 0.01)):
        scene = dome(comm, size)
        cable = over(scene)
        Solver(scene).advance(pressure=0.4)
        assert_allclose(cable.tension, TENSION, rtol=rtol)


def test_tension_given(comm) -> None:
    """It stretches the cable from the same length."""
    scene = dome(comm, 3.0)
    taut, tight = over(scene), over(scene, tension=20.0)
    assert tight.tension == pytest.approx(20.0, rel=1e-9)
    assert tight.L0 * (1 + 20.0 / EA) == pytest.approx(taut.L0, rel=1e-13)


def test_flat_membranes_have_one_length(comm) -> None:
    scene = sheet(comm, 5, "unstructured", side=10.0)
    lengths = [
        scene.lay_cable(Cable(EA), [(0.0, 4.3), (10.0, 6.1)], measured_on=where).L0
        for where in ("facets", "surface")
    ]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-14)


def test_free_spans_and_anchors_are_straight(comm) -> None:
    """Of a cable from an anchor high over the dome only the part that touches it is longer."""
    scene = dome(comm, 3.0)
    path = [(-25.0, 0.0, 10.0), (0.0, 0.0, 10.0), (25.0, 0.0, 10.0)]
    facets, surface = (
        scene.lay_cable(Cable(EA), path, measured_on=where) for where in ("facets", "surface")
    )
    assert 0.0 <= surface.L0 - facets.length < 0.01


@pytest.mark.ranks
def test_laid_again_in_its_fold(comm) -> None:
    """A line of a cable that comes back as a path is as long as it is: it is where it is."""
    scene = dome(comm, 3.0)
    cable = over(scene)
    Solver(scene).advance(pressure=0.4)
    line, length = cable.line, cable.length
    again = scene.lay_cable(Cable(EA), line)
    assert again.L0 == pytest.approx(length, rel=1e-9)


def test_laid_again_before_there_is_a_fold(comm) -> None:
    """A second cable along the line of one that has just been laid is as long as that."""
    for scene in (dome(comm, 3.0), dome(comm, 2.0)):
        first = over(scene)
        second = scene.lay_cable(Cable(EA), first.line)
        assert second.L0 == pytest.approx(first.L0, rel=1e-12)
        assert second.length == pytest.approx(first.length, rel=1e-12)


def test_the_papers_law_knows_the_facets(comm) -> None:
    scene = dome(comm, 3.0)
    cable = scene.lay_cable(
        Cable(EA, law="step"), nets.great_circle(RADIUS, HEIGHT, 0.3, 0.0), tension=5.0
    )
    assert cable.tension == pytest.approx(5.0, rel=1e-9)
    assert cable.L0 * (1 + 5.0 / EA) == pytest.approx(cable.length, rel=1e-13)


def test_unknown_ways_to_measure(comm) -> None:
    scene = dome(comm, 5.0)
    with pytest.raises(InputError, match=r"measured_on = 'chords' is not known; use 'surface'"):
        over(scene, measured_on="chords")


SPHERE = 25.0
CIRCLE = nets.great_circle(RADIUS, HEIGHT, 0.3, 9.0)


def off_circle(cable) -> float:
    """The largest distance of a cable's points from the plane of the great circle."""
    centre = np.array([0.0, 0.0, HEIGHT - SPHERE])
    ends = np.column_stack([CIRCLE[[0, -1]], [0.0, 0.0]]) - centre
    normal = np.cross(*ends) / np.linalg.norm(np.cross(*ends))
    return float(np.abs((cable.state.positions - centre) @ normal).max())


@pytest.mark.ranks
def test_great_circle(comm) -> None:
    """It converges to the great circle from a path 4.3 m beside it, and its length to that."""
    start, end = np.column_stack([CIRCLE[[0, -1]], 2 * [SPHERE - HEIGHT]])
    arc = SPHERE * np.arccos(start @ end / SPHERE**2)
    for size, beside, rtol in ((3.0, 0.2, 2e-3), (1.5, 0.1, 5e-4)):
        scene = dome(comm, size)
        straight = scene.lay_cable(Cable(EA=30e3), CIRCLE[[0, -1]])
        cable = scene.lay_cable(Cable(EA=30e3), CIRCLE[[0, -1]], shortest=True)
        assert off_circle(straight) > 4.0 and straight.L0 > 1.02 * arc
        assert off_circle(cable) < beside
        assert cable.L0 == pytest.approx(arc, rel=rtol)
        assert_allclose(cable.state.positions[[0, -1]], straight.state.positions[[0, -1]])


def test_bears_as_one_along_the_circle(comm) -> None:
    """A cable just taut on the straight path slides to the circle, on which it is too long."""
    tensions = {}
    for name, path, shortest in (
        ("circle", CIRCLE, False),
        ("shortest", CIRCLE[[0, -1]], True),
        ("straight", CIRCLE[[0, -1]], False),
    ):
        scene = dome(comm, 3.0)
        cable = scene.lay_cable(Cable(EA=30e3), path, shortest=shortest)
        Solver(scene).advance(pressure=0.4)
        tensions[name] = cable.tension
    assert tensions["shortest"] == pytest.approx(tensions["circle"], rel=0.05)
    assert tensions["straight"] == 0.0


def test_anchors_stay(comm) -> None:
    """What is pulled taut is the part on the membrane."""
    scene = dome(comm, 3.0)
    path = [(-15.0, 10.0, 12.0), (15.0, 10.0, 12.0)]
    cable = scene.lay_cable(Cable(EA=30e3), path, shortest=True)
    assert_allclose(cable.state.positions[[0, -1]], path)
    assert cable.length <= scene.lay_cable(Cable(EA=30e3), path).length
