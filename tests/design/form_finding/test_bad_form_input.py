"""Bad input is refused on all ranks, before anything is computed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bad_calls import NO_GROUPS, functions
from bad_values import NAN, NO_NUMBERS, NO_VECTORS, NOT_POSITIVE
from form_meshes import CORNERS, SIDES
from mpi4py import MPI

from crms_fenicsx import InputError, meshes
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.design.form_finding.form_search import FormSearch
from crms_fenicsx.foundation.meshes import MembraneMesh


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may be solved."""

    def run(*arguments: object) -> None:
        raise AssertionError("a search was begun")

    monkeypatch.setattr(FormSearch, "run", run)


@pytest.fixture
def mesh(comm: MPI.Intracomm) -> MembraneMesh:
    return meshes.rectangle(comm, 2.0, 2.0, 1.0, structured=True)


@pytest.mark.parametrize("name", ["tension", "force_density", "length"])
def test_cables(name: str) -> None:
    for value in NOT_POSITIVE:
        with pytest.raises(InputError, match=name):
            FormCable("front", **{name: value})
    with pytest.raises(InputError, match="nothing prescribed"):
        FormCable("front")
    other = {"length": "tension", "tension": "force_density", "force_density": "length"}[name]
    with pytest.raises(InputError, match=r" and .* prescribed; expected one of"):
        FormCable("front", **{name: 1.0, other: 2.0})


def test_arguments(comm: MPI.Intracomm, mesh: MembraneMesh, idle: None) -> None:
    """One bad value at a time."""
    good: dict[str, Any] = {"mesh": mesh, "stress": 2.0, "fixed": ["boundary"]}
    stresses = [value for value in NOT_POSITIVE if not np.iterable(value)]
    pairs = [(1.0,), (1.0, 2.0, 3.0), (1.0, -2.0), (NAN, 1.0), "ab"]
    lifts: list[Any] = [*NO_VECTORS]
    lifts += functions(comm, lambda x: 0 * x, [lambda x: x[:2], lambda x: NAN * x])
    bad: dict[str, Any] = {
        "mesh": [None, 3, mesh.mesh],
        "stress": [*stresses, *pairs, {}, {"roof": 1.0}, None],
        "fixed": [*NO_GROUPS, [], {}, [3], {"left": "w"}, {"left": ""}, {"left": 3}, ["left", "x"]],
        "lifted": [3, "left", ["left"], {"x": (0, 0, 0)}, *({"boundary": v} for v in lifts)],
        "cables": [3, "front", ["front"], [None], [FormCable("x", tension=1.0)]],
        "warp": [*NO_VECTORS, (0.0, 0.0, 0.0), {"roof": (1.0, 0.0, 0.0)}],
        "pressure": NO_NUMBERS, "volume": NOT_POSITIVE, "rise": NOT_POSITIVE,
        "prefix": [3, NAN, ["a"], "-crms_"],
    }  # fmt: skip
    for name, values in bad.items():
        for value in values:
            with pytest.raises(InputError):
                find_form(**{**good, name: value})
            if name != "mesh" and comm.size > 1:  # on one rank alone
                one = value if comm.rank == comm.size - 1 else good.get(name)
                with pytest.raises(InputError):
                    find_form(**{**good, name: one})
    for two in ({"pressure": 1.0, "rise": 1.0}, {"volume": 1.0, "rise": 1.0}):
        with pytest.raises(InputError, match="expected one of pressure, volume, rise"):
            find_form(**good, **two)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"fixed": CORNERS}, "8 edges at the rim are neither held nor supported"),
        ({"fixed": [*SIDES[:3]]}, "2 edges at the rim"),
        ({"fixed": [*CORNERS, *SIDES[:3]], "rise": 1.0,
          "cables": [FormCable("left", tension=9.0)]}, "pressure, but the rim is not held"),
        ({"fixed": {"boundary": "z"}}, "holds nothing along xy"),
        ({"fixed": {"boundary": "xy", "left": "xyz"}, "lifted": {"boundary": (0, 0, 1.0)}},
         "not held in that direction"),
        ({"lifted": {"left": (0, 0, 1.0), "front": (0, 0, 2.0)}}, "another group moves elsewhere"),
        ({"stress": (1.0, 2.0), "warp": (0.0, 0.0, 1.0)}, "normal to the start mesh"),
        ({"cables": [FormCable("boundary", tension=1.0)]}, "boundary.* is closed"),
        ({"cables": [FormCable("left", tension=1.0)] * 2}, "edges of another cable"),
    ],
)  # fmt: skip
def test_what_does_not_fit(mesh: MembraneMesh, idle: None, given: Any, match: str) -> None:
    with pytest.raises(InputError, match=match):
        find_form(mesh, **{"stress": 2.0, "fixed": ["boundary"], **given})


def test_parts_without_stress(comm: MPI.Intracomm, idle: None) -> None:
    points = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    mesh = meshes.from_arrays(
        comm, points, [(0, 1, 2), (0, 2, 3)], parts={"one": [0], "two": [1], "same": [0]}
    )
    for stress, match in (
        ({"one": 1.0}, "1 cells are in none of the parts"),
        ({"one": 1.0, "same": 2.0}, "shares cells with part"),
        ({"one": 1.0, "roof": 1.0}, "no part 'roof'"),
    ):
        with pytest.raises(InputError, match=match):
            find_form(mesh, stress, fixed=["boundary"])
    with pytest.raises(InputError, match="warp is given for 'one', but stress for"):
        find_form(mesh, {"one": 1.0, "two": 1.0}, fixed=["boundary"], warp={"one": (1.0, 0.0, 0.0)})
