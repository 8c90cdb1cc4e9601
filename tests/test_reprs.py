"""What a notebook or a prompt shows of an object: a line, or a small table."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
from cabled_square import CABLE, advanced, sheet
from mpi4py import MPI

from crms_fenicsx import Bar, InputError, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.foundation.runtime.checks import counted, span

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD
NUMBER = r"-?[\d.]+(e[+-]\d+)?"
LINE = 250
"""Most characters of a line."""


@cache
def solved() -> Solver:
    """A square that air and snow load, with a cable, and a bar beside it."""
    scene = sheet(COMM, 5)
    scene.put_load((0.0, 0.0, -1e-4), name="snow")
    scene.lay_cable(CABLE, [(0.0, 45.0), (100.0, 52.0)], name="ridge", L0=99.5)
    top = scene.add_joint((0.0, 0.0, 80.0), name="top", held="xyz")
    scene.add_bar(Bar(EA=1.0), (0.0, 0.0, 90.0), top, name="rod")
    return advanced(Solver(scene), pressure=0.01, load={"snow": 1.0})


def form() -> Any:
    return find_form(meshes.rectangle(COMM, 4.0, 4.0, 1.0), stress=2.0, fixed=["boundary"])


SHOWN: dict[str, tuple[Callable[[], Any], str]] = {
    "new scene": (lambda: sheet(COMM, 2), r"Scene\(8 cells; pressure 0\)"),
    "scene": (
        lambda: solved().scene,
        rf"Scene\(50 cells; pressure 0.01, snow 1; 1 cable, tension {NUMBER}; 1 bar, force 0\)",
    ),
    "mesh": (
        lambda: solved().scene.mesh,
        r"MembraneMesh\(50 cells, 36 vertices; edges boundary[a-z, ]*; points [a-z, ]*\)",
    ),
    "cable": (
        lambda: solved().scene.cables[0],
        rf"LaidCable\('ridge', \d+ points, tension {NUMBER}\)",
    ),
    "solver": (solved, r"Solver\(1 load step; Scene\(50 cells; .*\)\)"),
    "step": (
        lambda: solved().steps[0],
        rf"Step\(1: energy {NUMBER}, \d+ iterations?, {NUMBER} s, verified\)",
    ),
    "outcome": (
        lambda: solved().steps[0].outcome,
        rf"Outcome\(converged, residual {NUMBER} for {NUMBER}, \d+ iterations?, .*\)",
    ),
    "results": (
        lambda: solved().results(),
        r"MembraneResults\(\d+ cells?, true force 1 .*, true force 2 .*, \d+ slack, .* taut\)",
    ),
    "places": (
        lambda: solved().results().at([(30.0, 40.0), (50.0, 50.0)]),
        rf"PlaceResults\(2 places: true force 1 {NUMBER} to {NUMBER}, true force 2 .*\)",
    ),
    "reactions": (
        lambda: solved().reactions("boundary"),
        r"Reactions\(total \(.*, .*, -.*\), vertices of this rank: \d+\)",
    ),
    "contact": (
        lambda: solved().contact_forces(solved().scene.cables[0]),
        rf"ContactForces\(\d+ points, {NUMBER} to {NUMBER} per length\)",
    ),
    "cable results": (
        lambda: solved().cable_forces()["ridge"],
        rf"CableResults\('ridge', tension {NUMBER}, length {NUMBER}, contact up to .*\)",
    ),
    "error": (
        lambda: solved().estimate_error(),
        rf"ErrorEstimate\(total {NUMBER}, relative {NUMBER}\)",
    ),
    "snapshot": (
        lambda: solved().snapshot(),
        rf"SceneState\(energy {NUMBER}; 1 cable, tension {NUMBER}\)",
    ),
    "history": (lambda: solved().history, r"History\(1 row; step, halvings, .*seconds\)"),
    "form": (form, rf"FoundForm\(area 16; deviation {NUMBER}; disturbance {NUMBER}\)"),
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", SHOWN)
def test_a_line_says_the_essentials(name: str) -> None:
    make, pattern = SHOWN[name]
    text = repr(make())
    assert re.fullmatch(pattern, text), text
    assert len(text) < LINE or name == "history"


def test_tables() -> None:
    verification, summary = solved().steps[0].verification, solved().summary()
    assert repr(verification) == str(verification)
    assert repr(verification).startswith("verified\n  ")
    rows = repr(summary).splitlines()
    assert max(map(len, rows)) < 120
    words = ("load .*snow +1", "pressure", "energy", "displacement", "membrane", "cable +ridge",
             "bar +rod +force 0", "support +boundary +total")  # fmt: skip
    for word in words:
        assert any(re.match(word, row) for row in rows), (word, rows)


def test_a_history_is_a_table_in_a_notebook() -> None:
    history = solved().history
    html = history._repr_html_()
    assert html.count("<tr>") == 1 + len(history)
    assert html.count("<th>") == html.count("<td>") == len(history.columns)
    assert f"<td>{history['tension ridge'][0]:.5g}</td>" in html


def test_ranges_and_numbers() -> None:
    assert [span([]), span([float("nan")]), span([2.0]), span([3.0, 1.0])] == [
        "none", "none", "2", "1 to 3",
    ]  # fmt: skip
    assert (counted(1, "bar"), counted(0, "bar")) == ("1 bar", "0 bars")


@pytest.mark.ranks
def test_errors_are_short() -> None:
    """No other error before it, and few calls of the package between it and who made it."""
    scene: Scene = sheet(COMM, 2)
    solver = Solver(scene)
    scene.put_load((0.0, 0.0, -1.0), name="snow")
    for call in (
        lambda: solver.advance(pressure="much"),  # type: ignore[arg-type]
        lambda: solver.combine({"a": {"wind": 1.0}}),
        lambda: scene.fix("rim"),
        lambda: scene.floor(5.0),
        lambda: solver.draw("picture.doc"),
    ):
        with pytest.raises(InputError) as told:
            call()
        error = told.value
        assert error.__cause__ is None
        assert error.__context__ is None or error.__suppress_context__
        seen = [
            frame for frame, _ in traceback.walk_tb(error.__traceback__)
            if "__tracebackhide__" not in frame.f_locals
        ]  # fmt: skip
        assert len(seen) <= 9, [frame.f_code.co_qualname for frame in seen]
        assert len(str(error)) < LINE
