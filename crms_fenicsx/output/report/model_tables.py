"""Tables of a report that describe the model: mesh, materials, supports, cables, bars, loads."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import datetime, timezone
from typing import Any

import dolfinx
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energies.residual_stress import ResidualStress
from crms_fenicsx.meshes.triangles import area_vectors, cell_sides
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import ALL, Strengths
from crms_fenicsx.model.membrane import COMPONENTS
from crms_fenicsx.output.report.bar_tables import families
from crms_fenicsx.output.report.page import Cell, Table, number, shown
from crms_fenicsx.output.report.results_tables import Units, part_name
from crms_fenicsx.results.reactions import held_lengths
from crms_fenicsx.results.summary import held_groups
from crms_fenicsx.runtime.arrays import Array, Integers, floats
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene

Row = tuple[str | int | float | None, ...]


@dataclass(frozen=True)
class ModelData:
    """A scene by plain numbers and texts, the same on all ranks."""

    cells: int  # cells, vertices, ranks: how many there are
    vertices: int
    ranks: int
    # least, mean and largest length of the cells' stress-free sides (length)
    sides: tuple[float, float, float]
    low: tuple[float, ...]  # low, high: corners of the stress-free surface's box (length)
    high: tuple[float, ...]
    area: float  # stress-free (length squared)
    materials: tuple[Row, ...]  # rows: part, its stress-free area, kind of material, its data
    # by part in warp and weft (force per length); under "" of the whole membrane
    strengths: Mapping[str, Strengths]
    supports: tuple[Row, ...]  # rows: group, directions, vertices, length of its edges
    cables: tuple[Row, ...]  # rows: name, EA, unstressed length, friction, ends, how it lies
    bars: tuple[Row, ...]  # rows: name, kind, EA, unstressed length, ends
    joints: tuple[Row, ...]  # rows: name, directions in which it is held, place (length)
    # rows: name, kind, mean size per area at the factor 1, components of the sum; of ponds no sizes
    loads: tuple[Row, ...]
    # names and texts: pressure, laws, sealed air, floor, terms of the user's own
    other: Mapping[str, str]

    @property
    def size(self) -> float:
        """Largest extent (length)."""
        return max(b - a for a, b in zip(self.low, self.high, strict=True))


def model_data(scene: Scene) -> ModelData:
    """Describe a scene. Collective."""
    mesh, comm = scene.mesh.mesh, scene.comm
    owned = mesh.topology.index_map(2).size_local
    sides = np.linalg.norm(cell_sides(mesh, np.arange(owned, dtype=np.int32)), axis=2)
    least = comm.allreduce(float(sides.min(initial=np.inf)), op=MPI.MIN)
    largest = comm.allreduce(float(sides.max(initial=0.0)), op=MPI.MAX)
    cells = mesh.topology.index_map(2).size_global
    mean = comm.allreduce(float(sides.sum())) / (3 * cells)
    areas = np.linalg.norm(area_vectors(mesh)[:owned], axis=1)
    places = scene.membrane.stress_free
    low = [-comm.allreduce(float((-x).max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    high = [comm.allreduce(float(x.max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    return ModelData(
        cells,
        scene.V.dofmap.index_map.size_global,
        comm.size,
        (least, mean, largest),
        tuple(low),
        tuple(high),
        comm.allreduce(float(areas.sum())),
        _materials(scene, areas),
        dict(scene.membrane.strengths),
        _supports(scene),
        tuple(_cable(cable) for cable in scene.cables),
        tuple(_bar(bar) for bar in scene.bars),
        tuple(_joint(joint) for joint in scene.joints),
        _loads(scene),
        _other(scene),
    )


STATE = {
    "materials": (), "supports": (3,), "cables": (2,), "bars": (3,), "joints": (2, 3, 4),
    "loads": (3, 4, 5),
}  # fmt: skip
"""Tables of a model, with those of their columns that are of the state it is described in."""


def merged(models: Mapping[str, ModelData]) -> ModelData:
    """The descriptions of a scene that combinations were brought on with, as one."""
    tables: dict[str, Any] = {}
    for table, of_state in STATE.items():
        found: dict[object, tuple[str, Row]] = {}
        for names, model in models.items():
            for row in getattr(model, table):
                others, known = found.setdefault(row[0], (names, row))
                a, b = ([x for k, x in enumerate(one) if k not in of_state] for one in (known, row))
                if a != b:
                    raise InputError(
                        f"report: the {table} of the combinations {others} and {names} differ: "
                        f"{tuple(a)} and {tuple(b)}; write a report of its own for each model."
                    )
        tables[table] = tuple(row for _, row in found.values())
    texts: dict[str, dict[str, list[str]]] = {}
    for names, model in models.items():
        for name, text in model.other.items():
            texts.setdefault(name, {}).setdefault(text, []).append(names)
    other = {
        name: "; ".join(
            text if len(of) == len(models) else f"{', '.join(of)}: {text}"
            for text, of in found.items()
        )
        for name, found in texts.items()
    }
    return replace(next(iter(models.values())), other=other, **tables)


def _materials(scene: Scene, areas: Array) -> tuple[Row, ...]:
    membrane, rows = scene.membrane, []
    for k, material in membrane.materials.items():
        cells: Integers = np.arange(len(areas))
        if membrane.cell_tags is not None:
            cells = np.flatnonzero(membrane.cell_tags.values[: len(areas)] == k)
        area = scene.comm.allreduce(float(areas[cells].sum()))
        part = membrane.parts.get(k, ALL) or "whole membrane"
        rows.append((part, area, type(material).__name__, _data(material)))
    return tuple(rows)


def _data(thing: Any) -> str:
    """The fields of a dataclass as text."""
    if not is_dataclass(thing):
        return ""
    return ", ".join(f"{one.name} = {_text(getattr(thing, one.name))}" for one in fields(thing))


def _text(value: Any) -> str:
    if callable(value):
        return f"function {getattr(value, '__name__', type(value).__name__)}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(_text(x) for x in value) + ")"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _supports(scene: Scene) -> tuple[Row, ...]:
    rows: list[Row] = []
    own, comm = scene.V.dofmap.index_map.size_local, scene.comm
    for name, (directions, dofs) in held_groups(scene.membrane).items():
        length = None
        if name in scene.mesh.edges:
            lengths = held_lengths(scene.membrane, name)[:own]
            length = comm.allreduce(float(lengths.max(axis=1).sum()))
        count = comm.allreduce(int(np.count_nonzero(dofs < own)))
        rows.append((name, ", ".join(directions), count, length))
    held = comm.allreduce(int(np.count_nonzero(scene.held[:own].any(axis=1))))
    return (*rows, ("all held vertices", "", held, None))


def _cable(cable: LaidCable) -> Row:
    friction = cable.cable.friction
    data = _data(friction) if isinstance(friction, Friction) else f"mu = {friction:g}"
    free = cable.slides_freely and cable.cable.along == 0.0
    lies = "in the edge's sleeve" if cable.in_edge else "in a sleeve" if cable.sleeve else "loose"
    ends = " / ".join(
        joint or ("anchored" if end != "tied" else "tied")
        for end, joint in zip(cable.ends, cable.joints, strict=True)
    )
    return cable.name, cable.cable.EA, cable.L0, "none" if free else data, ends, lies


def _bar(bar: PlacedBar) -> Row:
    kind = "guy, tension only" if bar.bar.tension_only else "tension and compression"
    start, end = (one.name if isinstance(one, Joint) else f"vertex at {_text(one.place)}"
                  for one in (bar.start, bar.end))  # fmt: skip
    return bar.name, kind, bar.bar.EA, bar.L0, start, end


def _joint(joint: Joint) -> Row:
    directions = ", ".join(letter for letter, k in COMPONENTS.items() if joint.held[k])
    return joint.name, directions, *floats(joint.position)


def _loads(scene: Scene) -> tuple[Row, ...]:
    rows: list[Row] = []
    for load in scene.loads:
        total = scene.comm.allreduce(load.forces.sum(axis=0))
        kind = "fixed direction" if load.suction is None else "wind, follows the surface"
        if load.joints:
            kind, total = "on joints", np.sum([*load.joints.values()], axis=0)
        size = None if load.joints else load.intensity
        rows.append((load.name, kind, size, *total.tolist()))
    for pond in scene.ponds:
        given = f"level z = {pond.level:g}" if pond.given == "level" else f"volume {pond.volume:g}"
        kind = f"water of the weight {pond.weight:g} by volume, {given}"
        rows.append((pond.name, kind, None, None, None, None))
    return tuple(rows)


def _other(scene: Scene) -> dict[str, str]:
    pressed, comm = scene.membrane.pressed, scene.comm
    if comm.allreduce(int(np.count_nonzero(~pressed))):
        free = {k: comm.allreduce(int(np.count_nonzero(~pressed[cells])))
                for k, cells in scene.mesh.parts.items()}  # fmt: skip
        where = ", ".join(sorted(name for name, count in free.items() if count == 0))
    else:
        where = "all of the membrane"
    found = {"Pressure acts on": where}
    found["Strain"] = {
        "total": "Green-Lagrange, from the stress-free shape", "step": "step-wise",
    }[scene.strain_law]  # fmt: skip
    if scene.air is not None:
        found["Air"] = (
            f"sealed at the pressure {scene.air.sealed_at:g} in the volume {scene.air.volume:g}, "
            f"exponent {scene.air.exponent:g}; atmosphere {scene.air.atmosphere:g}, temperature "
            f"{scene.air.temperature:g} of that at sealing"
        )
    if scene.floor_level is not None:
        found["Rigid floor at z"] = f"{scene.floor_level:g}"
    added = [term.name for term in scene.terms]
    if ResidualStress.name in added:
        added.remove(ResidualStress.name)
        found["Residual section forces"] = (
            "those of the form beside its prestress, with which it is in equilibrium; the section "
            "forces below have them"
        )
    if added:
        found["Terms of the energy added by the user"] = ", ".join(added)
    return found


def mesh(model: ModelData, units: Units) -> Table:
    """The mesh and what it is computed with."""
    m = units["length"]
    extents = [b - a for a, b in zip(model.low, model.high, strict=True)]
    rows: list[tuple[Cell, ...]] = [
        ("Triangular cells", model.cells),
        ("Vertices", model.vertices),
        (f"Sides of cells{m}: least, mean, largest", ", ".join(map(number, model.sides))),
        (f"Extents in x, y, z, stress-free{m}", " by ".join(map(number, extents))),
        (f"Stress-free area{units['area']}", model.area),
        *model.other.items(),
    ]
    return Table("Mesh and theory", ("Property", "Value"), [(a, shown(b)) for a, b in rows])


def materials(model: ModelData, units: Units) -> Table:
    """Materials by part."""
    columns = ("Part", f"Area{units['area']}", "Material", "Data")
    return Table("Membrane", columns, model.materials)


def strengths(model: ModelData, units: Units) -> Table:
    """Strengths by part."""
    rows = [(part_name(part), *pair) for part, pair in model.strengths.items()]
    line = units["stress"]
    return Table("Strengths", ("Part", f"Warp{line}", f"Weft{line}"), rows)


def supports(model: ModelData, units: Units) -> Table:
    """Where the membrane is held."""
    columns = ("Group", "Held directions", "Vertices", f"Length of edges{units['length']}")
    return Table("Supports of the membrane", columns, model.supports)


def cables(model: ModelData, units: Units) -> Table:
    """The cables."""
    columns = (
        "Cable", f"EA{units['force']}", f"Unstressed length{units['length']}", "Friction",
        "Start / end", "Lies",
    )  # fmt: skip
    return Table("Cables", columns, model.cables)


def bars(model: ModelData, units: Units) -> Table:
    """The bars; of a family the first one's data, from its start to the last one's end."""
    by_name = {str(row[0]): row for row in model.bars}
    rows: list[tuple[Cell, ...]] = []
    for label, own in families(list(by_name)).items():
        _, kind, EA, L0, start, _ = by_name[own[0]]
        rows.append((label, kind, EA, L0, start, by_name[own[-1]][-1]))
    columns = (
        "Bar", "Kind", f"EA{units['force']}", f"Unstressed length{units['length']}", "Start", "End",
    )  # fmt: skip
    return Table("Bars", columns, rows)


def joints(model: ModelData, units: Units) -> Table:
    """The joints."""
    at = (f"{x}{units['length']}" for x in "xyz")
    return Table("Joints", ("Joint", "Held directions", *at), model.joints)


def loads(model: ModelData, units: Units) -> Table:
    """The loads at the factor 1."""
    kN = units["force"]
    columns = (
        "Load", "Kind", f"Mean per area{units['pressure']}", *(f"Sum F{x}{kN}" for x in "xyz"),
    )  # fmt: skip
    rows = []
    for name, kind, intensity, *total in model.loads:
        scale = max((abs(x) for x in total if isinstance(x, float)), default=0.0)
        parts = [0.0 if isinstance(x, float) and abs(x) <= 1e-9 * scale else x for x in total]
        rows.append((name, kind, intensity, *parts))
    return Table("Loads at the factor 1", columns, rows)


def versions(model: ModelData) -> list[tuple[str, str]]:
    """When and with what it was computed."""
    package = __name__.partition(".")[0]
    used = (
        f"{package} {sys.modules[package].__version__}",
        f"DOLFINx {getattr(dolfinx, '__version__', '')}",
        f"PETSc {'.'.join(map(str, PETSc.Sys.getVersion()))}",
        f"NumPy {np.__version__}",
        f"Python {platform.python_version()}",
    )
    processes = "1 process" if model.ranks == 1 else f"{model.ranks} processes"
    return [
        ("Date", datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")),
        ("Computed with", f"{', '.join(used)}, on {processes}"),
    ]
