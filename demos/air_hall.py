"""Air hall over a tennis court
=============================

From a ground plan to a report: an air-supported hall of 36 x 36 m under a net of sliding cables.

Form finding gives the shape. A net of 12 steel cables is laid over the hall and tightened. Weight,
snow, wind from two directions and inner pressure are combined; fans control the pressure, or the
hall is sealed in a gust. The report has pictures, section forces, utilisations, envelopes, cable
forces, reactions and the verification of all combinations, with CSV tables beside the page. Loads,
factors, coefficients and strengths are examples in the style of EN 1990 and 1991; use those of your
code and site. Units: m, kN.

::

    ./run python demos/air_hall.py [SIZE] [--resume]

with the cell size, 1.8 m by default. The pictures docs/air_hall.png and docs/report.png are this
demo's both.png and pages of its report.pdf.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, FanControl, OrthotropicMembrane, Solver, codes, meshes, nets
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.results.output import draw, join_pictures

RESULTS = "results/air_hall"
HALF = 18.0  # half the side of the plan
CALM, STORM, MELT = 0.3, 0.4, 0.6  # kPa, inner pressure: in operation, in storms, under snow
SNOW, GUST = 0.45, 0.5  # kPa: s_k on the ground, q_p of the wind

# %%
# Form
# ----
# A film of equal section forces over the plan, under operating pressure: p R = 2 s, so 3.78 kN/m
# give a rise of 9.5 m. The fabric, PVC-coated polyester with a strength of 84 and 80 kN/m divided
# by 4, is cut to that shape and has these forces as prestress. Strands of the net break at 195 kN.
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.8))
plan = meshes.rectangle(MPI.COMM_WORLD, 2 * HALF, 2 * HALF, size, corner=(-HALF, -HALF))
form = find_form(plan, stress=3.78, fixed=["boundary"], pressure=CALM)
fabric = OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)

# %%
# Net
# ---
# Two families of 6 spiral strands of 16 mm run from side to side, each along the shortest path
# between its anchors, where a frictionless cable stays; a cable straight in plan would be too long.
# The form is cut along the net, so that cables lie on lines of the mesh, which slide with them. The
# cables slide over each other, too. They are 1 % shorter than their paths, and so carry load.
offsets = np.arange(-15.0, 16.0, 6.0) / np.sqrt(2.0)
net = nets.sections(form.scene(fabric), (np.pi / 4, -np.pi / 4), offsets, shortest=True)
form = form.along(net)
scene = form.scene(fabric)
scene.set_strengths((21.0, 20.0), cables=codes.CableDesign(breaking=195.0))
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
cables = scene.lay_net(net, Cable(EA=20e3))
scene.put_load((0.0, 0.0, -0.0105), name="weight", per="material")
shorter = {cable: 0.99 * cable.L0 for cable in cables}
solver.advance(pressure=CALM, load={"weight": 1.0}, L0=shorter)
operation = np.array([cable.tension for cable in scene.cables])

LOOK = {
    "box": ((-18.5, -18.5, 0.0), (18.5, 18.5, 10.0)),
    "view": (-125.0, 30.0),
    "colour": "stress",
    "limits": (0.0, 16.0),
    "line_limits": (0.0, 80.0),
    "unit": "m",
    "force": "kN",
    "width": 7.5,
    "dpi": 110,
}
draw(solver, f"{RESULTS}/operation.png", title=f"In operation: {CALM} kPa inside", **LOOK)


# %%
# Snow and wind
# -------------
# Snow lies on slopes of up to 30 degrees, and decreases to zero at 60 (EN 1991-1-3); drifted snow
# lies on one half only. The wind coefficients are those of vaulted roofs of this rise (EN 1991-1-4,
# 7.2.8), as a function of how far the surface faces the wind: +0.7 at the windward foot, -1.0 over
# the top, -0.4 leeward.
def snow(points, normals):
    """Snow by slope, EN 1991-1-3, table 5.2."""
    slope = np.degrees(np.arccos(np.clip(normals[2], -1.0, 1.0)))
    s = 0.8 * SNOW * np.clip((60.0 - slope) / 30.0, 0.0, 1.0)
    return np.stack([0 * s, 0 * s, -s])


def wind_to(x, y):
    """Pressure coefficients of wind that blows to (x, y)."""

    def coefficient(points, normals):
        """c_p of a vaulted roof, EN 1991-1-4, 7.2.8, by how far the surface faces the wind."""
        away = (x * normals[0] + y * normals[1]) / np.hypot(x, y)
        return np.interp(
            away, [-0.9, -0.45, -0.2, 0.2, 0.5, 1.0], [0.7, 0.0, -1.0, -1.0, -0.4, -0.4]
        )

    return coefficient


scene.put_load(snow, name="snow", per="plan")
scene.put_load(lambda x, n: snow(x, n) * (x[0] > 0.0), name="drift", per="plan")
scene.put_wind(GUST, wind_to(1.0, 0.0), name="wind")
scene.put_wind(GUST, wind_to(1.0, 1.0), name="diagonal wind")

# %%
# Combinations
# ------------
# The fans raise the pressure under snow. Each combination starts from the hall in operation, so it
# takes one load step instead of a complete run.
fans = FanControl("snow", factors=[0.0, 0.5, 1.0], pressures=[CALM, 0.45, MELT])
cases = solver.combine(
    {
        "Operation": {"weight": 1.35},
        "Snow": {"weight": 1.35, "snow": 1.5, "pressure": fans},
        "Drifted snow": {"weight": 1.35, "drift": 1.5, "pressure": MELT},
        "Storm": {"wind": 1.5, "pressure": STORM},
        "Diagonal storm": {"diagonal wind": 1.5, "pressure": STORM},
        "Snow and wind": {"weight": 1.35, "snow": 0.75, "wind": 0.9, "pressure": fans},
    }
)

# %%
# Gust on a sealed hall
# ---------------------
# A gust of seconds is faster than the fans. The hall is sealed in the mean wind, half of the gust;
# suction lifts the roof, the volume grows, and the pressure falls by the gas law.
calm = solver.snapshot()
solver.advance(load={"wind": 0.75}, pressure=STORM)
scene.seal(volume=form.volume + scene.volume, exponent=1.4)
cases |= solver.combine({"Gust, sealed": {"wind": 1.5}})
solver.restore(calm)

# %%
# Report
# ------
# One HTML page, and a PDF to hand in.
solver.report(
    f"{RESULTS}/report.html",
    cases,
    title="Tennis hall of 36 x 36 m",
    pdf=True,
    about={
        "Office": "Example & Partners",
        "Project": "Tennis hall",
        "Structure": "Air hall, net of 12 sliding steel cables",
        "Author": "A. Weaver",
        "Checker": "C. Mast",
        "Revision": "A",
    },
    basis={
        "Codes": "examples in the style of EN 1990 and EN 1991, not for use",
        "Snow": f"s_k = {SNOW} kN/m², C_e = C_t = 1; drifted snow on one half only",
        "Fans": f"{CALM} kPa in operation, {STORM} kPa in storms, {MELT} kPa under snow",
    },
    unit="m",
    force="kN",
)
solver.restore(cases["Storm"].snapshot)
draw(solver, f"{RESULTS}/storm.png", title=f"Storm along x: {1.5 * GUST} kPa", **LOOK)

# %%
# Headline figures
# ----------------
found = {}
for name, case in cases.items():
    solver.restore(case.snapshot)
    summary, tension = solver.summary(), max(case.snapshot.tensions.values())
    used = summary.parts[""].largest["utilisation"].value
    moved = summary.deflection.value  # from the hall in operation; of the gust from the mean wind
    found[name] = (tension, used, moved)
    if scene.comm.rank == 0:
        print(f"{name:14} tensions to {tension:4.1f} kN, fabric loaded to {used:.0%}, deflected by"
              f" {moved:.2f} m, {scene.pressure:.3f} kPa inside")  # fmt: skip
if scene.comm.rank == 0:
    join_pictures(
        f"{RESULTS}/both.png", [f"{RESULTS}/operation.png", f"{RESULTS}/storm.png"], upright=True
    )
    lift, weight = CALM * 4 * HALF**2, 0.0105 * form.area
    print(f"in operation tensions from {operation.min():.1f} to {operation.max():.1f} kN, the air"
          f" lifts {lift:.0f} kN, fabric weighs {weight:.1f} kN")  # fmt: skip
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
