"""The record of a scene: every argument of every call that makes it is in it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from cabled_square import clamped
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    EnergyTerm,
    Friction,
    InputError,
    OrthotropicMembrane,
    Scene,
    Solver,
    UflMembrane,
    meshes,
    nets,
)
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.checkpoint.journal import difference, scene_record


class Springs(EnergyTerm):
    """Springs to the ground from a lowered position."""

    name = "springs"

    def __init__(self, k: float) -> None:
        self.k = k

    def sums(self, x: Array, out: Array) -> None:
        own = x[: self.unknowns.n_vertices] + 1.0
        out[0] = self.k / 2 * np.vdot(own, own)

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        n = self.unknowns.n_vertices
        g[:n] += self.k * (x[:n] + 1.0)


def elastic(stiffness: float) -> Callable[[Any], Any]:
    return lambda E: stiffness * ufl.inner(E, E)


def turned(angle: float) -> Callable[[Array], Array]:
    """A warp that turns along x."""
    return lambda x: np.array([np.cos(angle + 0.1 * x[0]), np.sin(angle + 0.1 * x[0]), 0 * x[0]])


FABRIC: dict[str, Any] = {"E1": 300.0, "E2": 200.0, "G12": 20.0, "nu21": 0.1, "thickness": 0.1}
ROUTE = [(0.0, 3.3), (10.0, 4.2)]


def sheet(material: Any = None, **options: Any) -> Scene:
    """A square of two parts."""
    points = [(x, y) for y in (0.0, 5.0, 10.0) for x in (0.0, 5.0, 10.0)]
    cells = [(k, k + 1, k + 4) for k in (0, 1, 3, 4)] + [(k, k + 4, k + 3) for k in (0, 1, 3, 4)]
    parts = {"front": [0, 1, 4, 5], "back": [2, 3, 6, 7]}
    edges = {"left": [(0, 3), (3, 6)], "right": [(2, 5), (5, 8)]}
    mesh = meshes.from_arrays(MPI.COMM_SELF, points, cells, parts=parts, edges=edges)
    return Scene(mesh, material or OrthotropicMembrane(**FABRIC, wrinkling=False), **options)


def lined(*names: str) -> Scene:
    """A sheet with one line across others."""
    ways = [ROUTE, [(3.1, 0.0), (3.2, 10.0)], [(6.1, 0.0), (6.2, 10.0)]]
    lines = dict(zip(names, ways, strict=False))
    mesh = meshes.rectangle(MPI.COMM_SELF, 10.0, 10.0, 1.0, lines=lines)
    return clamped(mesh, OrthotropicMembrane(**FABRIC))


def crossed() -> Scene:
    """A sheet with two cables across another, along its lines."""
    scene = lined("a", "b", "c")
    for name in "abc":
        scene.lay_cable(Cable(50.0), along=name, tension=1.0)
    return scene


def held() -> Scene:
    scene = sheet()
    scene.fix("boundary")
    return scene


def mast(**bar: Any) -> Scene:
    scene = sheet()
    top = scene.add_joint((12.0, 0.0, 5.0), name="top", held="xy")
    scene.add_bar(Bar(**({"EA": 100.0} | bar)), (12.0, 0.0, 0.0), top, name="mast")
    return scene


def roped(cables: str = "a", **given: Any) -> Scene:
    scene = crossed()
    laid = [scene.cable(name) for name in cables]
    return after(scene, "put_cable_load", **{"force": (0, 0, 1.0), "cables": laid} | given)


def after(scene: Scene, call: str, *arguments: Any, **given: Any) -> Scene:
    """The scene after a call of one of its methods."""
    getattr(scene, call)(*arguments, **given)
    return scene


def with_bar(start: Any = (12.0, 0.0, 0.0), end: Any = None, **given: Any) -> Scene:
    scene = sheet()
    top = scene.add_joint((12.0, 0.0, 5.0), name="top", held="xy")
    scene.add_bar(Bar(EA=9.0), start, top if end is None else end, **given)
    return scene


def netted(net: Any = ROUTE, cable: Any = 9.0, on: Scene | None = None, **given: Any) -> Scene:
    scene = held() if on is None else on
    families = [[np.array(net)], [np.array([(3.1, 0.0), (3.2, 10.0)])]]
    scene.lay_net(nets.from_paths(scene, families), Cable(cable), **{"tension": 1.0, **given})
    return scene


def forced(forces: float = 1.0, **given: Any) -> Scene:
    scene = sheet()
    found = fem.Function(scene.V)
    found.interpolate(lambda x: np.array([0 * x[0], 0 * x[0], forces * x[0]]))
    return after(scene, "put_forces", found, **given)


def joint_load(forces: float = 1.0, **given: Any) -> Scene:
    scene = mast()
    return after(scene, "put_joint_load", {scene.joint("top"): (0, 0, forces)}, **given)


def removed(call: str, name: str | None = None) -> Scene:
    scene = mast()
    scene.fix("boundary")
    scene.lay_cable(Cable(50.0), ROUTE, name="c")
    scene.put_line_load((0, 0, 1.0), "left")
    return scene if name is None else after(scene, call, name)


def stiffer(EA: float = 50.0) -> Scene:
    scene = crossed()
    return after(scene, "set_stiffness", {scene.cable("a"): EA})


def unclamped(cables: Any = None, near: Any = None) -> Scene:
    scene = crossed()
    scene.clamp("a", "b")
    scene.clamp("a", "c")
    return scene if cables is None else after(scene, "unclamp", *cables, near=near)


def ponded(**given: Any) -> Scene:
    given = {"weight": 10.0, "level": -1.0} | given
    if "volume" in given:
        del given["level"]
    return after(sheet(), "put_pond", **given)


def laid(cable: Cable | None = None, **given: Any) -> Scene:
    scene = held()
    scene.lay_cable(cable or Cable(50.0), **({"path": ROUTE} | given))
    return scene


def roof() -> Scene:
    """A sheet whose middle is raised in its stress-free shape."""
    points = [(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0), (5, 5, 3)]
    cells = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    mesh = meshes.from_arrays(MPI.COMM_SELF, points, cells)
    return clamped(mesh, OrthotropicMembrane(**FABRIC, wrinkling=False))


def raised(**given: Any) -> Scene:
    dome = meshes.spherical_cap(MPI.COMM_SELF, 10.0, 4.0, 2.0)
    scene = clamped(dome, OrthotropicMembrane(**FABRIC))
    scene.lay_cable(Cable(50.0), [(-8.0, 0.0), (8.0, 0.3)], hold="sleeve", **given)
    return scene


def raised_load(**given: Any) -> Scene:
    return after(roof(), "put_load", (0, 0, -1.0), **given)


CALLS: dict[str, tuple[Callable[..., Scene], dict[str, Any]]] = {
    "Scene": (sheet, {
        "material": {"front": OrthotropicMembrane(**FABRIC), "back": UflMembrane(elastic(20.0))},
        "strain": "step", "pressure": "lagged", "pressure_on": ["front"], "penalty": 0.2,
        "literal_penalty": 1.0, "frames": np.array([[(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)]] * 8),
    }),
    "OrthotropicMembrane": (
        lambda **new: sheet(OrthotropicMembrane(**FABRIC | {"warp": turned(0.0)} | new)),
        {
            "E1": 301.0, "E2": 201.0, "G12": 21.0, "nu21": 0.11, "thickness": 0.11,
            "warp": turned(0.4), "prestress": (0.5, 1.0), "wrinkling": False,
            "expansion": (1e-5, 2e-5), "dT": 1.0,
        },
    ),
    "UflMembrane": (
        lambda **new: sheet(UflMembrane(**{"psi": elastic(20.0), "warp": turned(0.0)} | new)),
        {"psi": elastic(21.0), "warp": turned(0.4)},
    ),
    "Cable": (
        lambda **new: laid(Cable(**{"EA": 50.0} | new)),
        {"EA": 51.0, "law": "step", "friction": 0.1, "expansion": 1e-5},
    ),
    "Cable, on a line": (
        lambda **new: laid(Cable(50.0, **new), path=None, along="left", hold="pocket"),
        {"diameter": 0.02},
    ),
    "Friction": (
        lambda **new: laid(Cable(50.0, friction=Friction(**{"mu": 0.1} | new))),
        {"mu": 0.2, "static": 0.3, "along": 0.1, "law": "step", "tolerance": 0.004},
    ),
    "Friction along": (
        lambda **new: laid(Cable(50.0, friction=Friction(**{"mu": 0.1, "along": 0.1} | new))),
        {"cone": True},
    ),
    "Bar, in compression": (
        lambda **new: mast(**{"strength": 8.0, "curve": 0.5} | new), {"curve": 0.6}
    ),
    "Bar": (mast, {
        "EA": 101.0, "tension_only": True, "EI": 5.0, "strength": 9.0, "gamma_M": 1.1,
        "buckling_length": 3.0, "expansion": 1e-5, "section": "CHS 60.3x4",
    }),
    "lay_cable": (laid, {
        "cable": Cable(51.0), "path": [(0, 3.3), (10, 4.3)], "L0": 9.9, "tension": 2.0,
        "hold": "sleeve", "layer": 1, "name": "A",
    }),
    "lay_cable, on a line": (
        lambda along="left": laid(path=None, along=along, hold="pocket", name="c"),
        {"along": "right"},
    ),
    "lay_cable, bent": (
        lambda **new: laid(path=[(0, 3.3), (4.0, 6.0), (10, 4.2)], **new), {"shortest": True}
    ),
    "lay_cable, raised": (
        lambda **new: raised(**new), {"measured_on": "facets"}
    ),
    "clamp": (
        lambda cables="ab", **new: after(crossed(), "clamp", *cables, **new),
        {"cables": "ac", "slip": 3.0},
    ),
    "clamp, three": (
        lambda **new: after(crossed(), "clamp", *"abc", **new), {"near": [(3.1, 3.6, 0.0)]}
    ),
    "unclamp": (unclamped, {"cables": "ab"}),
    "unclamp, three": (
        lambda near=None: unclamped("abc", near), {"near": [(3.1, 3.6, 0.0)]}
    ),
    "lay_net": (netted, {
        "net": [(0.0, 3.3), (10.0, 4.3)], "cable": 10.0, "tension": 2.0, "hold": "sleeve",
    }),
    "lay_net, on lines": (lambda **new: netted(on=lined("A1", "B1"), **new), {"clamped": True}),
    "fix": (
        lambda **new: after(sheet(), "fix", **{"where": "boundary"} | new),
        {"where": "left", "directions": "z"},
    ),
    "release": (
        lambda **new: after(
            after(sheet(), "fix", where="boundary"), "release", **{"where": "left"} | new
        ),
        {"where": "right", "directions": "z"},
    ),
    "floor": (lambda **new: after(sheet(), "floor", **{"z": -1.0} | new), {"z": -2.0}),
    "add_term": (lambda term=1.0: after(sheet(), "add_term", Springs(term)), {"term": 2.0}),
    "put_load": (
        lambda **new: after(sheet(), "put_load", **{"force": (0, 0, -1.0)} | new),
        {"force": lambda x, n: np.array([0 * x[0], 0 * x[0], -x[0] / 5]), "name": "snow"},
    ),
    "put_load, on a slope": (lambda **new: raised_load(**new), {"per": "plan"}),
    "put_wind": (
        lambda **new: after(sheet(), "put_wind", **{"pressure": 1.0, "coefficient": -0.5} | new),
        {"pressure": 2.0, "coefficient": {"front": -0.5, "back": 0.4}, "name": "storm"},
    ),
    "put_forces": (forced, {"forces": 1.01, "name": "more"}),
    "put_line_load": (
        lambda **new: after(
            sheet(), "put_line_load", **{"force": (0, 0, 1.0), "edges": "left"} | new
        ),
        {"force": (0, 0, 2.0), "edges": "right", "name": "parapet"},
    ),
    "put_cable_load": (roped, {"force": (0, 0, 2.0), "cables": "ab", "name": "ice"}),
    "put_temperature": (
        lambda **new: after(sheet(), "put_temperature", **{"change": 30.0} | new),
        {"change": {"fabric": 20.0}, "name": "temperature winter", "reference": 10.0},
    ),
    "put_joint_load": (joint_load, {"forces": 2.0, "name": "sign"}),
    "put_pond": (
        ponded, {"weight": 11.0, "level": -1.1, "volume": 0.5, "on": ["front"], "name": "lake"}
    ),
    "remove": (lambda cable=None: removed("remove", cable), {"cable": "c"}),
    "remove_bar": (lambda bar=None: removed("remove_bar", bar), {"bar": "mast"}),
    "remove_load": (lambda name=None: removed("remove_load", name), {"name": "line load"}),
    "add_joint": (
        lambda **new: after(sheet(), "add_joint", **{"position": (12.0, 0.0, 5.0)} | new),
        {"position": (12.0, 0.0, 5.1), "name": "tip", "held": "y"},
    ),
    "add_bar": (
        with_bar, {"start": (12.0, 0.1, 0.0), "end": (9.0, 0.0, 1.0), "L0": 5.2, "name": "post"}
    ),
    "seal": (
        lambda **new: after(held(), "seal", **{"volume": 50.0} | new),
        {"volume": 51.0, "atmosphere": 100.0, "exponent": 1.4},
    ),
    "set_material": (
        lambda material=300.0: after(
            sheet(), "set_material",
            OrthotropicMembrane(**FABRIC | {"E1": material}, wrinkling=False),
        ),
        {"material": 310.0},
    ),
    "set_stiffness": (stiffer, {"EA": 120.0}),
}  # fmt: skip
"""How a scene is made by a call, and what each of its arguments is changed to."""
ELSEWHERE = {"Scene": {"mesh"}, "add_bar": {"bar"}}
"""Arguments that other rows, or other tests, change."""
NO_CHANGE = {
    "bar", "cable", "joint", "load", "in_equilibrium", "positions", "record", "require_equilibrium",
    "set_limits", "vertex_at", "vertices", "set_strengths", "unseal",
}  # fmt: skip
"""Methods of a scene that do not change its equilibrium, and one without arguments."""


@pytest.mark.parametrize(
    ("call", "argument"), [(call, name) for call, (_, new) in CALLS.items() for name in new]
)
def test_a_changed_argument_is_found(call: str, argument: str) -> None:
    build, new = CALLS[call]
    before, same = scene_record(build()), scene_record(build())
    assert difference(before, same) is None
    assert difference(before, scene_record(build(**{argument: new[argument]}))) is not None


def test_every_argument_is_changed() -> None:
    """Of the classes that make a scene, and of its methods."""
    found: dict[str, set[str]] = {}
    for call, (_, new) in CALLS.items():
        found.setdefault(call.partition(",")[0].removesuffix(" along"), set()).update(new)
    kinds = {one.__name__: one for one in (OrthotropicMembrane, UflMembrane, Cable, Friction, Bar)}
    due = {name: {one.name for one in fields(kind)} for name, kind in kinds.items()}
    methods = {"Scene": Scene.__init__} | {
        name: method for name, method in inspect.getmembers(Scene, inspect.isfunction)
        if name[0] != "_" and name not in NO_CHANGE
    }  # fmt: skip
    for name, method in methods.items():
        due[name] = {*inspect.signature(method).parameters} - {"self"} - ELSEWHERE.get(name, set())
    assert found == due


def test_moved_groups_and_options_are_found(tmp_path: Path) -> None:
    """A part with other cells under the same name, and each option that is no file."""
    records = []
    for cells in ([0, 1], [0, 2]):
        points, triangles = [(0, 0), (1, 0), (1, 1), (0, 1)], [(0, 1, 2), (0, 2, 3)]
        parts = {"roof": cells[:1], "wall": [1]} if cells[1] == 1 else {"roof": [1], "wall": [0]}
        mesh = meshes.from_arrays(MPI.COMM_SELF, points, triangles, parts=parts)
        records.append(scene_record(Scene(mesh, OrthotropicMembrane(**FABRIC))))
    assert "groups" in str(difference(*records))
    Solver(held(), results=tmp_path, resume=False).advance(pressure=0.01)
    for option in (
        {"rtol": 1e-8}, {"max_halvings": 3}, {"slide": False}, {"verify": False},
        {"stability": "ignore"}, {"prefix": "other_"}, {"estimate": True},
    ):  # fmt: skip
        solver = Solver(held(), results=tmp_path, resume=True, **option)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=f"solver, {next(iter(option))} = "):
            solver.advance(pressure=0.01)
        del solver
