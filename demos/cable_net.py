"""Cable net in the wind
=====================

An air dome with a net of sliding cables, inflated and then loaded by wind.

A spherical cap of 40 m span, 10 m high, of PVC-coated fabric; two families of 7 steel cables cross
obliquely on it. The cables run along great circles, just taut, and are anchored at their ends only;
they slide without friction over the fabric and over each other. After inflation the wind blows from
-x. It pushes the windward side in; cables there lose most of their tension and lift off (striped in
the pictures). Suction acts on the rest of the dome, where tensions triple. Units: m, kN.

::

    ./run python demos/cable_net.py [SIZE] [--resume]

with the cell size, 1.6 m by default. The picture docs/cable_net.png is this demo's both.png.
"""

import itertools
import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.results.output import Line, draw, draw_paths, join_pictures

RESULTS = "results/cable_net"
RADIUS, HEIGHT = 20.0, 10.0
PRESSURE, GUST = 0.4, 0.75  # kPa, inner pressure and velocity pressure (35 m/s)
COEFFICIENTS = {-RADIUS: 0.8, 0.0: -1.0, RADIUS: -0.3}  # of pressure, over x (our assumption)
LOOK = {
    "view": (-140.0, 32.0),
    "box": ((-21.0, -21.0, 0.0), (21.0, 21.0, 11.0)),
    "colour": "stress",
    "limits": (0.0, 15.0),
    "line_limits": (0.0, 40.0),
    "unit": "m",
    "force": "kN",
    "width": 7.5,
    "dpi": 110,
}


# %%
# Wind
# ----
# Pressure coefficients over the dome, and two measures of sliding.
def coefficient(points, normals):
    """Pressure coefficient at the current positions."""
    return np.interp(points[0], list(COEFFICIENTS), list(COEFFICIENTS.values()))


def on_fabric(name):
    """Stress-free positions of the cable points that touch the fabric."""
    lines = []
    for cable in scene.cables:
        gaps = np.flatnonzero(np.isnan(cable.reference_positions[:, 0]))
        lines += [
            part[np.isfinite(part[:, 0])] for part in np.split(cable.reference_positions, gaps)
        ]
    return [Line(part, name=name) for part in lines if len(part) > 1]


def farthest(lines, others):
    """Largest distance of the points of some lines from other lines."""
    t = np.linspace(0.0, 1.0, 20)[:, None]
    pairs = [pair for line in others for pair in itertools.pairwise(line.points)]
    dense = [a + t * (b - a) for a, b in pairs]
    there = np.concatenate(dense)
    return max(np.linalg.norm(there - p, axis=1).min() for line in lines for p in line.points)


# %%
# The net
# -------
# ``nets.great_circle`` returns a route in space. Each cable's length makes it just taut on the
# smooth surface, not on the facets of the mesh.
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.6))
mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=RADIUS, height=HEIGHT, size=size)
scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
scene.fix("boundary")
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
for angle in np.radians([30.0, -30.0]):
    for offset in 4.5 * np.arange(-3, 4):
        scene.lay_cable(Cable(EA=30e3), path=nets.great_circle(RADIUS, HEIGHT, angle, offset))

# %%
# Calm
# ----
solver.advance(pressure=PRESSURE, steps=2)
draw(solver, f"{RESULTS}/calm.png", title="Inflated: 0.4 kPa", **LOOK)
calm, path = np.array([cable.tension for cable in scene.cables]), on_fabric("calm")
shape = scene.positions()

# %%
# Storm
# -----
# Wind acts normal to the surface, also as the dome deforms.
scene.put_wind(GUST, coefficient)
solver.advance(load=1.0, steps=2)
draw(solver, f"{RESULTS}/wind.png", title="Wind of 0.75 kPa along x", **LOOK)
windy, moved = np.array([cable.tension for cable in scene.cables]), on_fabric("under the wind")
draw_paths(scene, f"{RESULTS}/paths.png", path + moved, unit="m", title="The net on the fabric")

# %%
# The result
# ----------
way = scene.comm.allreduce(np.linalg.norm(scene.positions() - shape, axis=1).max(), MPI.MAX)
slid = farthest(moved, path)
lifted = sum(bool(cable.free_spans.any()) for cable in scene.cables)
if scene.comm.rank == 0:
    join_pictures(
        f"{RESULTS}/both.png", [f"{RESULTS}/calm.png", f"{RESULTS}/wind.png"], upright=True
    )
    print(f"calm   tensions from {calm.min():5.2f} to {calm.max():5.2f} kN")
    print(f"windy  tensions from {windy.min():5.2f} to {windy.max():5.2f} kN")
    print(f"       {lifted} cables lifted off somewhere; the membrane moved up to {way:.2f} m,")
    print(f"       cables slid over it up to {slid:.2f} m")
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
