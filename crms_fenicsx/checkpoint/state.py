"""Saving a scene with its run to a folder, and taking it from there."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.checkpoint.fields import Fields, read_fields, write_fields
from crms_fenicsx.checkpoint.fingerprint import check_same, fingerprint
from crms_fenicsx.checkpoint.folder import complete, replaced_folder
from crms_fenicsx.checkpoint.json_data import Plain, integers
from crms_fenicsx.checkpoint.run import Run, plain_run, run_of
from crms_fenicsx.output.npy import read_rows, write_rows
from crms_fenicsx.runtime.checks import LONGEST
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import explained, read_text, readable
from crms_fenicsx.scene import Scene

if TYPE_CHECKING:
    from crms_fenicsx.cables.strip import Strip
    from crms_fenicsx.model.crossing import Crossing
    from crms_fenicsx.model.laid_cable import LaidCable

STATE, CELLS = "state.json", "cells.npy"
FORMAT = "crms_fenicsx checkpoint 4"
"""What a checkpoint says it is; the number grows when its content changes."""


def save(folder: str | Path, scene: Scene, run: Run, call: Plain | None = None) -> None:
    """Write a checkpoint; see `Solver.save`. Collective.

    Parameters
    ----------
    folder
        Where to; it is replaced when the new one is complete.
    scene, run
        What is kept.
    call
        The call of `Solver.advance` that it belongs to, plain data; None if to none.
    """
    with replaced_folder(Path(folder).resolve(), scene.comm, STATE) as partial:
        edges, digests = write_fields(partial, scene)
        if run.step_history is not None and run.step_history.cells is not None:
            ids, total = _cell_ids(scene)
            cells = run.step_history.cells
            digests["cells"] = write_rows(partial / CELLS, scene.comm, ids, cells, total)
        data = {"scene": fingerprint(scene), "held edges": edges, "digests": digests}
        data |= _plain_rest(scene) | plain_run(run) | {"call": call}
        with raised_together(scene.comm), explained(partial / STATE):
            if scene.comm.rank == 0:
                (partial / STATE).write_text(signed(data), encoding="utf-8")


def signed(data: Plain) -> str:
    """The text of a file of plain data, in which each accidental change can be told."""
    content = json.dumps(data, allow_nan=False)
    return f'{{"format": "{FORMAT}", "digest": "{_digest(content)}", "content": {content}}}'


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


@dataclass(frozen=True)
class Saved:
    """What a checkpoint's file of plain data holds, the same on all ranks.

    Attributes
    ----------
    file
        The file.
    data
        All of it.
    call
        The call of `Solver.advance` that the checkpoint belongs to, if to one.
    """

    file: Path
    data: Plain
    call: Plain | None


def read(folder: Path, comm: MPI.Intracomm) -> Saved:
    """Read the plain data of a checkpoint. Collective.

    Raises
    ------
    InputError
        On all ranks: there is none, or it is damaged.
    """
    data: Plain = {}
    with raised_together(comm):
        if comm.rank == 0:
            data = _read(folder / STATE)
    data = comm.bcast(data)
    return Saved(folder / STATE, data, data["call"])


def load(folder: str | Path, scene: Scene) -> Run:
    """Bring a scene to the state of a checkpoint; see `Solver.load`. Collective.

    Returns
    -------
    Run
        What its solver must know.
    """
    return give(read(complete(Path(folder).resolve()), scene.comm), scene)


def give(saved: Saved, scene: Scene) -> Run:
    """Bring a scene to the state of a checkpoint. Collective.

    Parameters
    ----------
    saved
        What `read` has read.
    scene
        Has no cables yet, or those of the checkpoint, which stay the objects that they are.

    Returns
    -------
    Run
        What its solver must know.

    Raises
    ------
    InputError
        On all ranks: it is another scene's, or damaged. The scene is then as before.
    """
    comm, data, place = scene.comm, saved.data, saved.file.parent
    with told(saved.file):
        fingerprint_of, digests = dict(data["scene"]), dict(data["digests"])
        (edges,) = integers([data["held edges"]])
        rest, run = _rest_of(data), run_of(data)
        _check_ids(rest, scene)
        if scene.cables and [c.name for c in scene.cables] != [c.name for c in rest.cables]:
            raise ValueError(f"its cables are {rest.cables}, and the scene's {scene.cables}")
    check_same(fingerprint_of, scene)
    fields = read_fields(place, scene, edges, digests, rest.intensity is not None)
    if run.step_history is not None and scene.strain_law == "step":
        ids, total = _cell_ids(scene)
        due, shape = digests.get("cells", ""), (total, 6)
        run = run.with_cells(read_rows(place / CELLS, comm, ids, np.float64, shape, due))
    _give(scene, fields, rest, saved.file)
    scene.step_history = run.step_history
    scene.commits += 1
    return run


@dataclass(frozen=True)
class _Rest:
    """A scene's state but for its fields, the same on all ranks."""

    pressure: float
    load: float
    floor: float | None
    laid: int
    dissipated: float
    energies: dict[str, float]
    intensity: float | None
    cables: list[LaidCable]
    crossings: list[Crossing]
    complete: npt.NDArray[np.int64]


def _plain_rest(scene: Scene) -> Plain:
    data: Plain = {
        "pressure": float(scene.pressure),
        "load": float(scene.load),
        "floor": scene.floor_level,
        "laid": scene.net.laid,
        "dissipated": float(scene.net.removed_dissipation),
        "energies": {name: float(value) for name, value in scene.energies.items()},
        "intensity": None if scene.dead_forces is None else scene.dead_forces.intensity,
        "strip": [],
        "cables": [],
        "crossings": [],
    }
    if scene.cables and scene.net.strip is not None:
        from crms_fenicsx.checkpoint.cables import plain_cable, plain_crossing

        data["strip"] = sorted(scene.net.strip.complete)
        data["cables"] = [plain_cable(cable, scene.net.crossings) for cable in scene.cables]
        data["crossings"] = [plain_crossing(crossing) for crossing in scene.net.crossings]
    return data


def _rest_of(data: Plain) -> _Rest:
    cables, crossings = [], []
    if data["cables"]:
        from crms_fenicsx.checkpoint.cables import cable_of, crossing_of

        crossings = [crossing_of(one) for one in data["crossings"]]
        cables = [cable_of(one, crossings) for one in data["cables"]]
    floor, intensity = data["floor"], data["intensity"]
    (laid,) = integers([data["laid"]])
    if laid < len(cables):
        raise ValueError(f"{laid} cables that have been laid, but {len(cables)} that are there")
    if intensity is not None and not intensity >= 0:
        raise ValueError(f"a dead load of the intensity {intensity}")
    return _Rest(
        float(data["pressure"]),
        float(data["load"]),
        None if floor is None else float(floor),
        laid,
        float(data["dissipated"]),
        {str(name): float(value) for name, value in data["energies"].items()},
        None if intensity is None else float(intensity),
        cables,
        crossings,
        np.array(integers(data["strip"]), dtype=np.int64),
    )


def _check_ids(rest: _Rest, scene: Scene) -> None:
    """Refuse vertices that the mesh does not have, and crossings of cables that are not there."""
    total = scene.V.dofmap.index_map.size_global
    supports = [
        node.point.support for c in rest.cables for node in c.nodes if node.point is not None
    ]
    supports += [crossing.support for crossing in rest.crossings]
    ids = np.concatenate([rest.complete, *(np.array(support) for support in supports)])
    if len(ids) and not 0 <= ids.min() <= ids.max() < total:
        raise ValueError(f"vertices {ids.min()} to {ids.max()} of a mesh with {total}")
    if any(
        not 0 <= number < len(rest.cables)
        for crossing in rest.crossings
        for number in (crossing.lower, crossing.upper)
    ):
        raise ValueError("a crossing of cables that are not there")


def _give(scene: Scene, fields: Fields, rest: _Rest, file: Path) -> None:
    """Bring the scene to a state that has been read."""
    held_edges = scene.membrane.held_edges.copy()
    scene.membrane.held_edges[:] = fields.held_edges  # the strip's cells know them
    if rest.cables:
        strip = _strip(scene, rest)
        if strip is None:
            scene.membrane.held_edges[:] = held_edges
            raise InputError(
                f"{file} is damaged: a cable does not lie on cells of the mesh; take another "
                "checkpoint"
            )
        scene.net.strip = strip
    scene.u.x.array[:] = fields.u.ravel()
    scene.held[:] = fields.held
    scene._floor_level, scene._pressure, scene._load = rest.floor, rest.pressure, rest.load
    scene.net.laid, scene.net.removed_dissipation = rest.laid, rest.dissipated
    scene.energies = rest.energies
    scene._dead_forces = None
    if fields.dead_forces is not None and rest.intensity is not None:
        from crms_fenicsx.energies.dead_load import DeadForces

        scene._dead_forces = DeadForces(fields.dead_forces, rest.intensity)
    for own, cable in zip(scene.cables, rest.cables, strict=False):
        own.state = cable.state
    scene.net.cables = scene.net.cables or tuple(rest.cables)
    scene.net.crossings = rest.crossings
    scene.changes += 1


def _strip(scene: Scene, rest: _Rest) -> Strip | None:
    """The cells around the cables; None if one lies on none of them. Collective."""
    from crms_fenicsx.cables.strip_gather import cells_at

    strip = cells_at(scene.membrane, rest.complete)
    points = (node.point for cable in rest.cables for node in cable.nodes)
    on_cells = (bool(strip.rows(point.support)) for point in points if point is not None)
    return strip if all(on_cells) else None


def _cell_ids(scene: Scene) -> tuple[npt.NDArray[np.int64], int]:
    """Ids of this rank's cells, numbers in the mesh as it was given, and how many there are."""
    topology = scene.mesh.mesh.topology
    ids = np.asarray(topology.original_cell_index, dtype=np.int64)
    return ids, topology.index_map(2).size_global


def _read(file: Path) -> Plain:
    with readable(file, "give the folder of a checkpoint"):
        text = read_text(file)
    with told(file):
        found = json.loads(text, parse_constant=_finite, parse_float=_finite)
        if found["format"] != FORMAT:
            raise ValueError(f"it is a {found['format']!r} where a {FORMAT!r} is due")
        data: Plain = found["content"]
        if _digest(json.dumps(data)) != found["digest"]:
            raise ValueError("its content is not what was written")
        if not isinstance(data["call"], dict | None):
            raise ValueError(f"it belongs to the call {data['call']!r}")
    return data


def _finite(text: str) -> float:
    """A number of a JSON text, which may name some that JSON does not have."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"it has the number {text[:20]}")
    return number


@contextmanager
def told(file: Path) -> Iterator[None]:
    """Say of data that are not what they should be which file they are from."""
    try:
        yield
    except (
        ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError,
    ) as error:  # fmt: skip
        why = repr(error)  # of a text that cannot be decoded it has all of it
        why = why if len(why) <= LONGEST else why[:LONGEST] + "..."
        raise InputError(
            f"{file} is damaged or of another version ({why}); take another checkpoint"
        ) from error
