"""Runs random scenes of many features, and checks the properties of every answer."""

from __future__ import annotations

import logging
import shutil
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.foundation.runtime import errors
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.checkpoint.journal import Journal
from fuzzing.feature_scenes import FeatureScene, Frame
from fuzzing.feature_world import World, joints
from fuzzing.runs import kind_of, limited

SECONDS = 60
ENERGY, FORCE, BALANCE = 1e-6, 1e-4, 1e-6
"""Relative differences of energies and forces of the same answer, and of forces that balance."""
LOOSE = 300.0
"""How much more they may be where friction stops a cable anywhere within its tolerance."""
WARNINGS = (
    errors.DoubtWarning, errors.FrictionWarning, errors.InstabilityWarning, errors.PathWarning,
    errors.PenaltyWarning, errors.SnapThroughWarning,
)  # fmt: skip
Numbers = dict[str, list[float]]


@dataclass
class Found:
    """What came of a scene.

    Attributes
    ----------
    number, kind
        The scene's.
    outcome
        "converged", "refused" (an error of the package that says what to do) or "failed".
    text
        The error, without its numbers.
    answers
        What the scene was like after each event, by what had been done.
    problems, notes
        What must not be, and what is worth to know, as another equilibrium of the same scene.
    """

    number: int
    kind: str
    names: list[str] = field(default_factory=list)
    loose: bool = False
    outcome: str = "converged"
    text: str = ""
    answers: list[tuple[str, Numbers]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0


def answer(world: World) -> Numbers:
    """The present state in metres and kN, whatever the frame. Collective."""
    scene, frame = world.scene, world.frame
    work = frame.force * frame.unit
    n = scene.V.dofmap.index_map.size_local
    u = scene.u.x.array.reshape(-1, 3)[:n] @ frame.turn / frame.unit
    X = frame.back(scene.membrane.stress_free[:n].T)
    weights = np.sin(np.array([1.0, 2.0, 3.0]) @ X)
    size = world.comm.allreduce(np.array([*(weights @ u), *(u**2).sum(axis=0)]))
    sums = world.solver.summary()
    held = np.array(sums.supports["all supports"].total) @ frame.turn / frame.force
    bars = [bar.force / frame.force for bar in sorted(scene.bars, key=lambda b: b.name)]
    cables = sorted(scene.cables, key=lambda c: c.name)
    places = [x for j in joints(scene) for x in frame.back(j.position[:, None]).ravel()]
    return {
        "energy": [scene.energy / work],
        "parts": [v / work for _, v in sorted(scene.energies.items())],
        "u": size.tolist(),
        "tensions": [cable.tension / frame.force for cable in cables],
        "bars": bars,
        "joints": places,
        "reaction": held.tolist(),
        "pressure": [scene.pressure / frame.per_area],
        "volume": [scene.volume / frame.unit**3],
        "ponds": [pond.volume / frame.unit**3 for pond in scene.ponds],
    }  # fmt: skip


def differs(a: Numbers, b: Numbers, tight: float = 1.0) -> str:
    """Where two answers differ, in words; empty if they do not."""
    found = []
    forces = [abs(x) for k in ("tensions", "bars", "reaction") for x in (*a[k], *b[k])]
    energies = [abs(x) for x in (*a["parts"], *b["parts"])]
    for name, x in a.items():
        y = b.get(name, [])
        if len(x) != len(y):
            found.append(f"{name}: {len(x)} and {len(y)} of them")
            continue
        scale = {"tensions": forces, "bars": forces, "reaction": forces, "energy": energies,
                 "parts": energies}.get(name, [abs(v) for v in (*x, *y)])  # fmt: skip
        top = max(scale, default=0.0)
        if name in ("u", "volume", "ponds", "joints"):
            top = max(top, 1e-2)
        tolerance = tight * (ENERGY if name == "energy" else FORCE) * max(top, 1e-9)
        away = float(np.abs(np.subtract(x, y)).max(initial=0.0))
        if not away <= tolerance:
            found.append(f"{name} by {away / max(top, 1e-9):.1e}")
    return ", ".join(found)


def check_state(world: World, what: str, found: Found) -> None:
    """What must be true of each accepted state."""
    scene, frame = world.scene, world.frame
    now = answer(world)
    found.answers.append((what, now))
    if not all(np.isfinite(x).all() for x in now.values()):
        found.problems.append(f"{what}: not finite")
    if not world.solver.steps or (
        scene.versions.model_version and what.endswith(("remove", "seal", "unseal"))
    ):
        return
    away = unbalanced(world)
    if away > BALANCE:
        found.problems.append(f"{what}: reactions and loads differ by {away:.1e}")
    if not frame.unit:
        raise AssertionError


def unbalanced(world: World) -> float:
    """Sum of all supports' and loads' forces relative to their size. Collective.

    Loads from areas and rims: the pressure on a surface with a closed rim is p times the vector
    area that the rim encloses, whatever the surface is.
    """
    scene, comm = world.scene, world.comm
    sums = world.solver.summary()
    total = np.array(sums.reaction)
    size = np.abs(total).sum() + sum(abs(b.force) for b in scene.bars)
    size += sum(c.tension for c in scene.cables)
    unknown = set(scene.energies) & {"springs", "residual stress"}
    if world.data.walls or world.data.laws:
        return 0.0
    if "floor" in world.data.names and scene.floor_level is not None:
        z = scene.positions()[:, 2].min(initial=np.inf)
        lowest = comm.allreduce(float(z), op=MPI.MIN)
        if lowest < scene.floor_level + 1e-6 * world.frame.unit:
            return 0.0  # it carries something
    for load in scene.loads:
        own = comm.allreduce(load.factor * load.forces.sum(axis=0))
        own = own + load.factor * sum(map(np.array, load.joints.values()), np.zeros(3))
        if load.suction is not None and load.factor:
            if any(True for cable in scene.cables):
                pass
        total, size = total + own, size + np.abs(own).sum()
    if scene.pressure and not world.data.walls:
        own = scene.pressure * rim_area(world)
        total, size = total + own, size + np.abs(own).sum()
    vertical = 1.0
    for pond in scene.ponds:
        own = np.array([0.0, 0.0, -pond.factor * pond.weight * pond.volume])
        total, size = total + own, size + np.abs(own).sum()
        vertical = 0.0 if pond.factor else vertical  # its rim may carry it sideways
    if "springs" in unknown:
        return 0.0
    total[:2] *= vertical
    prestress = 1.0 * world.frame.force
    return float(np.linalg.norm(total) / max(size, prestress))


def rim_area(world: World) -> Array:
    """Vector area that the membrane's rim encloses now, (3,). Collective."""
    scene = world.scene
    mesh = scene.mesh.mesh
    edges = scene.mesh.edges["boundary"]
    cells = mesh.topology.connectivity(1, 2)
    own = mesh.topology.index_map(2).size_local
    x, dofs, area = scene.positions(), scene.V.dofmap.list, np.zeros(3)
    ends = mesh.topology.connectivity(1, 0)
    vertex_dofs = {}
    corners = mesh.topology.connectivity(2, 0)
    for c in range(own):
        vertex_dofs.update(zip(corners.links(c).tolist(), dofs[c].tolist(), strict=True))
    for e in edges:
        for c in cells.links(e):
            if c < own:
                loop = corners.links(c).tolist()
                a, b = ends.links(e).tolist()
                if loop[(loop.index(a) + 1) % 3] != b:
                    a, b = b, a
                area += np.cross(x[vertex_dofs[a]], x[vertex_dofs[b]]) / 2
    return np.asarray(world.comm.allreduce(area))


def taylor(world: World, found: Found) -> None:
    """Gradient and stiffness of the whole potential beside the last state. Collective."""
    system = world.solver.system
    system.update()
    potential, unknowns = system.potential, system.unknowns
    n = unknowns.n_owned
    saved = potential.x.copy()
    rng = np.random.default_rng((world.data.number + 5, world.comm.rank))
    cells = world.scene.mesh.mesh.topology.index_map(2).size_global
    h0 = 1e-3 * world.scene.membrane.size / np.sqrt(cells)
    way = rng.normal(size=(n, 3))
    way[unknowns.held[:n]] = 0.0
    base = saved[:n] + h0 * rng.normal(size=(n, 3)) * ~unknowns.held[:n]
    f = TermsWithDyads.__new__(TermsWithDyads)
    f.potential, f.unknowns, f.exact = potential, unknowns, True

    def value(x: Array) -> tuple[float, Array]:
        potential.x[:n] = x
        potential.place()
        energy = potential.evaluate()
        return energy, potential.g[:n].copy()

    _, g = value(base)
    slope, best = f.dot(g, way), np.inf
    scale = np.sqrt(f.dot(g, g) * f.dot(way, way)) + 1e-30
    for h in h0 * 0.1 ** np.arange(0, 5):
        difference = (value(base + h * way)[0] - value(base - h * way)[0]) / (2 * h)
        best = min(best, abs(difference - slope) / scale)
    if best > 1e-5:
        found.problems.append(f"gradient off by {best:.1e} of its size")
    try:
        product = f.times(base, way)
    except NotImplementedError:
        product = None
    if product is not None and not world.data.depends_on_way and "term" not in world.data.names:
        product[unknowns.held[:n]] = 0.0
        best = np.inf
        for h in h0 * 0.1 ** np.arange(0, 5):
            change = (value(base + h * way)[1] - value(base - h * way)[1]) / (2 * h)
            change[unknowns.held[:n]] = 0.0
            away = change - product
            best = min(best, np.sqrt(f.dot(away, away) / max(f.dot(change, change), 1e-300)))
        if best > 1e-4:
            found.notes.append(f"second derivatives off by {best:.0e}")
    potential.x[:] = saved
    potential.place()
    unknowns.read_vertices(potential.x, world.scene.u.x.array.reshape(-1, 3))
    potential.sum_up()


def scenario(
    data: FeatureScene, comm: MPI.Intracomm, frame: Frame | None = None, found: Found | None = None,
    order: Any = None, ranks: Any = None, **options: Any,
) -> tuple[World, Found]:  # fmt: skip
    """Build a scene and do to it what is to be done, with checks after all."""
    found = Found(data.number, data.kind) if found is None else found
    world = World(data, frame or Frame(), comm, ranks, **options)
    world.after = lambda world, what: check_state(world, what, found)
    world.build(order)
    world.play()
    return world, found


def compare(name: str, a: Found, b: Found, result: Found) -> None:
    """Note where two runs of the same scene differ."""
    if len(a.answers) != len(b.answers):
        result.problems.append(f"{name}: {len(a.answers)} and {len(b.answers)} states")
    for (what, x), (_, y) in zip(a.answers, b.answers, strict=False):
        text = differs(x, y, LOOSE if result.loose else 1.0)
        if text:
            e, d = x["energy"][0], y["energy"][0]
            result.problems.append(f"{name}, {what}: {text} (energies {e:.9g} {d:.9g})")
            return


def turned(rng: np.random.Generator) -> Frame:
    """Turned about the vertical, and elsewhere."""
    a = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    return Frame(turn, rng.uniform(-20, 20, 3))


TWINS = (
    "turned", "mm-N", "tiny", "huge", "order", "resume", "branch", "load", "outputs", "verify",
    "stopped",
)  # fmt: skip


def twin(name: str, data: FeatureScene, comm: MPI.Intracomm, first: Found, result: Found) -> None:
    """Run a scene otherwise, with what must be the same answer. Collective."""
    rng = np.random.default_rng(data.number)
    frames: dict[str, Callable[[], Frame]] = {
        "turned": lambda: turned(rng), "mm-N": lambda: Frame(unit=1e3, force=1e3),
        "tiny": lambda: Frame(unit=1e-3, force=1e-6), "huge": lambda: Frame(unit=1e2, force=1e7),
    }  # fmt: skip
    if name in frames:
        if name == "turned" and data.held == "plane":
            return
        compare(name, first, scenario(data, comm, frames[name]())[1], result)
    elif name == "order":
        order = rng.permutation(len(data.features)).tolist()
        names = [n for n, _ in data.features]
        if "mast" in names:  # cables may end there
            order.sort(key=lambda k: names[k] != "mast")
        compare(name, first, scenario(data, comm, order=order)[1], result)
    elif name == "verify":
        compare(name, first, scenario(data, comm, verify=False)[1], result)
    elif name == "resume":
        resumed(data, comm, first, result, int(rng.integers(1, 6)))
    elif name == "load":
        loaded(data, comm, result)
    elif name == "branch":
        branched(data, comm, result)
    elif name == "stopped":
        stopped(data, comm, result)
    else:
        outputs(data, comm, first, result)


def stopped(data: FeatureScene, comm: MPI.Intracomm, result: Found) -> None:
    """A load step that is stopped leaves the state before, and the next one is as if it had not."""
    (world, _), (other, _) = scenario(data, comm), scenario(data, comm)
    u, before, whole = world.scene.u.x.array.copy(), answer(world), Potential.sum_up
    load = {name: 1.1 * factor + 0.1 for name, factor in world.scene.factors.items()}
    for count in (1, 5, 30):
        left = count

        def counted(self: Potential, vertices: bool = True) -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            whole(self, vertices)

        Potential.sum_up = counted  # type: ignore[method-assign]
        try:
            world.advance(load=load, move="boundary", way=(0.0, 0.02, 0.03), of=0)
            result.notes.append("stopped: it was done before")
            return
        except Killed:
            pass
        finally:
            Potential.sum_up = whole  # type: ignore[method-assign]
        text = differs(before, answer(world), LOOSE if result.loose else 1e-6)
        if text or not np.array_equal(u, world.scene.u.x.array):
            result.problems.append(f"stopped after {count}: {text or 'u'}")
    for one in (world, other):
        one.advance(load=load)
    text = differs(answer(world), answer(other), LOOSE if result.loose else 1.0)
    if text:
        result.problems.append(f"stopped, then a load step: {text}")


class Killed(BaseException):
    """Stands for the end of the process."""


def resumed(
    data: FeatureScene, comm: MPI.Intracomm, first: Found, result: Found, after: int
) -> None:
    """A script that ends after some checkpoints and goes on has the answer of one that did not."""
    folder = Path(comm.bcast(tempfile.mkdtemp(prefix="fuzz")))
    keep, kept = Journal.keep, 0

    def keeping(self: Journal, *arguments: Any) -> None:
        nonlocal kept
        keep(self, *arguments)
        kept += 1
        if kept == after:
            raise Killed

    Journal.keep = keeping  # type: ignore[method-assign]
    try:
        try:
            scenario(data, comm, results=folder / "out", resume=False)
        except Killed:
            pass
    finally:
        Journal.keep = keep  # type: ignore[method-assign]
    comm.barrier()
    second = scenario(data, comm, results=folder / "out", resume=True)[1]
    compare("resume", first, second, result)
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder, ignore_errors=True)


def loaded(data: FeatureScene, comm: MPI.Intracomm, result: Found) -> None:
    """A state that is saved and loaded is the same, and stays where it is."""
    world, _ = scenario(data, comm)
    folder = Path(comm.bcast(tempfile.mkdtemp(prefix="fuzz")))
    before = answer(world)
    world.solver.save(folder / "state")
    other = World(data, Frame(), comm)
    if "term" in data.names:
        other.put_term(**dict(data.features)["term"])
    other.solver.load(folder / "state")
    text = differs(before, answer(other), LOOSE if result.loose else 1e-3)
    if text:
        result.problems.append(f"load: {text}")
    settle("load", other, before, result)
    a = {"load": {name: 0.9 * factor for name, factor in world.scene.factors.items()}}
    for one in (world, other):
        one.advance(**a)
    text = differs(answer(world), answer(other), LOOSE if result.loose else 1.0)
    if text:
        result.problems.append(f"load, then other loads: {text}")
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder, ignore_errors=True)


def settle(name: str, world: World, before: Numbers, result: Found) -> None:
    """A load step without anything new moves nothing."""
    world.solver.advance()
    text = differs(before, answer(world), LOOSE if result.loose else 1.0)
    if text:
        result.problems.append(f"{name}, a load step without anything new: {text}")


def branched(data: FeatureScene, comm: MPI.Intracomm, result: Found) -> None:
    """A branch ends in the state in which it began, bit by bit, and that is an equilibrium."""
    world, _ = scenario(data, comm)
    before, u = answer(world), world.scene.u.x.array.copy()
    try:
        world.branch({name: 0.7 for name in world.scene.factors}, True, True, True,
                     {"move": "boundary", "way": (0.05, 0.0, 0.1), "of": 0})  # fmt: skip
    except (errors.ConvergenceError, errors.PathError) as error:  # a path over a hole
        result.notes.append(f"branch refused, {kind_of(error)}")
    text = differs(before, answer(world), LOOSE if result.loose else 1e-6)
    if text or not np.array_equal(u, world.scene.u.x.array):
        result.problems.append(f"branch: {text or 'u'}")
    settle("branch", world, before, result)
    snapshot, factors = world.solver.snapshot(), dict(world.scene.factors)
    try:
        world.advance(load={name: 1.1 * f for name, f in factors.items()})
        after = answer(world)
        world.solver.restore(snapshot)
        world.advance(load={name: 1.1 * f for name, f in factors.items()})
        text = differs(after, answer(world), LOOSE if result.loose else 1.0)
        if text:
            result.problems.append(f"restored, the same load step again: {text}")
    except errors.ConvergenceError as error:
        result.notes.append(f"restore refused, {kind_of(error)}")


def outputs(data: FeatureScene, comm: MPI.Intracomm, first: Found, result: Found) -> None:
    """Files, tables and reports are written and agree with the state."""
    folder = Path(comm.bcast(tempfile.mkdtemp(prefix="fuzz")))
    world, second = scenario(data, comm, results=folder / "out", estimate=True)
    compare("outputs", first, second, result)
    scene, solver = world.scene, world.solver
    results = solver.results()
    for name in results.names:
        values = results.values(name)
        if not np.isfinite(values).all() and name != "utilisation":
            result.problems.append(f"results: {name} is not finite")
        results.function(name)
    for cable in scene.cables:
        one = solver.cable_forces()[cable.name]
        if not one.least <= one.mean * (1 + 1e-12) <= one.largest * (1 + 1e-9):
            result.problems.append(f"results: {cable.name} {one}")
    factors = {name: 0.8 * f for name, f in scene.factors.items()}
    found = solver.combine({"less": factors}) if factors else None
    try:
        solver.report(folder / "out" / "report.html", found)
    except errors.InputError as error:
        result.notes.append(f"report: {kind_of(error)}")
    own = [row["energy"] for row in solver.history if not row.get("case")]
    if abs(own[-1] - scene.energy) > 1e-9 * abs(scene.energy):
        result.problems.append("outputs: history's energy")
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder, ignore_errors=True)


def run(
    data: FeatureScene, comm: MPI.Intracomm, twins: tuple[str, ...], ranks: Any = None
) -> Found:
    """Run a scene and some of its twins. Collective."""
    began = time.process_time()
    kind = f"{data.source} {data.kind}"
    result = Found(data.number, kind, sorted(data.names), data.depends_on_way)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for own in WARNINGS:
            warnings.simplefilter("ignore", own)
        for name in ("", *twins):
            try:
                with limited(SECONDS):
                    if name:
                        twin(name, data, comm, result, result)
                    else:
                        world, _ = scenario(data, comm, None, result, ranks=ranks)
                        taylor(world, result)
            except (errors.InputError, errors.ConvergenceError) as error:
                if not name:
                    result.outcome, result.text = "refused", kind_of(error)
                    break
                result.problems.append(f"{name}: refused, {str(error)[:300]}")
            except Exception as error:
                logging.getLogger("crms_fenicsx").debug("%s", error, exc_info=True)
                where = traceback.extract_tb(error.__traceback__)[-1]
                result.problems.append(
                    f"{name}: {type(error).__name__}: {str(error)[:300]} "
                    f"({Path(where.filename).name}:{where.lineno})"
                )
                if not name:
                    break
    if result.problems:
        result.outcome = "failed"
    result.seconds = time.process_time() - began
    return result
