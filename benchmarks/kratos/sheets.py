"""The membranes of `benchmarks/validation/kratos_membranes.py`, by Kratos Multiphysics.

    PYTHONPATH=KRATOS python sheets.py SCENE.npz RESULT.npz

SCENE.npz has points and triangles of the arch and of the square. Needs no DOLFINx.
"""

from __future__ import annotations

import sys

import KratosMultiphysics as KM  # noqa: N817
import KratosMultiphysics.ConstitutiveLawsApplication as Laws
import KratosMultiphysics.StructuralMechanicsApplication as Structural
import numpy as np

COMPONENTS = (KM.DISPLACEMENT_X, KM.DISPLACEMENT_Y, KM.DISPLACEMENT_Z)
REACTIONS = (KM.REACTION_X, KM.REACTION_Y, KM.REACTION_Z)
THICKNESS = 0.001


def sheet(points: np.ndarray, cells: np.ndarray, data: dict, law: object) -> KM.ModelPart:
    """A membrane without supports and loads."""
    part = MODEL.CreateModelPart(data["name"])
    part.ProcessInfo[KM.DOMAIN_SIZE] = 3
    for variable in (KM.DISPLACEMENT, KM.REACTION, KM.VOLUME_ACCELERATION, Structural.POINT_LOAD):
        part.AddNodalSolutionStepVariable(variable)
    part.SetBufferSize(2)
    made = part.CreateNewProperties(1)
    made.SetValue(KM.THICKNESS, THICKNESS)
    made.SetValue(KM.CONSTITUTIVE_LAW, law)
    for variable, value in data["values"].items():
        made.SetValue(variable, value)
    for k, point in enumerate(points, start=1):
        part.CreateNewNode(k, *map(float, point))
    for component, reaction in zip(COMPONENTS, REACTIONS, strict=True):
        KM.VariableUtils().AddDof(component, reaction, part)
    for k, triangle in enumerate(cells + 1, start=1):
        nodes = [int(v) for v in triangle]
        element = part.CreateNewElement("MembraneElement3D3N", k, nodes, made)
        a, b, c = points[triangle - 1]
        normal = np.cross(b - a, c - a)
        axis = np.array(data["axis"]) - normal * (normal @ data["axis"]) / (normal @ normal)
        axis /= np.linalg.norm(axis)
        for variable in data["axes"]:
            element.SetValue(variable, KM.Vector([float(x) for x in axis]))
    return part


def solved(part: KM.ModelPart) -> np.ndarray:
    """Displacements (n, 3)."""
    newton = KM.ResidualBasedNewtonRaphsonStrategy(
        part,
        KM.ResidualBasedIncrementalUpdateStaticScheme(),
        KM.ResidualCriteria(1e-12, 1e-14),
        KM.ResidualBasedBlockBuilderAndSolver(KM.SkylineLUFactorizationSolver()),
        200,
        False,
        False,
        True,
    )
    part.CloneTimeStep(1.0)
    newton.Solve()
    return np.array([list(node.GetSolutionStepValue(KM.DISPLACEMENT)) for node in part.Nodes])


MODEL = KM.Model()


def arch(points: np.ndarray, cells: np.ndarray) -> list[float]:
    """u_y of its middle."""
    values = {KM.YOUNG_MODULUS: 1000.0, KM.POISSON_RATIO: 0.2, KM.DENSITY: 700.0,
              Structural.PRESTRESS_VECTOR: KM.Vector([1e4, 0.0, 0.0])}  # fmt: skip
    data = {"name": "arch", "values": values, "axis": (1.0, 0.0, 0.0),
            "axes": (Structural.LOCAL_PRESTRESS_AXIS_1,)}  # fmt: skip
    part = sheet(points, cells, data, Structural.LinearElasticPlaneStress2DLaw())
    for node in part.Nodes:
        node.SetSolutionStepValue(KM.VOLUME_ACCELERATION_Y, -9.81)
        if node.X0 < 1e-9 or node.X0 > 1 - 1e-9:
            for component in COMPONENTS:
                node.Fix(component)
    return [float(solved(part)[20, 1])]


def square(points: np.ndarray, cells: np.ndarray, kind: str, direction: str) -> list[float]:
    """u_x and u_y of its free corner."""
    axis = (0.5**0.5, 0.5**0.5, 0.0) if direction == "diagonal" else (1.0, 0.0, 0.0)
    pulled = kind == "orthotropic"
    if pulled:
        law = Laws.LinearElasticOrthotropic2DLaw()
        values = {KM.YOUNG_MODULUS: 2.1e11, KM.YOUNG_MODULUS_X: 1.05e10,
                  KM.YOUNG_MODULUS_Y: 2.1e11, KM.SHEAR_MODULUS_XY: 7.894e10,
                  KM.POISSON_RATIO_XY: 0.0}  # fmt: skip
        axes = (Structural.LOCAL_MATERIAL_AXIS_1,)
    else:
        law = Structural.LinearElasticPlaneStress2DLaw()
        values = {KM.YOUNG_MODULUS: 2.1e11, KM.POISSON_RATIO: 0.0,
                  Structural.PRESTRESS_VECTOR: KM.Vector([3e10, 0.0, 0.0])}  # fmt: skip
        axes = (Structural.LOCAL_PRESTRESS_AXIS_1,)
    values[KM.DENSITY] = 0.0
    data = {"name": f"{kind} {direction}", "values": values, "axis": axis, "axes": axes}
    part = sheet(points, cells, data, law)
    side = float(points[:, 0].max())
    for k, node in enumerate(part.Nodes, start=1):
        node.Fix(KM.DISPLACEMENT_Z)
        if node.X0 < 1e-9:
            node.Fix(KM.DISPLACEMENT_X)
        if node.Y0 < 1e-9:
            node.Fix(KM.DISPLACEMENT_Y)
        force = [4e6 * (pulled and at > side - 1e-9) for at in (node.X0, node.Y0)]
        if any(force):
            part.CreateNewCondition("PointLoadCondition3D1N", k, [k], part.GetProperties(1))
            node.SetSolutionStepValue(Structural.POINT_LOAD, KM.Array3([*force, 0.0]))
    corner = int(points[:, :2].sum(axis=1).argmax())
    return [float(value) for value in solved(part)[corner, :2]]


def main() -> None:
    """Solve all, and write the displacements."""
    KM.Logger.GetDefaultOutput().SetSeverity(KM.Logger.Severity.WARNING)
    KM.ParallelUtilities.SetNumThreads(1)
    scene = dict(np.load(sys.argv[1]))
    found = {"patch": arch(scene["arch"], scene["arch_cells"])}
    for kind in ("orthotropic", "prestress"):
        for direction in ("diagonal", "horizontal"):
            values = square(scene["square"], scene["square_cells"], kind, direction)
            found[f"{kind}, {direction}"] = values
    np.savez(sys.argv[2], **found)


if __name__ == "__main__":
    main()
