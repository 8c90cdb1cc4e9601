"""A membrane under pressure, with a sliding cable on mesh lines, by Kratos Multiphysics.

    PYTHONPATH=KRATOS python membrane.py SCENE.npz RESULT.npz SECONDS

solves for each line of standard input, in at most so many seconds of processor time.

SCENE.npz has ``points`` (n, 3), ``start`` (n, 3; the first guess), ``triangles`` (m, 3), ``held``
(k,), ``cable`` (l,; vertices in order, may be empty), and the numbers ``E``, ``nu``, ``thickness``,
``pressure``, ``EA`` and ``steps``. Needs no DOLFINx. Kratos' pressure tangent is right only up to a
factor with a length in it; in metres instead of the scene's centimetres Newton's method converges,
though not quadratically. The membrane is of St. Venant-Kirchhoff type: with Kratos' wrinkling law
the inflated square has our height in all digits, at n = 16, 32 and 64, but takes two to four times
as long.
"""

from __future__ import annotations

import resource
import signal
import sys
import time

import KratosMultiphysics as KM  # noqa: N817
import KratosMultiphysics.CableNetApplication as CableNet
import KratosMultiphysics.LinearSolversApplication  # registers the solvers
import KratosMultiphysics.StructuralMechanicsApplication as Structural
import numpy as np
from KratosMultiphysics import python_linear_solver_factory

UNIT = 0.01  # a centimetre in metres
SOLVER = '{"solver_type": "amgcl"}'
TOLERANCE = 1e-9
ITERATIONS = 60
COMPONENTS = (KM.DISPLACEMENT_X, KM.DISPLACEMENT_Y, KM.DISPLACEMENT_Z)
REACTIONS = (KM.REACTION_X, KM.REACTION_Y, KM.REACTION_Z)


def properties(part: KM.ModelPart, number: int, E: float, law: object) -> KM.Properties:
    """A material."""
    made = part.CreateNewProperties(number)
    made.SetValue(KM.YOUNG_MODULUS, E)
    made.SetValue(KM.DENSITY, 0.0)
    made.SetValue(KM.CONSTITUTIVE_LAW, law)
    return made


def build(scene: dict, model: KM.Model) -> KM.ModelPart:
    """The structure, in metres."""
    part = model.CreateModelPart("structure")
    part.ProcessInfo[KM.DOMAIN_SIZE] = 3
    for variable in (KM.DISPLACEMENT, KM.REACTION, KM.VOLUME_ACCELERATION,
                     KM.POSITIVE_FACE_PRESSURE, KM.NEGATIVE_FACE_PRESSURE):  # fmt: skip
        part.AddNodalSolutionStepVariable(variable)
    part.SetBufferSize(2)
    law = Structural.LinearElasticPlaneStress2DLaw()
    sheet = properties(part, 1, float(scene["E"]) / UNIT**2, law)
    sheet.SetValue(KM.POISSON_RATIO, float(scene["nu"]))
    sheet.SetValue(KM.THICKNESS, float(scene["thickness"]) * UNIT)
    sheet.SetValue(Structural.PRESTRESS_VECTOR, KM.Vector(3, 0.0))
    for k, point in enumerate(UNIT * scene["points"], start=1):
        part.CreateNewNode(k, *map(float, point))
    for component, reaction in zip(COMPONENTS, REACTIONS, strict=True):
        KM.VariableUtils().AddDof(component, reaction, part)
    for k, triangle in enumerate(scene["triangles"] + 1, start=1):
        nodes = [int(v) for v in triangle]
        part.CreateNewElement("MembraneElement3D3N", k, nodes, sheet)
        part.CreateNewCondition("SurfaceLoadCondition3D3N", k, nodes, sheet)
    if len(scene["cable"]):
        add_cable(scene, model, part)
    for k, way in enumerate(UNIT * (scene["start"] - scene["points"]), start=1):
        node = part.GetNode(k)
        for component, value in zip(COMPONENTS, way, strict=True):
            node.SetSolutionStepValue(component, 0, float(value))
        node.X, node.Y, node.Z = map(float, np.array([node.X0, node.Y0, node.Z0]) + way)
    for k in scene["held"]:
        for component in COMPONENTS:
            part.GetNode(int(k) + 1).Fix(component)
    return part


def add_cable(scene: dict, model: KM.Model, part: KM.ModelPart) -> None:
    """One sliding cable element through all its nodes."""
    rope = properties(part, 2, float(scene["EA"]), Structural.TrussConstitutiveLaw())
    rope.SetValue(Structural.CROSS_AREA, 1.0)
    rope.SetValue(Structural.TRUSS_PRESTRESS_PK2, 0.0)
    nodes = [int(v) + 1 for v in scene["cable"]]
    edge = part.CreateSubModelPart("cable")
    edge.AddNodes(nodes)
    edge.AddProperties(rope)
    settings = KM.Parameters('{"edge_sub_model_part_name": "structure.cable", '
                             '"element_type": "cable", "property_id": 2}')  # fmt: skip
    settings.AddEmptyValue("node_id_order").SetVector(KM.Vector([float(k) for k in nodes]))
    settings.AddEmptyValue("element_id").SetInt(len(scene["triangles"]) + 1)
    CableNet.EdgeCableElementProcess(edge, settings).ExecuteInitialize()


def solve(scene: dict) -> tuple[np.ndarray, int, bool, float]:
    """Newton's method in equal load steps.

    Returns
    -------
    Positions (n, 3), iterations, whether all steps converged, and the processor time of solving.
    """
    part = build(scene, KM.Model())
    factory = python_linear_solver_factory.ConstructSolver(KM.Parameters(SOLVER))
    newton = KM.ResidualBasedNewtonRaphsonStrategy(
        part,
        KM.ResidualBasedIncrementalUpdateStaticScheme(),
        KM.ResidualCriteria(TOLERANCE, 1e-14),
        KM.ResidualBasedEliminationBuilderAndSolver(factory),
        ITERATIONS,
        False,
        False,
        True,
    )
    began, iterations, converged = time.process_time(), 0, True
    steps, pressure = int(scene["steps"]), float(scene["pressure"]) / UNIT**2
    for step in range(1, steps + 1):
        part.CloneTimeStep(float(step))
        share = pressure * step / steps
        KM.VariableUtils().SetScalarVar(KM.NEGATIVE_FACE_PRESSURE, share, part.Nodes)
        if step == 1:
            newton.Initialize()
        newton.InitializeSolutionStep()
        newton.Predict()
        converged &= bool(newton.SolveSolutionStep())
        newton.FinalizeSolutionStep()
        iterations += int(part.ProcessInfo[KM.NL_ITERATION_NUMBER])
    solving = time.process_time() - began
    places = np.array([[node.X, node.Y, node.Z] for node in part.Nodes]) / UNIT
    return places, iterations, converged, solving


def peak() -> float:
    """Peak memory of this process so far (MiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """For each line of standard input solve and write positions, times, iterations and memory."""
    KM.Logger.GetDefaultOutput().SetSeverity(KM.Logger.Severity.WARNING)
    KM.ParallelUtilities.SetNumThreads(1)
    scene, base = dict(np.load(sys.argv[1])), peak()
    for _ in sys.stdin:
        signal.setitimer(signal.ITIMER_PROF, float(sys.argv[3]))  # its signal ends the process
        began = time.process_time(), time.perf_counter()
        places, iterations, converged, solving = solve(scene)
        ended = time.process_time(), time.perf_counter()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        np.savez(sys.argv[2], places=places, seconds=ended[0] - began[0], solving=solving,
                 wall=ended[1] - began[1], iterations=iterations, converged=converged,
                 memory=peak(), base=base)  # fmt: skip
        print("DONE", flush=True)


if __name__ == "__main__":
    main()
