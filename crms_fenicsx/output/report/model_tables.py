"""Tables of a report that describe the model."""

from __future__ import annotations

import platform
import sys
from datetime import datetime, timezone

import dolfinx
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.output.report.bar_tables import families
from crms_fenicsx.output.report.model_data import ModelData
from crms_fenicsx.output.report.results_tables import Units, part_name
from crms_fenicsx.output.report.tables import Cell, Table, number, shown


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
