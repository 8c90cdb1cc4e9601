"""Kratos' validation example of a catenoid, by Kratos' form finding and by `find_form`.

A film between two rings of radius 10, H apart, from a cylinder: for H = 12 there is a catenoid, for
H = 14 none (the limit is 13.25487). Both methods use the same vertices, n round and n / 4 high;
Kratos also bilinear quadrilaterals, as in its example. CPU seconds on one thread from arrays to the
form, medians of alternating runs; errors of area and neck in per cent of the catenoid's. Then rings
8 apart under 4 along the axis and 2 around it, which no surface satisfies everywhere.

    sh benchmarks/kratos/install
    ./run python benchmarks/catenoid.py [runs]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from accuracy.kratos import folder
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import ConvergenceError
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "scenes"))
from form_meshes import cylinder

PROGRAM = Path(__file__).parent / "kratos" / "film.py"
RADIUS, FABRIC = 10.0, (4.0, 2.0)
TOLERANCE, MOST = 1e-4, 20  # those of Kratos' example
METHODS = {  # corners of a cell, and most iterations
    "find_form": (3, 0),
    "Kratos, half of them": (3, MOST // 2),
    "Kratos, triangles": (3, MOST),
    "Kratos, quadrilaterals": (4, MOST),
    "Kratos, more": (3, 2 * MOST),
}
Figures = tuple[float, float, float, str]
"""CPU seconds, area, neck, and iterations or what went wrong."""


def catenoid(height: float) -> tuple[float, float]:
    """Neck and area of the stable catenoid; NaN where there is none."""
    half = height / 2
    turn = 0.5524341  # of neck / radius, at the largest height

    def gap(a: float) -> float:
        return float(a * np.cosh(half / a) - RADIUS)

    if gap(turn * RADIUS) > 0:
        return np.nan, np.nan
    a = float(brentq(gap, turn * RADIUS, RADIUS))
    return a, np.pi * a * (height + a * np.sinh(height / a))


def by_find_form(n: int, height: float, stress: tuple[float, float] = (1.0, 1.0)) -> Figures:
    """Ours."""
    began = time.process_time()
    mesh = cylinder(MPI.COMM_WORLD, n, n // 4, RADIUS, height)
    try:
        found = find_form(mesh, stress, fixed=["boundary"], warp=(0.0, 0.0, 1.0))
    except ConvergenceError as error:
        return time.process_time() - began, np.nan, np.nan, str(error).partition(";")[0]
    seconds = time.process_time() - began
    return seconds, found.area, neck(found.mesh.mesh.geometry.x), str(found.iterations)


def by_kratos(
    mesh: MembraneMesh, n: int, corners: int, most: int, stress: tuple[float, float] = (1.0, 1.0)
) -> Figures:
    """Kratos', in a process of its own."""
    points = mesh.mesh.geometry.x
    cells = geometry_dofmap(mesh.mesh) if corners == 3 else quadrilaterals(points, n)
    rim = (points[:, 2] < 1e-9) | (points[:, 2] > points[:, 2].max() - 1e-9)
    with tempfile.TemporaryDirectory() as place:
        np.savez(f"{place}/start.npz", points=points, cells=cells, held=np.flatnonzero(rim),
                 stress=stress, tolerance=TOLERANCE, most=most)  # fmt: skip
        ran = subprocess.run(
            [sys.executable, str(PROGRAM), f"{place}/start.npz", f"{place}/result.npz"],
            env=os.environ | {"PYTHONPATH": str(folder())}, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        if ran.returncode:
            lines = (ran.stderr + ran.stdout).splitlines()
            said = [line for line in lines if "Error" in line] or ["no reason"]
            return np.nan, np.nan, np.nan, said[0][:70]
        out = dict(np.load(f"{place}/result.npz"))
    iterations = f"{out['iterations']}{'' if out['converged'] else ' (not converged)'}"
    return float(out["seconds"]), area(out["places"], cells), neck(out["places"]), iterations


def quadrilaterals(points: np.ndarray, n: int) -> np.ndarray:
    """The cylinder's cells before they are cut, (m, 4)."""
    turn = np.round(np.arctan2(points[:, 1], points[:, 0]) * n / (2 * np.pi)).astype(int) % n
    row = np.unique(np.round(points[:, 2], 6), return_inverse=True)[1]
    at = np.zeros((row.max() + 1, n), dtype=int)
    at[row, turn] = np.arange(len(points))
    right = np.roll(at, -1, axis=1)
    return np.stack([at[:-1], right[:-1], right[1:], at[1:]], axis=-1).reshape(-1, 4)


def neck(points: np.ndarray) -> float:
    """Smallest distance of a vertex from the axis."""
    return float(np.hypot(points[:, 0], points[:, 1]).min())


def area(points: np.ndarray, cells: np.ndarray) -> float:
    """Of triangles, or of bilinear quadrilaterals by 2 x 2 points."""
    p = points[cells]
    if p.shape[1] == 3:
        across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return float(np.linalg.norm(across, axis=1).sum() / 2)
    total, places = 0.0, (0.5 - 12**-0.5, 0.5 + 12**-0.5)
    for s in places:
        for t in places:
            along = (1 - t) * (p[:, 1] - p[:, 0]) + t * (p[:, 2] - p[:, 3])
            up = (1 - s) * (p[:, 3] - p[:, 0]) + s * (p[:, 2] - p[:, 1])
            total += np.linalg.norm(np.cross(along, up), axis=1).sum() / 4
    return float(total)


def main() -> None:
    """Run all in turn and print a table."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    if not folder().exists():
        sys.exit("catenoid: Kratos is missing; run sh benchmarks/kratos/install.")
    by_find_form(16, 10.0)  # compiles its integrals
    print(f"{'H':>3} {'n':>3} {'method':23} {'s':>7} {'area %':>8} {'neck %':>8}  iterations")
    for height in (10.0, 12.0, 14.0):
        exact_neck, exact_area = catenoid(height)
        print(f"{height:3.0f}     catenoid: area {exact_area:.4f}, neck {exact_neck:.6f}")
        for n in (16, 32, 64):
            mesh = cylinder(MPI.COMM_WORLD, n, n // 4, RADIUS, height)
            found: dict[str, list[Figures]] = {name: [] for name in METHODS}
            if height < 14.0:
                del found["Kratos, more"]
            for _ in range(runs):
                for name in found:
                    corners, most = METHODS[name]
                    one = by_kratos(mesh, n, corners, most) if most else by_find_form(n, height)
                    found[name].append(one)
            for name, figures in found.items():
                seconds = float(np.median([one[0] for one in figures]))
                _, size, radius, iterations = figures[0]
                if np.isnan(exact_area):
                    values = f"{size:8.3f} {radius:8.4f}"  # no errors, but what they have reached
                else:
                    errors = (100 * (size / exact_area - 1), 100 * (radius / exact_neck - 1))
                    values = "{:8.3f} {:8.3f}".format(*errors)
                print(f"{height:3.0f} {n:3d} {name:23} {seconds:7.3f} {values}  {iterations}",
                      flush=True)  # fmt: skip
    under_different_forces()


def under_different_forces() -> None:
    """Rings 8 apart: area and neck themselves; one run each."""
    print(f"section forces {FABRIC}")
    for n in (16, 32, 64):
        mesh = cylinder(MPI.COMM_WORLD, n, n // 4, RADIUS, 8.0)
        found = {
            "find_form": by_find_form(n, 8.0, FABRIC),
            "Kratos, triangles": by_kratos(mesh, n, 3, MOST, FABRIC),
            "Kratos, more": by_kratos(mesh, n, 3, 5 * MOST, FABRIC),
        }
        for name, (seconds, size, radius, iterations) in found.items():
            print(f"  8 {n:3d} {name:23} {seconds:7.3f} {size:8.3f} {radius:8.4f}  {iterations}")


if __name__ == "__main__":
    main()
