"""A few of the random scenes of benchmarks/fuzz.py, and of hypothesis' own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fuzzing import feature_scenes, runs, scenes, twins
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.arrays import Array, Integers

KNOWN = (
    1,  # a slack cable whose points were not where it said
    110,  # tensions of 1e4 where the membrane's forces are of size 1
    182,  # a slack cable that touches down next to a vertex
    620,  # friction along a cable that ends on a held vertex
    1310,  # and the vertex moves off the cable's end
    659,  # friction forces that go round in circles
    4136,  # a node that begins to hold a cable between two passes
    1978,  # a cable with friction along the boundary that is led past a vertex of it
)

FOUND = (
    45,  # a cap that nothing loads, which a strong cable pulls slack
    208,  # a cap that nothing loads, whose forces fade together
    122,  # a cable so strong that it bends the edges that it crosses
    390,  # friction forces far below those of another cable
    412,  # as 122, without friction
)


class Drawn:
    """Choices that hypothesis makes, and shrinks."""

    def __init__(self, data: st.DataObject) -> None:
        self.data = data

    def integer(self, low: int, high: int) -> int:
        """A number from low to high."""
        return self.data.draw(st.integers(low, high))

    def real(self, low: float, high: float) -> float:
        """A number between low and high."""
        return self.data.draw(st.floats(low, high))


@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.slow] * (n == 659)) for n in KNOWN]
)
def test_scenes_that_have_failed(number: int) -> None:
    """Each for a reason of its own."""
    result = runs.run(scenes.scene(number))
    assert result.outcome != "failed", result.problems


@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.slow] * (n in (45, 122))) for n in FOUND]
)
def test_scenes_that_were_refused(number: int) -> None:
    """Each for a reason of its own."""
    result = runs.run(replace(scenes.scene(number), twins=()))
    assert result.outcome == "converged", result.text or result.problems


@settings(
    max_examples=12,
    derandomize=True,
    deadline=None,
    database=None,
    phases=[Phase.generate, Phase.shrink],
    suppress_health_check=list(HealthCheck),
)
@given(st.data())
def test_random_scenes(data: st.DataObject) -> None:
    """They converge or are refused, with all that is checked of their answers."""
    result = runs.run(scenes.drawn(Drawn(data)))
    assert result.outcome != "failed", result.problems


@pytest.mark.parametrize("kind", ["turned", "mirrored", "renumbered", "units"])
def test_twins_are_the_same_scene(kind: str) -> None:
    """What a twin changes it changes everywhere; its answer is the same."""
    data = scenes.scene(5)
    found = twins.variant(kind, data)
    assert found is not None and found[0].points.shape == data.points.shape

    def area(points: Array, cells: Integers) -> float:
        a, b, c = points[cells].transpose(1, 0, 2)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    other, frame = found
    whole = area(frame.place(other.points), other.cells)
    assert whole == pytest.approx(area(data.points, data.cells) * frame.unit**2)
    result = runs.run(replace(data, twins=(kind,)))
    assert result.outcome == "converged" and not result.notes, result


def test_a_scene_follows_from_its_number() -> None:
    """So that what fails can be run again."""
    a, b = scenes.scene(77), scenes.scene(77)
    assert np.array_equal(a.points, b.points) and repr(a.events) == repr(b.events)


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (545, "turned"),
        (537, "branch"),
        (528, "load"),
        (1000, "stopped"),
        (1012, "resume"),
    ],
)
def test_scenes_of_many_features(number: int, kind: str) -> None:
    """Bars, air, water, loads, cables and load cases at once, and a twin with the same answer."""
    data = replace(feature_scenes.feature_scene(number), twins=(kind,))
    result = runs.run(data, MPI.COMM_SELF)
    assert result.outcome == "converged", (result.text, result.problems)
    assert len(result.answers) > len(data.events)


def test_wind_on_a_cable_with_friction_along_it_ends() -> None:
    """Near the limit of its tension the cable is not let go at the start of each solve."""
    data = replace(feature_scenes.feature_scene(289), twins=("branch",))
    result = runs.run(data, MPI.COMM_SELF)
    assert result.outcome == "converged", (result.text, result.problems)
    assert [name for name, _ in data.events].count("advance") == 2
    assert sum("advance" in what for what, _ in result.answers) == 2
