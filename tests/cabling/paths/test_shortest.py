"""Cables laid along the shortest way between two places, against great circles of a sphere."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from dome import HEIGHT, RADIUS
from dome import dome as cap

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, nets

pytestmark = pytest.mark.usefixtures("comm")
SPHERE = 25.0
CIRCLE = nets.great_circle(RADIUS, HEIGHT, 0.3, 9.0)


def dome(comm, size: float) -> Scene:
    """A cap on which a straight path in plan is longer than the great circle."""
    return clamped(cap(comm, size), IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))


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
        np.testing.assert_allclose(
            cable.state.positions[[0, -1]], straight.state.positions[[0, -1]]
        )


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
    np.testing.assert_allclose(cable.state.positions[[0, -1]], path)
    assert cable.length <= scene.lay_cable(Cable(EA=30e3), path).length
