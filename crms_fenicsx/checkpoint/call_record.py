"""What tells whether a script does again what it did before: the scene when loads are put on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.checkpoint.codec import Plain, encode
from crms_fenicsx.checkpoint.fields import edge_vertices
from crms_fenicsx.checkpoint.fingerprint import described, fingerprint, mixed
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.fan_control import FanControl
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.scene import Scene

Vector = Sequence[float]

ROUNDING = 1e-7
"""Difference of numbers, relative to the largest beside them, that other numbers of processes and
their rounding make."""


def plain_loads(
    pressure: float | FanControl | None,
    move: Mapping[object, Vector],
    L0: Mapping[object, float],
    load: float | Mapping[str, float] | None,
    steps: int,
    air: Mapping[str, float | None],
) -> Plain:
    """The arguments of `Solver.advance` as plain data, by names; `air` are those of sealed air."""
    return {
        "pressure": encode(pressure),
        "load": encode(load),
        "move": {_name(key): [float(x) for x in vector] for key, vector in move.items()},
        "L0": {_name(key): float(length) for key, length in L0.items()},
        "steps": int(steps),
        **{name: encode(value) for name, value in air.items()},
    }


def _name(key: object) -> str:
    if isinstance(key, Joint | PlacedBar):
        return f"{'joint' if isinstance(key, Joint) else 'bar'} {key.name!r}"
    if isinstance(key, CableEnd):
        return f"{key.which} of the cable {key.cable.name!r}"
    return f"cable {key.name!r}" if isinstance(key, LaidCable) else f"group {key!r}"


def scene_record(scene: Scene) -> Plain:
    """Describe a scene by numbers and texts that hardly any change leaves alone. Collective.

    Of fields they are sums with weights, so that they are the same on any number of processes up to
    rounding.
    """
    mesh = scene.mesh.mesh
    own = scene.V.dofmap.index_map.size_local
    ids = scene.membrane.vertex_ids
    cells = mesh.topology.index_map(2).size_local
    pairs = np.sort(edge_vertices(scene)[: mesh.topology.index_map(1).size_local], axis=1)
    pressed = scene.membrane.pressed[:cells, None].astype(np.int64)
    numbers = np.asarray(mesh.topology.original_cell_index[:cells], dtype=np.int64)[:, None]
    held = np.column_stack([ids[:own], scene.held[:own].astype(np.int64)])
    u = scene.u.x.array.reshape(-1, 3)
    largest = scene.comm.allreduce(float(np.abs(u).max(initial=0.0)), op=MPI.MAX)
    return fingerprint(scene) | {
        "materials now": [described(material) for material in scene.materials.values()],
        "pressure_on (cells, mixed to one number)": mixed(scene, np.hstack([numbers, pressed])),
        "held vertices (mixed to one number)": mixed(scene, held),
        "held edges (mixed to one number)": mixed(
            scene, pairs[scene.membrane.held_edges[: len(pairs)]]
        ),
        "floor": None if scene.floor_level is None else float(scene.floor_level),
        "pressure before": float(scene.pressure),
        "sealed air before": encode(scene.air),
        "ponds before": encode(scene.ponds),
        "displacements (sums with weights)": [*_sums(scene, ids[:own], u[:own]), largest],
        "loads": [
            {
                "name": load.name,
                "follows the normals": load.suction is not None,
                "factor before": float(load.factor),
                "forces (sums with weights)": [
                    *_sums(scene, ids, load.forces),
                    load.intensity * scene.membrane.size**2,
                ],
                "joints": {name: list(force) for name, force in load.joints.items()},
            }
            for load in scene.loads
        ],
        "cables": [_described(cable) for cable in scene.cables],
        "joints": [
            {
                "name": joint.name,
                "held": [int(held) for held in joint.held],
                "position": joint.position.tolist(),
            }
            for joint in scene.joints
        ],
        "bars": [
            {
                "name": bar.name,
                **encode(bar.bar),
                "ends": bar.points.ravel().tolist(),
                "L0": float(bar.L0),
            }
            for bar in scene.bars
        ],
    }


def _sums(scene: Scene, ids: Integers, values: Array) -> list[float]:
    """Sums of the components over all ranks, weighted by the vertices' ids."""
    weights = 0.5 + (0.6180339887498949 * ids) % 1.0
    total: Array = scene.comm.allreduce(weights @ values)
    return [float(x) for x in total]


def _described(cable: LaidCable) -> Plain:
    points = cable.positions[cable.contacts()]
    spans = np.diff(points, axis=0)
    lengths, middles = np.linalg.norm(spans, axis=1), (points[1:] + points[:-1]) / 2
    length = max(float(lengths.sum()), np.finfo(float).tiny)
    way = [lengths @ middles / length, points[0], points[-1]]
    square = np.einsum("s,si,sj->ij", lengths, middles, middles)
    square += np.einsum("s,si,sj->ij", lengths, spans, spans) / 12
    return {
        "name": cable.name,
        **encode(cable.cable),
        "sleeve": bool(cable.sleeve),
        "layer": int(cable.layer),
        "L0, length": [float(cable.L0), float(cable.length)],
        "tension": float(cable.tension),
        "ends and middle": [float(x) for place in way for x in place],
        "moments of its way": (square / length).ravel().tolist(),
    }


def difference(was: object, now: object) -> str | None:
    """Where plain data differ by more than rounding, in words; None if they do not."""
    if isinstance(was, dict) and isinstance(now, dict):
        for name in {**was, **now}:
            found = difference(was.get(name), now.get(name))
            if found is not None:
                label = name if name == "name" or "name" not in now else f"{now['name']!r}, {name}"
                return label + ("" if found.startswith((" =", ":")) else ", ") + found
        return None
    if _close(was, now):
        return None
    if isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        pairs = zip(was, now, strict=True)
        found = next((d for d in (difference(a, b) for a, b in pairs) if d is not None), "")
        if not found.startswith(" ="):
            return f": {found}"
    return f" = {_short(was)}, and now {_short(now)}"


def _close(was: object, now: object) -> bool:
    if _numeric(was) and _numeric(now):
        a, b = np.atleast_1d(was), np.atleast_1d(now)  # type: ignore[call-overload]
        size = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        return a.shape == b.shape and bool(np.all(np.abs(a - b) <= ROUNDING * size))
    if isinstance(was, list) and isinstance(now, list):
        return len(was) == len(now) and all(
            difference(a, b) is None for a, b in zip(was, now, strict=True)
        )
    return was == now


def _numeric(value: object) -> bool:
    """Whether it is a number that may be rounded, or a list of such."""
    values: list[Any] = value if isinstance(value, list) and value else [value]
    return all(isinstance(one, float) for one in values)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + "..."
