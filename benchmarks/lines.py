"""Cables along lines of the mesh: cost and results beside the bare roof and beside folded cables.

    ./run python benchmarks/lines.py [TABLE ...] [--repeats N] [--scale S]
                                     [--roofs FIRST END] [--unknowns UNKNOWNS]

square
    An inflated square with a cable at 30 % of its width that slides sideways: tension, energy
    and place on meshes of 10, 20 and 40 cells a side, and where they lead to.
kratos
    The square with a cable along a line in its middle, on the same mesh here and by Kratos, if
    `benchmarks/kratos/install` has run: time of solving, tension.
dome
    The cap of `demos/air_dome.py` with 28 cables along great circles, cut along them, with 16 000,
    40 000 and 119 000 unknowns: load steps to 0.3 and 0.5 kPa on one mesh without cables, with
    lines that are held and with lines that slide, and what cutting and laying take.
cost
    How the time of the dome's load steps grows from 5000 to 140 000 unknowns.
folded
    The dome's net across cells and along lines, with 20 000, 50 000 and 140 000 unknowns.
mirrored
    Tensions of mirrored cables of the dome's net, on a mesh that is cut, that embeds the lines, and
    that is itself mirrored, with 50 000 unknowns.
net
    The net of `demos/cable_net.py`, calm and in the wind, on three meshes by both ways, where they
    lead to, and factorisations of each round of the wind.
roofs
    Random roofs under nets, cut or embedded, inflated from 0.3 to 1.0 kPa, then in the wind: what
    is refused or doubtful. Those from FIRST to END, 20 by default, with 5000 UNKNOWNS.
halls
    Air halls of 36 m by 36 and by 54 with nets of diagonals, in operation and in a diagonal storm:
    cables that fold the cells of a mesh of their own, and cables along lines of a mesh with as many
    unknowns; time, tensions, and what these lead to on finer meshes.
calm
    The halls in operation, both ways on one found form each, on four finer meshes.
limits
    Four cables in pockets that are alike, on a dome: tensions on meshes of several sizes, cut along
    the cables, made with lines and with folded cells, and where they lead to.
angles
    The smallest angles of six roofs cut along their lines, and what is told.
clamps
    Sixty random nets of 1 x 1 to 3 x 3 clamped cables on a rigid sheet, against strings that meet
    at points.
processes
    Cutting, laying and a load step of the dome with 100 000 unknowns on one and on two processes.

Seconds are CPU time of this process, but for the wall times of `processes`; in `dome` and `halls`
medians of N runs, which take turns, otherwise of one. --scale multiplies all numbers of unknowns,
for a quick look.
"""

from __future__ import annotations

import argparse
import json
import logging
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from accuracy.cases import PRESSURE, Case
from accuracy.cases import inflated as inflated_sheet
from accuracy.kratos import Kratos, folder
from lined import Result, limit, timed
from lined.cable_net import SIZES as NET_SIZES
from lined.cable_net import cable_net
from lined.dome import CABLES, PRESSURES, cost, dome, folded, inflated, mirrored, net_on
from lined.many_roofs import run
from lined.strings import clamped
from mpi4py import MPI
from numpy.typing import NDArray
from roofs import cap, covered, great_circles, suction

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    PathWarning,
    Scene,
    Solver,
    meshes,
    nets,
)
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form
from crms_fenicsx.design.patterns import plane_section
from crms_fenicsx.foundation.meshes.triangles import shapes
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

COMM = MPI.COMM_WORLD
CELLS = (10, 20, 40)  # a side of the square
UNKNOWNS = (16_000, 40_000, 119_000)
FOLDED, MIRRORED = (14_000, 38_000, 119_000), 40_000
BESIDE = (8, 32, 64)  # cells a side of the square that Kratos solves, too
CALM, STORM, TIGHTENED = 0.3, 0.4, 0.99


# --- square ----------------------------------------------------------------------------------


def lined_square(cells: int, at: float) -> meshes.MembraneMesh:
    """A square of 100 m with cells beside a line at y = `at`."""
    x = np.linspace(0.0, 100.0, cells + 1)
    j = round(at / 100.0 * cells)
    y = np.interp(np.arange(cells + 1), [0, j, cells], [0.0, at, 100.0])
    points = np.array([(a, b, 0.0) for a in x for b in y])
    number = np.arange(len(points)).reshape(cells + 1, cells + 1)
    triangles = []
    for a in range(cells):
        for b in range(cells):
            p, q, r, s = number[a, b], number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]
            triangles += [(p, q, r), (p, r, s)] if (a + b) % 2 == 0 else [(p, q, s), (q, r, s)]
    edges = np.stack([number[:-1, j], number[1:, j]], axis=1)
    return meshes.from_arrays(COMM, points, np.array(triangles), edges={"A1": edges})


def sheet(cells: int, at: float = 30.0) -> tuple[Scene, LaidCable]:
    """The square under a cable along the line."""
    scene = Scene(lined_square(cells, at), IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    return scene, scene.lay_cable(Cable(EA=32e3), along="A1", L0=100.0)


def kratos(numbers: Sequence[int], repeats: int) -> None:
    """The square with a cable in its middle on one mesh, solved here and by Kratos; medians."""
    if not folder().exists():
        print("\nthere is no Kratos: sh benchmarks/kratos/install", flush=True)
        return
    print(f"\n{'cells a side':14}{'s':>8}{'Kratos':>9}{'ratio':>8}{'T':>11}{'Kratos':>11}")
    for cells in numbers:
        case = Case("", "", lambda n: lined_square(n, 50.0), inflated_sheet, (cells,))
        other, seconds, runs = Kratos(case, cells, 100.0), [], []
        for _ in range(repeats):
            scene, cable = sheet(cells, 50.0)
            solver = Solver(scene, rtol=1e-9)
            seconds.append(timed(lambda s=solver: s.advance(pressure=PRESSURE))[0])  # type: ignore[misc]
            runs.append(other.run())
        own, theirs = (statistics.median(x) for x in (seconds, [run["solving"] for run in runs]))
        print(f"{cells:<14}{own:8.3f}{theirs:9.3f}{theirs / own:8.1f}{cable.tension:11.4f}"
              f"{runs[0]['found']['T']:11.4f}", flush=True)  # fmt: skip


def square(numbers: Sequence[int]) -> NDArray[np.float64]:
    """Tension, energy and place of the cable's middle on the stress-free square; the last row what
    the last two meshes lead to, if errors fall with the number of cells to the square."""
    print(f"\n{'square, cells a side':24}{'unknowns':>10}{'T':>11}{'W':>11}{'Y':>10}{'fact.':>7}")
    rows = []
    for cells in numbers:
        scene, cable = sheet(cells)
        solver = Solver(scene)
        step = solver.advance(pressure=0.01)
        places = cable.reference_positions
        middle = float(np.interp(50.0, *places[np.isfinite(places[:, 0]), :2].T))
        rows.append((cable.tension, scene.energy, middle))
        print(f"{cells:<24}{3 * solver.system.unknowns.n_global:10}{cable.tension:11.4f}"
              f"{scene.energy:11.4f}{middle:10.5f}{step.outcome.factorizations:7}",
              flush=True)  # fmt: skip
    finer = (numbers[-1] / numbers[-2]) ** 2
    limit = (finer * np.array(rows[-1]) - np.array(rows[-2])) / (finer - 1)
    print(f"{'limit':34}{limit[0]:11.4f}{limit[1]:11.4f}{limit[2]:10.5f}", flush=True)
    return np.array([*rows, limit])


# --- halls -----------------------------------------------------------------------------------


@dataclass
class Hall:
    """An air hall with a net of diagonals."""

    name: str
    depth: float
    stress: float
    pressure: float
    offsets: Any
    material: OrthotropicMembrane
    warp: tuple[float, float, float] | None = None

    def form(self, size: float) -> FoundForm:
        """Its found form."""
        corner = (-18.0, -self.depth / 2)
        plan = meshes.rectangle(COMM, 36.0, self.depth, size, corner=corner)
        return find_form(
            plan, stress=self.stress, fixed=["boundary"], pressure=self.pressure, warp=self.warp
        )

    def net(self, form: FoundForm) -> nets.Net:
        """Diagonals, straight in plan at first and then pulled taut."""
        scene = form.scene(self.material)
        return nets.sections(scene, (np.pi / 4, -np.pi / 4), self.offsets, shortest=True)


HALLS = [
    Hall("36 x 36", 36.0, 3.78, 0.3, np.arange(-15.0, 16.0, 6.0) / np.sqrt(2),
         OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)),
    Hall("36 x 54", 54.0, 4.55, 0.3, np.arange(-27.0, 28.0, 6.0),
         OrthotropicMembrane(E1=1100.0, E2=900.0, G12=40.0, nu21=0.2, thickness=1.0),
         (1.0, 0.0, 0.0)),
]  # fmt: skip
SIZES = {"36 x 36": (1.7, 1.2, 0.8), "36 x 54": (1.4, 1.0, 0.75)}
FINER = {"36 x 36": (1.2, 0.8, 0.6, 0.5), "36 x 54": (1.0, 0.75, 0.6, 0.5)}


def diagonal_wind(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pressure coefficients of a wind from the south west."""
    away = (normals[0] + normals[1]) / np.sqrt(2.0)
    return suction(away)


@dataclass
class Storm:
    """A hall in operation and in the storm: CPU seconds, tensions of both."""

    seconds: tuple[float, float, float]  # laying, calm, storm
    calm: NDArray[np.float64]
    storm: NDArray[np.float64]
    unknowns: int
    doubts: int


def in_operation(
    hall: Hall, form: FoundForm, net: nets.Net
) -> tuple[Solver, list[LaidCable], tuple[float, float]]:
    """A net in operation on a form, its cables, and CPU seconds of laying and of the load step."""
    scene = form.scene(hall.material)
    laying, cables = timed(lambda: scene.lay_net(net, Cable(EA=20e3)))
    scene.put_load((0.0, 0.0, -0.0105), name="weight", per="material")
    solver = Solver(scene)
    lengths: dict[object, float] = {cable: TIGHTENED * cable.L0 for cable in cables}
    calm, _ = timed(lambda: solver.advance(pressure=CALM, load={"weight": 1.0}, L0=lengths))
    return solver, cables, (laying, calm)


def in_the_storm(hall: Hall, form: FoundForm, net: nets.Net) -> Storm:
    """Lay the net on a form, and advance to operation and to the storm."""
    solver, cables, seconds = in_operation(hall, form, net)
    at_calm = np.array([cable.tension for cable in cables])
    solver.scene.put_wind(0.5, diagonal_wind, name="wind")
    storm, step = timed(lambda: solver.advance(pressure=STORM, load={"wind": 1.5}))
    at_storm = np.array([cable.tension for cable in cables])
    unknowns = 3 * solver.system.unknowns.n_global
    doubts = len(step.verification.doubtful) if step.verification else 0
    return Storm((*seconds, storm), at_calm, at_storm, unknowns, doubts)


def calm_hall(hall: Hall, sizes: Sequence[float]) -> None:
    """Mean, smallest and largest tension in operation, both ways on one form each."""
    print(f"\nhall {hall.name}, calm".ljust(25) + "size  unknowns      s   T mean    min    max")
    found: dict[str, list[tuple[float, float, float]]] = {"folded": [], "along lines": []}
    for size in sizes:
        form = hall.form(size)
        net = hall.net(form)
        for way, tensions in found.items():
            own = form if way == "folded" else form.along(net)
            solver, cables, (_, spent) = in_operation(hall, own, net)
            T = np.array([cable.tension for cable in cables])
            tensions.append((T.mean(), T.min(), T.max()))
            unknowns = 3 * solver.system.unknowns.n_global
            print(f"{way:23}{size:6.2f}{unknowns:10}{spent:7.1f}"
                  + "{:9.2f}{:7.2f}{:7.2f}".format(*tensions[-1]), flush=True)  # fmt: skip
    ends = {way: limit(sizes, tensions) for way, tensions in found.items()}
    for way, end in ends.items():
        print(f"{way:23} limit".ljust(46) + "{:9.2f}{:7.2f}{:7.2f}".format(*end))
    apart = ends["along lines"] / ends["folded"] - 1
    print("apart".ljust(46) + "{:9.2%}{:7.2%}{:7.2%}".format(*apart), flush=True)


def halls(hall: Hall, size: float, repeats: int) -> tuple[tuple[float, NDArray[np.float64]], ...]:
    """Folded cables and cables along lines that slide, with as many unknowns: of both the cells'
    size and tensions; mean, smallest and largest one, calm and in the storm."""
    form = hall.form(size)
    net = hall.net(form)
    folded = [in_the_storm(hall, form, net)]
    # the size at which a mesh with lines, and vertices of these that shift, has as many unknowns
    plain = 1.05 * 3 * form.mesh.mesh.topology.index_map(0).size_global
    of_lines = 3 * sum(line.length for line in net.lines) / size
    root = float(np.sqrt(of_lines**2 + 4 * plain * folded[0].unknowns))
    finer = size * 2 * plain / (root - of_lines)
    other = hall.form(finer)
    own = hall.net(other)
    cutting, lined = timed(lambda: other.along(own))
    lying = [in_the_storm(hall, lined, own)]
    for _ in range(repeats - 1):
        folded.append(in_the_storm(hall, form, net))
        lying.append(in_the_storm(hall, lined, own))
    head = "unknowns   laying   calm  storm   T calm    min    max   storm    min    max  doubts"
    print(f"\nhall {hall.name}, {size:.3g} m".ljust(25) + head)
    spent = {}
    for name, runs in (("folded", folded), ("along lines", lying)):
        seconds = [statistics.median(one.seconds[k] for one in runs) for k in range(3)]
        spent[name] = seconds
        tensions = "".join(f"{T.mean():{w}.2f}{T.min():7.2f}{T.max():7.2f}"
                           for w, T in ((9, runs[0].calm), (8, runs[0].storm)))  # fmt: skip
        print(f"{name:19}{runs[0].unknowns:14}{seconds[0]:9.2f}{seconds[1]:7.2f}{seconds[2]:7.2f}"
              f"{tensions}{runs[0].doubts:8}", flush=True)  # fmt: skip
    ratios = [a / b for a, b in zip(spent["folded"], spent["along lines"], strict=True)]
    print(f"folded / along lines: calm {ratios[1]:.2f}, storm {ratios[2]:.2f}, laying "
          f"{ratios[0]:.1f}; form cut along the net in {cutting:.2f} s", flush=True)  # fmt: skip
    return tuple(
        (own, np.array([(T.mean(), T.min(), T.max()) for T in (run.calm, run.storm)]).ravel())
        for own, run in ((size, folded[0]), (finer, lying[0]))
    )


def limits_of_halls(found: Sequence[tuple[tuple[float, NDArray[np.float64]], ...]]) -> None:
    """What tensions of both ways lead to on finer meshes, and how far these are apart."""
    ends = [limit(*zip(*way, strict=True)) for way in zip(*found, strict=True)]
    rows = zip(("folded", "along lines"), ends, [T for _, T in found[-1]], strict=True)
    for name, end, finest in rows:
        said = "".join(f"{T:9.2f} ({one / T - 1:+.1%})" for T, one in zip(end, finest, strict=True))
        print(f"{name:12} limits (error of the finest mesh) {said}")
    print("apart" + "".join(f"{a / b - 1:10.2%}" for b, a in zip(*ends, strict=True)), flush=True)


# --- limits ----------------------------------------------------------------------------------

DOME, TOP = 12.0, 5.0
BALL = (DOME**2 + TOP**2) / (2 * TOP)
ENDS = {"A1": (1, 11), "A2": (23, 13), "B1": (7, 17), "B2": (5, 19)}  # in 24ths of the rim
ON_RIM = (72, 96, 144, 192, 240)
WAYS = ("folded", "cut", "lines")


def arcs(turn: float = 0.0) -> tuple[dict[str, NDArray[np.float64]], float]:
    """Great circles alike over the dome, turned by an angle, and their length."""
    centre, found, angle = np.array([0.0, 0.0, TOP - BALL]), {}, 0.0
    for name, ends in ENDS.items():
        around = np.array(ends) * np.pi / 12 + turn
        p, q = DOME * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1) - centre
        angle = float(np.arccos(p @ q / BALL**2))
        t = np.linspace(0.0, angle, 400)[:, None]
        found[name] = centre + (np.sin(angle - t) * p + np.sin(t) * q) / np.sin(angle)
    return found, BALL * angle


def alike(way: str, on_rim: int, shortened: float, turn: float = 0.0) -> NDArray[np.float64]:
    """Tensions of cables that are alike, on a mesh with that many vertices on the rim."""
    lines, length = arcs(turn)
    size = 2 * np.pi * DOME / on_rim
    mesh = meshes.spherical_cap(COMM, DOME, TOP, size, lines=lines if way == "lines" else None)
    if way == "cut":
        mesh = meshes.along(mesh, lines)
    roof = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
    roof.fix("boundary")
    cables = []
    for name, path in lines.items():
        where: Any = {"path": path, "name": name} if way == "folded" else {"along": name}
        cable = Cable(EA=20e3)
        cables.append(roof.lay_cable(cable, L0=shortened * length, hold="pocket", **where))
    Solver(roof).advance(pressure=0.5)
    return np.array([cable.tension for cable in cables])


def limits(shortened: float, on_rim: Sequence[int] = ON_RIM) -> dict[str, NDArray[np.float64]]:
    """Mean and largest tensions of all meshes, the last row those that they lead to."""
    found = {}
    print(f"\nlimits, L0 {shortened:g} of the arc".ljust(34) + "".join(f"{n:>8}" for n in on_rim)
          + "   limit")  # fmt: skip
    for way in WAYS:
        tensions = [alike(way, n, shortened) for n in on_rim]
        rows = np.array([(T.mean(), T.max()) for T in tensions])
        finest = 1.0 / np.square(on_rim[-3:])  # of the cells' size to the square
        fit = np.polyfit(finest, rows[-3:], 1)[1]
        found[way] = np.concatenate([rows, fit[None]])
        for what, row in zip(("mean", "max"), found[way].T, strict=True):
            print(f"{way:22}{what:10}" + "".join(f"{T:8.3f}" for T in row), flush=True)
    return found


def scatter(on_rim: int) -> None:
    """Tensions of cables alike that end between vertices of the rim."""
    for way in WAYS:
        T = np.array([alike(way, on_rim, 1.0, turn) for turn in (0.04, 0.1, 0.14, 0.2)])
        print(f"net turned, {on_rim} on the rim, {way:10} T {T.mean():.3f}, {T.min():.3f} to "
              f"{T.max():.3f}", flush=True)  # fmt: skip


# --- angles ----------------------------------------------------------------------------------


def roofs(scale: float) -> Iterator[tuple[str, meshes.MembraneMesh, dict[str, Any]]]:
    """Six roofs with their lines; sizes grow with a smaller scale."""
    wider = float(1 / np.sqrt(scale))
    for hall, size in ((HALLS[0], 2.4), (HALLS[0], 1.2), (HALLS[1], 2.0)):
        form = hall.form(size * wider)
        net = hall.net(form)
        yield (
            f"hall {hall.name}, {len(net.lines)} cables, {size * wider:.2g} m",
            form.mesh,
            net.paths,
        )
    form = HALLS[0].form(1.5 * wider)
    scene, ways = form.scene(HALLS[0].material), [(1.0, 1.0), (-1.0, 1.0)]
    net = nets.equidistant(scene, 6.0, origin=(0.0, 0.0), directions=ways)
    yield f"hall 36 x 36, equal meshes, {1.5 * wider:.2g} m", form.mesh, net.paths
    mesh, lines = tent(0.6 * wider)
    yield f"tent, {len(lines)} lines, {0.6 * wider:.2g} m", mesh, lines
    yield f"dome, 28 cables, {1e5 * scale:.0f} unknowns", cap(1e5 * scale), great_circles(CABLES)


def tent(size: float) -> tuple[meshes.MembraneMesh, dict[str, Any]]:
    """The tent of `demos/tent.py` with a ridge, a valley and three cables askew."""
    sides = ["south east", "north east", "north west", "south west"]
    heights = {"corner 1": 1.2, "corner 2": 6.0, "corner 3": 1.2, "corner 4": 6.0}
    plan = meshes.polygon(
        COMM, [(0.0, -7.0), (8.0, 0.0), (0.0, 7.0), (-8.0, 0.0)], size, names=sides
    )
    cables = [FormCable(side, tension=45.0) for side in sides]
    lifted = {corner: (0.0, 0.0, z) for corner, z in heights.items()}
    form = find_form(plan, stress=2.5, fixed=list(heights), cables=cables, lifted=lifted)
    planes = {
        "ridge": ((0.0, 0.0, 3.0), (0.0, 1.0, 0.0)),
        "valley": ((0.0, 0.0, 3.0), (1.0, 0.0, 0.0)),
        "north": ((0.0, 1.5, 3.0), (0.1, 1.0, 0.0)),
        "south": ((0.0, -1.5, 3.0), (-0.1, 1.0, 0.0)),
        "across": ((2.5, 0.0, 3.0), (1.0, 0.2, 0.0)),
    }
    return form.mesh, {
        name: plane_section(form.mesh, place, normal, name=name).path
        for name, (place, normal) in planes.items()
    }


def smallest_angles(mesh: meshes.MembraneMesh) -> NDArray[np.float64]:
    """The smallest angle of each cell (degrees), on one process."""
    sines = shapes(mesh.mesh.geometry.x[geometry_dofmap(mesh.mesh)])[1]
    found: NDArray[np.float64] = np.degrees(np.arcsin(sines))
    return found


def angles(scale: float) -> None:
    """The smallest angles before and after cutting."""
    print(
        f"\n{'smallest angle, degrees':44}{'before':>9}{'1 %':>7}{'cut':>8}{'1 %':>7}{'s CPU':>8}"
    )
    for name, mesh, lines in roofs(scale):
        told = Told()
        logging.getLogger("crms_fenicsx").addHandler(told)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", PathWarning)
            try:
                spent, cut = timed(lambda m=mesh, way=lines: meshes.along(m, way))  # type: ignore[misc]
            except InputError as error:
                print(f"{name:44} refused: {error}", flush=True)
                continue
            finally:
                logging.getLogger("crms_fenicsx").removeHandler(told)
        before, after = smallest_angles(mesh), smallest_angles(cut)
        print(f"{name:44}{before.min():9.1f}{np.percentile(before, 1):7.1f}{after.min():8.1f}"
              f"{np.percentile(after, 1):7.1f}{spent:8.2f}", flush=True)  # fmt: skip
        for one in caught:
            print(f"    {one.message}")
        if told.texts:
            print(f"    {len(told.texts)} rows turn sideways by more than 0.5 degrees")


class Told(logging.Handler):
    """Collects what is logged."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a text."""
        self.texts.append(record.getMessage())


# --- processes -------------------------------------------------------------------------------


def work(unknowns: float) -> None:
    """One run on all processes: prints its figures on rank 0."""
    small = cap(1600.0)
    net = net_on(small)
    inflated(meshes.along(small, net.paths), net)  # compile and load
    first = cap(unknowns)
    net = net_on(first)
    figures: dict[str, Any] = {}

    def wall(name: str, function: Callable[[], Result]) -> Result:
        COMM.Barrier()
        begin = time.perf_counter()
        found = function()
        COMM.Barrier()
        figures[name] = time.perf_counter() - begin
        return found

    mesh = wall("cut", lambda: meshes.along(first, net.paths))
    for bare in (True, False):
        scene = covered(mesh)
        solver = Solver(scene)
        kind = "bare" if bare else "28 cables"
        if not bare:
            wall("lay", lambda s=scene: s.lay_net(net, Cable(EA=600e3)))  # type: ignore[misc]
        for pressure in PRESSURES:
            wall(f"{kind}, {pressure}", lambda p=pressure, s=solver: s.advance(pressure=p))  # type: ignore[misc]
    tensions = [cable.tension for cable in scene.cables]
    if COMM.rank == 0:
        print("FIGURES " + json.dumps([figures, scene.energy, tensions]), flush=True)


def processes(unknowns: float) -> None:
    """One process and two: wall times, and the same digits."""
    runs = []
    for count in (1, 2):
        command = ["mpirun", "-n", str(count), sys.executable, str(Path(__file__).resolve())]
        out = subprocess.run([*command, "--work", str(unknowns)], capture_output=True, text=True)
        lines = [line for line in out.stdout.splitlines() if line.startswith("FIGURES ")]
        if not lines:
            sys.exit(out.stdout + out.stderr)
        runs.append(json.loads(lines[0].removeprefix("FIGURES ")))
    print(f"\nwall time, s, dome of {unknowns:.0f} unknowns{'1 process':>12}{'2':>9}{'ratio':>9}")
    for name, seconds in runs[0][0].items():
        other = runs[1][0][name]
        print(f"{name:34}{seconds:18.2f}{other:9.2f}{seconds / other:9.2f}")
    energies, tensions = (np.array([run[k] for run in runs]) for k in (1, 2))
    worst = np.abs(tensions[1] / tensions[0] - 1).max()
    print(f"two processes against one: energy {abs(energies[1] / energies[0] - 1):.0e}, tensions "
          f"{worst:.0e}", flush=True)  # fmt: skip


def many_roofs(numbers: Sequence[int], unknowns: float) -> None:
    """Random roofs in many load steps."""
    wrong = [(number, text) for number in numbers for text in run(number, unknowns)]
    bad = len({number for number, _ in wrong})
    print(f"\n{len(numbers)} roofs, {bad} of which with refused or doubtful states")
    print("\n".join(text for _, text in wrong), flush=True)


def clamps(count: int) -> None:
    """Random clamped nets on a rigid sheet, against strings."""
    found = [clamped(seed, 1 + seed // 2 % 3, 1 + seed // 6 % 3) for seed in range(count)]
    errors, ways = (np.array([getattr(net, name) for net in found]) for name in ("error", "way"))
    told = sum(net.told for net in found)
    slack = sum(net.slack > 0 for net in found)
    print(f"\n{count} clamped nets on a rigid sheet: {(errors < 1e-6).sum()} within 1e-6 of the "
          f"largest tension, largest error {errors.max():.1e}, {told} told to be doubtful; "
          f"clamps slide by up to {ways.max():.2f}, {slack} nets with slack parts",
          flush=True)  # fmt: skip


def tables(chosen: argparse.Namespace) -> dict[str, Callable[[], Any]]:
    """What prints each table."""
    scale, repeats = chosen.scale, chosen.repeats
    finer = float(np.sqrt(scale))

    def domes() -> None:
        dome(min(UNKNOWNS) * min(scale, 0.1), 1)  # compile and load
        for unknowns in UNKNOWNS:
            dome(unknowns * scale, repeats)

    def air_halls() -> None:
        for hall in HALLS:
            sizes = [size / finer for size in SIZES[hall.name]]
            limits_of_halls([halls(hall, size, repeats) for size in sizes])

    def calm_halls() -> None:
        for hall in HALLS:
            calm_hall(hall, [size / finer for size in FINER[hall.name]])

    def of_limits() -> None:
        on_rim = [24 * max(round(n * finer / 24), 1) for n in ON_RIM]
        for shortened in (1.0, 0.995):
            limits(shortened, on_rim)
        for n in on_rim[:3]:
            scatter(n)

    return {
        "square": lambda: square([max(round(k * finer / 10), 1) * 10 for k in CELLS]),
        "kratos": lambda: kratos(BESIDE, repeats),
        "dome": domes,
        "cost": lambda: cost([unknowns * scale for unknowns in (3_500, *UNKNOWNS)]),
        "folded": lambda: [folded(unknowns * scale) for unknowns in FOLDED],
        "mirrored": lambda: mirrored(MIRRORED * scale),
        "halls": air_halls,
        "calm": calm_halls,
        "net": lambda: cable_net([size / finer for size in NET_SIZES]),
        "roofs": lambda: many_roofs(range(*chosen.roofs), chosen.unknowns * scale),
        "limits": of_limits,
        "angles": lambda: angles(scale),
        "clamps": lambda: clamps(max(2, round(60 * min(scale, 1.0)))),
        "processes": lambda: processes(1e5 * scale),
    }


def main(given: list[str]) -> None:
    """Print the tables asked for."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("tables", nargs="*", help="which of the tables above; all by default")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--scale", type=float, default=1.0, help="of the numbers of unknowns")
    options.add_argument("--roofs", type=int, nargs=2, default=(0, 20), help="first and end")
    options.add_argument("--unknowns", type=float, default=5000.0, help="of each of the roofs")
    chosen = options.parse_args(given)
    known = tables(chosen)
    if set(chosen.tables) - set(known):
        options.error(f"there are no such tables: {', '.join(set(chosen.tables) - set(known))}")
    logging.getLogger("crms_fenicsx").setLevel(logging.INFO)
    warnings.simplefilter("ignore", PathWarning)
    for name in chosen.tables or known:
        known[name]()


if __name__ == "__main__":
    if "--work" in sys.argv:
        warnings.simplefilter("ignore", PathWarning)
        work(float(sys.argv[2]))
    else:
        main(sys.argv[1:])
