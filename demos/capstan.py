"""Friction along a cable
======================

A cable over an air hall, tightened from one end against friction.

An air hall, 16 m wide, 24 m deep and 8 m high: a half-cylinder with rounded ends. Two cables cross
it from ground to ground, each bent by about half a turn. A winch at each cable's right end takes in
25 cm in 5 steps, and lets out 8 cm in 4. One cable slides without friction and has the same tension
everywhere. The other has a coefficient of friction of 0.3: once the whole cable slides, its tension
falls from the winch to the far end by the capstan equation, exp(0.3 x angle). Let out, it slides
back near the winch only, and the largest tension remains in its middle. Units: m, kN.

::

    ./run python demos/capstan.py [SIZE] [--resume]

with the cell size, 1.2 m by default.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, Friction, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import History, draw, draw_history, join_pictures

RESULTS = "results/capstan"
MU, EA = 0.3, 3000.0

# %%
# The hall
# --------
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.2))
mesh = meshes.air_hall(MPI.COMM_WORLD, width=16.0, depth=24.0, height=8.0, size=size)
scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
scene.fix("boundary")
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
solver.advance(pressure=0.4)
free = scene.lay_cable(Cable(EA), path=[(0.0, 9.0), (16.0, 9.0)], name="free")
rough = scene.lay_cable(
    Cable(EA, friction=Friction(0.0, along=MU)), path=[(0.0, 15.0), (16.0, 15.0)], name="rough"
)


# %%
# Two measures
# ------------
def wind(length, steps):
    """Take in, or let out, some length at the cables' right ends."""
    solver.advance(L0={cable: cable.L0 - length for cable in (free, rough)}, steps=steps)


def turned(cable):
    """Total turn of a cable between its ends."""
    way = np.diff(cable.line, axis=0)
    way /= np.linalg.norm(way, axis=1)[:, None]
    return np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1.0, 1.0)).sum()


def profile(cable, places):
    """Tension at distances from the far end, relative to the length."""
    size = np.linalg.norm(np.diff(cable.line, axis=0), axis=1)
    middles = np.cumsum(size) - size / 2
    return np.interp(places * size.sum(), middles, cable.tensions)


# %%
# Taking in and letting out
# -------------------------
look = {
    "view": (-78.0, 36.0), "unit": "m", "force": "kN", "width": 6.8, "dpi": 100,
    "box": ((-0.5, -0.5, 0.0), (16.5, 24.5, 9.0)), "line_limits": (0.0, 8.0),
}  # fmt: skip
places, profiles, ends = np.linspace(0.0, 1.0, 81), {}, {}
for what, length, steps in (("taken in", 0.25, 5), ("let out", -0.08, 4)):
    wind(length, steps)
    picture = f"{RESULTS}/{what.replace(' ', '_')}.png"
    draw(solver, picture, title=f"{abs(length):.2f} m {what} at the right", **look)
    profiles[what], profiles[f"{what}, free"] = (profile(c, places) for c in (rough, free))
    T, angle = rough.tensions, turned(rough)
    ends[what] = T[0], T.max(), T[-1], T[-1] / T[0] / np.exp(MU * angle)
    if scene.comm.rank == 0:
        print(
            f"{what:8} tension of the free cable {free.tension:.2f} kN; of the rough one", end=" "
        )
        print(f"{T[0]:.2f} at the far end, {T.max():.2f} at most, {T[-1]:.2f} at the winch:")
        print(f"{T[-1] / T[0]:15.3f} of that at the far end; if it slid all over it would", end=" ")
        print(f"be {np.exp(MU * angle):.3f} for its turn of {np.degrees(angle):.1f} degrees")
if scene.comm.rank == 0:
    print(f"friction has dissipated {scene.dissipated:.3f} kN m")
    table = History(None, MPI.COMM_SELF)
    for k, place in enumerate(places):
        row = {f"tension {what}": float(values[k]) for what, values in profiles.items()}
        table.append({"distance from the far end": float(place * rough.length)} | row)
    draw_history(
        table, f"{RESULTS}/profile.png", "distance from the far end",
        [[f"tension {what}" for what in profiles]], title="Tension along the cables", width=6.8,
        units={"tension": "kN", "distance from the far end": "m"}, dpi=100,
    )  # fmt: skip
    join_pictures(
        f"{RESULTS}/both.png", [f"{RESULTS}/taken_in.png", f"{RESULTS}/profile.png"], upright=True
    )
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 1
