"""What must be true of every state of a random scene."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.verification.verifier import Verifier
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.foundation.runtime.arrays import Array
from fuzzing.scenes import SceneData
from fuzzing.world import Frame, World, joints

ENERGY, FORCE, BALANCE = 1e-6, 1e-4, 1e-6
"""Relative differences of energies and forces of the same answer, and of forces that balance."""
LOOSE = 300.0
"""How much more they may be where friction stops a cable anywhere within its tolerance."""
FALL = 1e-8
"""Rise of the energy between two stages of a minimisation, relative to the sum of its parts, that
is rounding, or what the trapezoidal rule misses near the minimum where friction is not smooth."""
SHAKES = (1e-4, 1e-2)
"""Sizes of the displacements about an equilibrium, relative to the cells."""
Numbers = dict[str, list[float]]


@dataclass
class Result:
    """What came of a scene.

    Attributes
    ----------
    number, kind, names
        The scene's, and its features and events.
    loose
        Whether its answer depends on the way to it.
    outcome
        "converged", "refused" (an error of the package that says what to do) or "failed".
    text
        The error, without its numbers.
    answers
        What the scene was like after each event, by what had been done.
    problems, notes
        What must not be, and what is worth to know, as another equilibrium of the same scene.
    steps, evaluations, halvings, seconds, verification
        What it took, the last of it for verification.
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
    steps: int = 0
    evaluations: int = 0
    halvings: int = 0
    seconds: float = 0.0
    verification: float = 0.0

    @property
    def energies(self) -> list[float]:
        """After each event."""
        return [numbers["energy"][0] for _, numbers in self.answers]

    @property
    def tensions(self) -> list[list[float]]:
        """After each event, of all cables."""
        return [numbers["tensions"] for _, numbers in self.answers]


def empty(data: SceneData) -> Result:
    """Of a scene that has not been run."""
    names = sorted({name for name, _ in data.features + data.events})
    kind = data.kind if data.source in ("arrays", data.kind) else f"{data.source} {data.kind}"
    return Result(data.number, kind, names, data.depends_on_way)


@contextmanager
def scenario(
    data: SceneData, comm: MPI.Intracomm, result: Result | None = None, frame: Frame | None = None,
    order: Any = None, ranks: Any = None, **options: Any,
) -> Iterator[World]:  # fmt: skip
    """A scene to which has been done what is to be done, with checks after all. Collective."""
    result = empty(data) if result is None else result
    world = World(data, frame or Frame(), comm, ranks, **options)
    world.after = lambda world, what: check_state(world, what, result)
    try:
        world.build(order)
        yield world.play()
    finally:
        world.close()
        for step in world.solver.steps:
            result.steps += 1
            result.evaluations += step.outcome.evaluations
            result.halvings += step.halvings
            result.verification += step.verification.seconds if step.verification else 0.0


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


def check_state(world: World, what: str, result: Result) -> None:
    """What must be true of each accepted state."""
    scene = world.scene
    now = answer(world)
    result.answers.append((what, now))
    lengths = [cable.length for cable in scene.cables]
    if not all(np.isfinite(x).all() for x in (*now.values(), lengths)):
        result.problems.append(f"{what}: not finite")
    for cable in scene.cables:
        if cable.cable.law == "total" and min(cable.tension, *cable.tensions) < 0.0:
            result.problems.append(f"{what}: {cable.name} is compressed")
        coulomb = cable.cable.sideways is None or cable.has_coulomb
        grips = [
            grip for grip in (cable.state.law.lateral, cable.state.law.axial) if grip is not None
        ]
        if coulomb and any(grip.dissipated < 0.0 for grip in grips):
            result.problems.append(f"{what}: negative dissipation of {cable.name}")
    changed = scene.versions.model_version and what.endswith(("remove", "seal", "unseal"))
    if world.solver.steps and not changed and (away := unbalanced(world)) > BALANCE:
        result.problems.append(f"{what}: reactions and loads differ by {away:.1e}")


def unbalanced(world: World) -> float:
    """Sum of all supports' and loads' forces relative to their size, where all are known.

    Loads from areas and rims: the pressure on a surface with a closed rim is p times the vector
    area that the rim encloses, whatever the surface is. Collective.
    """
    scene, comm, data = world.scene, world.comm, world.data
    if data.walls or data.laws or data.ambiguous or "springs" in scene.energies:
        return 0.0
    if scene.floor_level is not None:
        z = scene.positions()[:, 2].min(initial=np.inf)
        lowest = comm.allreduce(float(z), op=MPI.MIN)
        if lowest < scene.floor_level + 1e-6 * world.frame.unit:
            return 0.0  # it carries something
    forces = [np.array(world.solver.summary().reaction)]
    for load in scene.loads:
        own = load.factor * comm.allreduce(load.forces.sum(axis=0))
        forces.append(own + load.factor * sum(map(np.array, load.joints.values()), np.zeros(3)))
    if scene.pressure:
        forces.append(scene.pressure * rim_area(world))
    for pond in scene.ponds:
        forces.append(np.array([0.0, 0.0, -pond.factor * pond.weight * pond.volume]))
    total = np.sum(forces, axis=0)
    if any(pond.factor for pond in scene.ponds):  # their rims may carry it sideways
        total[:2] = 0.0
    size = np.abs(forces).sum() + sum(abs(b.force) for b in scene.bars)
    size += sum(c.tension for c in scene.cables)
    return float(np.linalg.norm(total) / max(size, world.frame.force))


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


def taylor(world: World, result: Result) -> None:
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

    _, g = f.value(base)
    slope, best = f.dot(g, way), np.inf
    scale = np.sqrt(f.dot(g, g) * f.dot(way, way)) + 1e-30
    for h in h0 * 0.1 ** np.arange(0, 5):
        difference = (f.value(base + h * way)[0] - f.value(base - h * way)[0]) / (2 * h)
        best = min(best, abs(difference - slope) / scale)
    if best > 1e-5:
        result.problems.append(f"gradient off by {best:.1e} of its size")
    try:
        product = f.times(base, way)
    except NotImplementedError:
        product = None
    if product is not None and not world.data.depends_on_way and "term" not in result.names:
        product[unknowns.held[:n]] = 0.0
        best = np.inf
        for h in h0 * 0.1 ** np.arange(0, 5):
            change = (f.value(base + h * way)[1] - f.value(base - h * way)[1]) / (2 * h)
            change[unknowns.held[:n]] = 0.0
            away = change - product
            best = min(best, np.sqrt(f.dot(away, away) / max(f.dot(change, change), 1e-300)))
        if best > 1e-4:
            result.notes.append(f"second derivatives off by {best:.0e}")
    potential.x[:] = saved
    potential.place()
    unknowns.read_vertices(potential.x, world.scene.u.x.array.reshape(-1, 3))
    potential.sum_up()


@contextmanager
def watched(result: Result) -> Iterator[None]:
    """Look at each minimisation and at each state that is verified."""
    solve, check = Minimizer.solve, Verifier.check
    levels: list[float] = []

    def solving(self: Minimizer, *args: Any, **kwargs: Any) -> Any:
        levels.clear()
        own = self.potential.evaluate_terms

        def evaluate_terms() -> tuple[float, float]:
            energy, scale = own()
            levels.append(energy)
            return energy, scale

        self.potential.evaluate_terms = evaluate_terms  # type: ignore[method-assign]
        try:
            outcome = solve(self, *args, **kwargs)
        finally:
            del self.potential.evaluate_terms
        size = sum(abs(v) for v in self.potential.energies().values())
        size += self.atol * float(np.ptp(self.potential.unknowns.X)) / FALL  # nothing at all
        rises = np.diff(levels)
        if outcome.converged and len(rises) and rises.max() > FALL * size:
            result.problems.append(f"energy rises in a minimisation by {rises.max() / size:.1e}")
        return outcome

    def checking(self: Verifier, system: System, outcome: Any, *others: Any) -> Any:
        found = check(self, system, outcome, *others)
        result.notes += [f"doubtful: {check.name}" for check in found.doubtful]
        if not found.passed:
            result.notes += [f"halved, not verified: {check.name}" for check in found.failed]
        else:
            result.notes += lower_states(system)
        return found

    Minimizer.solve, Verifier.check = solving, checking  # type: ignore[method-assign]
    try:
        yield
    finally:
        Minimizer.solve, Verifier.check = solve, check  # type: ignore[method-assign]


def lower_states(system: System) -> list[str]:
    """States near an equilibrium with less energy, in words."""
    potential, unknowns, scene = system.potential, system.unknowns, system.scene
    n = unknowns.n_owned
    potential.sum_up()
    here = potential.energies()
    saved, found = potential.x.copy(), []
    cells = scene.mesh.mesh.topology.index_map(2).size_global
    size = scene.membrane.size / np.sqrt(cells)
    rounding = 1e-13 * sum(abs(v) for v in here.values())
    random = np.random.default_rng(scene.comm.rank)
    for shake in SHAKES:
        way = random.normal(size=(n, 3)) * shake * size
        way[unknowns.held[:n]] = 0.0
        potential.x[:n] = saved[:n] + way
        if unknowns.bounds is not None:
            np.maximum(potential.x[:n], unknowns.bounds[0][:n], out=potential.x[:n])
        potential.place()
        potential.sum_up()
        rise = sum(potential.energies()[name] - here[name] for name in here)
        if rise < -rounding:
            found.append(f"lower state within {shake:g} cells")
        if not np.isfinite(rise):
            found.append("energy not finite beside the equilibrium")
    potential.x[:] = saved
    unknowns.read_vertices(potential.x, scene.u.x.array.reshape(-1, 3))
    potential.sum_up()
    return found


def kind_of(error: Exception) -> str:
    """An error's text without what differs from scene to scene."""
    text = str(error).split(": unbalanced force")[0]
    text = re.sub(r"\[[^\]]*\]|\([^)]*\d[^)]*\)", "()", text)
    text = re.sub(r"'cable \d+'|cable \d+(, cable \d+)*", "cable", text)
    return f"{type(error).__name__}: " + re.sub(r"-?\d[\d.e+-]*%?", "#", text)[:160]
