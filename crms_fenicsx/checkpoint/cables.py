"""Laid cables with all that they remember, as plain numbers and texts, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from crms_fenicsx.cables.cable import (
    Cable,
    CableNode,
    CableState,
    Crossing,
    LaidCable,
    StepStart,
)
from crms_fenicsx.cables.friction import Friction
from crms_fenicsx.cables.path import CellPoint, EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.checkpoint.plain import Plain, floats, integers, listed

if TYPE_CHECKING:
    from crms_fenicsx.cables.axial import AxialGrip
    from crms_fenicsx.cables.grip import Grip
    from crms_fenicsx.cables.slip import MaterialCurve

KINDS = ("vertex", "fold", "rail", "rider", "anchor", "crossing")


def plain_crossing(crossing: Crossing) -> Plain:
    """A crossing as plain data."""
    return asdict(crossing) | {"place": listed(crossing.place), "apart": bool(crossing.apart)}


def crossing_of(data: Plain) -> Crossing:
    """A crossing from plain data."""
    lower, upper = integers([data["lower"], data["upper"]])
    first, second = integers(data["links"])
    return Crossing(
        lower, upper, integers(data["support"]), (first, second), floats(data["place"], 3),
        tuple(integers(support) for support in data["between"]), bool(data["apart"]),
    )  # fmt: skip


def plain_cable(cable: LaidCable, crossings: Sequence[Crossing]) -> Plain:
    """A cable as plain data.

    Parameters
    ----------
    cable
        The cable.
    crossings
        The scene's, which its nodes refer to by number.
    """
    number = {id(crossing): k for k, crossing in enumerate(crossings)}
    return {
        "name": cable.name,
        "cable": plain_data(cable.cable),
        "nodes": [
            {
                "kind": node.kind,
                "point": None if node.point is None else asdict(node.point),
                "crossing": None if node.crossing is None else number[id(node.crossing)],
            }
            for node in cable.nodes
        ],
        "positions": listed(cable.positions),
        "fractions": listed(cable.fractions),
        "lifted": listed(cable.lifted),
        "material": listed(cable.material),
        "L0": cable.L0,
        "length": cable.length,
        "tension": cable.tension,
        "step_start": None if cable.step_start is None else _numbers(cable.step_start),
        "taut": bool(cable.taut),
        "sleeve": cable.sleeve,
        "level": cable.level,
        "traced": cable.traced,
        "ends_before": None if cable.ends_before is None else listed(cable.ends_before),
        "blocked": list(cable.blocked),
        "grip": None if cable.grip is None else _plain_grip(cable.grip),
        "axial": None if cable.axial is None else _plain_grip(cable.axial),
        "excess": cable.excess,
    }


def cable_of(data: Plain, crossings: Sequence[Crossing]) -> LaidCable:
    """A cable from plain data.

    Raises
    ------
    KeyError, TypeError, ValueError
        The data are no cable's.
    """
    nodes = tuple(_node(node, crossings) for node in data["nodes"])
    n, start = len(nodes), data["step_start"]
    lifted = np.array(data["lifted"])
    if lifted.shape != (n,) or lifted.dtype != bool:
        raise ValueError(f"lifted: {data['lifted']!r} for {n} nodes")
    state = CableState(
        nodes=nodes,
        positions=floats(data["positions"], n, 3),
        fractions=floats(data["fractions"], n),
        lifted=lifted,
        L0=float(data["L0"]),
        length=float(data["length"]),
        tension=float(data["tension"]),
        step_start=None if start is None else StepStart(**{k: float(v) for k, v in start.items()}),
        taut=bool(data["taut"]),
        traced=bool(data["traced"]),
        ends_before=None if data["ends_before"] is None else floats(data["ends_before"], 2, 3),
        blocked=integers(data["blocked"]),
        grip=None if data["grip"] is None else _grip(data["grip"]),
        axial=None if data["axial"] is None else _axial(data["axial"]),
        excess=float(data["excess"]),
    )
    state.material[:] = floats(data["material"], n, 3)
    return LaidCable(
        str(data["name"]), _data(data["cable"]), state, bool(data["sleeve"]), int(data["level"])
    )


def plain_data(cable: Cable) -> Plain:
    """A cable's data as plain data."""
    friction: Any = cable.friction
    if isinstance(friction, Friction):
        numbers = ("mu", "static", "along", "tolerance")
        friction = {"law": friction.law} | {
            name: None if (value := getattr(friction, name)) is None else float(value)
            for name in numbers
        }
    else:
        friction = float(friction)
    return {"EA": float(cable.EA), "law": cable.law, "friction": friction}


def _data(data: Plain) -> Cable:
    friction = data["friction"]
    if isinstance(friction, dict):
        friction = Friction(**friction)
    return Cable(data["EA"], data["law"], friction)


def _node(data: Plain, crossings: Sequence[Crossing]) -> CableNode:
    if data["kind"] not in KINDS or (data["point"] is None) != (data["kind"] == "anchor"):
        raise ValueError(f"a node of kind {data['kind']!r} with the point {data['point']!r}")
    crossing = None if data["crossing"] is None else crossings[data["crossing"]]
    return CableNode(
        data["kind"], None if data["point"] is None else _point(data["point"]), crossing
    )


def _point(data: Plain) -> SurfacePoint:
    if "vertex" in data:
        return VertexPoint(*integers([data["vertex"]]))
    if "edge" in data:
        a, b = integers(data["edge"])
        return EdgePoint((a, b), float(data["fraction"]))
    a, b, c = integers(data["cell"])
    u, v, w = (float(weight) for weight in data["weights"])
    return CellPoint((a, b, c), (u, v, w))


def _numbers(start: StepStart) -> Plain:
    return {name: float(value) for name, value in asdict(start).items()}


def _plain_grip(grip: Grip | AxialGrip) -> Plain:
    """A grip's fields; those of its curve too."""
    return {
        name: value if isinstance(value, bool | float) else _plain_field(value)
        for name, value in vars(grip).items()
        if name != "row_of"  # follows from the others
    }


def _plain_field(value: Any) -> Any:
    from crms_fenicsx.cables.slip import MaterialCurve

    if isinstance(value, MaterialCurve):
        return {name: listed(array) for name, array in vars(value).items()}
    if isinstance(value, tuple):
        return [list(support) for support in value]
    return listed(value)


def _supports(data: Plain) -> tuple[tuple[int, ...], ...]:
    return tuple(integers(support) for support in data["supports"])


def _grip(data: Plain) -> Grip:
    from crms_fenicsx.cables.grip import Grip

    supports = _supports(data)
    bounds, moving = (floats(data[name], len(supports)) for name in ("bounds", "moving"))
    return Grip(
        _curve(data["curve"]), supports, bounds, moving, float(data["dissipated"]),
        bool(data["known"]),
    )  # fmt: skip


def _axial(data: Plain) -> AxialGrip:
    from crms_fenicsx.cables.axial import AxialGrip

    curve, supports = _curve(data["curve"]), _supports(data)
    bounds, eps = (floats(data[name], len(supports)) for name in ("bounds", "eps"))
    tensions, spans, arcs, slips = (
        floats(data[name], -1) for name in ("tensions", "spans", "arcs", "slips")
    )
    return AxialGrip(
        curve, floats(data["rest"], len(curve.points)), supports, bounds, eps, tensions, spans,
        arcs, slips, float(data["loss"]), float(data["dissipated"]),
    )  # fmt: skip


def _curve(data: Plain) -> MaterialCurve:
    from crms_fenicsx.cables.slip import MaterialCurve

    points = floats(data["points"], -1, 3)
    n = len(points)
    part = np.array(integers(data["part"]), dtype=np.int64)
    if len(part) != n:
        raise ValueError(f"a curve of {n} points with {len(part)} numbers of parts")
    arc, elastic, moving = (floats(data[name], n) for name in ("arc", "elastic", "moving"))
    return MaterialCurve(points, arc, part, elastic, moving)
