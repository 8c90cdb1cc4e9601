"""Tuning a net
============

The 12 cables of an air hall are tuned to one tension, and their lengths written for fabrication.

The hall is that of the clamped net tutorial, its cables along lines of the mesh. All 1 % shorter
than the form, they have different tensions in operation. The unstressed lengths for one tension
follow from the derivatives of all tensions by all lengths, computed from the exact tangent; a few
load steps suffice. The fabrication lengths are then written to a table. Units: m, kN.

::

    ./run python demos/net_tuning.py [SIZE]

with the cell size, 1.6 m by default.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, Solver, meshes, nets
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.results.output import draw

RESULTS = "results/net_tuning"
HALF = 18.0  # half the side of the plan
CALM, WANTED = 0.3, 17.0  # kPa in operation, kN
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.6))

# %%
# Hall and net
# ------------
plan = meshes.rectangle(MPI.COMM_WORLD, 2 * HALF, 2 * HALF, size, corner=(-HALF, -HALF))
form = find_form(plan, stress=3.78, fixed=["boundary"], pressure=CALM)
fabric = OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)
offsets = np.array([-15.0, -9.0, -3.0, 3.0, 9.0, 15.0]) / np.sqrt(2.0)
net = nets.sections(form.scene(fabric), (np.pi / 4, -np.pi / 4), offsets, shortest=True)
scene = form.along(net).scene(fabric)
cables = scene.lay_net(net, Cable(EA=20e3))
solver = Solver(scene, results=RESULTS)
solver.advance(pressure=CALM, L0={cable: 0.99 * cable.L0 for cable in cables})
before = np.array([cable.tension for cable in cables])

# %%
# Shortening one cable
# --------------------
# A shortened cable gains tension, and its neighbours lose some.
found = solver.sensitivities([*cables, "energy"], cables)
own, others = np.diag(found.values), found.values[:-1] - np.diag(np.diag(found.values))
more, less = -own.min() / 100, others.max() / 100
if scene.comm.rank == 0:
    print(f"tensions from {before.min():.1f} to {before.max():.1f} kN")
    print(f"1 cm shorter, a cable has up to {more:.2f} kN more, another one {less:.2f} kN less")

# %%
# Tuning
# ------
lengths = nets.tune(solver, dict.fromkeys(cables, WANTED))
steps = len(solver.steps) - 1
after = np.array([cable.tension for cable in cables])
draw(solver, f"{RESULTS}/tuned.png", title=f"All cables at {WANTED:g} kN", colour="stress",
     unit="m", force="kN", view=(-125.0, 30.0))  # fmt: skip

# %%
# Order
# -----
# The cables are cut on a bench at 10 kN and at 15 kelvin below the roof's temperature, with 0.35 m
# more for each of the two fittings.
order = nets.lengths_to_order(scene, tension=10.0, temperature=-15.0, allowance=0.35)
order.write(f"{RESULTS}/order.csv")
cut = [one.cut for one in order.cables.values()]
if scene.comm.rank == 0:
    print(f"tuned in {steps} load steps: {after.min():.3f} to {after.max():.3f} kN; cables are cut"
          f" to {min(cut):.3f} to {max(cut):.3f} m")  # fmt: skip
    print(f"files: {RESULTS}")
