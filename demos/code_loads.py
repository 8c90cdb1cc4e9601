"""Vaulted roof under loads by code
================================

A membrane between two arches under snow, wind and combinations by the Eurocodes, with a report.

The roof spans 14 m between its straight feet, and 9 m between arches of 4.5 m rise. It has no inner
pressure: the fabric hangs from arch to arch, and a valley cable holds it down in the middle. Snow
follows EN 1991-1-3, 5.3.5 (cylindrical roof, even and drifted to either side), wind EN 1991-1-4,
7.2.8 (vaulted roof), and the combinations EN 1990, expression (6.10). Units: m, kN.

::

    ./run python demos/code_loads.py [SIZE] [--resume]

with the cell size, 0.5 m by default.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, Solver, codes, meshes
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.results.output import draw, join_pictures

RESULTS = "results/code_loads"
SPAN, RISE, BAY = 14.0, 4.5, 9.0
PRESTRESS, TENSION = 3.0, 8.0  # kN/m of the fabric, kN of the valley cable
SNOW = 0.75  # kPa: s_k on the ground
GUST = codes.peak_pressure(24.0, RISE, "II")  # kPa: q_p of the wind at the crown
VIEW = (-55.0, 28.0)

# %%
# Form
# ----
# The feet along y stay on the ground. The ends of the sheet are lifted onto the arches, which are
# circular. Between the arches the film sags, and a valley cable in a sleeve holds it down. It is
# part of the form: laid over the finished roof and pulled by 1.5 % of its length, it would shorten
# the fabric along it and take away the weft's prestress, as the limit below would tell.
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 0.5))
feet = [(-SPAN / 2, 0.0), (SPAN / 2, 0.0)]
plan = meshes.rectangle(
    MPI.COMM_WORLD, SPAN, BAY, size, corner=(-SPAN / 2, -BAY / 2), lines={"valley": feet}
)
RADIUS = (SPAN**2 / 4 + RISE**2) / (2 * RISE)


def arch(points):
    """Displacement (3, n) of an edge's points (3, n) onto its arch."""
    up = np.sqrt(RADIUS**2 - points[0] ** 2) - (RADIUS - RISE)
    return np.stack([0 * up, 0 * up, up])


form = find_form(
    plan, stress=PRESTRESS, fixed=["boundary"], lifted={"front": arch, "back": arch},
    cables=[FormCable("valley", tension=TENSION)], warp=(0, 1, 0),
)  # fmt: skip
fabric = OrthotropicMembrane(E1=1100.0, E2=900.0, G12=40.0, nu21=0.2, thickness=1.0)
scene = form.scene(fabric, Cable(EA=5e3))
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
scene.put_load((0.0, 0.0, -0.0135), name="weight", per="material")
solver.advance(load={"weight": 1.0})

# %%
# Loads
# -----
# Coefficients refer to the shape at the time of the call: the prestressed roof, which
# ``codes.vault`` measures.
vault = {"crown": (0.0, 0.0), "span": SPAN, "rise": RISE}
shapes = {
    "snow": codes.CylindricalSnow(across=(1, 0), case="i", **vault),
    "snow drifted": codes.CylindricalSnow(across=(1, 0), case="ii", **vault),
    "snow drifted back": codes.CylindricalSnow(across=(-1, 0), case="ii", **vault),
}
for name, shape in shapes.items():
    scene.put_load(codes.snow_load(SNOW, shape), name=name, per="plan")
wind = codes.vault(scene, (1.0, 0.0))
scene.put_wind(GUST, wind, name="wind")

# %%
# Strengths
# ---------
# PVC-coated polyester, type I, has 60 kN/m along warp and weft. Factors of the material, of weather
# and of the duration of the loads divide it; those of a combination follow from its loads. The
# cable is a spiral strand with sockets. Limits in service are the designer's.
design = codes.FabricDesign(
    (60.0, 60.0), gamma_M=1.4, ageing=1.1,
    duration={"permanent": 1.7, "weight": 1.7, "snow": 1.6, "wind": 1.0},
)  # fmt: skip
scene.set_strengths(design, cables=codes.CableDesign(breaking=55.0))
scene.set_limits(deflection=0.6, prestress=0.5, slope=1.0, water=0.0)

# %%
# Combinations
# ------------
# Loads whose names begin with the same kind exclude each other. Favourable and unfavourable weight,
# and each variable load as the leading one, give 22 combinations of the ultimate limit state. Two
# more tell how the roof serves.
table = codes.combinations(codes.en1990, permanent=["weight"], variable=[*shapes, "wind"]) | {
    "serviceability": {"snow": 1.0, "state": "characteristic"},
    "in operation": {"state": "quasi-permanent"},
}
found = solver.combine(table)
solver.report(
    f"{RESULTS}/report.html",
    found,
    title="Vaulted roof of 14 x 9 m",
    about={
        "Office": "Example & Partners",
        "Project": "Vaulted roof",
        "Structure": "Membrane between two arches, valley cable",
        "Author": "A. Weaver",
        "Checker": "C. Mast",
        "Revision": "A",
    },
    basis={
        "Codes": "EN 1990, expression (6.10); EN 1991-1-3 and EN 1991-1-4, recommended values",
        "Fabric": "PVC-coated polyester, type I",
    },
    pdf=True,
    unit="m",
    force="kN",
    pictures=["displacement", "utilisation"],
    view=VIEW,
)

# %%
# Governing combinations
# ----------------------
judged = solver.judge(found)
summaries = {}
for name, one in found.items():
    solver.restore(one.snapshot)
    summaries[name] = solver.summary()
used = {
    name: one.membrane.largest["utilisation"].value for name, one in summaries.items() if one.design
}
pull = {name: one.cables["valley"].largest for name, one in summaries.items()}
wet = {name: one.hollows[0].depth for name, one in summaries.items() if one.hollows}
fabric, cable = (max(of, key=lambda name, of=of: of[name]) for of in (used, pull))
for name, file in ((fabric, "fabric"), (cable, "cable")):
    solver.restore(found[name].snapshot)
    draw(
        solver, f"{RESULTS}/{file}.png", colour="utilisation", unit="m", force="kN", view=VIEW,
        title=name, dpi=110, limits=(0.0, used[fabric]), line_limits=(0.0, pull[cable]),
    )  # fmt: skip
if scene.comm.rank == 0:
    join_pictures(f"{RESULTS}/both.png", [f"{RESULTS}/fabric.png", f"{RESULTS}/cable.png"])
    zones = ", ".join(f"{c:.2f}" for c in wind.zones)
    print(f"mu_3 = {shapes['snow drifted'].mu_3:.2f}; c_pe = {zones} on f/d = "
          f"{wind.roof.rise / wind.roof.depth:.3f}; {len(table)} combinations")  # fmt: skip
    print(f"fabric loaded to {used[fabric]:.0%}: {fabric}")
    print(f"tension of the valley cable {pull[cable]:.1f} kN: {cable}")
    print(f"rain would stand in {len(wet)} of the combinations")
    print(judged)
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 1
