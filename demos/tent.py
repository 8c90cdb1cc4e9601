"""A tent on masts and guys
========================

A four-point tent from a flat sheet to a report: form finding, masts and guys, erection, snow and
wind.

A sail of PVC-coated polyester (type II) between two high points on masts, 16 m apart, and two low
points, 14 m apart. Cables of 18 mm run in the edge pockets. Two guys hold each mast, which leans
outward; a tie holds each low point. The tent has no other supports. Loads, factors and strengths
are examples, not taken from a code. Units: m, kN.

::

    ./run python demos/tent.py [SIZE] [--resume]

with the cell size, 0.42 m by default. The picture docs/tent.png is this demo's snow.png.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, OrthotropicMembrane, Solver, codes, meshes
from crms_fenicsx.design.form_finding import FormBar, FormCable, find_form
from crms_fenicsx.results.output import draw

RESULTS = "results/tent"
PRESTRESS, EDGE_TENSION = 2.5, 45.0
HIGH = {"west": (-8.0, 0.0, 6.0), "east": (8.0, 0.0, 6.0)}
LOW = {"south": (0.0, -7.0, 1.2), "north": (0.0, 7.0, 1.2)}
CORNERS = {"south": "corner 1", "east": "corner 2", "north": "corner 3", "west": "corner 4"}
EDGES = ["south east", "north east", "north west", "south west"]

FABRIC = OrthotropicMembrane(E1=900.0, E2=700.0, G12=30.0, nu21=0.2, thickness=1.0)
EDGE_CABLE = Cable(EA=31.5e3)  # spiral strand of 18 mm
BELT = Cable(EA=1500.0)  # two polyester belts of 50 mm
MAST = codes.steel_bar("CHS 168.3x8", 235e3, curve="c")  # cold-formed, S235
GUY = Bar(EA=39e3, tension_only=True, section="spiral strand of 20 mm")
PROP = codes.steel_bar("CHS 88.9x4", 235e3, curve="c")
LOOSE = {"guy": 0.05, "tie": 0.03}  # m by which turnbuckles are open when the tent is raised
STRENGTHS = (84.0 / 4.0, 80.0 / 4.0)  # fabric, warp and weft
EDGE_DESIGN, GUY_DESIGN = codes.CableDesign(breaking=210.0), codes.CableDesign(breaking=255.0)
BELT_STRENGTH = 2 * 70.0 / 4.0
VIEW = (-72.0, 30.0)

# %%
# The form
# --------
# The sheet starts flat. Section forces, tensions of the edge cables and positions of the corners
# are prescribed; they determine the shape. The warp runs from high point to high point, where the
# sail hangs, the weft from low point to low point, where it arches.
places = {**HIGH, **LOW}
size = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 0.42))
flat = meshes.polygon(
    MPI.COMM_WORLD, [places[corner][:2] for corner in CORNERS], size=size, names=EDGES
)
found = find_form(
    flat,
    stress=PRESTRESS,
    fixed=list(CORNERS.values()),
    lifted={CORNERS[corner]: (0.0, 0.0, z) for corner, (_, _, z) in places.items()},
    cables=[FormCable(edge, tension=EDGE_TENSION) for edge in EDGES],
)

# %%
# Masts, guys and ties
# --------------------
# ``found.reactions`` has the force at each corner. A tie takes the direction of this force. A mast
# and two guys balance any force in the wedge between them: the bar forces follow from the reaction,
# and the unstressed lengths from the bar forces. The corners are free, and do not move.
bars = []
for corner, (x, y, _) in HIGH.items():
    out = np.sign(x)
    bars.append(FormBar(CORNERS[corner], MAST, (x - 0.8 * out, y, 0.0), f"mast {corner}"))
    for side, way in (("south", -1.0), ("north", 1.0)):
        foot = (x + 4.0 * out, y + 2.5 * way, 0.0)
        bars.append(FormBar(CORNERS[corner], GUY, foot, f"guy {corner} {side}"))
for corner, place in LOW.items():
    reaction = found.reactions[CORNERS[corner]]
    foot = place + 0.8 * reaction / np.linalg.norm(reaction)
    bars.append(FormBar(CORNERS[corner], GUY, foot, f"tie {corner}"))
# %%
# Belts
# -----
# A cable in a pocket carries the fabric's pull across the edge, but not along it. The pull along
# the edge would concentrate at the corners: without belts the snow below loads the fabric there to
# six times its strength. Polyester belts sewn along the pockets carry this pull. They start without
# force.
scene = found.scene(FABRIC, EDGE_CABLE, bars=bars, belts=BELT)
#
# At the corners the fabric is doubled around the plates, within 0.5 m: its forces grow there as
# cells become finer, so that the plain fabric is judged outside of these patches.
ropes = dict.fromkeys(EDGES, EDGE_DESIGN)
ropes |= {bar.name: GUY_DESIGN for bar in scene.bars if bar.bar.tension_only}
belts = dict.fromkeys([f"belt {edge}" for edge in EDGES], BELT_STRENGTH)
scene.set_strengths(STRENGTHS, cables=ropes | belts, patches=0.5)

# %%
# The first load step moves nothing: masts and guys hold the form in equilibrium.
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
solver.advance()
moved = solver.summary().displacement.value
pretension = {bar.name: bar.force for bar in scene.bars}
if scene.comm.rank == 0:
    print(f"prestressed: {found.area:.1f} m2, mast {pretension['mast east']:.1f}, guy"
          f" {pretension['guy east south']:.1f} kN; moved by {moved:.3f} m")  # fmt: skip
draw(
    solver, f"{RESULTS}/form.png", title="Found form", colour="height", unit="m", force="kN",
    view=VIEW, dpi=110,
)  # fmt: skip


# %%
# Loads
# -----
# Wind along x presses on the windward quarter and lifts the rest.
def coefficient(points, normals):
    """Net c_p, upper minus lower side: 0.3 on the windward quarter, else -0.7."""
    return np.where(points[0] < -4.0, 0.3, -0.7)


scene.put_load((0.0, 0.0, -0.0105), name="weight", per="material")
scene.put_load((0.0, 0.0, -0.52), name="snow", per="plan")
scene.put_wind(0.5, -0.8, name="uplift")
scene.put_wind(0.5, coefficient, name="wind along x")

# %%
# Erection
# --------
# The tent is raised on props, with all turnbuckles open. The props go, then guys and ties are
# tightened one after the other to their lengths in the found form, which the last stage thus
# reaches. Each stage starts from the one before it, and is in equilibrium under the weight.
members = {bar.name: bar for bar in scene.bars}
turnbuckles = [name for name in members if name.startswith(("guy", "tie"))]
designed = {members[name]: members[name].L0 for name in turnbuckles}


def tell(stage):
    """Print the largest forces."""
    forces = {kind: max(bar.force for bar in scene.bars if bar.name.startswith(kind))
              for kind in ("guy", "tie")}  # fmt: skip
    edge = max(scene.cable(name).tension for name in EDGES)
    if scene.comm.rank == 0:
        print(f"{stage:24}  guys {forces['guy']:4.1f}, ties {forces['tie']:4.1f}, "
              f"edges {edge:4.1f} kN")  # fmt: skip


with solver.stage("raised on props"):
    for corner, (x, y, _) in HIGH.items():
        foot = (x - 4.0 * np.sign(x), y, 0.0)
        scene.add_bar(PROP, foot, CORNERS[corner], name=f"prop {corner}")
    opened = {bar: length + LOOSE[bar.name[:3]] for bar, length in designed.items()}
    solver.advance(load={"weight": 1.0}, L0=opened)
tell("raised on props")
with solver.stage("props removed"):
    for corner in HIGH:
        scene.remove_bar(f"prop {corner}")
tell("props removed")
for name in turnbuckles:
    with solver.stage(f"{name} tightened"):
        solver.advance(L0={members[name]: designed[members[name]]})
    tell(f"{name} tightened")

# %%
# Combinations and report
# -----------------------
# ``combine`` applies the factored loads of each combination to the prestressed tent.
combinations = solver.combine(
    {
        "Permanent": {"weight": 1.35},
        "Snow": {"weight": 1.35, "snow": 1.5},
        "Uplift": {"weight": 1.0, "uplift": 1.5},
        "Wind along x": {"weight": 1.0, "wind along x": 1.5},
    },
    steps=2,
)
solver.report(
    f"{RESULTS}/report.html",
    combinations | solver.stages,
    title="Tent on two masts",
    pdf=True,
    about={
        "Office": "Example & Partners",
        "Project": "Tent on two masts",
        "Structure": "Four-point sail, 16 m x 14 m, edge cables, belts, 2 masts and 4 guys",
        "Author": "A. Weaver",
        "Checker": "C. Mast",
        "Revision": "A",
    },
    basis={
        "Codes": "examples in the style of EN 1990 and EN 1991, not for use",
        "Snow": "s = 0.52 kN/m² on the plan, with mu = 0.8",
    },
    unit="m",
    force="kN",
    view=VIEW,
)

# %%
# The summary has the forces for the design checks: fabric, edge cables, buckling of masts.
# Pictures to be compared have the same colours.
summaries = {}
for name, one in combinations.items():
    solver.restore(one.snapshot)
    summaries[name] = solver.summary()
    if name in ("Snow", "Uplift"):
        draw(
            solver, f"{RESULTS}/{name.lower()}.png", title=name, colour="utilisation",
            limits=(0.0, 0.8), line_limits=(-210.0, 210.0), unit="m", force="kN", view=VIEW,
            dpi=110,
        )  # fmt: skip
for name, one in summaries.items():
    forces = {kind: [bar.force for bar in one.bars.values() if bar.name.startswith(kind)]
              for kind in ("mast", "guy")}  # fmt: skip
    mast, guy = -min(forces["mast"]), max(forces["guy"])
    edge = max(one.cables[name].largest for name in EDGES)
    belt = max(one.cables[f"belt {name}"].largest for name in EDGES)
    used = one.membrane.largest["utilisation"].value
    stable = max(x.utilisation for x in one.bars.values() if x.name.startswith("mast"))
    if scene.comm.rank == 0:
        print(
            f"{name:12} tension of edges {edge:5.1f}, guys {guy:5.1f}, belts {belt:4.1f} kN; masts "
            f"{mast:5.1f} kN, {stable:3.0%} used; fabric {used:3.0%}; "
            f"z {one.lowest.value:+.3f} to {one.highest.value:+.3f} m"
        )
if scene.comm.rank == 0:
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
