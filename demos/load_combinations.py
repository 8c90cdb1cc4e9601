"""Load combinations and a report
==============================

An air dome under combinations of loads, with a report to attach to a calculation.

A spherical cap of 40 m span, 10 m high, of coated fabric, with warp and weft; two families of 3
steel cables cross on it. Three combinations of weight, snow, wind and inner pressure are brought on
from the inflated dome. The report has pictures, section forces, utilisations, envelopes, cable
forces, reactions and the verification's verdicts of all of them, and CSV tables lie beside it.
Loads, factors and strengths are ours, of no code. Units: m, kN.

::

    ./run python demos/load_combinations.py [SIZE] [--resume]

with the cells' size, 1.6 m by default. The picture of the README, docs/report.png, shows pages of
this demo's report.html.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.output import draw

RESULTS = "results/load_combinations"
RADIUS, HEIGHT = 20.0, 10.0
COEFFICIENTS = {-RADIUS: 0.8, 0.0: -1.0, RADIUS: -0.3}  # of the wind's pressure, over x (ours)
COMBINATIONS = {
    "Permanent": {"weight": 1.35},
    "Snow": {"weight": 1.35, "snow": 1.0, "pressure": 1.0},
    "Storm along x": {"weight": 1.0, "wind": 1.0, "pressure": 0.75},
}


def coefficient(points, normals):
    """Pressure coefficient of the wind at the current place."""
    return np.interp(points[0], list(COEFFICIENTS), list(COEFFICIENTS.values()))


size = float(next((word for word in sys.argv[1:] if word != "--resume"), 1.6))
mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=RADIUS, height=HEIGHT, size=size)
scene = Scene(mesh, OrthotropicMembrane(E1=800.0, E2=500.0, G12=30.0, nu21=0.2, thickness=1.0))
scene.fix("boundary")
scene.set_strengths((35.0, 30.0))
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
for family, angle in (("A", 30.0), ("B", -30.0)):
    for k in (1, 2, 3):
        path = meshes.great_circle(RADIUS, HEIGHT, np.radians(angle), 7.0 * (k - 2))
        scene.lay_cable(Cable(EA=30e3), path, name=f"{family}{k}")
scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
solver.advance(pressure=0.4, load={"weight": 1.0})

scene.put_load((0.0, 0.0, -0.75), name="snow", per="plan")
scene.put_wind(0.75, coefficient)
found = solver.combine(COMBINATIONS, steps=2)
solver.report(
    f"{RESULTS}/report.html",
    found,
    title="Air dome of 40 m span",
    about={"Structure": "Spherical cap, 10 m high, 6 steel cables", "Document": "Annex B"},
    unit="m",
    force="kN",
    cable_strengths={cable.name: 80.0 for cable in scene.cables},
)
solver.restore(found["Storm along x"].snapshot)
draw(solver, f"{RESULTS}/storm.png", colour="utilisation", unit="m", force="kN", dpi=110)
for name, one in found.items():
    if scene.comm.rank == 0:
        tensions = one.snapshot.tensions.values()
        print(f"{name:14} tensions from {min(tensions):5.2f} to {max(tensions):5.2f} kN")
