"""Form finding of a film of prescribed section forces by Kratos Multiphysics.

    PYTHONPATH=KRATOS python film.py START.npz RESULT.npz

START.npz has ``points`` (n, 3), ``cells`` (m, 3 or 4), ``held`` (k,), ``stress`` (2,; along the
projection of z and across), and the numbers ``tolerance`` (residual, relative to that of the first
iteration) and ``most`` (iterations). Needs no DOLFINx. The settings are those of Kratos' own
example: membrane elements with prestress and without material stiffness, and the updated reference
strategy. Of the available linear solvers, conjugate gradients are fastest (on 1088 nodes, 20
iterations: 1.06 s; AMGCL 1.10, skyline LU 1.36, sparse LU 1.52), with the same forms to 10 digits.
"""

from __future__ import annotations

import sys
import time

import KratosMultiphysics as KM  # noqa: N817
import KratosMultiphysics.LinearSolversApplication  # registers the solvers
import KratosMultiphysics.StructuralMechanicsApplication as Structural
import numpy as np
from KratosMultiphysics import python_linear_solver_factory
from membrane import COMPONENTS, REACTIONS

SOLVER = '{"solver_type": "LinearSolversApplication.sparse_cg"}'
PROJECTION = """{
    "model_part_name": "film", "echo_level": 0, "projection_type": "planar",
    "global_direction": [0, 0, 1], "variable_name": "LOCAL_PRESTRESS_AXIS_1",
    "visualize_in_vtk": false, "method_specific_settings": {}, "check_local_space_dimension": false
}"""


def build(start: dict, model: KM.Model) -> KM.ModelPart:
    """The film with its supports."""
    part = model.CreateModelPart("film")
    part.ProcessInfo[KM.DOMAIN_SIZE] = 3
    for variable in (KM.DISPLACEMENT, KM.REACTION, KM.VOLUME_ACCELERATION):
        part.AddNodalSolutionStepVariable(variable)
    part.SetBufferSize(2)
    sheet = part.CreateNewProperties(1)
    for variable in (KM.YOUNG_MODULUS, KM.POISSON_RATIO, KM.DENSITY):
        sheet.SetValue(variable, 0.0)
    sheet.SetValue(KM.THICKNESS, 1.0)
    sheet.SetValue(Structural.PRESTRESS_VECTOR, KM.Vector([*map(float, start["stress"]), 0.0]))
    sheet.SetValue(KM.CONSTITUTIVE_LAW, Structural.LinearElasticPlaneStress2DLaw())
    for k, point in enumerate(start["points"], start=1):
        part.CreateNewNode(k, *map(float, point))
    for component, reaction in zip(COMPONENTS, REACTIONS, strict=True):
        KM.VariableUtils().AddDof(component, reaction, part)
    kind = f"MembraneElement3D{start['cells'].shape[1]}N"
    for k, cell in enumerate(start["cells"] + 1, start=1):
        part.CreateNewElement(kind, k, [int(v) for v in cell], sheet)
    for k in start["held"]:
        for component in COMPONENTS:
            part.GetNode(int(k) + 1).Fix(component)
    return part


def find(part: KM.ModelPart, tolerance: float, most: int) -> tuple[int, bool]:
    """Find the form; iterations, and whether the residual has fallen enough."""
    factory = python_linear_solver_factory.ConstructSolver(KM.Parameters(SOLVER))
    strategy = Structural.FormfindingStrategy(
        part,
        KM.ResidualBasedIncrementalUpdateStaticScheme(),
        KM.ResidualCriteria(tolerance, 1e-14),
        KM.ResidualBasedEliminationBuilderAndSolver(factory),
        part,
        False,
        "none",
        KM.Parameters(PROJECTION),
        most,
        False,
        False,
        False,
    )
    part.CloneTimeStep(1.0)
    strategy.Initialize()
    strategy.InitializeSolutionStep()
    strategy.Predict()
    converged = bool(strategy.SolveSolutionStep())
    return int(part.ProcessInfo[KM.NL_ITERATION_NUMBER]), converged


def main() -> None:
    """Find the form and write it, with the processor time from the arrays on."""
    KM.Logger.GetDefaultOutput().SetSeverity(KM.Logger.Severity.WARNING)
    KM.ParallelUtilities.SetNumThreads(1)
    start = dict(np.load(sys.argv[1]))
    began = time.process_time()
    part = build(start, KM.Model())
    built = time.process_time()
    iterations, converged = find(part, float(start["tolerance"]), int(start["most"]))
    ended = time.process_time()
    places = np.array([[node.X0, node.Y0, node.Z0] for node in part.Nodes])
    np.savez(sys.argv[2], places=places, iterations=iterations, converged=converged,
             solving=ended - built, seconds=ended - began)  # fmt: skip


if __name__ == "__main__":
    main()
