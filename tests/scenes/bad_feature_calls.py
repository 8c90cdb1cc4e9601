"""Calls of loads, air, water, bars and load cases, with bad values for each of their arguments."""

from __future__ import annotations

from bad_calls import NO_PATHS, Call
from bad_values import INF, NAN, NO_NUMBERS, NO_TEXTS, NO_VECTORS, NOT_POSITIVE, UP
from dolfinx import fem

from crms_fenicsx import Bar, Cable, FanControl, Scene, Solver, meshes


def features(scene: Scene, other: Scene, solver: Solver) -> list[Call]:
    """What is called on a scene, with another one of the same mesh, which has a joint "top"."""
    top, vertex = other.joint("top"), other.vertex_at((0.0, 0.0, 0.0))
    rod, own = (
        other.bar("rod"),
        scene.add_joint((0.0, 0.0, 9.0), name="own", held="xyz"),
    )
    scene.add_bar(Bar(1.0), own, (9.0, 9.0, 9.0), name="own rod")
    bar = scene.bar("own rod")
    scene.put_load(UP, name="up")
    wrong = fem.Function(fem.functionspace(scene.mesh.mesh, ("Lagrange", 1)))
    numbers = (3, None, "x", [1.0], {}, NAN)
    fans = FanControl("unknown", [0.0], [1.0])
    factors = [{"up": value} for value in NO_NUMBERS] + [{"unknown": 1.0}, {3: 1.0}, [1.0]]
    cases = [{"a": one} for one in (*factors, 3, None, {"pressure": "x"}, {"temperature": 1.0})]
    lists = ([], "x", 3, [[1.0]], [NAN], [INF, 1.0], [1.0, 0.0], None, {})
    return [
        Call(
            "FanControl",
            FanControl,
            {"load": "up", "factors": [0.0], "pressures": [1.0]},
            {"factors": lists, "pressures": lists},
            False,
        ),
        Call(
            "put_forces",
            scene.put_forces,
            {"forces": fem.Function(scene.V), "name": "new"},
            {"forces": (*numbers, wrong), "name": ("up", "pressure")},
        ),
        Call(
            "remove_load",
            scene.remove_load,
            {"name": "up"},
            {"name": ("", "unknown", *numbers, ("up",), b"up", UP)},
        ),
        Call(
            "put_pond by volume",
            scene.put_pond,
            {"weight": 10.0, "volume": 1.0},
            {"volume": (None,), "level": (0.0,), "name": ("up", "temperature")},
        ),
        Call(
            "combine",
            solver.combine,
            {"combinations": {"a": {"up": 1.0}}},
            {"combinations": (*cases, {}, 3, None, "x", {"": {"up": 1.0}}, {3: {"up": 1.0}})},
        ),
        Call(
            "restore",
            solver.restore,
            {"snapshot": solver.snapshot()},
            {"snapshot": (*numbers, scene, solver)},
        ),
        Call("save", solver.save, {}, {"folder": ("/proc/nowhere",)}, False),
        Call("load", solver.load, {}, {"folder": ("/nowhere",)}, False),
        Call("bar", scene.bar, {"name": "own rod"}, {"name": ("", "rod", *numbers)}, False),
        Call("joint", scene.joint, {"name": "own"}, {"name": ("", "top", *numbers)}, False),
        Call("cable", scene.cable, {"name": "cable 1"}, {"name": ("", *numbers)}, False),
        Call("load", scene.load, {"name": "up"}, {"name": ("", *numbers)}, False),
        Call("remove_bar", scene.remove_bar, {"bar": bar}, {"bar": (rod, own, *numbers, "rod")}),
        Call(
            "add_bar",
            scene.add_bar,
            {"bar": Bar(1.0), "start": own, "end": vertex},
            {
                "start": (*NO_VECTORS, None, top, bar), "end": (own, rod, "left", "unknown"),
                "L0": NOT_POSITIVE, "name": ("", "own rod", *numbers[:1], "x "),
            },
        ),
        Call(
            "put_joint_load",
            scene.put_joint_load,
            {"forces": {own: UP}, "name": "push"},
            {
                "forces": [*({own: v} for v in NO_VECTORS), {top: UP}, {bar: UP}, {"own": UP}],
                "name": ("up", "atmosphere"),
            },
        ),
        Call(
            "lay_cable to a joint",
            scene.lay_cable,
            {"cable": Cable(1.0), "path": [own, (5.0, 5.0, 0.0)]},
            {
                "path": [[top, UP], [own, own], [own], [own, (5.0, 5.0)], [UP, own, UP],
                         [own, (NAN, 0.0, 0.0)], *NO_PATHS[:3]],
                "tension": NOT_POSITIVE,
            },
        ),
        Call(
            "advance with features",
            solver.advance,
            {"load": {"up": 1.0}},
            {
                "load": factors, "pressure": (fans, *NO_NUMBERS), "temperature": (1.0, NAN),
                "move": [{own: v} for v in NO_VECTORS] + [{top: UP}, {bar: UP}, {vertex: UP}],
                "L0": [{bar: v} for v in NOT_POSITIVE] + [{rod: 1.0}, {own: 1.0}, {"own rod": 1.0}],
            },
        ),
        Call(
            "refine",
            lambda project=None: meshes.refine(solver.scene.mesh, project=project),
            {},
            {"project": [n for n in numbers if n is not None]},
        ),
        Call(
            "held", other.add_joint, {"position": UP}, {"held": (*NO_TEXTS[2:], "xq", "XY")}
        ),
    ]  # fmt: skip
