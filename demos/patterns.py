"""Cutting patterns of an air hall
================================

From a form to sheets for the workshop and back: the hall, sewn from its pieces, meets a storm.

The air hall of 36 x 36 m under its net of sliding cables (`demos/air_hall.py`) is cut into strips
along geodesics, which are flattened with the least strain energy and compensated for the section
forces of the form. Sewn together, the flat pieces only approximate the doubly curved form: the last
table shows the effect on the cables, with and without compensation, and for a hall cut into gores
instead of strips. Units: m, kN.

::

    ./run python demos/patterns.py [SIZE]

with the cell size under the net, 1.8 m by default. The pieces have cells a quarter as wide, nine
columns in most strips: sewn from pieces with three columns, the hall is 5 cm off its form instead
of 1 cm.
"""

import importlib.util
import sys
import warnings

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, OrthotropicMembrane, PatternWarning, Solver, meshes, patterns
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.results.output import draw

RESULTS = "results/patterns"
HALF = 18.0  # half the side of the plan
WANTED = 3.78  # kN/m, along warp and weft, at a pressure of 0.3 kPa
CALM, STORM, GUST = 0.3, 0.4, 0.5  # kPa: inner pressure, and velocity pressure
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1.8))
fabric = OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)
warnings.simplefilter("ignore", PatternWarning)  # the cells under the net are coarse


# %%
# Form, seams and pieces
# ----------------------
# Strips from front to back, of 5 m wide fabric, with welds of 80 mm, half of them on each side.
def cut_hall(size):
    """Form and pieces of the hall at a cell size."""
    plan = meshes.rectangle(MPI.COMM_WORLD, 2 * HALF, 2 * HALF, size, corner=(-HALF, -HALF))
    form = find_form(plan, stress=WANTED, fixed=["boundary"], pressure=CALM)
    seams = patterns.strips(form.mesh, "front", "back", width=5.0, allowance=0.04)
    return form, patterns.cut(form.mesh, seams)


_, pieces = cut_hall(size / 4)

# %%
# Flat pieces
# -----------
# The warp runs along the seams. Compensation shrinks the pieces by the fabric's strain in the form:
# .29 % along the warp and .50 % along the weft.
shrink = patterns.shrink_for(fabric, WANTED)
pattern = patterns.flatten(pieces, fabric, warp="seams", shrink=shrink)

# %%
# Sheets
# ------
# Pieces as laid out on the roll, with allowances, and match marks every 2 m.
sheet = patterns.Sheet(roll=5.2, allowance=0.04, rim=0.15, marks=2.0, gap=0.05)
patterns.draw_sheets(pattern, f"{RESULTS}/roll.png", sheet, unit="m")
patterns.draw_sheets(pattern, f"{RESULTS}/sheets.pdf", sheet, unit="m")
if importlib.util.find_spec("ezdxf"):
    patterns.write_dxf(pattern, f"{RESULTS}/hall.dxf", sheet, unit="m")


# %%
# Sewn back
# ---------
# The roof as built, inflated without cables: its section forces, and its distance from the form.
def inflated(pattern):
    """The hall sewn from a pattern, in operation."""
    scene = patterns.sew(pattern)
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=CALM)
    return solver


built = inflated(pattern)
got = patterns.compare(built, pattern, WANTED)
draw(built, f"{RESULTS}/built.png", colour="warp", view=(-125.0, 30.0), unit="m", force="kN",
     title="Sewn from its pieces: section force along the warp")  # fmt: skip


# %%
# Net and storm
# -------------
# The same net and storm on four halls: the ideal one, with its prestress everywhere; one sewn from
# strips without compensation; one with; and one sewn from 32 gores, whose seams run along geodesics
# from the crown to the foot. The cells are coarse, as cables need no finer ones.
def gores(form, count=32):
    """Gores between the crown and the foot."""
    x = np.concatenate(form.comm.allgather(form.mesh.mesh.geometry.x))
    crown = x[np.hypot(x[:, 0], x[:, 1]).argmin(), :2]  # a vertex, where all seams meet
    seams = []
    for k in range(count):
        side, along = divmod(4 * k, count)
        a, b = HALF, HALF * (1.0 - 2.0 * along / count)
        foot = [(a, b), (b, -a), (-a, -b), (-b, a)][side]
        seams.append(patterns.geodesic(form.mesh, [crown, foot], name=f"seam {k + 1}"))
    return patterns.cut(form.mesh, seams)


def suction(points, normals):
    """Pressure coefficients of wind along x."""
    away = [-0.9, -0.45, -0.2, 0.2, 0.5, 1.0]
    return np.interp(normals[0], away, [0.7, 0.0, -1.0, -1.0, -0.4, -0.4])


def netted(scene, **options):
    """Solver and cable tensions, in operation and in the storm."""
    for family, side in (("A", 1.0), ("B", -1.0)):
        for k, c in enumerate((-15.0, -9.0, -3.0, 3.0, 9.0, 15.0), start=1):
            ends = (max(-HALF, -HALF - c), min(HALF, HALF - c))
            path = [(side * x, x + c) for x in ends]
            scene.lay_cable(Cable(EA=20e3), path, shortest=True, name=f"{family}{k}")
    scene.put_load((0.0, 0.0, -0.0105), name="weight", per="material")
    scene.put_wind(GUST, suction, name="wind")
    solver = Solver(scene, **options)
    net = {cable: 0.99 * cable.L0 for cable in scene.cables}
    solver.advance(pressure=CALM, load={"weight": 1.0}, L0=net)
    calm = np.array([cable.tension for cable in scene.cables])
    solver.advance(pressure=STORM, load={"wind": 1.5})
    return solver, calm, np.array([cable.tension for cable in scene.cables])


form, coarse = cut_hall(size)
scenes = {"ideal": form.scene(fabric)}
for name, cut, given in (
    ("not compensated", coarse, None),
    ("compensated", coarse, shrink),
    ("gores", gores(form), shrink),
):
    scenes[name] = patterns.sew(patterns.flatten(cut, fabric, warp="seams", shrink=given))
    scenes[name].fix("boundary")
found = {
    name: netted(scene, **({"results": RESULTS} if name == "compensated" else {}))
    for name, scene in scenes.items()
}

# %%
# Report
# ------
# The report shows the pieces, their sheets and the deviation from the form.
solver = found["compensated"][0]
sections = patterns.report_sections(pattern, sheet, got, unit="m", force="kN")
solver.report(
    f"{RESULTS}/report.html", title="Hall sewn from its pieces", sections=sections,
    pictures=["warp"], unit="m", force="kN",
)  # fmt: skip

# %%
# Headline figures
# ----------------
if form.comm.rank == 0:
    print(f"{len(pattern.flat)} pieces, {pattern.area:.0f} m2, strained by up to"
          f" {max(one.distortion for one in pattern.flat):.2%} to lie flat")  # fmt: skip
    print(f"sewn and inflated: {got.whole.mean[0]:.2f} and {got.whole.mean[1]:.2f} kN/m on the mean"
          f" of {WANTED} wanted, {got.whole.deviation:.2f} m off the form")  # fmt: skip
    print(f"{'tensions [kN]':14}" + "".join(f"{name:>18}" for name in found))
    print(f"{'':14}" + len(found) * f"{'operation':>10}{'storm':>8}")
    names = [cable.name for cable in scenes["ideal"].cables]
    columns = np.array([tensions for _, *both in found.values() for tensions in both])
    for name, row in zip([*names, "mean"], [*columns.T, columns.mean(axis=1)], strict=True):
        print(f"{name:14}" + "".join(f"{a:10.1f}{b:8.1f}" for a, b in row.reshape(-1, 2)))
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
