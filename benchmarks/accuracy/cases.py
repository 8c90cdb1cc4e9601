"""The cases: scenes on a mesh of n cells, load steps, and the two compared numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.laid_cable import LaidCable

COMM = MPI.COMM_SELF
PRESSURE = 0.01
ROPE = 32000.0
FABRIC = OrthotropicMembrane(1394.0, 140.0, 12.0, 0.065, 1.0, warp=(0.0, 1.0, 0.0))


@dataclass(frozen=True)
class Laws:
    """Laws and tolerance of a run.

    Attributes
    ----------
    stepwise
        The paper's step-wise laws of strain, pressure and cables instead of the total ones.
    steps
        Load steps of each stage of loading; None for the case's own number.
    rtol
        The solver's tolerance.
    """

    stepwise: bool = False
    steps: int | None = None
    rtol: float = 1e-9

    def scene(self, mesh: MembraneMesh, material: IsotropicMembrane | OrthotropicMembrane) -> Scene:
        """The membrane."""
        law = "step" if self.stepwise else "total"
        return Scene(mesh, material, strain=law, pressure=law)  # type: ignore[arg-type]

    def cable(self, EA: float, friction: float = 0.0) -> Cable:
        """A cable's data."""
        law = "step" if self.stepwise else "total"
        return Cable(EA, law=law, friction=friction)  # type: ignore[arg-type]

    @property
    def sheet(self) -> IsotropicMembrane:
        """The isotropic membrane."""
        return IsotropicMembrane(300.0, 0.25, 0.08, wrinkling=not self.stepwise)


Run = Callable[[MembraneMesh, Laws], tuple[Solver, dict[str, float]]]


@dataclass(frozen=True)
class Case:
    """A case.

    Attributes
    ----------
    title
        What it is, in a line.
    reference
        Its name in `references.REFERENCES`.
    mesh
        Makes the mesh of n cells a side (or across).
    run
        Does the load steps; what it takes is timed.
    sizes, quick
        Meshes n of the full and of the quick benchmark, from coarse to fine.
    stepwise
        The mesh on which the paper's step-wise laws run; None where they do not.
    outside
        Whether programs without sliding over cells can do it, on these meshes.
    steps
        Load steps that `run` takes with the package's own laws, and other programs with theirs.
    """

    title: str
    reference: str
    mesh: Callable[[int], MembraneMesh]
    run: Run
    sizes: tuple[int, ...]
    quick: tuple[int, ...] = (16,)
    stepwise: int | None = None
    outside: bool = False
    steps: int = 1
    quantities: tuple[str, str] = field(default=("W", "T"))


QUANTITIES: dict[str, Callable[[Solver], float]] = {
    "W": lambda solver: solver.scene.energy,
    "w": lambda solver: top(solver.scene),
    "V": lambda solver: solver.scene.volume,
    "T": lambda solver: float(np.mean([cable.tension for cable in solver.scene.cables] or [0.0])),
    "z": lambda solver: float(middle(solver.scene.cables[0])[2]),
    "y": lambda solver: float(middle(solver.scene.cables[0])[1]) - 50.0,
}
"""What references are of: energy, height of the top, volume, mean tension, place of the cable."""


def top(scene: Scene) -> float:
    """Height of the highest vertex."""
    return float(scene.positions()[:, 2].max())


def square(n: int) -> MembraneMesh:
    """Structured mesh of the square; y = 50 is a mesh line where n is even."""
    return meshes.rectangle(COMM, 100.0, 100.0, 100.0 / n, structured=True)


def free_square(n: int) -> MembraneMesh:
    """Unstructured mesh of the square."""
    return meshes.rectangle(COMM, 100.0, 100.0, 100.0 / n)


def clamped(mesh: MembraneMesh, laws: Laws) -> Scene:
    """A flat, stress-free sheet, held all around."""
    scene = laws.scene(mesh, laws.sheet)
    scene.fix("boundary")
    return scene


def middle(cable: LaidCable) -> np.ndarray:
    """Where a cable on the membrane passes x = 50."""
    x = cable.line
    return np.array([np.interp(50.0, x[:, 0], x[:, i]) for i in range(3)])


def inflated(mesh: MembraneMesh, laws: Laws) -> tuple[Solver, dict[str, float]]:
    """A sheet under pressure, from flat."""
    scene = clamped(mesh, laws)
    solver = Solver(scene, rtol=laws.rtol)
    solver.advance(pressure=PRESSURE, steps=laws.steps or 1)
    return solver, {"W": scene.energy, "w": top(scene), "V": scene.volume}


def with_cable(height: float, steps: int = 1) -> Run:
    """A sheet with a cable of length 100 across it at y = height, inflated from flat."""

    def run(mesh: MembraneMesh, laws: Laws) -> tuple[Solver, dict[str, float]]:
        scene = clamped(mesh, laws)
        # The step-wise law takes its length from the path: it is as long.
        L0 = None if laws.stepwise else 100.0
        path = [(0.0, height), (100.0, height)]
        cable = scene.lay_cable(laws.cable(ROPE), path, L0=L0)
        solver = Solver(scene, rtol=laws.rtol)
        solver.advance(pressure=PRESSURE, steps=laws.steps or steps)
        return solver, {"W": scene.energy, "T": cable.tension}

    return run


def tightened(mesh: MembraneMesh, laws: Laws) -> tuple[Solver, dict[str, float]]:
    """The paper's model 2: inflated; then a cable is laid over it and its ends are pulled down."""
    scene = clamped(mesh, laws)
    solver = Solver(scene, rtol=laws.rtol)
    solver.advance(pressure=PRESSURE, steps=laws.steps or 1)
    ends = [(-80.0, 50.0, 0.0), (180.0, 50.0, 0.0)]
    cable = scene.lay_cable(laws.cable(ROPE), ends)
    solver.advance(move={cable: (0.0, 0.0, -15.0)}, steps=laws.steps or 1)
    return solver, {"W": scene.energy, "T": cable.tension, "z": float(middle(cable)[2])}


def dragged(friction: float) -> Run:
    """The paper's model 3: a cable pressed into a fabric and dragged sideways over it."""

    def run(mesh: MembraneMesh, laws: Laws) -> tuple[Solver, dict[str, float]]:
        scene = laws.scene(mesh, FABRIC)
        scene.fix("front")
        scene.fix("back")
        ends = [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
        cable = scene.lay_cable(laws.cable(47638.0, friction), ends)
        solver = Solver(scene, rtol=laws.rtol)
        solver.advance(move={cable: (0.0, 0.0, -10.0)}, steps=laws.steps or 5)
        solver.advance(move={cable: (0.0, 10.0, 0.0)}, steps=laws.steps or 5)
        y = float(middle(cable)[1]) - 50.0
        return solver, {"W": scene.energy, "T": cable.tension, "y": y}

    return run


def net(mesh: MembraneMesh, laws: Laws) -> tuple[Solver, dict[str, float]]:
    """A small `demos/cable_net.py`: an inflated dome under two families of three cables."""
    scene = laws.scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    scene.fix("boundary")
    solver = Solver(scene, rtol=laws.rtol)
    for angle in np.radians([30.0, -30.0]):
        for offset in (-9.0, 0.0, 9.0):
            path = nets.great_circle(20.0, 10.0, angle, offset)
            ends = np.column_stack([path[[0, -1]], [15.0, 15.0]])  # from the sphere's centre
            length = 25.0 * np.arccos(ends[0] @ ends[1] / 25.0**2)
            # As long as on the sphere: laid taut on its facets, cables are too short by an error
            # that is large against their small strain.
            scene.lay_cable(laws.cable(30e3), path, L0=length)
    solver.advance(pressure=0.4)
    tensions = [cable.tension for cable in scene.cables]
    return solver, {"W": scene.energy, "T": float(np.mean(tensions))}


EVEN, ODD = (8, 16, 32, 64), (9, 17, 33, 65)
CASES: dict[str, Case] = {
    "circle": Case(
        "Inflated circle", "circle", lambda n: meshes.circle(COMM, 100.0, size=200.0 / n), inflated,
        (*EVEN, 128, 192), stepwise=32, outside=True, quantities=("W", "V"),
    ),
    "square": Case(
        "Inflated square", "square", square, inflated,
        (*EVEN, 128, 192), stepwise=32, outside=True, quantities=("W", "w"),
    ),
    "cable on lines": Case(
        "Square with a cable on a mesh line", "centre cable", square, with_cable(50.0),
        EVEN, stepwise=32, outside=True,
    ),
    "cable, 13 steps": Case(
        "Square with a cable on a mesh line, in 13 load steps", "centre cable", square,
        with_cable(50.0, 13), EVEN, outside=True, steps=13,
    ),
    "cable anywhere": Case(
        "Square with a cable across the cells", "centre cable", free_square, with_cable(50.0),
        ODD, (17,),
    ),
    "sliding cable": Case(
        "Cable that slides sideways", "sliding cable", free_square, with_cable(30.0),
        ODD, (17,),
    ),
    "model 2": Case(
        "Model 2: cable tightened over the square", "model 2", square, tightened,
        ODD, (17,), stepwise=33, quantities=("z", "T"),
    ),
    "model 3, smooth": Case(
        "Model 3 without friction", "model 3, smooth", free_square, dragged(0.0),
        (8, 12, 16, 24, 34), (12,),
    ),
    "model 3, rough": Case(
        "Model 3 with mu = 0.7", "model 3, rough", free_square, dragged(0.7),
        (10, 14, 20), (10,), quantities=("y", "T"),
    ),
    "dome net": Case(
        "Air dome with a net of cables", "dome net",
        lambda n: meshes.spherical_cap(COMM, radius=20.0, height=10.0, size=40.0 / n), net,
        (10, 14, 20, 28, 40), (14,),
    ),
}  # fmt: skip
