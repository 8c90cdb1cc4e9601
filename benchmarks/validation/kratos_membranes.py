"""Membranes of Kratos Multiphysics' tests, on the same meshes in both programs.

The arched strip of `test_patch_test_membrane.py`, whose mesh is made again here from its
dimensions, and the square sheet of `membrane_test/` with an orthotropic fabric or a prestress,
along an edge or along the diagonal. `KRATOS` holds what Kratos 10.4.4 computes, on the meshes
below; with `kratos` as an argument the script runs it again (`sh benchmarks/kratos/install`). The
square's mesh in Kratos' repository is another one, so that its reference files differ from both.

    ./run python benchmarks/validation/kratos_membranes.py [kratos]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from dolfinx import fem

sys.path.insert(0, str(Path(__file__).parents[1]))
from accuracy.kratos import folder

from crms_fenicsx import OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import MembraneMaterial
from validation.table import COMM, OURS, PUBLISHED, Row, labels, panels, report, save

STATIONS = (0.0, 0.3332937795, 0.6667065195, 1.0), (0.1666202255, 0.5000000746, 0.8333799236)
"""Places along the arch of the corners and of the middles of its cells; they are not even."""
SAGITTA = 0.01
WEIGHT, THICKNESS, PRESTRESS = 700.0 * 9.81, 0.001, 1e4
SIDE, FORCE, CELLS = 1.2, 4e6, 13
"""Of the square; a force on each vertex of two edges."""
STIFF, SOFT, SHEAR, MODULUS = 2.1e11, 1.05e10, 7.894e10, 2.1e11
STRESS = 3e10

CASES = ("orthotropic, diagonal", "orthotropic, horizontal", "prestress, diagonal",
         "prestress, horizontal")  # fmt: skip
FILES = {
    "patch": (-0.04937043,), "orthotropic, diagonal": (1.0107244546729122, 1.013624206353548),
    "orthotropic, horizontal": (1.4883199704959853, 0.2267393031419876),
    "prestress, diagonal": (-0.1387708922138907, -0.13877416111469582),
    "prestress, horizontal": (-0.18581489429548395, 0.0),
}  # fmt: skip
"""What Kratos' repository has as references: of the arch for an element that is no longer there."""
KRATOS: dict[str, tuple[float, ...]] = {
    "patch": (-0.07881352589777196,),
    "orthotropic, diagonal": (0.9896480643602106, 0.9896480643602108),
    "orthotropic, horizontal": (1.4872661117039652, 0.22593855476537555),
    "prestress, diagonal": (-0.13877072796613177, -0.13877072796613182),
    "prestress, horizontal": (-0.18581489432578005, 0.0),
}
"""What Kratos 10.4.4 computes on our meshes."""


def arch() -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of the arched strip: squares cut by both diagonals."""
    radius = (0.25 + SAGITTA**2) / (2 * SAGITTA)

    def points(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        x, z = (a.ravel() for a in np.meshgrid(x, z))
        y = radius - SAGITTA - np.sqrt(radius**2 - (x - 0.5) ** 2)
        return np.column_stack([x, y, z])

    corners, middles = (np.array(part) for part in STATIONS)
    even = np.arange(4) / 3
    every = np.vstack([points(corners, even), points(middles, (even[1:] + even[:-1]) / 2)])
    cells = []
    for k in range(9):
        row, column = divmod(k, 3)
        a, m = 4 * row + column, 16 + k
        round_about = (a, a + 1, a + 5, a + 4)
        cells += [(round_about[i], round_about[(i + 1) % 4], m) for i in range(4)]
    return every, np.array(cells)


def hanging_arch() -> float:
    """Displacement y of the arch's middle."""
    points, cells = arch()
    mesh = meshes.from_arrays(COMM, points, cells, outside=(0.0, -1.0, 0.0))
    material = OrthotropicMembrane(
        1000.0, 1000.0, 1000.0 / 2.4, 0.2, THICKNESS, warp=(1.0, 0.0, 0.0),
        prestress=(PRESTRESS * THICKNESS, 0.0), wrinkling=False,
    )  # fmt: skip
    scene = Scene(mesh, material)
    scene.fix(lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9))
    scene.put_load((0.0, -WEIGHT * THICKNESS, 0.0), name="weight", per="material")
    Solver(scene).advance(load=1.0)
    return float(at(scene, points[20])[1])


def at(scene: Scene, place: np.ndarray) -> np.ndarray:
    """Displacement of the vertex at a stress-free place (3,)."""
    x = scene.V.tabulate_dof_coordinates()
    k = int(np.linalg.norm(x - place, axis=1).argmin())
    return np.asarray(scene.u.x.array.reshape(-1, 3)[k])


def fabric(case: str) -> MembraneMaterial:
    """The square's material."""
    kind, direction = case.split(", ")
    axis = (1.0, 1.0, 0.0) if direction == "diagonal" else (1.0, 0.0, 0.0)
    if kind == "orthotropic":
        return OrthotropicMembrane(SOFT, STIFF, SHEAR, 0.0, THICKNESS, warp=axis, wrinkling=False)
    return OrthotropicMembrane(
        MODULUS, MODULUS, MODULUS / 2, 0.0, THICKNESS, warp=axis,
        prestress=(STRESS * THICKNESS, 0.0), wrinkling=False,
    )  # fmt: skip


def square() -> MembraneMesh:
    """Mesh of the square."""
    return meshes.rectangle(COMM, SIDE, SIDE, SIDE / CELLS, structured=True)


def corner(case: str) -> np.ndarray:
    """Displacement (x, y) of the square's free corner."""
    scene = Scene(square(), fabric(case))
    scene.fix("left", "x")
    scene.fix("front", "y")
    scene.fix(lambda x: x[0] > -1.0, "z")
    pulled = case.startswith("orthotropic")
    forces = fem.Function(scene.V)
    x, values = scene.V.tabulate_dof_coordinates(), forces.x.array.reshape(-1, 3)
    for k in (0, 1):
        values[x[:, k] > SIDE - 1e-9, k] = FORCE
    scene.put_forces(forces)
    Solver(scene).advance(load=float(pulled))
    return at(scene, np.array([SIDE, SIDE, 0.0]))[:2]


def main() -> None:
    """Print the table and draw the picture."""
    if "kratos" in sys.argv[1:]:
        run_kratos()
    ours = {"patch": np.array([hanging_arch()])} | {case: corner(case) for case in CASES}
    rows, compared = [], []
    for case, values in ours.items():
        name = "arched strip: u_y of its middle (m)" if case == "patch" else f"square, {case}"
        for k, (value, theirs) in enumerate(zip(values, KRATOS[case], strict=False)):
            which = "" if case == "patch" else f": u_{'xy'[k]} of the corner (m)"
            rows.append(Row(name + which, theirs, float(value), 0.0, "Kratos 10.4.4, run by us",
                            zero=1.0))  # fmt: skip
            rows.append(Row(name + which, FILES[case][k], float(value), 0.0, "first hand, "
                            + ("reference of 2019, of an element since removed" if case == "patch"
                               else "Kratos' file, on its own mesh"), zero=1.0))  # fmt: skip
            compared.append((theirs, float(value)))
    report("Kratos", rows)
    figure, (left, right) = panels()
    scene = Scene(square(), fabric(CASES[1]))
    x = scene.V.tabulate_dof_coordinates()
    left.plot(x[:, 0], x[:, 1], ".", color="0.7", markersize=3, label="stress-free")
    left.plot(SIDE + ours[CASES[1]][0], SIDE + ours[CASES[1]][1], "o", color=OURS, label="package")
    left.plot(SIDE + KRATOS[CASES[1]][0], SIDE + KRATOS[CASES[1]][1], "x", color=PUBLISHED,
              label="Kratos, same mesh")  # fmt: skip
    left.plot(SIDE + FILES[CASES[1]][0], SIDE + FILES[CASES[1]][1], "s", color=PUBLISHED,
              mfc="none", label="Kratos, its mesh")  # fmt: skip
    labels(left, "x [m]", "y [m]", f"square, {CASES[1]}: its corner")
    a, b = np.array(compared).T
    right.semilogy(np.arange(len(a)), np.maximum(np.abs(b - a), 1e-12), "o", color=OURS)
    labels(right, "displacement, in the table's order", "|package - Kratos| [m]", "same mesh",
           legend=False)  # fmt: skip
    save(figure, "kratos_membranes")


PROGRAM = Path(__file__).parents[1] / "kratos" / "sheets.py"


def run_kratos() -> None:
    """Compute `KRATOS` again."""
    points, cells = arch()
    mesh = square().mesh
    with tempfile.TemporaryDirectory() as place:
        np.savez(f"{place}/scene.npz", arch=points, arch_cells=cells, square=mesh.geometry.x,
                 square_cells=geometry_dofmap(mesh))  # fmt: skip
        subprocess.run(
            [sys.executable, str(PROGRAM), f"{place}/scene.npz", f"{place}/result.npz"],
            env=os.environ | {"PYTHONPATH": str(folder())}, check=True,
        )  # fmt: skip
        for name, values in np.load(f"{place}/result.npz").items():
            KRATOS[name] = tuple(map(float, values))
            print(name, KRATOS[name])


if __name__ == "__main__":
    main()
