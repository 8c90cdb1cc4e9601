"""The paper's own laws
====================

The three models of the paper with all of its laws, beside the defaults of this package.

H. Sakai and E. Tachibana write every law for a load step: strain (2.3), pressure (2.4) and the
tension of a cable (2.2) are increments from the step's start, and friction (3.2, 3.3) has the size
and direction of the step's start. All are options here. The defaults differ, as
`docs/theory/the_paper.md` explains equation by equation; this demo shows by how much. The pictures
are made like the paper's figures 8, 9, 11 and 12, of which the scan has only the captions: shapes
and sizes are assumptions, and the curves measured in the experiment are lost. Units: kgf, cm.

::

    ./run python demos/paper.py [SIZE]

with the cell size of models 2 and 3, 5 cm by default.
"""

import sys
import warnings

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    Friction,
    FrictionWarning,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.results.output import draw

RESULTS = "results/paper"
SIZE = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 5.0))
FIRST = MPI.COMM_WORLD.rank == 0
RUNS = "paper", "default"
TITLES = {"paper": "the paper's laws", "default": "default laws"}

# %%
# The laws
# --------
# The coefficient of the penalty (2.5-1) is lost; its value hardly counts. The paper has no
# wrinkling.
PENALTY = 5.0
SCENE = {"strain": "step", "pressure": "step", "literal_penalty": PENALTY}
LAWS = {"paper": SCENE, "default": {}}
SHEET = {"E": 300.0, "nu": 0.25, "thickness": 0.08}
FABRIC = {
    "E1": 1394.0, "E2": 140.0, "G12": 12.0, "nu21": 0.065, "thickness": 1.0,
    "warp": (0.0, 1.0, 0.0),
}  # fmt: skip


def rope(run, EA, mu=0.0):
    """A cable with the laws of a run."""
    if run == "default":
        return Cable(EA, friction=mu)
    return Cable(EA, law="step", friction=Friction(mu, law="step") if mu else 0.0)


# %%
# Model 1: one element
# --------------------
# The two ends of the cable are displaced normal to the element in six steps. `tests` compare the
# paper's laws with its equations, written out by hand, to 1e-7 of the forces.
tensions = {}
for run in RUNS:
    corners = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
    mesh = meshes.from_arrays(
        MPI.COMM_WORLD, corners, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]}
    )
    scene = Scene(mesh, IsotropicMembrane(**SHEET, wrinkling=run != "paper"), **LAWS[run])
    scene.fix("corners")
    cable = scene.lay_cable(
        rope(run, 32000.0), path=[(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)], hold="sleeve"
    )
    solver = Solver(scene, results=f"{RESULTS}/model_1_{run}")
    tensions[run] = [0.0]
    for _ in range(6):
        solver.advance(move={cable: (0.0, 0.0, 2.0)})
        tensions[run].append(cable.tension)
    draw(
        solver, f"{RESULTS}/model_1_{run}.png", title=f"Model 1: {TITLES[run]}", colour="height",
        limits=(0.0, 9.0), ghost=True, view=(-60.0, 20.0), unit="cm", force="kgf", width=4.5,
    )  # fmt: skip
model_1 = {run: values[-1] for run, values in tensions.items()}

# %%
# Model 2: a cable on an inflated square
# --------------------------------------
# The square is inflated in five steps. Then the cable is laid, and in five more its ends are pulled
# down by 15 cm.
model_2 = {}
for run in RUNS:
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size=SIZE, structured=True)
    scene = Scene(mesh, IsotropicMembrane(**SHEET, wrinkling=run != "paper"), **LAWS[run])
    scene.fix("boundary")
    solver = Solver(scene, results=f"{RESULTS}/model_2_{run}")
    solver.advance(pressure=0.01, steps=5)
    look = {
        "colour": "height", "limits": (0.0, 10.3), "view": (-35.0, 25.0), "unit": "cm",
        "force": "kgf", "width": 5.5, "box": ((-20.0, -2.0, -6.5), (120.0, 102.0, 12.0)),
    }  # fmt: skip
    draw(solver, f"{RESULTS}/model_2_{run}_inflated.png", title=f"Inflated: {TITLES[run]}", **look)
    top = scene.comm.allreduce(scene.positions()[:, 2].max(), MPI.MAX)
    cable = scene.lay_cable(rope(run, 32000.0), path=[(-80.0, 47.0, 0.0), (180.0, 47.0, 0.0)])
    solver.advance(move={cable: (0.0, 0.0, -15.0)}, steps=5)
    draw(solver, f"{RESULTS}/model_2_{run}.png", title=f"Tightened: {TITLES[run]}", **look)
    x, _, z = cable.line.T
    model_2[run] = top, cable.tension, np.interp(50.0, x, z)

# %%
# Model 3: the experiment
# -----------------------
# The cable's ends go down by 10 cm in 5 steps, and sideways by 10 cm in 10. Where friction holds
# the cable a warning says so: the paper has no sticking.
warnings.simplefilter("ignore", FrictionWarning)
model_3, along = {}, np.linspace(0.0, 100.0, 101)
for run in RUNS:
    for mu in (0.0, 0.7):
        mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size=SIZE)
        scene = Scene(mesh, OrthotropicMembrane(**FABRIC, wrinkling=run != "paper"), **LAWS[run])
        scene.fix("front")
        scene.fix("back")
        cable = scene.lay_cable(
            rope(run, 47638.0, mu), path=[(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
        )
        solver = Solver(scene, results=f"{RESULTS}/model_3_{run}_{mu:g}")
        history = []
        for step in range(15):
            solver.advance(move={cable: (0.0, 0.0, -2.0) if step < 5 else (0.0, 1.0, 0.0)})
            x, y, z = cable.line.T
            history.append((np.interp(50.0, x, y) - 50.0, np.interp(50.0, x, z), cable.tension))
        model_3[run, mu] = np.array(history)
    draw(
        solver, f"{RESULTS}/model_3_{run}.png", title=f"Model 3, µ = 0.7: {TITLES[run]}",
        colour="height", limits=(-8.0, 0.0), view=(-65.0, 35.0), unit="cm", force="kgf", width=5.5,
    )  # fmt: skip

# %%
# The curves of figure 12
# -----------------------
# By step, the displacements of the cable's middle sideways and down, and its tension.
if FIRST:
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    names = "sideways y [cm]", "down z [cm]", "tension [kgf]"
    for k, (axis, name) in enumerate(zip(figure.subplots(1, 3), names, strict=True)):
        for (run, mu), values in model_3.items():
            style = ("o-" if mu else "s-") if run == "paper" else ("--" if mu else ":")
            colour = "#b5472f" if mu else "#2f5d8a"
            label = f"µ = {mu:g}, {TITLES[run]}"
            axis.plot(range(1, 16), values[:, k], style, color=colour, markersize=4, label=label)
        axis.axvline(5.5, color="0.85", zorder=0)
        axis.set_xticks(range(1, 16, 2))
        axis.set_xlabel("step (5 down, then sideways)")
        axis.set_ylabel(name)
    axis.legend(fontsize=8, frameon=False)
    figure.savefig(f"{RESULTS}/curves.png", dpi=100)

# %%
# The result
# ----------
if FIRST:
    for run in RUNS:
        top, tension, height = model_2[run]
        smooth, rough = (model_3[run, mu][-1] for mu in (0.0, 0.7))
        print(f"{run:>8}: model 1 tension {model_1[run]:.4f} kgf;")
        print(f"{'':9} model 2 top {top:.4f} cm, tension {tension:.3f} kgf,", end=" ")
        print(f"cable at {height:.4f} cm;")
        print(
            f"{'':9} model 3 tension {smooth[2]:.2f} and with µ = 0.7 {rough[2]:.2f} kgf,", end=" "
        )
        print(f"middle at y = {smooth[0]:.3f} and {rough[0]:.3f} cm")
    print(f"files: {RESULTS}")
