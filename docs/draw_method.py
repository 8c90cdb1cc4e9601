"""Draw the figures of `docs/theory`: ./run python docs/draw_method.py [FOLDER]

Unfoldings, angles and forces are computed from the points that are drawn, slid cables and friction
from solved scenes.
"""

from __future__ import annotations

import functools
import itertools
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import Bbox
from mpi4py import MPI
from scipy.special import j0

from crms_fenicsx import (
    Cable,
    Friction,
    IsotropicMembrane,
    PatternWarning,
    Scene,
    SnapThroughWarning,
    Solver,
    meshes,
    patterns,
)
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.cabling.friction.slip import material_place
from crms_fenicsx.energy.terms.lateral_friction import coulomb_forces
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.model.laid_cable import LaidCable

Array = npt.NDArray[Any]
Points = Sequence[Array] | Array

FOLDER = Path(__file__).parent / "theory" / "figures"
WIDTH = 7.0  # inches; with letters of 12 points legible at 400 pixels
FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)  # kgf, cm
COATED = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)  # kN, m
CABLE, FOLD, FORCE, SLIP = "#C24E00", "#0072B2", "#00795A", "#AA3377"
FABRIC, FOLDED, LINE = "#F1F1F1", "#FFE3B0", "#777777"
STYLE = {
    "font.size": 12,
    "axes.linewidth": 0.8,
    "svg.fonttype": "path",
    "svg.hashsalt": "method",
    "mathtext.fontset": "dejavusans",
    "path.simplify": True,
}


def panels(height: float, columns: Sequence[float], rows: Sequence[float] = (1,)) -> Any:
    """A figure and its drawing areas, row by row, with equal scales and without axes."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasSVG(figure)
    grid = figure.add_gridspec(len(rows), len(columns), width_ratios=columns, height_ratios=rows)
    areas = [figure.add_subplot(grid[k]) for k in range(len(rows) * len(columns))]
    for axes in areas:
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure, areas


def arrow(
    axes: Any, start: Array, vector: Array, colour: str, label: str = "", at: float = 1.0,
    aside: tuple[float, float] = (0.0, 0.0),
) -> None:  # fmt: skip
    """An arrow with a label at a share of its length, moved aside by points."""
    start, vector = np.asarray(start), np.asarray(vector)
    style = {"arrowstyle": "-|>,head_width=0.22,head_length=0.45", "color": colour, "lw": 2}
    style |= {"shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start + vector, start, arrowprops=style, zorder=6, annotation_clip=False)
    axes.update_datalim([start, start + vector])
    if label:
        note(axes, start + at * vector, label, aside, colour)


def note(
    axes: Any, place: Array, text: str, aside: tuple[float, float] = (0.0, 0.0),
    colour: str = "black", **options: Any,
) -> None:  # fmt: skip
    """A text centred at a place, moved aside by points, on a white ground."""
    options = {"ha": "center", "va": "center", "zorder": 8} | options
    ground = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    axes.annotate(
        text, place, aside, textcoords="offset points", color=colour, bbox=ground,
        annotation_clip=False, **options,
    )  # fmt: skip


def polygon(
    axes: Any, corners: Sequence[Any] | Array, colour: Any = FABRIC, **options: Any
) -> None:
    """A filled polygon (n, 2) with its outline."""
    axes.fill(*np.asarray(corners).T, **({"fc": colour, "ec": LINE, "lw": 1.2} | options))


def line(axes: Any, points: Points, colour: str, **options: Any) -> None:
    """A polyline (n, 2)."""
    axes.plot(*np.asarray(points).T, **({"color": colour, "lw": 2} | options))


def dots(axes: Any, points: Points, colour: str, **options: Any) -> None:
    """Round marks at points (n, 2)."""
    look = {"marker": "o", "ms": 6, "mec": "white", "mew": 0.8, "zorder": 7}
    axes.plot(*np.atleast_2d(points).T, ls="", color=colour, **(look | options))


def arc(axes: Any, centre: Array, start: Array, end: Array, radius: float, **options: Any) -> Array:
    """The arc about a centre from one direction to another, the short way; returns its middle."""
    first, last = (np.arctan2(*(way - centre)[::-1]) for way in map(np.asarray, (start, end)))
    last = first + (last - first + np.pi) % (2 * np.pi) - np.pi
    angles = np.linspace(first, last, 30)
    points = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    look: dict[str, Any] = {"colour": "black", "lw": 1.2} | options
    line(axes, points, **look)
    return np.asarray(points[15])


def seen(points: Array, azimuth: float, elevation: float) -> tuple[Array, Array]:
    """Places in the picture, (n, 2), of points (n, 3) seen from a direction (degrees); depths."""
    a, e = np.radians([azimuth, elevation])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    points = np.asarray(points)
    return points @ np.column_stack([right, np.cross(towards, right)]), points @ towards


def turned(point: Array, start: Array, end: Array, angle: float) -> Array:
    """A point turned about the line from start to end (degrees)."""
    axis = (end - start) / np.linalg.norm(end - start)
    arm, t = point - start, np.radians(angle)
    return np.asarray(
        start + arm * np.cos(t) + np.cross(axis, arm) * np.sin(t)
        + axis * (axis @ arm) * (1 - np.cos(t))
    )  # fmt: skip


def distance(a: Array, b: Array) -> float:
    """Distance of two points."""
    return float(np.linalg.norm(np.asarray(a) - b))


def angle(a: Array, at: Array, b: Array) -> float:
    """Angle between the directions from a point to two others (degrees)."""
    u, v = a - at, b - at
    return float(np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))))


# ---------------------------------------------------------------------------------------------
# The folded element


def folded(flat: Array, shares: tuple[float, float], bend: float) -> dict[str, Array]:
    """Points in space of a flat triangle i, j, k (3, 2) folded by an angle (degrees) about p q."""
    i, j, k = np.column_stack([flat, np.zeros(3)])
    p, q = i + shares[0] * (j - i), k + shares[1] * (j - k)
    return {"i": i, "j": turned(j, p, q, bend), "k": k, "p": p, "q": q}


def unfolded(x: dict[str, Array]) -> tuple[Array, Array, float, float]:
    """k'' and j'' in the plane with the radii r1, r2 of the two circles, (2.3-1 ... 2.3-7)."""
    base = distance(x["i"], x["k"])
    r1 = distance(x["i"], x["p"]) + distance(x["p"], x["j"])
    r2 = distance(x["j"], x["q"]) + distance(x["q"], x["k"])
    along = (base**2 + r1**2 - r2**2) / (2 * base)
    return np.array([base, 0.0]), np.array([along, np.sqrt(r1**2 - along**2)]), r1, r2


FLAT = np.array([(0.0, 0.0), (2.7, 5.0), (6.2, 0.0)])
STRAINED = np.array([(0.0, 0.0), (3.5, 5.45), (7.0, 0.0)])  # much more than any fabric
SHARES, BENDS = (0.42, 0.5), (50.0, 35.0)
VIEW = (-140.0, 27.0)


def element_in_space(axes: Any, x: dict[str, Array], offset: float = 0.35) -> dict[str, Array]:
    """Draw a folded element; returns the places of its points in the picture."""
    places = dict(zip(x, seen(np.array(list(x.values())), *VIEW)[0], strict=True))
    polygon(axes, [places[name] for name in "ipqk"], FOLDED)
    polygon(axes, [places[name] for name in "pjq"], FABRIC)
    dots(axes, [places[name] for name in "ijk"], "black", marker="s")
    middle = np.mean([places[name] for name in "ijk"], axis=0)
    for name in "ijk":
        away = places[name] - middle
        note(axes, places[name] + offset * away / np.linalg.norm(away), f"${name}$")
    return places


def draw_fold() -> Figure:
    """The folded element and its unfolding."""
    figure, (left, right) = panels(3.6, [1, 1.1])
    before = folded(FLAT, SHARES, BENDS[0])
    after = folded(STRAINED, SHARES, BENDS[1])
    places = element_in_space(left, before)
    along = before["q"] - before["p"]
    up = np.array([0.0, 0.0, 1.3])
    ends = np.array([before["p"] - 0.75 * along + up, before["q"] + 0.6 * along + up])
    ends = seen(ends, *VIEW)[0]
    line(left, [ends[0], places["p"], places["q"], ends[1]], CABLE, lw=3)
    dots(left, [places["p"], places["q"]], FOLD, ms=8)
    note(left, places["p"], "$p$", (-9, -11), FOLD)
    note(left, places["q"], "$q$", (9, -11), FOLD)
    note(left, ends[0], "$a$", (-8, 5), CABLE)
    note(left, ends[1], "$b$", (8, 5), CABLE)
    left.set_title("folded, in space", fontsize=12)
    left.margins(0.1)

    i = np.zeros(2)
    (k, j, r1, r2), (k1, j1, s1, s2) = unfolded(before), unfolded(after)
    np.testing.assert_allclose([j, j1], [FLAT[1], STRAINED[1]])  # folding changes no length
    polygon(right, [i, j, k], FABRIC, lw=1.6)
    polygon(right, [i, j1, k1], "none", ec=FOLD, lw=1.6, ls="--")
    for centre, radius, top, colour in (
        (i, r1, j, LINE), (k, r2, j, LINE), (i, s1, j1, FOLD), (k1, s2, j1, FOLD),
    ):  # fmt: skip
        way = np.arctan2(*(top - centre)[::-1])
        angles = way + np.linspace(-0.2, 0.2, 20)
        circle = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
        line(right, circle, colour, lw=1, ls=":")
    p, q = i + SHARES[0] * (j - i), k + SHARES[1] * (j - k)
    line(right, [p, q], CABLE, lw=3)
    dots(right, [p, q], FOLD, ms=8)
    note(right, p, "$p$", (9, 10), FOLD)
    note(right, q, "$q$", (12, 9), FOLD)
    dots(right, [i, j, k], "black", marker="s")
    dots(right, [j1, k1], FOLD, marker="s")
    note(right, i, "$i$", (-11, 0))
    note(right, j, "$j''$", (-13, 8))
    note(right, j1, "$j'''$", (14, 9), FOLD)
    note(right, k, "$k$", (0, -13))
    note(right, k1, "$k''$", (12, -10), FOLD)
    for a, b, share, aside, text in (
        (i, j, 0.45, (-13, 7), "$r_1 = |ip| + |pj|$"),
        (k, j, 0.27, (-14, -9), "$r_2 = |jq| + |qk|$"),
    ):
        way = np.degrees(np.arctan2(*(b - a)[::-1]))
        note(right, a + share * (b - a), text, aside, rotation=way - 180 * (way > 90))
    arrow(right, k, k1 - k, FORCE, "$du_k$", 0.5, (0, 12))
    corner = np.array([j1[0], j[1]])
    arrow(right, j, corner - j, FORCE, "$du_j$", 0.5, (0, -11))
    arrow(right, corner, j1 - corner, FORCE, "$dv_j$", 0.3, (20, 0))
    right.set_title("unfolded", fontsize=12)
    right.margins(0.06)
    return figure


def draw_penalty() -> Figure:
    """The angles of (2.5-1) and the default's weight."""
    figure, (left, right) = panels(3.3, [1.25, 1])
    i, j, k = FLAT
    p, q = i + SHARES[0] * (j - i) + (-0.55, 0.12), k + SHARES[1] * (j - k) + (0.5, 0.15)
    polygon(left, [i, p, q, k], FOLDED)
    polygon(left, [p, j, q], FABRIC)
    line(left, [i, j], LINE, lw=1, ls=":")
    line(left, [k, j], LINE, lw=1, ls=":")
    line(left, [p, q], CABLE, lw=3)
    dots(left, [i, j, k], "black", marker="s")
    dots(left, [p, q], FOLD, ms=8)
    for name, place, aside in (
        ("i", i, (-11, 0)), ("j", j, (0, 12)), ("k", k, (11, 0)), ("p", p, (-13, 0)),
        ("q", q, (13, 3)),
    ):  # fmt: skip
        note(left, place, f"${name}$", aside, FOLD if name in "pq" else "black")
    for at, lower, other in ((p, i, q), (q, k, p)):
        for corner, colour in ((lower, FORCE), (j, SLIP)):
            middle = arc(left, at, corner, other, 0.75, colour=colour, lw=2)
            way = middle - at
            text = f"{angle(corner, at, other):.0f}°"
            note(left, at + 1.75 * way, text, colour=colour, fontsize=11)
    excess = [angle(a, at, b) + angle(j, at, b) - 180 for a, at, b in ((i, p, q), (k, q, p))]
    left.set_title(
        f"sum $-\\,\\pi = {excess[0]:.0f}$° at $p$, ${excess[1]:.0f}$° at $q$", fontsize=12
    )
    left.margins(0.1)

    share = np.linspace(0.0, 1.0, 101)
    right.plot(share, 4 * share * (1 - share), color=FOLD, lw=2.5)
    right.plot(share, np.ones_like(share), color="black", lw=1.8, ls="--")
    note(right, np.array([0.5, 1.0]), "paper", (0, 10), va="bottom")
    note(right, np.array([0.5, 0.55]), "default\n$w = 4ab/(a+b)^2$", colour=FOLD)
    graph(right, "place on the side, $a/(a+b)$", "weight $w$")
    right.set(xlim=(0, 1), ylim=(0, 1.3), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    return figure


def graph(axes: Any, x: str, y: str) -> None:
    """Turn a drawing area into a graph."""
    axes.set_axis_on()
    axes.set_aspect("auto")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def draw_pressure() -> Figure:
    """Nodal forces of the pressure on a folded element."""
    figure, (left, right) = panels(3.4, [1, 1])
    x = folded(FLAT, SHARES, BENDS[0])

    def area(corners: str) -> Array:
        a, b, c = (x[name] for name in corners)
        return np.asarray(np.cross(b - a, c - a) / 2)

    literal = dict.fromkeys("ijk", area("ikj") / 3)
    facets: dict[str, Array] = dict.fromkeys("ijkpq", np.zeros(3))
    # the quadrilateral by the mean of both diagonals
    for corners, share in (("ikq", 0.5), ("iqp", 0.5), ("ikp", 0.5), ("kqp", 0.5), ("pqj", 1.0)):
        for name in corners:
            facets[name] = facets[name] + share * area(corners) / 3
    for axes, forces, title in (
        (left, literal, "(2.4-1) on the corners"), (right, facets, "package: on the facets"),
    ):  # fmt: skip
        places = element_in_space(axes, x)
        line(axes, [places["p"], places["q"]], CABLE, lw=3)
        dots(axes, [places["p"], places["q"]], FOLD, ms=8)
        for name, force in forces.items():
            tip = seen(x[name] + 0.5 * force, *VIEW)[0]
            arrow(axes, places[name], tip - places[name], FORCE)
        note(axes, places["p"], "$p$", (-10, -8), FOLD)
        note(axes, places["q"], "$q$", (12, -4), FOLD)
        axes.set_title(title, fontsize=12)
    limits = Bbox.union([left.dataLim, right.dataLim]).padded(0.5)
    for axes in (left, right):
        axes.set(xlim=limits.intervalx, ylim=limits.intervaly)
    return figure


# ---------------------------------------------------------------------------------------------
# Contact and friction


def draw_contact_force() -> Figure:
    """Turning angle, tensions and contact force, inside and at the boundary."""
    figure, areas = panels(4.2, [1, 1], [1, 0.95])
    theta = np.radians(56.0)
    first = np.array([np.cos(theta / 2), np.sin(theta / 2)])  # direction of the cable before
    last = np.array([np.cos(theta / 2), -np.sin(theta / 2)])  # and after the node
    node, T = np.zeros(2), 1.0
    inside = 2 * T * np.sin(theta / 2)
    edge = T * (1 - np.cos(theta)) / np.sin(theta)
    pull = T * last - T * first
    normals = np.array([(-first[1], first[0]), (-last[1], last[0])])
    np.testing.assert_allclose(pull, (0.0, -inside), atol=1e-12)
    np.testing.assert_allclose(-edge * normals.sum(axis=0), pull, atol=1e-12)
    np.testing.assert_allclose(edge, T * np.tan(theta / 2))
    for column, axes in enumerate(areas[:2]):
        wide = np.array([1.5, -1.0])
        below = [-1.45 * first, node, 1.45 * last]
        polygon(axes, [*below, (1.5, wide[1]), (-1.5, wide[1])] if column == 0 else
                [node, 1.45 * last, (1.5, wide[1]), (0.0, wide[1])], FABRIC, ec="none")  # fmt: skip
        line(axes, below if column == 0 else [node, 1.45 * last], LINE, lw=1.2)
        line(axes, [-1.45 * first, node, 1.45 * last], CABLE, lw=3)
        line(axes, [node, 1.1 * first], "black", lw=1, ls=":")
        middle = arc(axes, node, first, last, 0.72)
        note(axes, 1.22 * middle, r"$\theta$")
        arrow(axes, -0.15 * first, -0.95 * first, CABLE, "$T$", 0.75, (-8, 13))
        arrow(axes, 0.15 * last, 0.95 * last, CABLE, "$T$", 0.75, (-6, -14))
        dots(axes, [node], FOLD, ms=9)
        axes.set_title(("inside the membrane", "at its boundary")[column], fontsize=12)
        axes.set(xlim=(-1.5, 1.5), ylim=(-0.85, 0.62))
    left, right = areas[2:]
    for axes in (left, right):
        arrow(axes, node, T * first, CABLE, "$T$", 0.5, (-4, 12))
        arrow(axes, node, T * last, CABLE, "$T$", 0.5, (-4, -12))
        middle = arc(axes, node, first, last, 0.33)
        note(axes, 1.38 * middle, r"$\theta$")
        axes.set(xlim=(-0.25, 2.4), ylim=(-0.66, 0.66))
    arrow(left, T * first, pull, FORCE, "$N = 2T\\,\\sin(\\theta/2)$", 0.5, (72, 0))
    corner = T * first - edge * normals[0]
    line(right, [T * first, T * last], FORCE, lw=1.2, ls="--")
    arrow(right, T * first, corner - T * first, FORCE, "$N$", 0.5, (11, 6))
    arrow(right, corner, T * last - corner, FORCE, "$N$", 0.5, (11, -6))
    note(right, np.array([1.76, 0.0]), "$N = T\\,\\tan(\\theta/2)$", colour=FORCE)
    return figure


def held(mesh: MembraneMesh, fabric: IsotropicMembrane) -> Scene:
    """A scene whose boundary is held."""
    scene = Scene(mesh, fabric)
    scene.fix("boundary")
    return scene


@functools.cache
def slid(mu: float) -> tuple[Scene, LaidCable, Array]:
    """A cable laid in an arc over an inflated sheet and tightened; its line on the fabric before.

    Units: kgf, cm.
    """
    mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=60.0, size=14.0)
    scene = held(mesh, FOIL)
    solver = Solver(scene)
    solver.advance(pressure=0.03)
    x = np.linspace(0.0, 100.0, 21)
    way = np.column_stack([x, 20.0 + 12.0 * np.sin(np.pi * x / 100.0)])
    cable = scene.lay_cable(Cable(EA=32000.0, friction=mu), path=way)
    before = on_fabric(scene, cable)
    solver.advance(L0={cable: 0.95 * cable.L0})
    return scene, cable, before


def on_fabric(scene: Scene, cable: LaidCable) -> Array:
    """Places of a cable's points on the flat stress-free fabric, (n, 2)."""
    shape = scene.net.strip_shape()
    return np.array([material_place(cable, k, shape)[:2] for k in cable.path_nodes()])


def cells_of(scene: Scene) -> Array:
    """Corners of the cells on the flat stress-free fabric, (n, 3, 2)."""
    return np.asarray(scene.membrane.stress_free[scene.V.dofmap.list][..., :2])


def twice_area(u: Array, v: Array) -> Array:
    """Signed areas of the parallelograms of vectors (..., 2) in the plane."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def crossed(cells: Array, path: Array) -> Array:
    """The cells that contain the middle of a segment of a path (n, 2)."""
    a, b, c = np.moveaxis(cells, 1, 0)[:, :, None]
    middle = ((path[1:] + path[:-1]) / 2)[None]

    def left(u: Array, v: Array) -> Array:
        return twice_area(v - u, middle - u)

    sides = np.stack([left(a, b), left(b, c), left(c, a)])
    inside = np.asarray((sides > 0.0).all(axis=0) | (sides < 0.0).all(axis=0))
    return np.asarray(cells[inside.any(axis=1)])


def draw_sliding() -> Figure:
    """A cable's path over the cells before and after it has slid."""
    figure, areas = panels(5.6, [1], [1, 1])
    scene, cable, before = slid(0.0)
    after, cells = on_fabric(scene, cable), cells_of(scene)
    cells = cells[(cells[..., 1].max(axis=1) > 7) & (cells[..., 1].min(axis=1) < 43)]
    vertices = np.unique(cells.reshape(-1, 2), axis=0)
    was, now = (np.interp(vertices[:, 0], *path.T) for path in (before, after))
    passed = vertices[(now < vertices[:, 1]) & (vertices[:, 1] < was)]
    for axes, path, title in (
        (areas[0], before, "as laid"), (areas[1], after, "tightened: it has slid"),
    ):  # fmt: skip
        for cell in cells:
            polygon(axes, cell, "white", lw=0.8)
        for cell in crossed(cells, path):
            polygon(axes, cell, FOLDED, lw=0.8)
        if path is after:
            line(axes, before, CABLE, lw=1.5, ls=":")
            for x in (30.0, 50.0, 70.0):
                start, end = (np.array([x, np.interp(x, *one.T)]) for one in (before, after))
                arrow(axes, start, end - start, SLIP)
        line(axes, path, CABLE, lw=3)
        dots(axes, path[1:-1], FOLD)
        dots(axes, passed, "none", mec="black", mew=2, ms=11)
        axes.set_title(title, fontsize=12)
        axes.set(xlim=(-1, 101), ylim=(7, 43))
    marks: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
    handles = [
        Line2D([], [], color=FOLD, label="fold point", **marks),
        Line2D([], [], color="none", mec="black", mew=2, label="vertex passed", **marks),
        Patch(fc=FOLDED, ec=LINE, label="cell with the cable"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    return figure


def draw_friction() -> Figure:
    """The friction element, and the slip of a cable from its material curve."""
    figure, (left, right) = panels(3.0, [1, 1.6])
    v, slip = np.zeros(2), np.array([0.35, -1.05])
    ring = [
        2.0 * np.array([np.cos(t), np.sin(t)]) for t in np.radians([12, 70, 128, 190, 250, 308])
    ]
    for a, b in itertools.pairwise([*ring, ring[0]]):
        polygon(left, [v, a, b], "white", lw=1)
    p = v + slip
    along = np.array([-slip[1], slip[0]]) / np.linalg.norm(slip)
    line(left, [v - 2.2 * along, v + 2.2 * along], CABLE, lw=1.5, ls=":")
    line(left, [p - 2.2 * along, p + 2.2 * along], CABLE, lw=3)
    arrow(left, v + 1.25 * along, slip, SLIP, r"$\Delta s$", 0.5, (14, 2))
    arrow(left, p, -0.85 * slip, FORCE, r"$F = \mu N$", 0.5, (-32, -6))
    dots(left, [v], "black", marker="s", ms=8)
    dots(left, [p], FOLD, ms=9)
    note(left, v, "$v$", (-3, 13))
    note(left, p, "$p$", (-6, -13), FOLD)
    left.set_title("friction element", fontsize=12)

    scene, cable, before = slid(0.4)
    after, cells = on_fabric(scene, cable), cells_of(scene)
    for cell in cells:
        polygon(right, cell, "white", lw=0.7)
    line(right, before, CABLE, lw=1.5, ls=":")
    line(right, after, CABLE, lw=3)
    dots(right, after[1:-1], FOLD, ms=5)
    curve = np.column_stack([x := np.linspace(0, 100, 400), np.interp(x, *before.T)])
    for place in after[1:-1]:
        foot = curve[np.argmin(np.linalg.norm(curve - place, axis=1))]
        line(right, [foot, place], SLIP, lw=2)
    note(right, np.array([40.0, 36.0]), "material curve", colour=CABLE)
    note(right, np.array([40.0, 17.0]), "cable now", colour=CABLE)
    right.set(xlim=(-1, 60), ylim=(10, 43))
    right.set_title("slip on the fabric", fontsize=12)
    return figure


def draw_friction_law() -> Figure:
    """Friction force over slip."""
    figure, (axes,) = panels(2.9, [1])
    s: Array = np.linspace(-2.0, 4.0, 601)
    one = np.ones(len(s))
    axes.axvspan(-1, 1, color=FABRIC, lw=0)
    axes.axhline(0, color=LINE, lw=0.8)
    axes.plot(s, coulomb_forces(s, one, one), color=FORCE, lw=3)
    axes.plot(s, one, color="black", lw=1.8, ls="--")
    graph(axes, r"slip $s$", "friction force")
    axes.set(xlim=(-2, 4), ylim=(-1.3, 1.5), xticks=[-1, 0, 1], yticks=[-1, 0, 1])
    axes.set_xticklabels([r"$-\epsilon$", "0", r"$\epsilon$"])
    axes.set_yticklabels([r"$-\mu N$", "0", r"$\mu N$"])
    note(axes, np.array([0.0, -1.1]), "sticks")
    note(axes, np.array([2.5, -1.1]), "slides")
    note(axes, np.array([2.5, 0.72]), "default", colour=FORCE)
    note(axes, np.array([0.4, 1.27]), "paper: constant in a step")
    return figure


def draw_contacts() -> Figure:
    """A cable that spans a hollow, and two that cross in a cell."""
    figure, (left, right) = panels(2.7, [1.5, 1])

    def height(x: Array) -> Array:
        return np.asarray(4.0 * np.sin(np.pi * x / 24.0) - 2.6 * np.exp(-(((x - 12.0) / 3.0) ** 2)))

    x, y = np.meshgrid(np.linspace(0.0, 24.0, 25), np.linspace(0.0, 3.0, 4))
    points = np.stack([x, y, height(x)], axis=-1).reshape(-1, 3)
    grid = np.arange(len(points)).reshape(x.shape)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    mesh = meshes.from_arrays(MPI.COMM_WORLD, points, triangles)
    scene = held(mesh, COATED)
    cable = scene.lay_cable(Cable(EA=30e3), path=[(0.0, 1.0), (24.0, 1.0)])
    hill = np.column_stack([points[: x.shape[1], 0], points[: x.shape[1], 2]])
    polygon(left, [(0, -1.5), *hill, (24, -1.5)], FABRIC, ec="none")
    line(left, hill, LINE, lw=1.5)
    line(left, cable.line[:, [0, 2]], CABLE, lw=3)
    dots(left, cable.line[1:-1, [0, 2]], FOLD)
    left.set_title("a cable over a hollow", fontsize=12)

    plan = meshes.rectangle(MPI.COMM_WORLD, width=4.0, depth=4.0, size=2.0)
    scene = held(plan, COATED)
    solver = Solver(scene)
    solver.advance(pressure=20.0)
    ends = [((0.0, 1.4), (4.0, 2.3)), ((1.3, 0.0), (2.2, 4.0))]
    cables = [scene.lay_cable(Cable(EA=30e3), path=pair) for pair in ends]
    solver.advance()
    cells = scene.positions()[scene.V.dofmap.list][..., :2]
    for cell in cells:
        polygon(right, cell, "white", lw=0.8)
    for cable in cables:
        for cell in crossed(cells, cable.line[:, :2]):
            polygon(right, cell, FOLDED, lw=0.8)
    for cable, colour in zip(cables, (CABLE, SLIP), strict=True):
        line(right, cable.line[:, :2], colour, lw=3)
        kinds = np.array([node.kind for node in cable.state.nodes])
        dots(right, cable.state.positions[kinds == "fold", :2], FOLD)
        dots(right, cable.state.positions[kinds == "crossing", :2], "black", marker="D", ms=9)
    right.set_title("two cables cross", fontsize=12)
    return figure


def draw_overview() -> Figure:
    """An inflated sheet with a taut cable."""
    figure, (axes,) = panels(3.0, [1])
    mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=60.0, size=10.0)
    scene = held(mesh, FOIL)
    solver = Solver(scene)
    solver.advance(pressure=0.05)
    cable = scene.lay_cable(Cable(EA=32000.0), path=[(0.0, 20.0), (100.0, 38.0)])
    solver.advance(L0={cable: 0.965 * cable.L0})
    surface = current_surface(scene.net)
    view = (-72.0, 22.0)
    places, depth = seen(surface.points, *view)
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    light = np.clip(0.62 + 0.52 * normals @ np.array([-0.7, -0.5, 0.5]), 0.0, 1.0)
    pieces = np.bincount(surface.parents)[surface.parents]
    for row in np.argsort(depth[surface.triangles].mean(axis=1)):
        colour = light[row] * np.array(to_rgb(FOLDED if pieces[row] > 1 else "white"))
        polygon(axes, places[surface.triangles[row]], tuple(colour), lw=0.8)
    on_cable, folds = seen(cable.line, *view)[0], places[surface.triangles[pieces > 1]]
    widest = folds[np.argmax(twice_area(folds[:, 1] - folds[:, 0], folds[:, 2] - folds[:, 0]))]
    line(axes, on_cable, CABLE, lw=3)
    dots(axes, on_cable[1:-1], FOLD, ms=5)
    for place, text, aside, colour in (
        (on_cable[0], "cable: one tension", (10, 60), CABLE),
        (on_cable[4], "fold points:\nunknowns that slide", (70, 75), FOLD),
        (widest.mean(axis=0), "folded element", (-20, 62), "black"),
    ):
        axes.annotate(
            text, place, aside, textcoords="offset points", color=colour, ha="center",
            arrowprops={"arrowstyle": "-", "color": colour, "shrinkB": 2}, annotation_clip=False,
        )  # fmt: skip
    return figure


# ---------------------------------------------------------------------------------------------
# Solved examples


def draw_wrinkling() -> Figure:
    """A sheared sheet: which cells are taut, wrinkled and slack, and along which way they pull."""
    figure, (axes,) = panels(3.2, [1])
    mesh = meshes.rectangle(MPI.COMM_WORLD, width=10.0, depth=4.0, size=0.8, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=1000.0, nu=0.3, thickness=1.0))
    for side in ("front", "back"):
        scene.fix(side)
    scene.fix(lambda x: x[2] < 1.0, "z")
    solver = Solver(scene)
    solver.advance(move={"back": (0.12, 0.07, 0.0)}, steps=3)
    results = solver.results()
    states, names = results.values("state"), ("slack", "wrinkled", "taut")
    looks = {"slack": "#CFCFCF", "wrinkled": FOLDED, "taut": "#BFDDF0"}
    cells = scene.positions()[scene.V.dofmap.list][..., :2]
    ways = results.true_directions[:, 0, :2]
    forces = results.values("true force 1")
    longest = forces.max()
    for cell, state, way, force in zip(cells, states, ways, forces, strict=True):
        polygon(axes, cell, looks[names[round(state)]], lw=0.5)
        arm = 0.3 * force / longest * way / max(np.linalg.norm(way), 1e-12)
        line(axes, [cell.mean(axis=0) - arm, cell.mean(axis=0) + arm], FORCE, lw=1.4)
    for y in (0.0, 4.07):
        at = cells.reshape(-1, 2)
        ends = at[np.abs(at[:, 1] - y) < 1e-9]
        line(axes, [ends.min(axis=0), ends.max(axis=0)], "black", lw=3)
    arrow(axes, np.array([4.3, 4.45]), np.array([1.6, 0.0]), SLIP)
    handles: list[Any] = [Patch(fc=looks[name], ec=LINE, label=name) for name in reversed(names)]
    handles.append(Line2D([], [], color=FORCE, label="larger section force"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def unrolled(cells: Sequence[Array], path: Array) -> tuple[list[Array], Array]:
    """A strip of cells (3, 3) in space laid into the plane one after the other, and a path's points
    (n, 3), of which each cell has two.
    """
    flat: list[Array] = []
    points: list[Array] = []
    for k, cell in enumerate(cells):
        if not flat:
            base = distance(cell[0], cell[1])
            places = [np.zeros(2), np.array([base, 0.0])]
            known = [0, 1]
        else:
            before = cells[k - 1]
            known = [c for c in range(3) if min(distance(cell[c], one) for one in before) < 1e-9]
            places = [
                flat[-1][int(np.argmin([distance(cell[c], one) for one in before]))] for c in known
            ]
        (new,) = set(range(3)) - set(known)
        a, b = (cell[c] for c in known)
        u, v = places
        size = distance(a, b)
        along = (cell[new] - a) @ (b - a) / size
        away = np.sqrt(max(distance(cell[new], a) ** 2 - along**2, 0.0))
        e = (v - u) / size
        normal = np.array([-e[1], e[0]])
        if flat:
            opposite = flat[-1].mean(axis=0)
            normal = -normal if (opposite - u) @ normal > 0 else normal
        laid = np.zeros((3, 2))
        laid[known[0]], laid[known[1]], laid[new] = u, v, u + along * e + away * normal
        flat.append(laid)
        frame = np.linalg.lstsq(cell.T, path[k], rcond=None)[0]
        points.append(frame @ laid)
        if k == len(cells) - 1:
            points.append(np.linalg.lstsq(cell.T, path[k + 1], rcond=None)[0] @ laid)
    return flat, np.array(points)


def draw_unrolled() -> Figure:
    """A geodesic over a dome, and its cells unrolled."""
    figure, (left, right) = panels(6.0, [1], [2.9, 1])
    mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=10.0, height=5.0, size=2.6)
    scene = held(mesh, COATED)
    ends = [(-9.3, -3.6), (8.2, -5.6)]
    ways = [scene.lay_cable(Cable(EA=15e3), ends, shortest=short) for short in (True, False)]
    points = scene.positions()
    cells = points[scene.V.dofmap.list] + np.array([0.0, 0.0, 1e3])  # no cell passes the origin
    view = (-75.0, 58.0)
    places = seen(points, *view)[0]
    for cell in scene.V.dofmap.list:
        polygon(left, places[cell], "white", lw=0.7)
    path = ways[0].line + np.array([0.0, 0.0, 1e3])
    path = path[np.r_[True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9]]
    strip = []
    for a, b in itertools.pairwise(path):
        shares = np.linalg.solve(np.moveaxis(cells, 1, 2), ((a + b) / 2)[None, :, None])[..., 0]
        inside = (shares.min(axis=1) > -1e-9) & (abs(shares.sum(axis=1) - 1) < 1e-6)
        strip.append(cells[inside.argmax()])
        polygon(left, places[scene.V.dofmap.list[inside.argmax()]], FOLDED, lw=0.7)
    flat, straight = unrolled(strip, path)
    chord = straight[-1] - straight[0]
    length = sum(distance(a, b) for a, b in itertools.pairwise(path))
    np.testing.assert_allclose(np.linalg.norm(chord), length)  # it is straight
    e = chord / np.linalg.norm(chord)
    back = np.array([[e[0], -e[1]], [e[1], e[0]]])
    for cell in flat:
        polygon(right, cell @ back, FOLDED, lw=0.8)
    line(right, straight @ back, CABLE, lw=3)
    dots(right, (straight @ back)[1:-1], FOLD, ms=5)
    on = [seen(cable.line, *view)[0] for cable in ways]
    line(left, on[1], "black", lw=1.8, ls="--")
    line(left, on[0], CABLE, lw=3)
    lengths = [sum(distance(a, b) for a, b in itertools.pairwise(c.line)) for c in ways]
    left.set_title("over the dome", fontsize=12)
    right.set_title("its cells unrolled", fontsize=12)
    handles = [
        Line2D([], [], color=CABLE, lw=3, label=f"geodesic, {lengths[0]:.2f} m"),
        Line2D([], [], color="black", ls="--", label=f"straight in plan, {lengths[1]:.2f} m"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def draw_stick_slip() -> Figure:
    """A cable on a sheet moved to and fro: its middle's place over that of its ends."""
    figure, (axes,) = panels(3.4, [1])
    for mu, colour, label in ((0.0, "black", "frictionless"), (0.4, CABLE, r"$\mu = 0.4$")):
        mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size=12.0)
        scene = Scene(mesh, FOIL)
        scene.fix("front")
        scene.fix("back")
        ends = [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
        cable = scene.lay_cable(Cable(EA=32000.0, friction=mu), ends)
        solver = Solver(scene)
        solver.advance(move={cable: (0.0, 0.0, -8.0)}, steps=2)
        way: list[tuple[float, float]] = []
        y = 0.0
        for step in [2.0] * 5 + [-2.0] * 10 + [2.0] * 10:
            y += step
            solver.advance(move={cable: (0.0, step, 0.0)})
            way.append((y, float(np.interp(50.0, *cable.line.T[:2])) - 50.0))
        axes.plot(*np.array(way).T, "o-", color=colour, ms=4, label=label)
    graph(axes, "ends of the cable, sideways [cm]", "its middle [cm]")
    axes.legend(frameon=False)
    return figure


def draw_capstan() -> Figure:
    """Tension along a cable with friction along itself, tightened at one end."""
    figure, (axes,) = panels(3.2, [1])
    mesh = meshes.air_hall(MPI.COMM_WORLD, width=16.0, depth=12.0, height=8.0, size=2.0)
    scene = held(mesh, COATED)
    solver = Solver(scene)
    solver.advance(pressure=0.4)
    mu = 0.3
    cable = scene.lay_cable(
        Cable(3000.0, friction=Friction(0.0, along=mu)), path=[(0.0, 6.0), (16.0, 6.0)]
    )
    solver.advance(L0={cable: cable.L0 - 0.25}, steps=5)
    ways = np.diff(cable.line, axis=0)
    sizes = np.linalg.norm(ways, axis=1)
    turns = np.arccos(np.clip(np.sum(ways[1:] * ways[:-1], axis=1) / sizes[1:] / sizes[:-1], -1, 1))
    wrap = np.r_[0.0, np.cumsum(turns)]
    smooth: Array = np.linspace(0.0, wrap[-1], 100)
    axes.plot(np.degrees(smooth), cable.tensions[0] * np.exp(mu * smooth), color=FORCE, lw=2,
              label=r"$T_0\,e^{\mu\theta}$")  # fmt: skip
    axes.plot(np.degrees(wrap), cable.tensions, "o", color=CABLE, ms=6, label="solved, by span")
    graph(axes, r"turn $\theta$ from the far end [degrees]", "tension [kN]")
    axes.set_ylim(0.0)
    axes.legend(frameon=False)
    return figure


def draw_ponding() -> Figure:
    """Sections of a drum under water of a given level, beside the closed form."""
    figure, (axes,) = panels(3.4, [1])
    tension, radius, h0 = 2.0, 3.0, 1e-3
    axes.axhline(1.0, color="#6BAED6", lw=1.5)
    for k, colour in ((1.0, FORCE), (1.5, SLIP), (2.0, CABLE)):
        scene = Scene(
            meshes.ellipse(MPI.COMM_WORLD, radius, radius, 0.3),
            IsotropicMembrane(E=1e-6, nu=0.3, thickness=1.0, prestress=tension, wrinkling=False),
        )
        scene.fix("boundary")
        scene.put_pond(tension * (k / radius) ** 2, level=h0)
        Solver(scene).advance(load=1.0)
        x, y, z = scene.positions()[abs(scene.positions()[:, 1]) < 0.3].T  # near a diameter
        r: Array = np.linspace(0.0, radius, 200)
        closed = -(j0(k * r / radius) / j0(k) - 1)
        axes.plot(r / radius, closed, color=colour, lw=1.5)
        axes.plot(np.hypot(x, y) / radius, z / h0, "o", color=colour, ms=2.5, label=f"k R = {k:g}")
    note(axes, np.array([0.08, 1.0]), "water level", (12, 0), "#2171B5")
    graph(axes, "distance from the centre, r / R", "z / h0")
    axes.legend(frameon=False, loc="lower right", markerscale=2)
    return figure


def draw_snap_through() -> Figure:
    """The height of a dome under growing snow, with its jump."""
    figure, (axes,) = panels(3.3, [1])
    mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=10.0, height=5.0, size=2.0)
    scene = held(mesh, COATED)
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    solver = Solver(scene)
    solver.advance(pressure=0.3)
    crown = int(np.argmin(np.hypot(*scene.positions()[:, :2].T)))
    way, jumps = [(0.0, scene.positions()[crown, 2])], []
    for load in np.arange(0.05, 0.51, 0.05):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SnapThroughWarning)
            step = solver.advance(load={"snow": float(load)})
        way.append((float(load), scene.positions()[crown, 2]))
        jumps += [getattr(one, "loads", {}).get("snow") for one in step.warnings]
    at = np.array(way)
    jump = next(one for one in jumps if one)
    limit = float(np.mean(jump))
    before = at[:, 0] < limit
    axes.axvline(limit, color=LINE, lw=1, ls=":")
    axes.axhline(0.0, color=LINE, lw=0.8)
    axes.plot(*at[before].T, "o-", color=FORCE, ms=5)
    axes.plot(*at[~before].T, "o-", color=CABLE, ms=5)
    tail, head = at[before][-1], at[~before][0]
    arrow(axes, np.array([limit, tail[1]]), np.array([0.0, head[1] - tail[1]]), SLIP)
    graph(axes, "snow [kPa]", "height of the crown [m]")
    axes.set_ylim(-6.5, 6.5)
    note(axes, np.array([limit, 1.5]), f"limit load {limit:.2f} kPa", (-78, 0))
    note(axes, np.array([limit, -2.0]), "snaps through", (52, 0), SLIP)
    return figure


def draw_flattening() -> Figure:
    """Strains across a flattened strip of a dome, beside the formula."""
    figure, (left, right) = panels(3.4, [1, 1.15])
    R, W = 8.0, 2.0
    mesh = meshes.spherical_cap(
        MPI.COMM_WORLD, radius=4.0, height=R - np.sqrt(R**2 - 16.0), size=0.16
    )
    seams = [
        patterns.plane_section(mesh, (0.0, y, 0.0), (0.0, 1.0, 0.0), name=f"seam {k}")
        for k, y in enumerate((-W / 2, W / 2))
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PatternWarning)  # 16 columns would take four times as long
        pattern = patterns.flatten(
            patterns.cut(mesh, seams), COATED, warp=(1.0, 0.0, 0.0), equal=False
        )
    (flat,) = (one for one in pattern.flat if sum(edge.sewn for edge in one.piece.edges) == 2)
    view = (-70.0, 35.0)
    angles = np.linspace(0.0, 2 * np.pi, 80)
    rim = np.column_stack([4.0 * np.cos(angles), 4.0 * np.sin(angles), 0.0 * angles])
    polygon(left, seen(rim, *view)[0], "white")
    crown = np.column_stack([0.0 * angles, 4.0 * np.cos(angles), 0.0 * angles])
    crown[:, 2] = np.sqrt(R**2 - crown[:, 1] ** 2) - np.sqrt(R**2 - 16.0)
    line(left, seen(crown, *view)[0], LINE, lw=1)
    outline = flat.piece.outline
    polygon(left, seen(flat.piece.points[outline], *view)[0], FOLDED, lw=1.2)
    polygon(left, flat.shape[outline] - flat.shape.mean(axis=0) - (0.0, 4.2), FOLDED, lw=1.2)
    note(left, np.array([0.0, -4.2]), "flat")
    left.set_title("a strip of a dome", fontsize=12)
    middles = flat.shape[flat.piece.triangles].mean(axis=1)
    middles -= (np.ptp(flat.shape, axis=0) / 2 + flat.shape.min(axis=0))[None]
    inside = abs(middles[:, 0]) < 0.7  # away from its ends
    y: Array = np.linspace(-W / 2, W / 2, 100)
    right.plot(middles[inside, 1], 100 * flat.strains[inside, 0], "o", color=CABLE, ms=2.5,
               label="cells")  # fmt: skip
    right.plot(y, 100 / R**2 * (W**2 / 24 - y**2 / 2), color="black", lw=1.8,
               label=r"$K(W^2/24 - y^2/2)$")  # fmt: skip
    right.axhline(0.0, color=LINE, lw=0.8)
    graph(right, "y across the strip [m]", "strain along it [%]")
    right.legend(frameon=False, fontsize=10)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "overview": draw_overview,
    "fold": draw_fold,
    "penalty": draw_penalty,
    "pressure": draw_pressure,
    "sliding": draw_sliding,
    "contacts": draw_contacts,
    "contact_force": draw_contact_force,
    "friction": draw_friction,
    "friction_law": draw_friction_law,
    "wrinkling": draw_wrinkling,
    "unrolled": draw_unrolled,
    "stick_slip": draw_stick_slip,
    "capstan": draw_capstan,
    "ponding": draw_ponding,
    "snap_through": draw_snap_through,
    "flattening": draw_flattening,
}


def main(folder: Path) -> None:
    """Draw all figures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        for name, draw in FIGURES.items():
            draw().savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
