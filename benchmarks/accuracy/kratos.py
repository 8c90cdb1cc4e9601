"""Kratos on the cases it supports: exports the scene, imports positions, evaluates results."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from accuracy.cases import PRESSURE, ROPE, Case, Laws, clamped
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

PROGRAM = Path(__file__).parents[1] / "kratos" / "membrane.py"
E, NU, THICKNESS = 300.0, 0.25, 0.08


def folder() -> Path:
    """Where `benchmarks/kratos/install` puts Kratos."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    version = "{}.{}".format(*sys.version_info[:2])
    return cache / "crms_fenicsx" / f"kratos-{version}"


class Kratos:
    """Kratos on a case and a mesh, in a process that repeats its run on request.

    Kratos' cable has Green-Lagrange strain: it gets the EA that has the same tension as ours at
    the case's equilibrium, so that both have one continuum. It starts from a bump of about the
    height that the membrane will have in its first load step, without which Newton's method has no
    stiffness to begin.
    """

    def __init__(self, case: Case, n: int, limit: float) -> None:
        scene = clamped(case.mesh(n), Laws())
        mesh = scene.mesh.mesh
        self.points, self.triangles = mesh.geometry.x.copy(), geometry_dofmap(mesh)
        self.cable, self.limit = np.zeros(0, dtype=int), limit
        if "T" in case.quantities:
            self.cable = np.flatnonzero(np.abs(self.points[:, 1] - 50.0) < 1e-9)
            self.cable = self.cable[np.argsort(self.points[self.cable, 0])]
        strain = 112.60349 / ROPE
        EA = ROPE / ((1 + strain) * (1 + strain / 2))
        height = bump(self.points, len(self.cable) > 0) * case.steps ** (-1 / 3)
        given = {  # the height is as the pressure's cube root
            "points": self.points, "triangles": self.triangles, "cable": self.cable,
            "held": _rim(self.triangles), "start": self.points + height[:, None] * [0.0, 0.0, 1.0],
            "E": E, "nu": NU, "thickness": THICKNESS, "pressure": PRESSURE, "EA": EA,
            "steps": case.steps,
        }  # fmt: skip
        self._place = tempfile.TemporaryDirectory()
        np.savez(f"{self._place.name}/scene.npz", **given)
        files = [f"{self._place.name}/{name}.npz" for name in ("scene", "result")]
        self._process = subprocess.Popen(
            [sys.executable, str(PROGRAM), *files, str(limit)], text=True,
            env=os.environ | {"PYTHONPATH": str(folder())},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def run(self) -> dict:
        """The figures of a run; as those of the package's."""
        assert self._process.stdin is not None and self._process.stdout is not None
        print(file=self._process.stdin, flush=True)
        if not any(line.startswith("DONE") for line in iter(self._process.stdout.readline, "")):
            late = self._process.wait() == -signal.SIGPROF
            reason = f"no convergence in {self.limit:g} s" if late else "ended with an error"
            return {"converged": False, "reason": reason, "seconds": self.limit, "found": {}}
        out = dict(np.load(f"{self._place.name}/result.npz"))
        x = out["places"]
        found = {"w": float(x[:, 2].max()), "V": volume(x, self.triangles)}
        found["W"] = membrane_energy(self.points, x, self.triangles) - PRESSURE * found["V"]
        if len(self.cable):
            length = float(np.linalg.norm(np.diff(x[self.cable], axis=0), axis=1).sum())
            found["T"] = ROPE * (length / 100.0 - 1.0)
            found["W"] += ROPE / 200.0 * max(length - 100.0, 0.0) ** 2
        return {
            "converged": bool(out["converged"]), "found": found,
            "reason": "" if out["converged"] else "Newton's method has not converged",
            "seconds": float(out["seconds"]), "solving": float(out["solving"]),
            "wall": float(out["wall"]), "memory": float(out["memory"]), "base": float(out["base"]),
            "iterations": int(out["iterations"]), "factorizations": int(out["iterations"]),
            "unknowns": 3 * len(self.points),
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
