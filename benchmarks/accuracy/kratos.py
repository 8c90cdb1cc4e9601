"""Kratos on the cases it supports: exports the scene, imports positions, evaluates results."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from accuracy.cases import PRESSURE, ROPE, Case, Laws, clamped
from crms_fenicsx.runtime.compat import geometry_dofmap

PROGRAM = Path(__file__).parents[1] / "kratos" / "membrane.py"
E, NU, THICKNESS = 300.0, 0.25, 0.08


def folder() -> Path:
    """Where `benchmarks/kratos/install` puts Kratos."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    version = "{}.{}".format(*sys.version_info[:2])
    return cache / "crms_fenicsx" / f"kratos-{version}"


def solve_with_kratos(case: Case, n: int, limit: float, runs: int, enough: float) -> dict:
    """The figures of Kratos on a case; as `worker.work`.

    Kratos' cable has Green-Lagrange strain: it gets the EA that has the same tension as ours at
    the case's equilibrium, so that both have one continuum. It starts from a bump of about the
    height that the membrane will have in its first load step, without which Newton's method has no
    stiffness to begin.
    """
    scene = clamped(case.mesh(n), Laws())
    mesh = scene.mesh.mesh
    points, triangles = mesh.geometry.x.copy(), geometry_dofmap(mesh)
    cable = np.zeros(0, dtype=int)
    if "T" in case.quantities:
        cable = np.flatnonzero(np.abs(points[:, 1] - 50.0) < 1e-9)
        cable = cable[np.argsort(points[cable, 0])]
    strain = 112.60349 / ROPE
    EA = ROPE / ((1 + strain) * (1 + strain / 2))
    height = bump(points, len(cable) > 0) * case.steps ** (-1 / 3)  # as the pressure's root
    given = {
        "points": points, "triangles": triangles, "cable": cable, "held": _rim(triangles),
        "start": points + height[:, None] * [0.0, 0.0, 1.0],
        "E": E, "nu": NU, "thickness": THICKNESS, "pressure": PRESSURE, "EA": EA,
        "steps": case.steps,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        np.savez(f"{place}/scene.npz", **given)
        command = [sys.executable, str(PROGRAM), f"{place}/scene.npz", f"{place}/result.npz"]
        environment = os.environ | {"PYTHONPATH": str(folder())}
        command += [str(runs), str(enough)]
        failed = {"converged": False, "reason": f"no convergence in {limit:g} s", "found": {}}
        failed |= {"seconds": limit, "wall": limit}
        try:  # its wall time on a busy machine may be longer
            subprocess.run(command, env=environment, timeout=3 * limit, capture_output=True,
                           text=True, check=True)  # fmt: skip
        except subprocess.TimeoutExpired:
            return failed
        except subprocess.CalledProcessError as error:
            return failed | {"reason": error.stderr.strip().splitlines()[-1]}
        out = dict(np.load(f"{place}/result.npz"))
    if out["seconds"] > limit:
        return failed
    x = out["places"]
    found = {"w": float(x[:, 2].max()), "V": volume(x, triangles)}
    found["W"] = membrane_energy(points, x, triangles) - PRESSURE * found["V"]
    if len(cable):
        length = float(np.linalg.norm(np.diff(x[cable], axis=0), axis=1).sum())
        found["T"] = ROPE * (length / 100.0 - 1.0)
        found["W"] += ROPE / 200.0 * max(length - 100.0, 0.0) ** 2
    return {
        "converged": bool(out["converged"]), "found": found,
        "reason": "" if out["converged"] else "Newton's method has not converged",
        "seconds": float(out["seconds"]), "solving": float(out["solving"]),
        "wall": float(out["wall"]), "runs": int(out["runs"]),
        "memory": float(out["memory"]), "base": float(out["base"]),
        "iterations": int(out["iterations"]), "factorizations": int(out["iterations"]),
        "unknowns": 3 * len(points),
    }  # fmt: skip


def bump(points: np.ndarray, with_cable: bool) -> np.ndarray:
    """Heights to begin from, (n,): of the circle about the origin, or of the square."""
    x, y = points[:, 0] / 100.0, points[:, 1] / 100.0
    if points.min() < -1.0:
        return 23.0 * (1 - x**2 - y**2)
    if with_cable:
        return 3.7 * np.sin(np.pi * x) * np.sin(np.pi * y) + 3.0 * (
            np.sin(np.pi * x) * np.sin(2 * np.pi * y) ** 2
        )
    return 10.0 * np.sin(np.pi * x) * np.sin(np.pi * y)


def _rim(triangles: np.ndarray) -> np.ndarray:
    """Vertices on edges of one triangle only."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]],
                                    triangles[:, [2, 0]]]), axis=1)  # fmt: skip
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return np.unique(unique[count == 1])


def volume(x: np.ndarray, triangles: np.ndarray) -> float:
    """Volume between a surface and the plane of its rim."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return float(np.sum(np.cross(b - a, c - a)[:, 2] / 2 * (a + b + c)[:, 2] / 3))


def membrane_energy(X: np.ndarray, x: np.ndarray, triangles: np.ndarray) -> float:
    """St. Venant-Kirchhoff's strain energy of flat triangles in plane stress."""
    D = np.stack([X[triangles[:, k]] - X[triangles[:, 0]] for k in (1, 2)], axis=2)[:, :2]
    d = np.stack([x[triangles[:, k]] - x[triangles[:, 0]] for k in (1, 2)], axis=2)
    F = d @ np.linalg.inv(D)
    strain = (np.swapaxes(F, 1, 2) @ F - np.eye(2)) / 2
    trace, square = np.trace(strain, axis1=1, axis2=2), np.sum(strain**2, axis=(1, 2))
    density = E * THICKNESS / (1 - NU**2) * (NU * trace**2 + (1 - NU) * square) / 2
    return float(np.sum(density * np.abs(np.linalg.det(D)) / 2))
