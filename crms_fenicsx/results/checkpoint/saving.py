"""Save a scene and its run to a folder, and restore them."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.cabling.cables.strip import Strip, cells_at
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.energy.terms.kinematics import warp_directions
from crms_fenicsx.foundation.meshes.edge_table import edge_keys
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, vertex_ids
from crms_fenicsx.foundation.meshes.triangles import lists
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Booleans, Integers, Rows
from crms_fenicsx.foundation.runtime.checks import LONGEST
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import explained, read_text, readable
from crms_fenicsx.foundation.runtime.handle import Handle
from crms_fenicsx.model.changed_materials import numbers, with_numbers
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.results.checkpoint.checkpoint_files import (
    complete,
    digest,
    read_rows,
    replaced_folder,
    write_rows,
)
from crms_fenicsx.results.checkpoint.codec import Plain, decode, encode

STATE = "state.json"
POSITIONS = "positions"
"""File name of the stress-free vertices of the mesh as given."""
FORMAT = "crms_fenicsx checkpoint 16"
"""Format mark of a checkpoint; its number grows with each change of the content."""


@dataclass(frozen=True)
class Run:
    """A solver's record of its load steps."""

    steps: list[Step]  # accepted load steps
    rows: list[Mapping[str, int | float | str]]  # rows of the history
    tried: TriedPaths | None  # paths tried and rejected; None before the first


@dataclass(frozen=True)
class Contents:
    """Contents of a checkpoint except the arrays on the mesh."""

    scene: Plain  # identifies the scene, see `fingerprint`
    positions: Plain  # description of the file of the vertices of the mesh as given
    state: Plain  # a `SceneState`
    state_version: int  # of the scene's versions
    in_equilibrium: bool  # whether the scene was unchanged since the last load step
    verification: Verification | None  # of that step's state
    run: Run
    # call of `Solver.advance` that the checkpoint belongs to, if any
    call: Plain | None


def save(folder: str | Path, scene: Scene, run: Run, call: Plain | None = None) -> None:
    """Write a checkpoint; see `Solver.save`. Collective."""
    with replaced_folder(Path(folder).resolve(), scene.comm, STATE) as partial:
        storage, found = _SceneStorage(partial, scene), scene.versions.current.equilibrium
        settled, before = scene.in_equilibrium(), run.steps[:-1]
        last = [replace(x, verification=_finite(x.verification)) for x in run.steps[-1:]]
        contents = Contents(
            fingerprint(scene),
            storage.write(POSITIONS, Rows.VERTICES, scene.membrane.given),
            encode(scene.state, storage),
            scene.versions.state_version,
            settled,
            _finite(found.verification) if settled and found is not None else None,
            # the checks of all steps in all checkpoints of a long run would take much room
            replace(run, steps=[*(replace(one, verification=None) for one in before), *last]),
            call,
        )
        data = encode(contents)
        with raised_together(scene.comm), explained(partial / STATE):
            if scene.comm.rank == 0:
                (partial / STATE).write_text(signed(data), encoding="utf-8")


def _finite(found: Verification | None) -> Verification | None:
    """Checks whose values JSON can write; what is infinite fails as before."""
    if found is None:
        return None
    most = sys.float_info.max
    return replace(
        found, checks=tuple(replace(x, value=min(x.value, most)) for x in found.checks)
    )  # fmt: skip


class _SceneStorage:
    """Stores a scene's arrays in files, in the mesh's original numbering, and handles by name."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self.folder, self.scene, self.comm = folder, scene, scene.comm
        vertices = scene.V.dofmap.index_map
        self._own, self._vertices = vertices.size_local, vertices.size_global
        self._ids = scene.membrane.vertex_ids
        self._held_edges: Booleans | None = None  # as read
        held: list[Handle[Any]] = [*scene.cables, *scene.joints, *scene.bars]
        self._handles: dict[tuple[type, str], Any] = {(type(one), one.name): one for one in held}

    def reduce(self, value: Any) -> Any:
        """A strip as its complete vertices, those with all their cells, and the corners of its
        covers; a material as numbers."""
        if isinstance(value, Strip):
            return [*sorted(value.complete), *lists(value.covers)]
        return numbers(value) if isinstance(value, MembraneMaterial) else value

    def restore(self, kind: type, data: Any, path: str) -> Any:
        """Restore a handle by name (making new ones), a strip or a material."""
        if issubclass(kind, Handle):
            if not isinstance(data, str):
                raise ValueError(f"expected the name of a {kind.__name__}, found {data!r}")
            return self._handles.setdefault((kind, data), kind(data, None))
        if kind is Strip:
            complete = [int(one) for one in data if not isinstance(one, list)]
            covers = [[int(v) for v in one] for one in data if isinstance(one, list)]
            strip = cells_at(self.scene.membrane, complete, self._held_edges)
            return strip.with_covers(np.array(covers, dtype=np.int64).reshape(-1, 3))
        if kind is MembraneMaterial:
            return with_numbers(self.scene.materials[int(path.rpartition(".")[2])], data)
        return NotImplemented

    def unsaved(self, kind: type) -> dict[str, Any]:
        """Terms and versions of the present scene."""
        if kind is not SceneState:
            return {}
        scene = self.scene
        return {
            "terms": scene.terms, "version": scene.versions.current, "scene": scene,
            "case": scene.case,
        }  # fmt: skip

    def write(self, path: str, rows: Rows, values: np.ndarray[Any, Any]) -> Plain:
        """Write a distributed array; return its digest and number of rows. Collective."""
        file = self.folder / f"{path}.npy"
        if rows is Rows.EDGES:
            own = self.scene.mesh.mesh.topology.index_map(1).size_local
            values = edge_vertices(self.scene)[:own][values[:own]]
            first, total = self.comm.exscan(len(values)) or 0, self.comm.allreduce(len(values))
            ids: Integers = first + np.arange(len(values))
        elif rows is Rows.CELLS:
            ids, total = cell_ids(self.scene)
        else:
            count = self._own if rows is Rows.VERTICES else len(self._ids)
            ids, values, total = self._ids[:count], values[:count], self._vertices
        columns = values.reshape(len(values), int(np.prod(values.shape[1:])))
        return {"digest": write_rows(file, self.comm, ids, columns, total), "rows": total}

    def read(
        self, path: str, rows: Rows, dtype: np.dtype[Any], shape: tuple[int, ...], data: Any
    ) -> np.ndarray[Any, Any]:
        """Read this rank's rows, (n, *shape); shared values go to their owner. Collective."""
        file, due = self.folder / f"{path}.npy", str(data["digest"])
        if rows is Rows.EDGES:
            pairs = read_rows(file, self.comm, None, np.int64, (int(data["rows"]), 2), due)
            self._held_edges = np.isin(edge_keys(edge_vertices(self.scene)), edge_keys(pairs))
            return self._held_edges
        ids, total = cell_ids(self.scene) if rows is Rows.CELLS else (self._ids, self._vertices)
        columns = int(np.prod(shape))
        values = read_rows(file, self.comm, ids, dtype, (total, columns), due)
        with raised_together(self.comm):
            if not np.isfinite(values).all():
                raise InputError(f"{file} has values that are not finite; use another checkpoint.")
        if rows is Rows.SHARES:
            values[self._own :] = 0.0
        return values.reshape(-1, *shape)

    def check_mesh(self, data: Any) -> None:
        """Refuse a mesh with other vertices than the saved ones. Collective."""
        X = self.read(POSITIONS, Rows.VERTICES, np.dtype(float), (3,), data)
        here, size = self.scene.membrane.given, self.scene.membrane.size
        with raised_together(self.comm):
            apart = np.flatnonzero(~(np.abs(X - here).max(axis=1) <= SAME_PLACE * size))
            if len(apart):
                k = apart[0]
                raise InputError(
                    f"load: the checkpoint is of another mesh: its vertex {self._ids[k]} is at "
                    f"{X[k]}, and here at {here[k]}; build the mesh as it was when it was saved."
                )


def fingerprint(scene: Scene) -> dict[str, Any]:
    """What a script must rebuild identically, as numbers and texts by name. Collective."""
    refuse_history(scene)
    mesh = scene.mesh.mesh
    cells = cell_vertex_ids(mesh)
    first = scene.membrane.first_materials
    tags = np.zeros((len(cells), 1), dtype=np.int64)
    if scene.membrane.cell_tags is not None:
        tags[:, 0] = scene.membrane.cell_tags.values
    frames, shapes = scene.membrane.frames, None
    if frames is not None:
        rounded = np.rint(1e8 * frames.reshape(-1, 6)).astype(np.int64)
        shapes = mixed(scene, np.hstack([cells, rounded]))
    warps = None
    if frames is None and any(callable(one.warp) for one in first.values()):
        ways, corners = np.zeros((len(cells), 3)), scene.membrane.given[scene.V.dofmap.list]
        for tag, one in first.items():
            if callable(one.warp):
                own = np.flatnonzero(tags[:, 0] == tag).astype(np.int32)
                ways[own] = warp_directions(scene.comm, one, corners, own)[own]
        warps = mixed(scene, np.hstack([cells, np.rint(1e8 * ways).astype(np.int64)]))
    return {
        "number of vertices": mesh.topology.index_map(0).size_global,
        "number of cells": mesh.topology.index_map(2).size_global,
        "cells (their vertices, mixed to one number)": mixed(scene, cells),
        "materials": [described(one) for one in first.values()],
        "warp (directions in the cells, mixed to one number)": warps,
        "cells of the materials (mixed to one number)": mixed(scene, np.hstack([cells, tags])),
        "stress-free shapes of the cells (mixed to one number)": shapes,
        "strain": scene.strain_law,
        "pressure": scene.pressure_law,
        "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty,
        "added terms": [term.name for term in scene.terms],
    }


def refuse_history(scene: Scene) -> None:
    """Refuse to checkpoint a scene whose terms have a history that would be lost."""
    for term in scene.terms:
        if term.has_history:
            raise InputError(
                f"the term {term.name!r} has a history, which checkpoints do not keep; do without "
                "checkpoints (resume=None), or without the term."
            )


def check_same(saved: dict[str, Any], scene: Scene) -> None:
    """Refuse a scene that does not match a saved fingerprint. Collective."""
    for name, value in fingerprint(scene).items():
        was = saved.get(name)
        if not _same(was, value):
            raise InputError(
                f"load: the checkpoint is of another scene: {name} {was!r}, and here {value!r}; "
                "build the mesh and the scene as they were when it was saved."
            )


def _same(a: object, b: object) -> bool:
    """Whether two values agree, numbers up to rounding."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12)
    return a == b


def described(material: MembraneMaterial) -> list[Any]:
    """A material as numbers and texts."""
    warp = material.warp
    direction = "a function" if callable(warp) else warp if warp is None else [*map(float, warp)]
    values = [*encode(numbers(material)).values()]
    if isinstance(material, UflMembrane):
        values += material.samples
    return [type(material).__name__, values, direction]


def mixed(scene: Scene, rows: Integers) -> str:
    """Hash of all ranks' integer rows, independent of their order. Collective."""
    return digest(scene.comm, np.zeros(len(rows), dtype=np.int64), rows)


def cell_ids(scene: Scene) -> tuple[Integers, int]:
    """Numbers of this rank's cells in the mesh as given, and their global count."""
    topology = scene.mesh.mesh.topology
    ids = np.asarray(topology.original_cell_index, dtype=np.int64)
    return ids, topology.index_map(2).size_global


def edge_vertices(scene: Scene) -> Integers:
    """End ids of this rank's edges, (m, 2)."""
    mesh = scene.mesh.mesh
    return vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]


def signed(data: Plain) -> str:
    """JSON text of plain data with its digest."""
    content = json.dumps(data, allow_nan=False)
    return f'{{"format": "{FORMAT}", "digest": "{_digest(content)}", "content": {content}}}'


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def read(folder: Path, comm: MPI.Intracomm) -> Contents:
    """Read a checkpoint without its arrays, the same on all ranks. Collective."""
    data = checks.from_first(comm, lambda: _read(folder / STATE))
    with reading(folder / STATE):
        return decode(Contents, data)


def load(folder: str | Path, scene: Scene) -> Run:
    """Restore a scene from a folder and return its run; see `Solver.load`. Collective."""
    place = complete(Path(folder).resolve())
    return restore(place, read(place, scene.comm), scene)


def restore(folder: Path, contents: Contents, scene: Scene) -> Run:
    """Restore a scene from a checkpoint and return its run. Collective."""
    storage = _SceneStorage(folder, scene)
    check_same(contents.scene, scene)
    storage.check_mesh(contents.positions)
    with reading(folder / STATE):
        state = decode(SceneState, contents.state, storage)
    unknown = {part for pond in state.loads.ponds for part in pond.parts} - set(scene.mesh.parts)
    if unknown:
        raise InputError(
            f"load: the checkpoint has ponds on the parts {sorted(unknown)}, which the mesh does "
            "not have; build the mesh as it was when it was saved."
        )
    scene.state = state
    scene.versions.change_model()
    scene.versions.change_state(above=contents.state_version)
    if contents.in_equilibrium:
        scene.versions.settle(scene.membrane.owned_u, contents.verification)
    else:
        scene.versions.unsettle()
    return contents.run


def _read(file: Path) -> Plain:
    with readable(file, "pass the folder of a checkpoint"):
        text = read_text(file)
    with reading(file):
        found = json.loads(text)
        if found["format"] != FORMAT:
            raise ValueError(f"expected the format {FORMAT!r}, found {found['format']!r}")
        data: Plain = found["content"]
        if _digest(json.dumps(data)) != found["digest"]:
            raise ValueError("its content is not what was written")
    return data


@contextmanager
def reading(file: Path) -> Iterator[None]:
    """Name the file in errors of decoding."""
    try:
        yield
    except InputError:  # already names the file
        raise
    except (
        ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError,
    ) as error:  # fmt: skip
        why = repr(error)  # a decoding error quotes the whole text
        why = why if len(why) <= LONGEST else why[:LONGEST] + "..."
        raise InputError(
            f"{file} is damaged or of another version ({why}); use another checkpoint."
        ) from error
