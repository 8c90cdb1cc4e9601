"""Accuracy of form finding: errors in per cent, against closed forms. See docs/benchmarks.

Catenoids between rings, flat sails with circular edges, a hypar against polynomial surfaces of
degree 12, and domes of a prescribed rise.

    ./run python benchmarks/forms.py [catenoids] [sails] [hypar] [domes]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import meshes
from crms_fenicsx.form_finding import FormCableFound, find_form

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))
from form_meshes import cylinder, nodes, sail

COMM = MPI.COMM_WORLD


def errors(*pairs: tuple[float, float]) -> str:
    """Of found and exact values."""
    return " ".join(f"{100 * (found / exact - 1):10.4f}" for found, exact in pairs)


def sag(cable: FormCableFound) -> float:
    """Largest distance of a cable from its chord."""
    start, end = cable.path[0], cable.path[-1]
    way = (end - start) / np.linalg.norm(end - start)
    off = cable.path - start
    return float(np.linalg.norm(off - np.outer(off @ way, way), axis=1).max())


def catenoids() -> None:
    """Rings of R = 10, H apart: n, H, errors of area and neck."""
    for height in (12.0, 10.0):
        neck = brentq(lambda c, h=height: c * np.cosh(h / 2 / c) - 10.0, 6.0, 10.0)
        area = np.pi * neck * (height + neck * np.sinh(height / neck))
        for n in (16, 32, 64):
            form = find_form(cylinder(COMM, n, n // 4, 10.0, height), 2.0, fixed=["boundary"])
            radii = np.hypot(*nodes(form)[:, :2].T)
            print(f"{n:5d} {height:5g}", errors((form.area, area), (radii.min(), neck)))


def sails() -> None:
    """Flat, 10 x 10, edges of R = 10: size, errors of radius and area."""
    area = 100.0 - 4 * 50.0 * (np.pi / 3 - np.sin(np.pi / 3))
    for size in (1.0, 0.5, 0.25):
        form = sail(COMM, size, tension=20.0)
        sags = np.array([sag(cable) for cable in form.cables])
        radii = 100.0 / (8 * sags) + sags / 2
        worst = radii[np.abs(radii - 10.0).argmax()]
        print(f"{size:5g}", errors((worst, 10.0), (form.area, area)))


def hypar() -> None:
    """Two corners 3 up: size, errors of area and length of an edge."""
    for size in (2.0, 1.0, 0.5, 0.25):
        form = sail(COMM, size, lift=3.0, tension=25.0)
        length = float(np.mean([cable.length for cable in form.cables]))
        print(f"{size:5g}", errors((form.area, 71.31908), (length, 10.765023)))


def domes() -> None:
    """On a circle of R = 10: rise, size, errors of pressure, area and volume."""
    for rise in (4.0, 14.0):
        radius = (100.0 + rise**2) / (2 * rise)
        exact = (4.0 / radius, 2 * np.pi * radius * rise, np.pi * rise**2 * (3 * radius - rise) / 3)
        for size in (2.0, 1.0, 0.5):
            form = find_form(meshes.circle(COMM, 10.0, size), 2.0, fixed=["boundary"], rise=rise)
            found = (form.pressure, form.area, form.volume or 0.0)
            print(f"{rise:5g} {size:5g}", errors(*zip(found, exact, strict=True)))


if __name__ == "__main__":
    for name in sys.argv[1:] or ["catenoids", "sails", "hypar", "domes"]:
        part = {"catenoids": catenoids, "sails": sails, "hypar": hypar, "domes": domes}[name]
        print(f"{name}: {part.__doc__}")
        part()
