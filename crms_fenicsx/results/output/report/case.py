"""A load case in the report: its extremes, checks and change of shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.foundation.meshes.surface import BOUNDARY
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.design_checks import Extreme, extreme
from crms_fenicsx.results.foundations import Foundations, foundations
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.output.report.page import Figure, Table
from crms_fenicsx.results.quantities import Solved
from crms_fenicsx.results.summary import Summary, summary

BASE = "LC0"
"""Case name of the state that the first combination started from."""

Corner = tuple[float, ...]


@dataclass(frozen=True)
class Case:
    """A load case as shown in a report; plain data, to be sent between processes."""

    name: str  # of the combination
    state: str  # limit state; "" if no combination of `Solver.combine`
    summary: Summary  # extremes
    # checks of this state; None if not verified in this run
    verification: Verification | None
    foundations: Foundations  # forces on foundations
    # since the base state: volume between roof and rim, relative to that before, None if the roof
    # enclosed none, as a sail does; share of the former area turned by more than 90 degrees
    volume: float | None
    turned: float
    deflection: Extreme  # largest displacement since the base state (length)
    # largest smoothed cell values, by part and quantity but the utilisation
    recovered: Mapping[str, Mapping[str, float]]
    # corners of the bounding box of membrane, cables and bars (length)
    low: Corner
    high: Corner
    prestress: float = 1.0  # partial factor of the prestress
    without: tuple[str, ...] = ()  # names of cables and bars that are missing
    # on the first rank: pictures, and the interactive page
    pictures: tuple[Figure, ...] = ()
    view: str = ""
    stage: int = 0  # number of the stage of erection; 0 for a combination
    # pressure and load factors of the combination's base state, if it is not that of the first one
    base: tuple[float, Mapping[str, float]] | None = None

    @property
    def acting(self) -> tuple[float, Mapping[str, float], float, tuple[str, ...]]:
        """What distinguishes it from the base state: pressure, load factors, that of the
        prestress, missing members."""
        return self.summary.pressure, self.summary.factors, self.prestress, self.without


def case_of(solver: Solved, name: str, before: Shape) -> Case:
    """Record the current state of a solver's scene, which had the shape `before`. Collective."""
    system = solver.system
    found, scene, comm = summary(system), system.scene, solver.comm
    places = np.concatenate([scene.positions(), *(cable.line for cable in scene.cables),
                             *(bar.points for bar in scene.bars)])  # fmt: skip
    settled = scene.versions.current.equilibrium
    checked = settled.verification if settled is not None and found.in_equilibrium else None
    return Case(
        name, "" if scene.case.base is None else found.state, found, checked, foundations(system),
        *_shape_change(before, scene), recovered(membrane_results(system), found),
        *box(comm, places), scene.case.prestress, scene.case.without,
    )  # fmt: skip


def recovered(results: MembraneResults, found: Summary) -> dict[str, dict[str, float]]:
    """Largest smoothed cell values, by part and quantity but the utilisation. Collective.

    A smoothed cell value is the mean of its vertices' values, which are means over the adjacent
    cells.
    """
    values: dict[str, dict[str, float]] = {part: {} for part in found.parts}
    for name in sorted(found.membrane.largest.keys() - {"utilisation"}):
        nodal = results.function(name, smooth=True)
        at = nodal.x.array[nodal.function_space.dofmap.list[: len(results.state)]].mean(axis=1)
        for part in found.parts:
            own = at[results.parts[part]] if part else at
            most = float(np.max(own[np.isfinite(own)], initial=-np.inf))
            values[part][name] = results.comm.allreduce(most, op=MPI.MAX)
    return values


def box(comm: MPI.Intracomm, places: Array) -> tuple[Corner, Corner]:
    """Lowest and highest corner of the bounding box of all ranks' places (n, 3). Collective."""
    high = [comm.allreduce(float(x.max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    low = [-comm.allreduce(float((-x).max(initial=-np.inf)), op=MPI.MAX) for x in places.T]
    return tuple(low), tuple(high)


@dataclass(frozen=True)
class Shape:
    """Shape of this rank's cells in a state of a scene."""

    places: Array  # (n, 3) of this rank's vertices (length)
    apex: Array  # (3,) mean of the held vertices in the first state (length)
    vectors: Array  # (m, 3) areas times unit normals (length squared)
    volume: float  # between the cells and the apex: the cone over the rim (length cubed)
    area: float  # of the cells (length squared)
    encloses: bool  # whether the roof encloses a space: its rim is held, or it is under pressure


def shape_of(scene: Scene, apex: Array | None = None) -> Shape:
    """Present shape and volume, about the held vertices' mean or a given apex. Collective."""
    comm, own = scene.comm, scene.mesh.mesh.topology.index_map(2).size_local
    places, n = scene.positions(), scene.V.dofmap.index_map.size_local
    if apex is None:
        held = scene.held[:n].any(axis=1)
        held = held if comm.allreduce(int(held.sum())) else np.ones(n, dtype=bool)
        apex = comm.allreduce(places[:n][held].sum(axis=0)) / comm.allreduce(int(held.sum()))
    corners = places[scene.V.dofmap.list[:own]]
    vectors = double_areas(corners) / 2
    volume = float(((corners.mean(axis=1) - apex) * vectors).sum()) / 3
    volume, area = comm.allreduce(np.array([volume, norm(vectors).sum()])).tolist()
    rim = scene.held[scene.membrane.vertices(BOUNDARY)].any(axis=1).all()
    closed = comm.allreduce(bool(rim), op=MPI.LAND) or scene.pressure != 0.0
    large = abs(volume) > 0.02 * area**1.5
    return Shape(places, apex, vectors, volume, area, closed and large)


def _shape_change(before: Shape, scene: Scene) -> tuple[float | None, float, Extreme]:
    """`Case.volume`, `turned` and `deflection` since an earlier shape. Collective."""
    now = shape_of(scene, before.apex)
    turned = np.einsum("mi,mi->m", before.vectors, now.vectors) < 0.0
    share = scene.comm.allreduce(float(norm(before.vectors)[turned].sum())) / before.area
    volume = now.volume / before.volume if before.encloses else None
    sizes = norm(now.places - before.places)
    return volume, share, extreme(scene.comm, sizes, now.places, largest=True)


def in_order(cases: Sequence[Case], factors: Table) -> list[Case]:
    """The cases in the order of their codes LC0, LC1 ..., so that all tables name the same one
    first."""
    order = [name for row in factors.rows for name in map(str, row[:2])]
    return sorted(cases, key=lambda case: order.index(case.name))


def with_codes(cases: Sequence[Case], factors: Table) -> list[Case]:
    """The cases; if a name is long, renamed to their codes LC0, LC1 ..."""
    codes = {str(row[1]): str(row[0]) for row in factors.rows}
    codes |= {code: code for code in codes.values()}
    if max(len(case.name) for case in cases) < 28:
        return list(cases)
    return [
        replace(case, name=codes[case.name], pictures=tuple(
            replace(one, caption=one.caption.replace(case.name, codes[case.name], 1))
            for one in case.pictures
        ))
        for case in cases
    ]  # fmt: skip
