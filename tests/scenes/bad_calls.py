"""All public calls, with good arguments and with bad values for each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bad_values import (
    INF,
    NAN,
    NO_NUMBERS,
    NO_PLACES,
    NO_TEXTS,
    NO_VECTORS,
    NOT_POSITIVE,
    UP,
    Values,
    bad_arguments,
)
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    Rotation,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.results.output import draw

FOIL = {"E": 300.0, "nu": 0.25, "thickness": 0.08}
FABRIC = {"E1": 1394.0, "E2": 140.0, "G12": 12.0, "nu21": 0.065, "thickness": 1.0}
ACROSS = [(0.0, 47.0), (100.0, 52.0)]
CORNERS = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
NO_SIZES: Values = (*NOT_POSITIVE, None, 1e300, 1e-300)
NO_GROUPS: Values = (*NO_TEXTS, np.array([1, 2]))
NO_PATHS: Values = (
    [], [(0.0, 47.0)], [(0.0, 47.0), (NAN, 52.0)], [(0.0, 47.0), (INF, 52.0)], "left", None, 7.0,
    [(0.0, 50.0), (0.0, 50.0)], [(0.0, 50.0), (90.0, 50.0, 0.0)], [(0.0, 1.0, 2.0, 3.0)] * 2, {},
    [(0.0, 50.0), (1e300, 50.0)], [(200.0, 47.0), (300.0, 52.0)], [("x", "y"), (1.0, 2.0)],
    [(-3.0, 50.0), (100.0, 50.0)], np.zeros((2, 2, 2)), np.zeros((0, 2)), object(),
    [(1j, 50.0), (100.0, 50.0)], [(0.0, 47.0), (50.0, 50.0, -9.0), (100.0, 52.0)],
)  # fmt: skip


def snapshot(scene: Scene) -> list[Any]:
    """All that a refused call must not have changed."""
    cables = [
        (c.name, c.L0, c.length, c.tension, c.taut, c.state.positions.tolist(), len(c.state.nodes))
        for c in scene.cables
    ]
    strip = None if scene.net.strip is None else len(scene.net.strip.cells)
    u = [repr(x) for x in scene.u.x.array.tolist()]  # NaN equals itself as text
    held = scene.held.tolist(), scene.membrane.held_edges.tolist()
    return [
        u,
        held,
        scene.pressure,
        scene.air.sealed,
        scene.ponds,
        scene.floor_level,
        cables,
        strip,
        scene.energies,
        scene.versions.current,
        [(joint.name, joint.position.tolist()) for joint in scene.joints],
        [(bar.name, bar.L0, bar.bar, bar.points.tolist()) for bar in scene.bars],
        ([cable.cable for cable in scene.cables], dict(scene.materials)),
        [(load.name, load.factor) for load in scene.loads],
    ]


def failing(x: object) -> None:
    """What a user's function may do; his error is passed on."""
    raise InputError("of the user's own")


NO_MARKERS: Sequence[Callable[[Any], Any]] = (
    failing, lambda x: None, lambda x: True, lambda x: x[0], lambda x: x > 0.0,
    lambda x: x[0, 1:] > 0.0, lambda x: "left", lambda x: np.array([]),
)  # fmt: skip
NO_FIELDS: Sequence[Callable[[Any], Any]] = (
    failing, lambda x: None, lambda x: np.full_like(x, NAN), lambda x: x[:2],
    lambda x: np.ones(4), lambda x: "up", lambda x: x[:, 1:], lambda x: np.full_like(x, INF),
    lambda x: x * 1j,
)  # fmt: skip


@dataclass
class Function:
    """A function of points that a user gives, bad on one rank or on all (`rank` None)."""

    good: Callable[[Any], Any]
    bad: Callable[[Any], Any]
    rank: int | None

    def __call__(self, x: Any, *normals: Any) -> Any:
        return (self.bad if self.rank in (None, MPI.COMM_WORLD.rank) else self.good)(x)

    def __repr__(self) -> str:
        return f"<function that is bad on rank {self.rank}>"


def functions(
    comm: MPI.Intracomm, good: Callable[[Any], Any], bad: Iterable[Callable[[Any], Any]]
) -> list[Function]:
    """Bad functions, on all ranks and on the last."""
    return [Function(good, one, rank) for one in bad for rank in (None, comm.size - 1)]


@dataclass
class Call:
    """A public call.

    Attributes
    ----------
    function
        What is called, by keywords.
    good
        Arguments that it takes; others have defaults.
    bad
        Values that it must refuse, by argument, besides those that its annotations refuse.
    together
        Whether the ranks compare their arguments, so that one alone may have a bad one.
    """

    name: str
    function: Callable[..., Any]
    good: dict[str, Any]
    bad: dict[str, Values]
    together: bool = True

    def __post_init__(self) -> None:
        for name, values in bad_arguments(self.function).items():
            if not hasattr(self.good.get(name), "comm"):  # without, a rank cannot tell the others
                self.bad[name] = (*values, *self.bad.get(name, ()))


def data() -> list[Call]:
    """What needs no mesh: cables and materials."""
    sheet = {"prestress": (*NO_NUMBERS[:4], -1.0, (1.0, 2.0, 3.0))}
    orthotropic = sheet | {"nu21": (9.0,), "warp": (*NO_VECTORS, (0.0, 0.0, 0.0))}
    rotation = {"point": (0.0, 0.0, 0.0), "axis": UP, "angle": 1.0}
    return [
        Call("Cable", Cable, {"EA": 1.0}, {"friction": (*NO_NUMBERS, -1.0, None)}, False),
        Call("Bar", Bar, {"EA": 1.0}, {"tension_only": (3, None, "x")}, False),
        Call("Rotation", Rotation, rotation, {}, False),
        Call("Friction", Friction, {"mu": 0.3}, {"static": (0.1,), "tolerance": (0.2,)}, False),
        Call("IsotropicMembrane", IsotropicMembrane, FOIL, {"nu": (1.0, -1.0), **sheet}, False),
        Call("OrthotropicMembrane", OrthotropicMembrane, FABRIC, orthotropic, False),
    ]


def generators(comm: MPI.Intracomm) -> list[Call]:
    """The meshes; rank 0 alone makes them and looks at their arguments."""
    more = {"refinements": (3, "x", [3], [None])}
    plane, centre = {"corner": NO_PLACES, **more}, {"center": NO_PLACES, **more}
    points = (*NO_PATHS[:7], [(0.0, NAN)] * 4, [("a", "b")] * 4)
    cells = (
        [], [(0, 1)], [(0, 1, 9)], [(0, 1, 1)], [(0, 1, -1)], "x", None, [(0.5, 1, 2)],
        [(0, 1, 2), (0, 1, 2)], {}, [(0, 1, NAN)], [("a", "b", "c")],
    )  # fmt: skip
    groups = (3, "x", {"a": "x"}, {"a": [99]}, {"a": [0.5]}, {3: [0]}, {"": [0]}, {"a": None})
    wanted: list[tuple[str, dict[str, Any], dict[str, Values]]] = [
        ("rectangle", {"width": 1.0, "depth": 1.0, "size": 0.5}, plane),
        ("ellipse", {"a": 1.0, "b": 1.0, "size": 0.5}, centre),
        ("circle", {"radius": 1.0, "size": 0.5}, centre),
        ("spherical_cap", {"radius": 1.0, "height": 0.5, "size": 0.3}, centre),
        ("air_hall", {"width": 1.0, "depth": 2.0, "height": 0.4, "size": 0.3}, plane),
        ("polygon", {"corners": CORNERS, "size": 0.5}, {"names": (["a"], 3, [1, 2, 3, 4]), **more}),
    ]
    found = []
    for name, good, bad in wanted:
        sizes = {key: NO_PATHS if key == "corners" else NO_SIZES for key in good}
        found.append(Call(f"meshes.{name}", getattr(meshes, name), good, sizes | bad, False))
    arrays = {"points": CORNERS, "cells": [(0, 1, 2), (0, 2, 3)]}
    # a mapping without parts is none of them: it leaves all upward
    sides = tuple(side for side in NO_VECTORS if not (isinstance(side, dict) and not side))
    sides = (*sides, (0.0, 0.0, 0.0), {"unknown": UP}, {3: UP})
    bad = {"points": points, "cells": cells, "outside": sides}
    bad |= {"parts": groups, "edges": groups, "point_groups": groups}
    found.append(Call("meshes.from_arrays", meshes.from_arrays, arrays, bad, False))
    files = {"path": ("nowhere.msh", "", 3, None, "/", __file__)}
    found.append(Call("meshes.from_file", meshes.from_file, {}, files, False))
    for call in found:
        call.good = {"comm": comm, **call.good}
    return found


def scenes(scene: Scene, other: Scene, solver: Solver, cable: LaidCable) -> list[Call]:
    """What is called on a scene with a cable, and on another one without, of the same mesh."""
    comm, foil = scene.comm, IsotropicMembrane(**FOIL)
    where = (*NO_GROUPS, *functions(comm, lambda x: x[0] < 1.0, NO_MARKERS))
    fields = functions(comm, lambda x: np.ones_like(x), NO_FIELDS)
    material = (None, "fabric", 3.0, {}, {"roof": foil}, {"roof": None}, [foil], Cable(1.0))
    moves = [{key: v} for key in ("left", cable, cable.start) for v in NO_VECTORS]
    moves += [{key: UP} for key in (3, "unknown", None, other)]
    moves += [
        {"left": Function(lambda x: 0 * x, bad, rank)}
        for bad in NO_FIELDS
        for rank in (None, comm.size - 1)
    ]
    top, far = other.add_joint((0.0, 0.0, 9.0), name="top"), (9.0, 9.0, 9.0)
    other.add_bar(Bar(1.0), top, far, name="rod")
    ends = (*NO_VECTORS, None, top, (0.0, 0.0, 9.0))
    lengths = [{cable: v} for v in (*NOT_POSITIVE, None)] + [{"left": 1.0}, {None: 1.0}]
    no_names = ("", 3, NAN, ["a"], {})
    names = (*no_names, cable.name)
    return [
        Call(
            "Scene",
            Scene,
            {"mesh": scene.mesh, "material": foil},
            {"material": material},
        ),
        Call("vertices", scene.vertices, {"where": "left"}, {"where": where}),
        Call(
            "fix",
            other.fix,
            {"where": "left"},
            {"where": where, "directions": (*NO_TEXTS, "xq")},
        ),
        Call(
            "release",
            other.release,
            {"where": "left"},
            {"where": where, "directions": (*NO_TEXTS, "xq")},
        ),
        Call("floor", scene.floor, {"z": -9.0}, {"z": (1.0, 1e300)}),
        Call(
            "put_load",
            scene.put_load,
            {"force": UP},
            {"force": (*NO_VECTORS, None, *fields)},
        ),
        Call(
            "put_cable_load",
            scene.put_cable_load,
            {"force": UP, "cables": [cable]},
            {
                "force": (3.0, "x", [1.0], (0.0, 0.0, NAN)), "cables": (3, "x", [], ["x"]),
                "name": ("", 3), "unknown": (1,),
            },
        ),
        Call(
            "put_temperature",
            scene.put_temperature,
            {"change": 30.0},
            {
                "change": (*NO_NUMBERS, None, 293.0, {"unknown": 1.0}, {"cables": NAN}),
                "name": ("", 3, "temperature"), "unknown": (1,),
            },
        ),
        Call(
            "put_line_load",
            scene.put_line_load,
            {"force": UP, "edges": "left"},
            {"force": (*NO_VECTORS, None), "edges": NO_TEXTS},
        ),
        Call(
            "put_wind",
            scene.put_wind,
            {"pressure": 0.1, "coefficient": -1.0},
            {"coefficient": (*NO_NUMBERS, None, {}, {"unknown": 1.0}, *fields)},
        ),
        Call(
            "add_joint",
            other.add_joint,
            {"position": UP},
            {"name": (*no_names, "top"), "held": ("xq", 3, None, ["x"])},
        ),
        Call("vertex_at", other.vertex_at, {"point": (0.0, 0.0, 0.0)}, {}),
        Call(
            "add_bar",
            other.add_bar,
            {"bar": Bar(1.0), "start": top, "end": UP},
            {"end": ends, "L0": NOT_POSITIVE, "name": (*no_names, "rod")},
        ),
        Call("remove_bar", other.remove_bar, {"bar": "rod"}, {"bar": (None, 3, "x", NAN, top)}),
        Call(
            "put_joint_load",
            other.put_joint_load,
            {"forces": {top: UP}},
            {"forces": (None, 3, "x", {}, {top: (1.0, 2.0)}, {"top": UP}, [top])},
        ),
        Call(
            "set_material",
            scene.set_material,
            {"material": next(iter(scene.materials.values()))},
            {"material": (*material, Cable, True, NAN)},
        ),
        Call(
            "set_stiffness",
            scene.set_stiffness,
            {"EA": {cable: 9.0}},
            {
                "EA": (
                    None, 3, "x", {}, [cable], {"left": 1.0}, {None: 1.0},
                    *({cable: v} for v in (*NOT_POSITIVE, None)),
                )
            },
        ),
        Call(
            "seal",
            scene.seal,
            {"volume": 1000.0},
            {"exponent": (0.9,), "unknown": (1,)},
        ),
        Call(
            "put_pond",
            scene.put_pond,
            {"weight": 10.0, "level": 0.0},
            {
                "level": (None,), "volume": (1.0,),
                "on": (3, NAN, "left", [], ["unknown"], [3], [["left"]], {}),
            },
        ),
        Call(
            "lay_cable",
            scene.lay_cable,
            {"cable": Cable(1.0), "path": ACROSS},
            {
                "path": NO_PATHS, "L0": NOT_POSITIVE, "tension": NOT_POSITIVE, "name": names,
                "unknown": (1,),
            },
        ),
        Call(
            "remove",
            other.remove,
            {"cable": cable},
            {"cable": (None, 3, NAN, "", "unknown", Cable(1.0), other, {}, [cable], cable.start)},
        ),
        Call(
            "Solver",
            Solver,
            {"scene": scene},
            {
                "results": ("/proc/nowhere", __file__), "rtol": (0.0, -1.0, 1.0, 2.0),
                "unknown": (1,),
            },
        ),
        Call(
            "advance",
            solver.advance,
            {"pressure": 0.01},
            {
                "pressure": NO_NUMBERS, "temperature": (*NO_NUMBERS, 1.0),
                "atmosphere": (*NO_NUMBERS, 1.0), "load": (*NO_NUMBERS, 1.0),
                "move": (3, "x", [("left", UP)], [3], *moves), "L0": (3, "x", [cable], *lengths),
                "unknown": (1,),
            },
        ),
        Call("reactions", solver.reactions, {"where": "left"}, {"where": where}),
        Call(
            "at",
            solver.results().at,
            {"points": [(50.0, 50.0)]},
            {
                "points": (*NO_PATHS[2:7], *NO_PATHS[8:], 3.0, [(-50.0, 50.0)]), "unknown": (1,),
            },
        ),
        Call("function", solver.results().function, {"name": "warp"}, {"name": no_names}),
        Call("shares", solver.results().shares, {}, {"part": (*no_names[:3], "unknown")}),
        Call(
            "set_strengths",
            other.set_strengths,
            {"strengths": (2.0, 1.0)},
            {
                "strengths": (
                    *NO_NUMBERS, None, (1.0, 0.0), (1.0, -1.0), (NAN, 1.0), (1.0, "x"), ("a", "b"),
                    (1.0, 2.0, 3.0), {"unknown": (1.0, 2.0)}, {},
                ),
                "patches": (-1.0, NAN, "x", [1.0], {"unknown": 1.0}),
                "cables": (0.0, NAN, "x", [1.0], {"cable 1": -1.0}),
            },
        ),
        Call(
            "set_limits",
            other.set_limits,
            {},
            {
                "deflection": (0.0, NAN, "x", {"unknown": 1.0}), "water": (-1.0, NAN, "x"),
                "prestress": (0.0, NAN, "x", {"unknown": 1.0}), "slope": (0.0, NAN, 90.0, "x"),
                "unknown": (1,),
            },
        ),
        Call(
            "report",
            solver.report,
            {"filename": "/nowhere/a.html"},
            {
                "filename": ("/nowhere/a.pdf", "", "/", "/proc/nowhere/a.html"),
                "combinations": (3, "x", {}, {"a": 1.0}, [1]), "unknown": (1,),
                "title": (3, None, NAN, ["a"]), "unit": (3, None), "force": (3, None),
                "about": (3, "x", ["a"], {"a": 3}, {3: "a"}), "view": (3, "nowhere", NAN, [1.0]),
                "pictures": ("stress", 3, NAN, ["red"], [3], ["utilisation"]),
            },
        ),
        Call(
            "contact_forces",
            solver.contact_forces,
            {"cable": cable},
            {"cable": ("cable 1", [cable])},
        ),
        Call(
            "draw",
            partial(draw, solver),
            {"filename": "/nowhere/a.png"},
            {
                "filename": ("/nowhere/a.xyz", 3, "", NAN, "/"), "unknown": (1,),
                "colour": ("red", 3, NAN, [1.0], {}), "view": (3, "nowhere", NAN, [1.0]),
            },
        ),
    ]  # fmt: skip
