"""Saving a scene with its run to a folder, and taking it from there."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from crms_fenicsx.cables.strip import Strip, cells_at
from crms_fenicsx.checkpoint.codec import Plain, decode, encode
from crms_fenicsx.checkpoint.contents import (
    Contents,
    Run,
    SavedBar,
    SavedCable,
    SavedJoint,
    SavedLoad,
    check_same,
    fingerprint,
)
from crms_fenicsx.checkpoint.fields import Fields, cell_ids, read_fields, write_fields
from crms_fenicsx.checkpoint.folder import complete, replaced_folder
from crms_fenicsx.model.bar import BarEnd, Joint, MeshVertex, PlacedBar
from crms_fenicsx.model.changed_materials import numbers, with_numbers
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane_load import MembraneLoad
from crms_fenicsx.output.shared_file import read_rows, write_rows
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.checks import LONGEST
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import explained, read_text, readable
from crms_fenicsx.scene import Scene

STATE, CELLS = "state.json", "cells.npy"
FORMAT = "crms_fenicsx checkpoint 8"
"""What a checkpoint says it is; the number grows when its content changes."""


def save(folder: str | Path, scene: Scene, run: Run, call: Plain | None = None) -> None:
    """Write a checkpoint; see `Solver.save`. Collective."""
    checks.same(scene.comm, "save", folder=folder)
    place = checks.file("save: folder", folder).resolve()
    with replaced_folder(place, scene.comm, STATE) as partial:
        edges, digests = write_fields(partial, scene)
        if run.step_history is not None and run.step_history.cells is not None:
            ids, total = cell_ids(scene)
            cells = run.step_history.cells
            digests["cells"] = write_rows(partial / CELLS, scene.comm, ids, cells, total)
        data = encode(_contents(scene, run, edges, digests, call))
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
    """What has been read of a checkpoint, the same on all ranks."""

    file: Path  # the file
    contents: Contents  # all that it holds


def read(folder: Path, comm: MPI.Intracomm) -> Saved:
    """Read a checkpoint, but for its fields. Collective."""
    data: Plain = {}
    with raised_together(comm):
        if comm.rank == 0:
            data = _read(folder / STATE)
    data = comm.bcast(data)
    with reading(folder / STATE):
        return Saved(folder / STATE, decode(Contents, data))


def load(folder: str | Path, scene: Scene) -> Run:
    """Bring a scene to the state of a checkpoint; see `Solver.load`. Collective.

    Returns what its solver must know.
    """
    checks.same(scene.comm, "load", folder=folder)
    place = checks.file("load: folder", folder).resolve()
    return restore(read(complete(place), scene.comm), scene)


def restore(saved: Saved, scene: Scene) -> Run:
    """Bring a scene to the state of a checkpoint. Collective.

    Returns what its solver must know.
    """
    comm, contents, place = scene.comm, saved.contents, saved.file.parent
    run, digests = contents.run, contents.digests
    with reading(saved.file):
        contents.check(scene.V.dofmap.index_map.size_global)
        unknown = {part for pond in contents.ponds for part in pond.parts}
        if unknown := unknown - set(scene.mesh.parts):
            raise ValueError(f"ponds on parts {sorted(unknown)}, which the mesh has not")
    check_same(contents.scene, scene)
    with reading(saved.file):
        pairs = zip(scene.materials.items(), contents.materials, strict=True)
        materials = {k: with_numbers(material, kept) for (k, material), kept in pairs}
    follows = [load.follows for load in contents.loads]
    fields = read_fields(place, scene, contents.held_edges, digests, follows)
    if run.step_history is not None and scene.strain_law == "step":
        ids, total = cell_ids(scene)
        due, shape = digests.get("cells", ""), (total, 6)
        run = run.with_cells(read_rows(place / CELLS, comm, ids, np.float64, shape, due))
    _restore(scene, fields, saved)
    scene.materials.update(materials)
    scene.step_history = run.step_history
    scene.versions.change_model()
    scene.versions.change_state(above=contents.state_version)
    if contents.in_equilibrium:
        scene.versions.settle(scene.membrane.owned_u, None)
    else:
        scene.versions.unsettle()
    return run


def _contents(
    scene: Scene, run: Run, edges: int, digests: dict[str, str], call: Plain | None
) -> Contents:
    """What is kept of a scene and its run besides the fields, with how many edges are held."""
    steps = [replace(step, verification=None) for step in run.steps]
    strip = scene.net.strip
    return Contents(
        scene=fingerprint(scene),
        held_edges=edges,
        digests=digests,
        pressure=scene.pressure,
        air=scene.air,
        state_version=scene.versions.state_version,
        in_equilibrium=scene.in_equilibrium(),
        floor=scene.floor_level,
        laid=scene.net.laid,
        dissipated=scene.net.removed_dissipation,
        energies=scene.energies,
        materials=tuple(numbers(material) for material in scene.materials.values()),
        loads=tuple(
            SavedLoad(
                load.name, load.intensity, load.suction is not None, load.factor, dict(load.joints)
            )
            for load in scene.loads
        ),
        ponds=scene.ponds,
        strip=() if strip is None else tuple(sorted(strip.complete)),
        cables=tuple(
            SavedCable(c.name, c.cable, c.sleeve, c.layer, c.in_edge, c.joints, c.state)
            for c in scene.cables
        ),
        crossings=scene.net.crossings,
        joints=tuple(SavedJoint(j.name, j.first, j.held, j.state) for j in scene.joints),
        bars=tuple(
            SavedBar(
                b.name,
                b.bar,
                (_saved_end(scene, b.start), _saved_end(scene, b.end)),
                b.state,
            )
            for b in scene.bars
        ),
        run=replace(run.with_cells(None), steps=steps),
        call=call,
        warnings=scene.warnings,
    )


def _saved_end(scene: Scene, end: BarEnd) -> int | MeshVertex:
    """An end of a bar, a joint by its number."""
    return scene.frame.number(end) if isinstance(end, Joint) else end


def _restore_frame(scene: Scene, contents: Contents) -> None:
    """Let joints and bars be those that have been read; ones of the same name stay the objects."""
    frame = scene.frame
    known: dict[str, Joint] = {joint.name: joint for joint in frame.joints}
    placed: dict[str, PlacedBar] = {bar.name: bar for bar in frame.bars}
    joints, bars = [], []
    for j in contents.joints:
        joint = known.get(j.name) or Joint(j.name, j.first, j.held, j.state)
        joint.first, joint.held, joint.state = j.first, j.held, j.state
        joints.append(joint)
    for b in contents.bars:
        start, end = (joints[end] if isinstance(end, int) else end for end in b.ends)
        bar = placed.get(b.name) or PlacedBar(b.name, b.bar, start, end, b.state)
        bar.bar, bar.start, bar.end, bar.state = b.bar, start, end, b.state
        bars.append(bar)
    frame.joints, frame.bars = tuple(joints), tuple(bars)


def _restored_cables(scene: Scene, contents: Contents) -> tuple[LaidCable, ...]:
    """The cables that have been read; ones of the same name stay the objects."""
    known = {cable.name: cable for cable in scene.cables}
    cables = []
    for c in contents.cables:
        read = LaidCable(c.name, c.cable, c.state, c.sleeve, c.layer, c.in_edge, c.joints)
        cable = known.get(c.name, read)
        cable.become(read)
        cables.append(cable)
    return tuple(cables)


def _restore(scene: Scene, fields: Fields, saved: Saved) -> None:
    """Bring the scene to a state that has been read."""
    contents = saved.contents
    held_edges = scene.membrane.held_edges.copy()
    scene.membrane.held_edges[:] = fields.held_edges  # the strip's cells know them
    strip = _strip(scene, contents) if contents.cables else None
    if contents.cables and strip is None:
        scene.membrane.held_edges[:] = held_edges
        raise InputError(
            f"{saved.file} is damaged: a cable does not lie on cells of the mesh; take another "
            "checkpoint"
        )
    scene._loads = tuple(
        MembraneLoad(load.name, forces, load.intensity, suction, load.factor, load.joints)
        for load, forces, suction in zip(
            contents.loads, fields.forces, fields.suctions, strict=True
        )
    )
    scene.u.x.array[:] = fields.u.ravel()
    scene.held[:] = fields.held
    scene._floor_level, scene._air = contents.floor, contents.air
    scene._pressure, scene._ponds = contents.pressure, contents.ponds
    scene.energies, net = contents.energies, scene.net
    scene._warnings = contents.warnings
    net.laid, net.removed_dissipation = contents.laid, contents.dissipated
    net.strip, net.cables = strip, _restored_cables(scene, contents)
    net.crossings, net.arranged = contents.crossings, net.cables
    _restore_frame(scene, contents)


def _strip(scene: Scene, contents: Contents) -> Strip | None:
    """The cells around the cables; None if one lies on none of them. Collective."""
    strip = cells_at(scene.membrane, contents.strip)
    points = (node.point for cable in contents.cables for node in cable.state.nodes)
    on_cells = (bool(strip.rows(point.support)) for point in points if point is not None)
    return strip if all(on_cells) else None


def _read(file: Path) -> Plain:
    with readable(file, "give the folder of a checkpoint"):
        text = read_text(file)
    with reading(file):
        found = json.loads(text, parse_constant=_finite, parse_float=_finite)
        if found["format"] != FORMAT:
            raise ValueError(f"it is a {found['format']!r} where a {FORMAT!r} is due")
        data: Plain = found["content"]
        if _digest(json.dumps(data)) != found["digest"]:
            raise ValueError("its content is not what was written")
    return data


def _finite(text: str) -> float:
    """A number of a JSON text, which may name some that JSON does not have."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"it has the number {text[:20]}")
    return number


@contextmanager
def reading(file: Path) -> Iterator[None]:
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
