"""Clamped net of an air hall
==========================

A tennis hall under a net of 12 cables, sliding or clamped at its crossings, in a diagonal storm.

The hall is that of the air hall tutorial: 36 x 36 m in plan, found as a soap film under operating
pressure, with a net of 12 steel cables that is 1 % shorter than the form. All crossings of the net
are clamped as it is laid, or none; then the wind blows over a corner. The cables lie along lines of
the mesh, and a clamp is a vertex where two of them meet: each cable has one tension from clamp to
clamp, and the crossing cables take the differences. Units: m, kN.

::

    ./run python demos/clamped_net.py [SIZE] [--resume]

with the cell size, 1.6 m by default.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, Solver, meshes, nets
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.results.output import draw, join_pictures

RESULTS = "results/clamped_net"
HALF = 18.0  # half the side of the plan
CALM, STORM, GUST = 0.3, 0.4, 0.5  # kPa: inside in operation and in storms, q_p of the wind
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.6))


# %%
# Hall and net
# ------------
# The lines of the net run at 45 degrees to the sides, 4.24 m apart, pulled taut over the form. The
# form is then cut along them.
plan = meshes.rectangle(MPI.COMM_WORLD, 2 * HALF, 2 * HALF, size, corner=(-HALF, -HALF))
form = find_form(plan, stress=3.78, fixed=["boundary"], pressure=CALM)
fabric = OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)
offsets = np.array([-15.0, -9.0, -3.0, 3.0, 9.0, 15.0]) / np.sqrt(2.0)
net = nets.sections(form.scene(fabric), (np.pi / 4, -np.pi / 4), offsets, shortest=True)
form = form.along(net)


def wind(points, normals):
    """Pressure coefficients of wind that blows to (1, 1)."""
    away = (normals[0] + normals[1]) / np.sqrt(2.0)
    return np.interp(away, [-0.9, -0.45, -0.2, 0.2, 0.5, 1.0], [0.7, 0.0, -1.0, -1.0, -0.4, -0.4])


# %%
# Storm
# -----
# The same storm over both nets.
LOOK = {
    "box": ((-18.5, -18.5, 0.0), (18.5, 18.5, 10.5)),
    "view": (-125.0, 30.0),
    "colour": "stress",
    "limits": (0.0, 16.0),
    "line_limits": (0.0, 90.0),
    "unit": "m",
    "force": "kN",
    "width": 7.5,
    "dpi": 110,
}
found = {}
for name in ("sliding", "clamped"):
    scene = form.scene(fabric)
    scene.lay_net(net, Cable(EA=20e3), clamped=name == "clamped")
    solver = Solver(scene, results=f"{RESULTS}/{name}", resume="--resume" in sys.argv)
    solver.advance(pressure=CALM, L0={cable: 0.99 * cable.L0 for cable in scene.cables})
    scene.put_wind(GUST, wind, name="wind")
    solver.advance(pressure=STORM, load={"wind": 1.5})
    title = f"Diagonal storm, {name}"
    draw(solver, f"{RESULTS}/{name}.png", title=title, **LOOK)
    tensions = np.concatenate([cable.tensions for cable in scene.cables])
    clamps = solver.clamp_forces()
    found[name] = {
        "largest tension": tensions.max(),
        "deflection": solver.summary().displacement.value,
        "clamp": max((clamp.size for clamp in clamps.values()), default=0.0),
    }
    if scene.comm.rank == 0:
        print(f"{name}: tensions from {tensions.min():.1f} to {tensions.max():.1f} kN,"
              f" moved up to {found[name]['deflection']:.2f} m, clamps hold up to"
              f" {found[name]['clamp']:.1f} kN")  # fmt: skip

# %%
# Which is better
# ---------------
# Under air pressure and suction, which act everywhere, the cables of both nets carry alike: clamps
# transfer a few per cent of the largest tension, and the hall moves a little less. A net of
# geodesics thus needs clamps to keep its meshes during erection and under loads on small parts of
# the roof, rather than for a storm; an equidistant net needs them to carry load at all.
if scene.comm.rank == 0:
    pictures = [f"{RESULTS}/{name}.png" for name in found]
    join_pictures(f"{RESULTS}/both.png", pictures, upright=True)
    print(f"files: {RESULTS}")
