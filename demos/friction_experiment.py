"""Friction
========

A cable dragged sideways over an orthotropic fabric with friction (the paper's model 3).

The paper compares this model with an experiment, whose drawing and measured curves are lost. Data
of fabric, cable and friction are the paper's; the sheet is an assumption: 100 cm square, flat and
stress-free, clamped along the two edges at the ends of the warp, free along the other two. A cable
lies across the sheet. Its ends, 10 cm beside the free edges, are moved 10 cm down in 5 steps, which
presses the cable into the fabric like the valley cable of a tent, and then 10 cm sideways along the
warp in 10 steps.

Without friction the cable follows its ends at once. With mu = 0.7 it sticks and drags the fabric
along, less and less from the ends inwards, until the ends have moved some 4 cm; then the whole
cable slides. `Friction(0.7, static=1.0)` would distinguish static from kinetic friction; here the
cable slips gradually from its ends inwards, and the distinction changes little. Units: kgf, cm.

::

    ./run python demos/friction_experiment.py [SIZE] [--resume]

with the cell size, 5 cm by default.
"""

import sys

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import draw, join_pictures

# %%
# Fabric and cable
# ----------------
# The fabric is ten times as stiff along its warp as along its weft, and hardly resists shear.
RESULTS = "results/friction_experiment"
SIZE = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 5.0))
THICKNESS = 0.1  # only the moduli times the thickness matter
FABRIC = OrthotropicMembrane(
    E1=1394.0 / THICKNESS, E2=140.0 / THICKNESS, G12=12.0 / THICKNESS, nu21=0.065,
    thickness=THICKNESS, warp=(0.0, 1.0, 0.0),
)  # fmt: skip
RUNS = {"smooth": (0.0, "no friction"), "rough": (0.7, "µ = 0.7")}
DOWN, SIDEWAYS, ALONG = 5, 10, np.linspace(0.0, 100.0, 101)


# %%
# The experiment
# --------------
def experiment(name):
    """Positions y, z of the cable along the sheet after each step; its tensions; the solver."""
    mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=100.0, size=SIZE)
    scene = Scene(mesh, FABRIC)
    scene.fix("front")
    scene.fix("back")
    friction, _ = RUNS[name]
    cable = scene.lay_cable(
        Cable(EA=47638.0, friction=friction), path=[(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
    )
    solver = Solver(scene, results=f"{RESULTS}/{name}", resume="--resume" in sys.argv)
    places, tensions = [], []
    for way in [(0.0, 0.0, -10.0 / DOWN)] * DOWN + [(0.0, 10.0 / SIDEWAYS, 0.0)] * SIDEWAYS:
        solver.advance(move={cable: way})
        x, y, z = cable.line.T
        places.append((np.interp(ALONG, x, y) - 50.0, np.interp(ALONG, x, z)))
        tensions.append(cable.tension)
    draw(
        solver, f"{RESULTS}/{name}.png", colour="stress", view=(-65.0, 35.0), unit="cm",
        force="kgf", title=RUNS[name][1], width=6.0, dpi=100, limits=(0.0, 20.0),
    )  # fmt: skip
    return np.array(places), np.array(tensions), solver


# %%
# Curves
# ------
def draw_curves(results):
    """Displacements along the cable at a few steps, and tensions over all steps."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    top, bottom = figure.subplots(2, 2, sharex="row", sharey="row")
    for upper, lower, (name, (places, _, _)) in zip(top, bottom, results.items(), strict=True):
        for step in (1, 3, 5, 7, 9, 11, 13, 15):
            colour = colormaps["viridis"]((step - 1) / 16)
            upper.plot(ALONG, places[step - 1, 0], color=colour, label=f"step {step}")
            lower.plot(ALONG, places[step - 1, 1], color=colour)
        upper.set_title(RUNS[name][1], fontsize=10)
        lower.set_xlabel("x [cm]")
    top[0].set_ylabel("sideways: y of the cable [cm]")
    bottom[0].set_ylabel("down: z of the cable [cm]")
    figure.legend(*top[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    figure.savefig(f"{RESULTS}/along.png", dpi=100)

    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (name, (places, tensions, _)), style in zip(results.items(), "o^", strict=True):
        steps = np.arange(1, len(tensions) + 1)
        left.plot(steps, places[:, 0, 50], style + "-", markersize=4, label=RUNS[name][1])
        right.plot(steps, tensions, style + "-", markersize=4)
    left.set_ylabel("sideways: y of the cable's middle [cm]")
    right.set_ylabel("tension of the cable [kgf]")
    left.legend(fontsize=8, frameon=False)
    for axis in (left, right):
        axis.axvline(DOWN, color="0.8", zorder=0)
        axis.set_xlabel("step (5 down, then sideways)")
    figure.savefig(f"{RESULTS}/curves.png", dpi=100)


# %%
# With and without friction
# -------------------------
results = {name: experiment(name) for name in RUNS}
for name, (_, values, solver) in results.items():
    if solver.scene.comm.rank == 0:
        print(f"{RUNS[name][1]:>11}: tension {values[DOWN - 1]:.2f} kgf down,", end=" ")
        print(f"{values[-1]:.2f} kgf sideways; middle at y =", end=" ")
        print(", ".join(f"{y:.2f}" for y in results[name][0][DOWN + 1 :: 2, 0, 50]), end=" cm; ")
        print(f"dissipated {solver.scene.dissipated:.1f} kgf cm")
if solver.scene.comm.rank == 0:
    draw_curves(results)
    join_pictures(f"{RESULTS}/both.png", [f"{RESULTS}/{name}.png" for name in RUNS])
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
