"""Tables of the model: mesh, materials, supports, cables, bars, loads."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import datetime, timezone
from typing import Any

import dolfinx
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.meshes.triangles import cell_sides
from crms_fenicsx.foundation.runtime.arrays import Array, floats
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.combination_table import CombinationTable
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import COMPONENTS
from crms_fenicsx.model.membrane_load import MembraneLoad
from crms_fenicsx.model.strengths import ALL
from crms_fenicsx.results.foundations import partition
from crms_fenicsx.results.output.report.case import box
from crms_fenicsx.results.output.report.design_tables import (
    BARS,
    CABLES,
    MAKE,
    bar_values,
    cable_make,
    cable_values,
    limits_in_service,
)
from crms_fenicsx.results.output.report.page import Cell, Figure, Table, Units, number, shown
from crms_fenicsx.results.output.report.results_tables import Row, clean, families
from crms_fenicsx.results.output.report.verdict import listed
from crms_fenicsx.results.quantities import load_values
from crms_fenicsx.results.reactions import held_groups, held_lengths


@dataclass(frozen=True)
class Model:
    """Tables of a scene, the same on all ranks, and its pictures."""

    size: float  # largest extent of the stress-free surface (length)
    ranks: int
    tables: dict[str, Table]  # by subject
    pictures: Sequence[Figure] = ()  # of model and loads, on the first rank
    loads: Sequence[Figure] = ()
    outline: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))  # in the base state
    pressure: float = 0.0  # of the base state (force per area)
    factors: Mapping[str, float] = field(default_factory=dict)  # of the loads in the base state
    basis: Mapping[str, str] = field(default_factory=dict)  # what loads say of codes, by name
    combined: Sequence[CombinationTable] = ()  # tables that the combinations are of


def model_of_scene(scene: Scene, units: Units) -> Model:
    """Tables of a scene. Collective."""
    areas = scene.membrane.cell_areas
    low, high = box(scene.comm, scene.membrane.stress_free)
    extents = [b - a for a, b in zip(low, high, strict=True)]
    listed: dict[str, tuple[str, str, list[Row]]] = {
        "mesh": ("Mesh and theory", "Property|Value", _mesh(scene, areas, extents, units)),
        "materials": ("Membrane", "Part|Area{area}|Material|Data", _materials(scene, areas, units)),
        "cable make": ("Make of the cables", MAKE, cable_make(scene, units)),
        "cable values": (*CABLES, cable_values(scene)),
        "bar values": (*BARS, bar_values(scene.bars, units)),
        "limits": (
            "Limits in service",
            "Limit|Value",
            limits_in_service(scene.design.limits, units),
        ),
        "supports": (
            "Supports of the membrane",
            "Group|Held directions|Vertices|Length of edges{length}",
            _supports(scene),
        ),
        "cables": (
            "Cables",
            "Cable|EA{force}|Unstressed length{length}|Friction|Start / end|Position|"
            "Expansion [1/K]",
            [_cable(cable, units) for cable in scene.cables],
        ),
        "bars": (
            "Bars",
            "Bar|Kind|EA{force}|Unstressed length{length}|Start at x; y; z{length}|"
            "End at x; y; z{length}|Expansion [1/K]",
            [_bar(bar, units) for bar in scene.bars],
        ),
        "joints": (
            "Joints",
            "Joint|Held directions|x{length}|y{length}|z{length}",
            [
                (
                    joint.name,
                    ", ".join(x for x, k in COMPONENTS.items() if joint.held[k]),
                    *map(units.exact, clean(floats(joint.position), max(extents), 1e-4)),
                )
                for joint in scene.joints
                if not is_unnamed(joint.name)
            ],
        ),
        "loads": (
            "Loads at the factor 1",
            "Load|Kind|Mean per area{pressure}|On the surface{pressure}, of wind c_p|Sum Fx{force}|"
            "Sum Fy{force}|Sum Fz{force}",
            _loads(scene),
        ),
    }
    tables = {
        name: Table(caption, units.headings(columns), rows, small=name in ("bars", "bar values"))
        for name, (caption, columns, rows) in listed.items()
    }
    return Model(
        max(extents), scene.comm.size, tables, pressure=scene.pressure, factors=scene.factors,
        basis=_basis(scene, units),
    )  # fmt: skip


PRESSED = "Pressure acts on"
"""Property that only models under inner pressure need."""

STATE = {
    "materials": (1,), "supports": (3,), "cables": (2,), "bars": (3,), "joints": (2, 3, 4),
    "loads": (3, 4, 5, 6), "cable values": (), "cable make": (), "bar values": (6, 7, 8, 9, 10),
}  # fmt: skip
"""Tables whose listed columns depend on the state; areas of parts do as lines slide."""


def merged(models: Mapping[str, Model], stages: Collection[str] = ()) -> Model:
    """One model from the models of the combinations, with what is other in stages of erection."""
    first = next(iter(models.values()))
    tables = dict(first.tables)
    for key, of_state in STATE.items():
        found: dict[object, tuple[str, Sequence[Cell]]] = {}
        for names, model in models.items():
            for row in model.tables[key].rows:
                others, known = found.setdefault(row[0], (names, row))
                a, b = ([x for k, x in enumerate(one) if k not in of_state] for one in (known, row))
                if a != b and names in stages:
                    found[(row[0], *b)] = names, (f"{row[0]}, {names}", *row[1:])
                elif a != b:
                    raise InputError(
                        f"report: the {key} of the combinations {others} and {names} differ: "
                        f"{tuple(a)} and {tuple(b)}; write a report of its own for each model."
                    )
        tables[key] = replace(tables[key], rows=[row for _, row in found.values()])
    texts: dict[Cell, dict[Cell, list[str]]] = {}
    for names, model in models.items():
        for name, text in model.tables["mesh"].rows:
            of = texts.setdefault(name, {})  # sides of cells change as lines slide
            of.setdefault(next(iter(of), text) if "Sides" in str(name) else text, []).append(names)
    rows = [
        (name, "; ".join(
            str(text) if len(of) == len(models) else f"{', '.join(of)}: {text}"
            for text, of in every.items()
        ))
        for name, every in texts.items()
    ]  # fmt: skip
    return replace(first, tables=tables | {"mesh": replace(tables["mesh"], rows=rows)})


def in_families(bars: Table) -> Table:
    """Table of bars with one row per family: the first bar's data, and the last bar's end."""
    by_name = {str(row[0]): row for row in bars.rows}
    rows = [
        (label, *by_name[own[0]][1:-1], by_name[own[-1]][-1])
        for label, own in families(list(by_name)).items()
    ]
    return replace(bars, rows=rows)


def _mesh(scene: Scene, areas: Array, extents: list[float], units: Units) -> list[Row]:
    mesh, comm, m = scene.mesh.mesh, scene.comm, units["length"]
    sides = np.linalg.norm(cell_sides(mesh), axis=2)
    cells = mesh.topology.index_map(2).size_global
    lengths = (
        comm.allreduce(float(sides.min(initial=np.inf)), op=MPI.MIN),
        comm.allreduce(float(sides.sum())) / (3 * cells),
        comm.allreduce(float(sides.max(initial=0.0)), op=MPI.MAX),
    )
    rows: list[Row] = [
        ("Triangular cells", cells),
        ("Vertices", scene.V.dofmap.index_map.size_global),
        (f"Sides of cells{m}: least, mean, largest", ", ".join(map(number, lengths))),
        (f"Extents in x, y, z, stress-free{m}", " by ".join(map(number, extents))),
        (f"Stress-free area{units['area']}", comm.allreduce(float(areas.sum()))),
        *_theory(scene, units).items(),
    ]
    return [(name, shown(value)) for name, value in rows]


def _materials(scene: Scene, areas: Array, units: Units) -> list[Row]:
    membrane, rows = scene.membrane, list[Row]()
    for k, material in membrane.materials.items():
        tags = membrane.cell_tags
        own = areas if tags is None else areas[tags.values == k]
        area = scene.comm.allreduce(float(own.sum()))
        part = membrane.parts.get(k, ALL) or "whole membrane"
        data = _material(material, units, membrane.frames is not None)
        kind = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(material).__name__).lower()
        rows.append((part, area, kind, data))
    return rows


MODULI = ("E", "E1", "E2", "G12")
"""Fields of materials that are told times the thickness, in force per length."""


def _material(material: Any, units: Units, sewn: bool) -> str:
    """Fields of a material as text, with units."""
    if not is_dataclass(material):
        return ""
    found, thickness = dict[str, str](), getattr(material, "thickness", 1.0)
    for name in (one.name for one in fields(material)):
        value = getattr(material, name)
        if name in MODULI:
            found[f"{name} t"] = _text(float(value * thickness)) + units.plain("stress")
        elif name == "warp" and sewn:
            found[name] = "as the pieces are cut"
        elif name == "dT" or value is None:  # of the state; unknown
            continue
        elif name != "thickness" or value != 1.0:  # 1: moduli are given times the thickness
            kind = {"thickness": "length", "prestress": "stress"}.get(name)
            found[name] = _text(value) + (units.plain(kind) if kind else "")
    return _listed(found)


def _listed(texts: Mapping[str, str]) -> str:
    return ", ".join(f"{name} = {text}" for name, text in texts.items())


def _text(value: Any) -> str:
    if callable(value):
        return f"function {getattr(value, '__name__', type(value).__name__)}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(_text(x) for x in value) + ")"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _supports(scene: Scene) -> list[Row]:
    rows: list[Row] = []
    own, comm = scene.V.dofmap.index_map.size_local, scene.comm
    groups = held_groups(scene.membrane)
    for name in partition(scene):
        if name not in groups:
            continue
        directions, dofs = groups[name]
        length = None
        if name in scene.mesh.edges:
            lengths = held_lengths(scene.membrane, name)[:own]
            length = comm.allreduce(float(lengths.max(axis=1).sum()))
        count = comm.allreduce(int(np.count_nonzero(dofs < own)))
        rows.append((name, ", ".join(directions), count, length))
    held = comm.allreduce(int(np.count_nonzero(scene.held[:own].any(axis=1))))
    return [*rows, ("all held vertices", "", held, None)] if held else rows


def _cable(cable: LaidCable, units: Units) -> Row:
    friction = cable.cable.friction
    friction = friction if isinstance(friction, Friction) else Friction(friction)
    data = _listed({one.name: _text(getattr(friction, one.name)) for one in fields(friction)})
    free = cable.slides_freely and cable.cable.along == 0.0
    names = {"outside": "on the membrane", "sleeve": "in a sleeve", "pocket": "in a pocket"}
    lies = names.get(cable.hold, cable.hold)
    lies += "" if cable.state.laid.line is None else ", on a mesh line"
    held = (
        joint or ("anchored" if end != "tied" else "tied")
        for end, joint in zip(cable.ends, cable.state.laid.joints, strict=True)
    )
    ends = " / ".join(dict.fromkeys(held))  # once if alike, to keep rows on one line
    L0, friction_data = units.exact(cable.L0), "none" if free else data
    return cable.name, cable.cable.EA, L0, friction_data, ends, lies, cable.cable.expansion


def _bar(bar: PlacedBar, units: Units) -> Row:
    kind = "tie, tension only" if bar.bar.tension_only else "strut"
    start, end = (
        _place(one.place, units) if not isinstance(one, Joint)
        else _place(one.position, units) if is_unnamed(one.name) else one.name
        for one in (bar.start, bar.end)
    )  # fmt: skip
    return bar.name, kind, bar.bar.EA, units.exact(bar.L0), start, end, bar.bar.expansion


def _place(at: Iterable[float], units: Units) -> str:
    return "; ".join(shown(units.exact(float(x) + 0.0)) for x in at)


def is_unnamed(joint: str) -> bool:
    """Whether a joint has the name that it gets as the end of its bar."""
    return joint.startswith(("start of ", "end of "))


def _loads(scene: Scene) -> list[Row]:
    rows: list[Row] = []
    for load in scene.loads:
        if load.warms:
            changes = [f"{name or 'all'} {dT:+g} K" for name, dT in load.warms.items()]
            rows.append((load.name, f"temperature: {', '.join(changes)}", *5 * [None]))
            continue
        total = scene.comm.allreduce(load.forces.sum(axis=0))
        kind = "fixed direction" if load.suction is None else "wind, follows the surface"
        size: float | None = load.intensity
        if load.joints:
            fabric = scene.comm.allreduce(float(np.abs(load.forces).sum())) > 0.0
            kind, size = (f"{kind}, also on joints", size) if fabric else ("on joints", None)
            total = total + np.sum([*load.joints.values()], axis=0)
        total = clean(total.tolist(), float(abs(total).max()), 1e-4)
        rows.append((load.name, kind, size, _range(scene, load), *total))
    for pond in scene.ponds:
        given = f"level z = {pond.level:g}" if pond.given == "level" else f"volume {pond.volume:g}"
        kind = f"water of the weight {pond.weight:g} by volume, {given}"
        rows.append((pond.name, kind, *(None,) * 5))
    return rows


def _range(scene: Scene, load: MembraneLoad) -> str | None:
    """Least and largest coefficient of a wind, or force per area of another load on cells; None of
    forces on points and lines. Collective."""
    if load.suction is None and load.material is None:
        return None
    values = load_values(scene, load.name)
    low = scene.comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN)
    high = scene.comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX)
    ends = dict.fromkeys(number(x) for x in (low, high))
    return " to ".join(ends)


def _basis(scene: Scene, units: Units) -> dict[str, str]:
    """Velocity pressures, and what the functions of loads say of themselves."""
    found = dict[str, str]()
    for load in scene.loads:
        peak = f"q_p = {number(load.peak)}{units.plain('pressure')}" if load.peak else ""
        grown = f"coefficients of expansion: {_expansions(scene, load)}" if load.warms else ""
        text = ", ".join(x for x in (peak, load.basis, grown) if x)
        if text:
            found[f"Load {load.name}"] = text
    return found


def _expansions(scene: Scene, load: MembraneLoad) -> str:
    """Coefficients of thermal expansion of what a temperature load changes, and of which
    members."""
    found = dict[str, list[str]]()
    parts = scene.membrane.parts
    warmed: list[tuple[str, Any, Any]] = [
        (f"fabric {parts.get(k, ALL)}".strip(), one, k) for k, one in scene.materials.items()
    ]
    warmed += [(one.name, one.cable, one) for one in scene.cables]
    warmed += [(one.name, one.bar, one) for one in scene.bars]
    for name, of, member in warmed:
        if any(one is load for one, _ in scene.loads.warmings(member)):
            found.setdefault(_text(getattr(of, "expansion", None)), []).append(name)
    return "; ".join(f"{x} 1/K of {listed(names)}" for x, names in found.items())


def _theory(scene: Scene, units: Units) -> dict[str, str]:
    """Texts on pressure, laws, sealed air, floor and user-defined terms."""
    pressed, comm = scene.membrane.pressed, scene.comm
    if comm.allreduce(int(np.count_nonzero(~pressed))):
        free = {k: comm.allreduce(int(np.count_nonzero(~pressed[cells])))
                for k, cells in scene.mesh.parts.items()}  # fmt: skip
        where = ", ".join(name for name, count in free.items() if count == 0)
    else:
        where = "all of the membrane"
    found = {PRESSED: where}
    found["Strain"] = {
        "total": "Green-Lagrange, from the stress-free shape", "step": "step-wise",
    }[scene.strain_law]  # fmt: skip
    air = scene.air.sealed
    if air is not None:
        found["Air"] = (
            f"sealed at the pressure {number(air.sealed_at)}{units.plain('pressure')} in the "
            f"volume {number(air.volume)}{units.plain('volume')}, exponent {air.exponent:g}; "
            f"atmosphere {air.atmosphere:g}{units.plain('pressure')}, temperature "
            f"{air.temperature:g} of that at sealing"
        )
    if scene.floor_level is not None:
        found["Rigid floor at z"] = f"{scene.floor_level:g}{units.plain('length')}"
    added = [term.name for term in scene.terms]
    if ResidualStress.name in added:
        added.remove(ResidualStress.name)
        found["Residual section forces"] = (
            "deviations of the form's equilibrium forces from the prescribed prestress; the "
            "section forces below include them"
        )
    if added:
        found["Terms of the energy added by the user"] = ", ".join(added)
    return found


def versions(ranks: int) -> list[tuple[str, str]]:
    """Date and software versions of the computation."""
    package = __name__.partition(".")[0]
    used = (
        f"DOLFINx {getattr(dolfinx, '__version__', '')}",
        f"PETSc {'.'.join(map(str, PETSc.Sys.getVersion()))}",
        f"NumPy {np.__version__}",
        f"Python {platform.python_version()}",
    )
    now = datetime.now(timezone.utc)
    processes = "1 process" if ranks == 1 else f"{ranks} processes"
    return [
        ("Date", f"{now:%Y-%m-%d}"),
        ("Program", f"{package} {sys.modules[package].__version__}"),
        ("Computed with", f"{', '.join(used)}, on {processes}, {now:%H:%M} UTC"),
    ]
