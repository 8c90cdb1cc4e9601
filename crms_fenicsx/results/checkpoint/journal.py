"""Checkpoints of all calls of `Solver.advance` in a run, and records of these calls.

Each call has a folder, numbered from 1, with the checkpoint of its last load step and the call's
arguments. A script that is started again makes the same calls. Completed calls are restored from
their folders instead of being computed, so that code between them finds the scene as it was; the
interrupted call continues from its last load step.

By the record of a call a resumed script is compared with the one that was interrupted. It is
derived from the whole state of the scene and from its model, so that whatever becomes part of them
is compared, too. Arrays on the mesh are recorded by weighted sums and functions by their values on
the mesh: the same on any number of processes, to rounding.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.strip import Strip
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers, Rows
from crms_fenicsx.foundation.runtime.checks import LONGEST
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import PARTIAL, explained, make_writable, partial_of
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.tolerances import SAME_VALUE
from crms_fenicsx.results.checkpoint.checkpoint_files import ASIDE, complete
from crms_fenicsx.results.checkpoint.codec import Plain, decode, encode
from crms_fenicsx.results.checkpoint.saving import (
    STATE,
    Run,
    cell_ids,
    described,
    edge_vertices,
    fingerprint,
    mixed,
    read,
    reading,
    refuse_history,
    restore,
    save,
)
from crms_fenicsx.results.quantities import summed


def _name(key: object) -> str:
    if isinstance(key, Joint | PlacedBar):
        return f"{'joint' if isinstance(key, Joint) else 'bar'} {key.name!r}"
    if isinstance(key, CableEnd):
        return f"{key.which} of the cable {key.cable.name!r}"
    return f"cable {key.name!r}" if isinstance(key, LaidCable) else f"group {key!r}"


def difference(was: object, now: object) -> str | None:
    """First difference of plain data beyond rounding, in words; None if there is none."""
    if isinstance(was, dict) and isinstance(now, dict):
        for name in {**was, **now}:
            found = difference(was.get(name), now.get(name))
            if found is not None:
                label = name if name == "name" or "name" not in now else f"{now['name']!r}, {name}"
                return label + ("" if found.startswith((" =", ":")) else ", ") + found
        return None
    if _numeric(was) and _numeric(now):
        a, b = np.atleast_1d(was), np.atleast_1d(now)  # type: ignore[call-overload]
        size = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        if a.shape == b.shape and np.all(np.abs(a - b) <= SAME_VALUE * size):
            return None
    elif was == now:
        return None
    elif isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        pairs = zip(was, now, strict=True)
        found = next((d for a, b in pairs if (d := difference(a, b)) is not None), None)
        if found is None or not found.startswith(" ="):
            return found and f": {found}"
    before, after = (
        text if len(text := repr(value)) <= LONGEST else text[:LONGEST] + "..."
        for value in (was, now)
    )
    return f" = {before}, and now {after}"


def _numeric(value: object) -> bool:
    """Whether the value is a rounded number, or a list of such."""
    values: list[Any] = value if isinstance(value, list) and value else [value]
    return all(isinstance(one, float) for one in values)


WAY = ("nodes", "positions", "fractions", "lifted", "reference_positions")
"""Fields of a cable's state that are recorded by the moments of its way: its points depend on
rounding where it meets vertices."""


def scene_record(scene: Scene) -> Plain:
    """A scene as numbers and texts, independent of the number of ranks to rounding. Collective."""
    storage = _RecordStorage(scene)
    mesh, cells = scene.mesh, cell_ids(scene)[0]
    pressed = scene.membrane.pressed[: len(cells)].astype(np.int64)
    edges = np.sort(edge_vertices(scene), axis=1)
    groups = {
        "parts": {name: mixed(scene, cells[_own(rows, len(cells)), None])
                  for name, rows in sorted(mesh.parts.items())},
        "edges": {name: mixed(scene, edges[_own(rows, storage.own_edges)])
                  for name, rows in sorted(mesh.edges.items())},
        "points": {
            name: mixed(scene, storage.ids[_own(rows, storage.own), None])
            for name in sorted(mesh.points)
            for rows in [fem.locate_dofs_topological(scene.V, 0, mesh.points[name])]
        },
    }  # fmt: skip
    return {
        **fingerprint(scene),
        "groups of the mesh (mixed to one number each)": groups,
        "pressure_on (cells, mixed to one number)": mixed(scene, np.stack([cells, pressed], 1)),
        "section forces of added terms": [
            None if term.section_forces is None
            else storage.write("", Rows.CELLS, term.section_forces)
            for term in scene.terms
        ],
        **encode(scene.state, storage),
    }  # fmt: skip


def _own(rows: Indices, count: int) -> Indices:
    return rows[rows < count]


class _RecordStorage:
    """Replaces the arrays of a scene's state by sums that do not depend on the ranks."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.ids = scene, scene.membrane.vertex_ids
        self.own = scene.V.dofmap.index_map.size_local
        self.own_edges = scene.mesh.mesh.topology.index_map(1).size_local

    def reduce(self, value: Any) -> Any:
        """A material as numbers, a cable by its way; a strip belongs to the mesh."""
        if isinstance(value, Strip):
            return None
        if isinstance(value, MembraneMaterial):
            return described(value)
        if isinstance(value, CableState):
            found = {one.name: getattr(value, one.name) for one in fields(value)}
            kept = {name: one for name, one in found.items() if name not in WAY}
            return kept | {"way": way(value)}
        return value

    def write(self, path: str, rows: Rows, values: Array) -> Any:
        """Weighted sums over all ranks and the largest component; Booleans as one number.
        Collective."""
        if rows is Rows.EDGES:
            pairs = np.sort(edge_vertices(self.scene)[: self.own_edges], axis=1)
            return mixed(self.scene, pairs[values[: self.own_edges]])
        if rows is Rows.SHARES:
            values = summed(self.scene.V, np.arange(len(values)), values)
        ids: Integers = cell_ids(self.scene)[0] if rows is Rows.CELLS else self.ids[: self.own]
        columns = values[: len(ids)].reshape(len(ids), -1)
        if columns.dtype == bool:
            return mixed(self.scene, np.column_stack([ids, columns.astype(np.int64)]))
        weights = 0.5 + (0.6180339887498949 * ids) % 1.0
        sums: Array = self.scene.comm.allreduce(weights @ columns)
        largest = self.scene.comm.allreduce(float(np.abs(columns).max(initial=0.0)), op=MPI.MAX)
        return [*map(float, sums), largest]

    def read(self, *arguments: Any) -> Any:
        """Nothing is read from a record."""
        raise NotImplementedError

    restore = unsaved = read


def way(state: CableState) -> Plain:
    """Ends, middle and second moments of a cable's polyline."""
    points = state.positions[~state.lifted]
    spans = np.diff(points, axis=0)
    lengths, middles = np.linalg.norm(spans, axis=1), (points[1:] + points[:-1]) / 2
    length = max(float(lengths.sum()), np.finfo(float).tiny)
    places = [lengths @ middles / length, points[0], points[-1]]
    square = np.einsum("s,si,sj->ij", lengths, middles, middles)
    square += np.einsum("s,si,sj->ij", lengths, spans, spans) / 12
    return {
        "ends and middle": [float(x) for place in places for x in place],
        "moments": (square / length).ravel().tolist(),
    }


logger = logging.getLogger("crms_fenicsx")

FOLDER = "checkpoints"
"""Name of the checkpoint folder inside the results folder."""
_OURS = re.compile(rf"({re.escape(PARTIAL)}|{re.escape(ASIDE)})?(\d{{4,9}})")


@dataclass(frozen=True)
class _CallProgress:
    """Progress of a call."""

    # increments done; fractional if increments were halved
    done: float = 0.0
    increment: float = 1.0  # next increment, 1 if whole
    failure: str | None = None  # why the call failed; None if it has not


class Journal:
    """Records the progress of all calls of `Solver.advance`."""

    def __init__(self, folder: Path, comm: MPI.Intracomm, options: Plain, resume: bool) -> None:
        self.folder, self.comm, self.options = folder.resolve(), comm, options
        self._replaying = resume
        self._call: Plain = {}
        self._number = 0
        self._outdated = 1
        """Number of the first call whose folder is from another run; 0 if there are none."""
        checks.from_first(comm, lambda: make_writable(self.folder))

    def begin(self, scene: Scene, given: Mapping[str, Any]) -> tuple[_CallProgress, Run | None]:
        """Begin a call; restore its saved progress and run (None if unsaved). Collective."""
        refuse_history(scene)
        steps, move, L0 = given["steps"], given["move"], given["L0"]
        loads = {name: encode(one) for name, one in given.items() if name not in ("move", "L0")}
        loads["move"] = {_name(key): [float(x) for x in vector] for key, vector in move.items()}
        loads["L0"] = {_name(key): float(length) for key, length in L0.items()}
        self._number += 1
        call: Plain = {"solver": self.options, "advance": loads, "scene": scene_record(scene)}
        saved, place = None, complete(self._place)
        if self._replaying and checks.from_first(self.comm, lambda: os.path.lexists(place / STATE)):
            saved = read(place, self.comm)
        if saved is None:
            self._replaying, self._call, self._outdated = False, call, self._number
            return _CallProgress(), None
        before = saved.call
        if before is None:
            raise InputError(f"{place / STATE} is not a checkpoint of a call; delete it.")
        for name, now in call.items():
            found = difference(before.get(name), now)
            if found is not None:
                raise InputError(
                    f"resume: at call {self._number} of advance the script is not the one that "
                    f"was interrupted: {name}, {found}. Run it as it was, or start again with "
                    f"resume=False, or delete {place} and those after it, to recompute "
                    "from this call on."
                )
        with reading(place / STATE):
            progress = decode(_CallProgress, before["progress"])
        run = restore(place, saved, scene)
        self._call = call
        if progress.done < steps and progress.failure is None:
            self._replaying, self._outdated = False, self._number + 1
        logger.info("call %d of advance: %g of %d steps from %s", self._number, progress.done,
                    steps, place)  # fmt: skip
        return progress, run

    def remove_outdated(self) -> None:
        """Remove the folders of calls that are computed anew. Collective."""
        # One by one from the last: a run killed meanwhile leaves folders it can resume from.
        first, self._outdated = self._outdated, 0
        if first == 0:
            return
        with raised_together(self.comm), explained(self.folder):
            if self.comm.rank == 0:
                found = [(match, path) for path in self.folder.iterdir()
                         if (match := _OURS.fullmatch(path.name))]  # fmt: skip
                order = {PARTIAL: 0, ASIDE: 1, None: 2}
                found.sort(key=lambda one: (-int(one[0][2]), order[one[0][1]]))
                for match, path in found:
                    if int(match[2]) >= first:
                        _remove(path, self.folder / match[2])

    def keep(
        self, scene: Scene, run: Run, done: float, increment: float, failure: str | None
    ) -> None:
        """Checkpoint a load step of the call; see `_CallProgress`. Collective."""
        self.remove_outdated()
        progress = _CallProgress(done, increment, failure)
        save(self._place, scene, run, self._call | {"progress": encode(progress)})

    @property
    def _place(self) -> Path:
        return self.folder / f"{self._number:04d}"


def _remove(path: Path, folder: Path) -> None:
    """Remove a folder, renaming it first so that none is ever left incomplete."""
    partial = partial_of(folder)
    if path != partial:
        if partial.exists():
            shutil.rmtree(partial)
        os.replace(path, partial)
    shutil.rmtree(partial)
