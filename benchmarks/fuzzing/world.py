"""Builds random scenes, and does to them what is to be done.

A `Frame` puts the same scene elsewhere, turned and in other units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    EnergyTerm,
    FanControl,
    Friction,
    IsotropicMembrane,
    OrthotropicMembrane,
    Rotation,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.bar import Joint
from fuzzing.scenes import SceneData, rim_crossings

GAS = 101.325
"""Pressure of the atmosphere (kPa)."""
SIDES, CORNERS = ("front", "right", "back", "left"), ("a", "b", "c", "d")


@dataclass(frozen=True)
class Frame:
    """Where a scene is, and in which units: places are ``unit * (turn x + push)``."""

    turn: Array = field(default_factory=lambda: np.eye(3))
    push: Array = field(default_factory=lambda: np.zeros(3))
    unit: float = 1.0
    force: float = 1.0

    def place(self, x: Any) -> Array:
        """Points (..., 3)."""
        return self.unit * (np.asarray(x, dtype=float) @ self.turn.T + self.push)

    def way(self, d: Any) -> Array:
        """Displacements (..., 3)."""
        return self.unit * (np.asarray(d, dtype=float) @ self.turn.T)

    def pull(self, F: Any) -> Array:
        """Forces (..., 3)."""
        return self.force * (np.asarray(F, dtype=float) @ self.turn.T)

    def back(self, x: Array) -> Array:
        """Points (3, n) as they are without it."""
        return self.turn.T @ (x / self.unit - self.push[:, None])

    @property
    def per_area(self) -> float:
        """The unit of pressures."""
        return self.force / self.unit**2

    @property
    def per_length(self) -> float:
        """The unit of section forces."""
        return self.force / self.unit


class Springs(EnergyTerm):
    """Springs of stiffness k from each vertex to where it is when stress-free, k/2 u^2."""

    name = "springs"

    def __init__(self, k: float) -> None:
        self.k = k

    def sums(self, x: Any, out: Any) -> None:
        n = self.unknowns.n_vertices
        out[0] = self.k / 2 * np.sum(x[:n] ** 2)

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        n = self.unknowns.n_vertices
        g[:n] += self.k * x[:n]


def flat_groups(data: SceneData) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Groups of edges, parts and points of a mesh, by numbers of vertices and cells."""
    x, cells = data.points, data.cells
    pairs = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    rim = edges[count == 1]
    middle = x[rim].mean(axis=1)
    half = np.array([np.abs(x[:, 0]).max(), np.abs(x[:, 1]).max()])
    groups = {"west": rim[middle[:, 0] < -0.6 * half[0]]}
    points: dict[str, Array] = {}
    if data.kind in ("structured", "jiggled"):
        for name, axis, sign in zip(SIDES, (1, 0, 1, 0), (-1, 1, 1, -1), strict=True):
            groups[name] = rim[np.abs(middle[:, axis] - sign * half[axis]) < 1e-6]
        for name, way in zip(CORNERS, ((-1, -1), (1, -1), (1, 1), (-1, 1)), strict=True):
            points[name] = np.array([np.argmax(x[:, :2] @ np.array(way))])
    centres = x[cells].mean(axis=1)
    east = centres[:, 0] > 0.3
    if data.walls:
        east = np.arange(len(cells)) >= len(cells) - data.walls
    parts = {"east": np.flatnonzero(east), "other": np.flatnonzero(~east)}
    return groups, parts, points


def membrane_mesh(
    data: SceneData, frame: Frame, comm: MPI.Intracomm, ranks: Any = None
) -> MembraneMesh:
    """The mesh of a scene."""
    groups, parts, points = flat_groups(data)
    groups = {name: edges for name, edges in groups.items() if len(edges)}
    root = comm.rank == 0
    if data.source != "dolfinx":
        cells = data.cells if np.linalg.det(frame.turn) > 0 else data.cells[:, [0, 2, 1]]
        return meshes.from_arrays(
            comm, frame.place(data.points) if root else None, cells if root else None,
            edges=groups, parts=parts, point_groups=points, ranks=ranks,
            outside={"east": tuple(frame.turn[:, 0])} if data.walls else (0.0, 0.0, 1.0),
        )  # fmt: skip
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    cells = data.cells if root else np.zeros((0, 3), dtype=np.int64)
    x = frame.place(data.points if root else np.zeros((0, 3)))
    plain = dolfinx.mesh.create_mesh(comm, cells=cells, x=x, e=ufl.Mesh(element))
    plain.topology.create_connectivity(2, 0)
    plain.topology.create_connectivity(1, 0)
    own = plain.topology.index_map(2).size_local
    numbers = np.asarray(plain.topology.original_cell_index[:own])
    values = np.isin(numbers, parts["east"]).astype(np.int32) + 1
    tags = dolfinx.mesh.meshtags(plain, 2, np.arange(own, dtype=np.int32), values)
    back = frame.back

    def in_west(p: Array) -> Array:
        q = back(p)
        return np.min(np.linalg.norm(
            q.T[:, None] - data.points[np.unique(groups["west"])][None], axis=2), axis=1,
            initial=np.inf) < 1e-6  # fmt: skip

    found = dolfinx.mesh.locate_entities_boundary(plain, 1, in_west)
    west = dolfinx.mesh.meshtags(plain, 1, found, np.full(len(found), 7, dtype=np.int32))
    names = {"other": (2, 1), "east": (2, 2), "west": (1, 7)}
    return meshes.from_dolfinx(plain, tags, west, names=names)


def joints(scene: Scene) -> list[Joint]:
    """The joints of bars in the order of these, by name: others name themselves as they come."""
    ends = [end for bar in sorted(scene.bars, key=lambda b: b.name) for end in (bar.start, bar.end)]
    return list(dict.fromkeys(end for end in ends if isinstance(end, Joint)))


class World:
    """A scene in a frame, with its solver."""

    def __init__(
        self, data: SceneData, frame: Frame, comm: MPI.Intracomm, ranks: Any = None,
        **options: Any,
    ) -> None:  # fmt: skip
        self.data, self.frame, self.comm = data, frame, comm
        kind, given = data.material
        given = dict(given)
        for name in ("E", "E1", "E2", "G12"):
            if name in given:
                given[name] *= frame.per_area
        given["thickness"] *= frame.unit
        given["prestress"] *= frame.per_length
        if "warp" in given:
            given["warp"] = tuple(frame.way(given["warp"]) / frame.unit)
        make: Any = IsotropicMembrane if kind == "isotropic" else OrthotropicMembrane
        mesh = membrane_mesh(data, frame, comm, ranks)
        if data.source == "form":
            self.scene = self._form(mesh, make(**given))
        else:
            laws: dict[str, Any] = dict(data.laws)
            if data.walls:
                laws["pressure_on"] = ["other"]
            self.scene = Scene(mesh, make(**given), **laws)
            self._hold()
        self.solver = Solver(self.scene, **options)
        self.after: Callable[[World, str], None] = lambda world, what: None

    def _hold(self) -> None:
        if self.data.held == "plane":
            self.scene.fix("left", "x")
            for name in ("front", "right", "back"):
                self.scene.fix(name)
        elif self.data.held == "ends":
            x = self.data.points[:, 0]
            limit, middle = 0.4 * float(np.ptp(x)), float(x.min() + x.max()) / 2
            self.scene.fix(lambda x: np.abs(self.frame.back(x)[0] - middle) > limit)
        else:
            self.scene.fix("boundary")

    def _form(self, mesh: MembraneMesh, material: Any) -> Scene:
        frame, lift = self.frame, self.frame.way((0.0, 0.0, 2.5))
        edged = self.data.number % 2 == 0
        cables = [FormCable(side, tension=20.0 * frame.force) for side in SIDES] if edged else []
        found = find_form(
            mesh, 2.0 * frame.per_length, fixed=CORNERS if edged else ("boundary",),
            lifted={"a": lift, "c": lift} if edged else {"a": lift / 3}, cables=cables,
        )  # fmt: skip
        return found.scene(material, Cable(EA=8000.0 * frame.force) if edged else None)

    def build(self, order: Any = None) -> World:
        """Put on it what is on it, in some order."""
        if self.data.pressure is not None:
            self.solver.advance(pressure=self.data.pressure * self.frame.per_area)
            self.after(self, "inflated")
        features = self.data.features
        for k in range(len(features)) if order is None else order:
            name, what = features[k]
            getattr(self, f"put_{name}")(**what)
        return self

    def play(self) -> World:
        """Do to it what is to be done."""
        for k, (name, what) in enumerate(self.data.events):
            getattr(self, name)(**what)
            if name not in ("lay", "load"):
                self.after(self, f"event {k + 1}, {name}")
        return self

    def close(self) -> None:
        """Destroy what PETSc holds of it."""
        if self.solver._increments._system is not None:
            self.solver.system.destroy()

    # what is put on it

    def put_weight(self, force: float, per: Any) -> None:
        F = self.frame.pull((0.0, 0.0, -force)) / self.frame.unit**2
        self.scene.put_load(F, name="weight", per=per)

    def put_snow(self, force: float, function: bool) -> None:
        F = self.frame.pull((0.0, 0.0, -force)) / self.frame.unit**2

        def drift(x: Array, n: Array) -> Array:
            share = 1.0 + 0.5 * np.tanh(self.frame.back(x)[0] / 3.0)
            return np.asarray(F[:, None] * share * np.abs(n[2]))

        self.scene.put_load(drift if function else F, name="snow", per="plan")

    def put_wind(self, q: float, kind: str) -> None:
        if self.scene.pressure_law == "step":
            return

        def coefficient(x: Array, n: Array) -> Array:
            return np.asarray(-0.5 - 0.4 * np.sin(self.frame.back(x)[0] / 3.0) * n[2])

        c: Any = {"number": -0.8, "parts": {"east": -0.9, "other": 0.3}, "function": coefficient}
        self.scene.put_wind(q * self.frame.per_area, c[kind], name="wind")

    def put_forces(self, F: Any) -> None:
        forces = fem.Function(self.scene.V)
        x = self.frame.back(self.scene.positions().T)
        bump = np.exp(-(x[0] ** 2 + x[1] ** 2) / 8.0)
        forces.x.array[:] = (bump[:, None] * self.frame.pull(F)).ravel()
        self.scene.put_forces(forces, name="forces")

    def _heights(self) -> tuple[float, float]:
        z = self.scene.positions()[:, 2]
        low = self.comm.allreduce(float(z.min(initial=np.inf)), op=MPI.MIN)
        return low, self.comm.allreduce(float(z.max(initial=-np.inf)), op=MPI.MAX)

    def put_pond(self, by: str, depth: float, part: bool) -> None:
        low, _ = self._heights()
        frame, given = self.frame, {}
        if by == "level":  # on domes only over the rim
            given["level"] = float(low + frame.unit * depth)
        else:
            given["volume"] = depth * 5.0 * frame.unit**3
        weight = 1.0 * frame.force / frame.unit**3
        self.scene.put_pond(
            weight, name="pond", on=["other"] if part or self.data.walls else None, **given
        )

    def put_mast(self, x: float, h: float, guys: int, F: Any) -> None:
        frame, scene = self.frame, self.scene
        top = scene.add_joint(frame.place((x, 0.5, h)), name="top")
        scene.add_bar(Bar(2e4 * frame.force), frame.place((x, 0.5, -1.0)), top, name="mast")
        guy = Bar(2e3 * frame.force, tension_only=True)
        for k, angle in enumerate(np.arange(guys) * 2 * np.pi / guys + 0.4):
            foot = frame.place((x + 3 * np.cos(angle), 0.5 + 3 * np.sin(angle), -1.0))
            bar = Bar(2e3 * frame.force) if guys == 2 else guy
            scene.add_bar(bar, top, foot, name=f"guy {k}",
                          L0=0.999 * float(np.linalg.norm(foot - top.position)))  # fmt: skip
        scene.put_joint_load({top: frame.pull(F)}, name="lamp")

    def put_prop(self, at: Any, up: bool, EA: float, guy: bool) -> None:
        frame, scene = self.frame, self.scene
        free = ~scene.membrane.held.any(axis=1)
        x = frame.back(scene.positions().T).T
        away = np.where(free, np.linalg.norm(x[:, :2] - np.asarray(at), axis=1), np.inf)
        k = int(np.argmin(away)) if len(away) else -1
        own = (float(away[k]), tuple(x[k].tolist())) if k >= 0 else (np.inf, (0.0, 0.0, 0.0))
        _, place = min(self.comm.allgather(own))
        vertex = scene.vertex_at(self.comm.bcast(frame.place(place)))
        foot = frame.place(np.add(place, (0.3, 0.2, 4.0 if up else -4.0)))
        scene.add_bar(Bar(EA * frame.force, tension_only=guy), foot, vertex, name="prop")

    def put_strengths(self, **what: Any) -> None:
        pair = (40.0 * self.frame.per_length, 30.0 * self.frame.per_length)
        self.scene.set_strengths({"east": pair} if what["by part"] else pair)

    def put_floor(self, below: float) -> None:
        self.scene.floor(self._heights()[0] - below * self.frame.unit)

    def put_term(self, k: float) -> None:
        self.scene.add_term(Springs(k * 0.01 * self.frame.per_length))

    def put_cable(
        self, k: int, joint: bool, angle: float, off: float, way: str, **what: Any
    ) -> None:  # fmt: skip
        along = np.array([np.cos(angle), np.sin(angle)])
        centre = off * np.array([-along[1], along[0]])
        back, reach = rim_crossings(self.data.points, self.data.cells, centre, along)
        share, more = 0.6 if way == "inside" else 1.0, 1.0 if way == "anchors" else 0.0
        ends = np.array([centre - (share * back + more) * along,
                         centre + (share * reach + more) * along])  # fmt: skip
        path: Any = np.column_stack([ends, [0.3, 0.3]]) if way == "anchors" else ends
        if joint:
            path = [self.scene.joint("top"), self.frame.place(self._places(ends[:1] * 0.6)[0])]
        self.lay(path, layer=k, name=f"cable {k + 1}", **what)

    def _places(self, plan: Array) -> Array:
        """Points (n, 3) in metres on the membrane now, over points (n, 2) in plan."""
        x = self.frame.back(self.scene.positions().T).T
        n = self.scene.V.dofmap.index_map.size_local
        every = np.concatenate(self.comm.allgather(x[:n]))
        near = [np.argmin(np.linalg.norm(every[:, :2] - p, axis=1)) for p in plan]
        return self.comm.bcast(every[near])

    # what is done to it

    def lay(
        self, path: Any, *, EA: float, law: Any, friction: Any, tension: float | None,
        sleeve: bool, layer: int, L0: float | None = None, name: str | None = None,
    ) -> None:  # fmt: skip
        frame = self.frame
        if isinstance(path, np.ndarray):
            plan = path.shape[1] == 2
            path = frame.place(np.column_stack([path, np.zeros(len(path))]) if plan else path)
            path = path[:, :2] if plan else path
        held: Any = 0.0 if friction is None else Friction(**friction)
        self.scene.lay_cable(
            Cable(EA * frame.force, law=law, friction=held), path,
            L0=None if L0 is None else L0 * frame.unit,
            tension=None if tension is None else tension * frame.force,
            hold="sleeve" if sleeve else "outside", layer=layer, name=name,
        )  # fmt: skip

    def load(self, F: Any) -> None:
        if self.scene.loads:
            self.scene.remove_load("load")
        self.scene.put_load(self.frame.pull(F) / self.frame.unit**2)

    def advance(self, steps: int = 1, **what: Any) -> None:
        frame, scene = self.frame, self.scene
        given: dict[str, Any] = {"steps": steps}
        load = {name: f for name, f in what.get("load", {}).items() if name in scene.factors}
        if load:
            given["load"] = load
        if "pressure" in what and scene.air.sealed is None:
            given["pressure"] = what["pressure"] * frame.per_area
        if "fans" in what and "wind" in scene.factors and scene.air.sealed is None:
            low, high = (p * frame.per_area for p in what["fans"])
            given["pressure"] = FanControl("wind", [0.0, 1.0], [low, high])
        if "temperature" in what and scene.air.sealed is not None:
            given["temperature"] = what["temperature"]
        given |= self._movements(what)
        self.solver.advance(**given)

    def _movements(self, what: dict[str, Any]) -> dict[str, Any]:
        frame, scene = self.frame, self.scene
        if self.data.ambiguous:
            return self._own_movements(**what)
        group = "boundary" if self.data.source != "form" and self.data.held == "all" else None
        by_name = {"key": lambda thing: thing.name}  # they may have been added in another order
        cables = sorted(scene.cables, **by_name)
        if "turn" in what and group:
            axis = frame.way((0.1, 0.0, 1.0))
            turn = Rotation(frame.place((0.5, 0.0, 0.0)), axis, what["turn"])
            return {"move": {group: turn}}
        if "function" in what and group:
            d = np.array(what["function"])

            def way(x: Array, t: float) -> Array:
                q = frame.back(x)
                return frame.way(t * (d[:, None] * np.sin(q[0] + 0.3)).T).T

            return {"move": {group: way}}
        if "L0" in what:
            total = [c for c in cables if c.cable.law == "total"]
            things: list[Any] = [*total, *sorted(scene.bars, **by_name)]
            if things:
                one = things[what["of"] % len(things)]
                return {"L0": {one: what["L0"] * one.L0}}
        if "move" in what:
            d = frame.way(what["way"])
            if what["move"] in ("boundary", "west") and group:
                return {"move": {what["move"]: d}}
            ends = [e for c in cables for e in (c.start, c.end)
                    if e.cable.state.nodes[c.node_of(e.which)].kind == "anchor"
                    and c.state.laid.joints[0 if e.which == "start" else 1] is None]  # fmt: skip
            if what["move"] == "cable" and ends:
                return {"move": {ends[what["of"] % len(ends)]: d}}
            anchors = [j for j in joints(scene) if j.held.all()]
            if what["move"] == "bar" and anchors:
                return {"move": {anchors[what["of"] % len(anchors)]: d}}
        return {}

    def _own_movements(
        self, ends: Any = None, lengths: Any = None, boundary: Any = None, **_: Any
    ) -> dict[str, Any]:
        """Of cables by number. What concerns a cable that does not hold by its end is left out."""
        cables, move, L0 = self.scene.cables, dict[Any, Array](), dict[Any, float]()
        for (c, which), d in (ends or {}).items():
            for end in (cables[c].start, cables[c].end):
                node = cables[c].state.nodes[cables[c].node_of(end.which)]
                if which in ("both", end.which) and node.point is None:
                    move[end] = self.frame.way(d)
        if boundary is not None and self.data.held == "all":
            move["boundary"] = self.frame.way(boundary)
        for c, factor in (lengths or {}).items():
            if cables[c].cable.law == "total":
                L0[cables[c]] = factor * cables[c].L0
        return {"move": move, "L0": L0}

    def seal(self, volume: float, exponent: float) -> None:
        frame = self.frame
        if self.scene.pressure_law == "step":
            return
        self.scene.seal(
            volume=volume * frame.unit**3, atmosphere=GAS * frame.per_area, exponent=exponent
        )

    def unseal(self) -> None:
        if self.scene.air.sealed is not None:
            self.scene.unseal()

    def remove(self, which: int) -> None:
        scene = self.scene
        free = [b for b in scene.bars if b.name in ("prop",)]
        cables = sorted(scene.cables, key=lambda cable: cable.name)
        things: list[Any] = [*cables, *free, *sorted(scene.factors)]
        if self.data.source == "form":
            things = [t for t in things if getattr(t, "name", t) not in SIDES]
        if things:
            one = things[which % len(things)]
            if isinstance(one, str):
                scene.remove_load(one)
            elif one in free:
                scene.remove_bar(one)
            else:
                scene.remove(one)

    def branch(self, load: Any, seal: bool, lay: bool, remove: bool, move: Any) -> None:
        with self.solver.branch("aside"):
            if seal and self.scene.air.sealed is None and self.scene.pressure > 0:
                self.seal(200.0, 1.2)
            if lay and self.data.source != "form":
                self.put_cable(
                    7, False, 0.9, 0.33, "inside",
                    EA=900.0, law="total", friction=None, tension=None, sleeve=False,
                )  # fmt: skip
            if remove:
                self.remove(3)
            self.advance(load=load, **move)
            self.after(self, "aside")

    def combine(self, load: Any, **_: Any) -> None:
        load = {name: f for name, f in load.items() if name in self.scene.factors}
        if load:
            half = {name: 0.5 * factor for name, factor in load.items()}
            self.solver.combine({"full": load, "half": half})

    def rest(self) -> None:
        self.advance()

    def results(self) -> None:
        """Nothing: the state stays."""

    checkpoint = results
