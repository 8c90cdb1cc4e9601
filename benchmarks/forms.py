"""Accuracy of form finding: errors in per cent, against closed forms. See docs/benchmarks.

Catenoids between rings, flat sails with circular edges and with sharp corners, a hypar against
polynomial surfaces of degree 12, domes of a prescribed rise; and forces that differ along warp and
weft: between two waves of small slope, in vaults, and between rings.

    ./run python benchmarks/forms.py [catenoids] [sails] [corners] [hypar] [domes]
                                     [waves] [vaults] [rings]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import meshes
from crms_fenicsx.design.form_finding import FormCableFound, find_form

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))  # their meshes
sys.path.append(str(Path(sys.path[-1]).parent / "design" / "form_finding"))  # and closed forms
from form_meshes import cylinder, nodes, sail
from test_hypar import sag as mean_sag
from test_sharp_corners import arc
from test_sharp_corners import sail as sharp_sail
from test_warp_and_weft import nearest_neck, wave

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
    """Rings of R = 10, H apart: n, H, errors of area and neck, iterations and deviation; and the
    errors within polygons as long as the rings."""
    for height in (12.0, 10.0):
        neck = brentq(lambda c, h=height: c * np.cosh(h / 2 / c) - 10.0, 6.0, 10.0)
        area = np.pi * neck * (height + neck * np.sinh(height / neck))
        for n in (16, 32, 64, 128):
            found, longer = [], 10.0 * np.pi / n / np.sin(np.pi / n)
            for rows, radius in ((n // 4, 10.0), (2 * round(n / 5), longer)):
                mesh = cylinder(COMM, n, rows, radius, height)
                form = find_form(mesh, 2.0, fixed=["boundary"])
                neck_found = np.hypot(*nodes(form)[:, :2].T).min()
                found.append(errors((form.area, area), (neck_found, neck)))
                found.append(f"{form.iterations:4d} {form.deviation:8.1e}")
            print(f"{n:5d} {height:5g}", *found)


def sails() -> None:
    """Flat, 10 x 10, edges of R = 10: size, errors of radius and area, also unstructured."""
    area = 100.0 - 4 * 50.0 * (np.pi / 3 - np.sin(np.pi / 3))
    for size in (1.0, 0.5, 0.25):
        pairs = []
        for structured in (True, False):
            form = sail(COMM, size, structured=structured, tension=20.0)
            sags = np.array([sag(cable) for cable in form.cables])
            radii = 100.0 / (8 * sags) + sags / 2
            worst = radii[np.abs(radii - 10.0).argmax()]
            pairs += [(worst, 10.0), (form.area, area)]
        print(f"{size:5g}", errors(*pairs))


def corners() -> None:
    """Flat, corners of 17.4 and 1.5 degrees: size, errors of area and of a cable's length."""
    for sides, tensions in (((12.0, 8.0), (15.0, 24.0)), ((10.0, 10.0), (10.4, 40.0))):
        exact = [arc(c, T) for c, T in zip(sides, tensions, strict=True)]
        area = sides[0] * sides[1] - 2 * sum(one[1] for one in exact)
        for size in (0.5, 0.25, 0.125):
            form = sharp_sail(COMM, sides, tensions, round(min(sides) / size))
            print(f"{size:5g}", errors((form.area, area), (form.cables[0].length, exact[0][0])),
                  f"{form.iterations:4d}")  # fmt: skip


def hypar() -> None:
    """Two corners 3 up: size, errors of area, and of length and mean sag of an edge."""
    for size in (2.0, 1.0, 0.5, 0.25):
        form = sail(COMM, size, lift=3.0, tension=25.0)
        length = float(np.mean([cable.length for cable in form.cables]))
        depth = float(np.mean([mean_sag(cable.path) for cable in form.cables]))
        pairs = (form.area, 71.31908), (length, 10.765023), (depth, 0.760238)
        print(f"{size:5g}", errors(*pairs))


def domes() -> None:
    """On a circle of R = 10: rise, size, errors of pressure, area and volume, deviation and
    disturbance."""
    for rise in (4.0, 14.0):
        radius = (100.0 + rise**2) / (2 * rise)
        exact = (4.0 / radius, 2 * np.pi * radius * rise, np.pi * rise**2 * (3 * radius - rise) / 3)
        for size in (2.0, 1.0, 0.5):
            form = find_form(meshes.circle(COMM, 10.0, size), 2.0, fixed=["boundary"], rise=rise)
            found = (form.pressure, form.area, form.volume or 0.0)
            print(f"{rise:5g} {size:5g}", errors(*zip(found, exact, strict=True)),
                  f"{form.deviation:9.1e} {form.disturbance:9.1e}")  # fmt: skip


def waves() -> None:
    """Strip of 6 x 4, forces along x over those along y: errors of its middle's height."""
    for ratio, warp in ((4.0, (1.0, 0.0, 0.0)), (0.25, (0.0, 1.0, 0.3))):
        exact = 1 / np.cosh(np.pi / 3 * np.sqrt(ratio))
        sizes = (1.0, 0.5, 0.25)
        print(f"{ratio:5g}", errors(*((wave(COMM, h, (4.0, 1.0), warp), exact) for h in sizes)))


def on_vault(x: np.ndarray) -> np.ndarray:
    """Ways of a flat rim, 12 wide, to a vault of radius 10."""
    turn = np.arcsin(0.6) * (x[0] / 6.0 - 1.0)
    return np.stack([6.0 + 10.0 * np.sin(turn) - x[0], 0 * x[0], 10.0 * np.cos(turn) - 8.0])


def vaults() -> None:
    """Of 12 x 8 under (4, 2): warp, size, largest error of the radius, and deviation."""
    for name, warp, across in (("along", (0, 1, 0), 2.0), ("across", (1, 0, 0), 4.0)):
        for size in (2.0, 1.0, 0.5):
            mesh = meshes.rectangle(COMM, 12.0, 8.0, size, structured=True)
            form = find_form(mesh, (4.0, 2.0), fixed=["boundary"], lifted={"boundary": on_vault},
                             warp=warp, pressure=across / 10.0)  # fmt: skip
            x = nodes(form)
            off = np.abs(np.hypot(x[:, 0] - 6.0, x[:, 2] + 8.0) / 10.0 - 1.0).max()
            print(f"{name:6} {size:5g} {100 * off:10.4f} {100 * form.deviation:10.4f}")


def rings() -> None:
    """8 apart: forces, neck of the nearest catenary, errors of 16, 32 and 64 cells around; the
    deviation, and that of the catenary."""
    for forces in ((2.0, 2.0), (2.2, 2.0), (3.0, 2.0), (4.0, 2.0), (2.0, 2.5), (2.0, 3.0)):
        neck, ideal = nearest_neck(*forces)
        pairs = []
        for n in (16, 32, 64):
            form = find_form(cylinder(COMM, n, n // 4, 10.0, 8.0), forces, fixed=["boundary"],
                             warp=(0, 0, 1))  # fmt: skip
            pairs.append((np.hypot(*nodes(form)[:, :2].T).min(), neck))
        print(f"{forces} {neck:.4f}", errors(*pairs), f"{form.deviation:9.1e} {ideal:9.1e}")


PARTS = {part.__name__: part
         for part in (catenoids, sails, corners, hypar, domes, waves, vaults, rings)}  # fmt: skip

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        print(f"{name}: {PARTS[name].__doc__}")
        PARTS[name]()
