"""Plans of a structure: the named model, and the forces on its foundations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.output.figures.axes3d import (
    DISTINCT,
    INK,
    RIM,
    annotate,
    style_axes,
    with_unit,
)
from crms_fenicsx.results.output.figures.picture import add_lines, add_polygons, new_figure, png_of
from crms_fenicsx.results.view_data import Line

UPLIFT, DOWNWARD, CABLE, BAR = DISTINCT[1], DISTINCT[0], "#444b55", DISTINCT[3]
ROOM = 0.16
"""Longest arrow and highest ordinate of a diagram, relative to the plan's size."""


@dataclass(frozen=True)
class ForcePlan:
    """Forces on foundations in plan, with the maxima that set the scale of all plans."""

    rim: Array  # (k, 2, 3) held edges (length)
    per_length: Array  # (k, 2, 3) forces on them (force per length)
    points: Mapping[str, tuple[Array, Array]]  # place and force (force) of each foundation
    outline: Array  # (k, 2, 3) edges of membrane and bars, for orientation
    most: float  # largest horizontal force on a point (force)
    most_per_length: float


def draw_forces(plan: ForcePlan, unit: str, force: str, dpi: int, width: float = 6.0) -> bytes:
    """Draw arrows of horizontal forces and a diagram of the forces per length beside the rim."""
    places: list[Array] = [plan.outline[..., :2].reshape(-1, 2), plan.rim[..., :2].reshape(-1, 2)]
    places += [at[None, :2] for at, _ in plan.points.values()]
    flats = np.concatenate(places)
    few = len(plan.points) <= 30  # names have their vertical force beside them
    air = ROOM + (0.5 if few else 0.15) * (plan.most_per_length > 0.0)
    axes, size = _axes(flats, unit, width, air)
    centre = (flats.min(axis=0) + flats.max(axis=0)) / 2
    high = float(np.linalg.norm(plan.per_length, axis=2).max(initial=0.0))
    high *= ROOM * size / (plan.most_per_length or 1.0)
    if plan.most_per_length > 0.0:
        flat = plan.rim[..., :2]
        along = flat[:, 1] - flat[:, 0]
        out = np.stack([along[:, 1], -along[:, 0]], axis=1)
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
        out *= np.sign(((flat.mean(axis=1) - centre) * out).sum(axis=1, keepdims=True))
        sizes = np.linalg.norm(plan.per_length, axis=2) * ROOM * size / plan.most_per_length
        outer = flat + sizes[..., None] * out[:, None]
        quads = np.concatenate([flat, outer[:, ::-1]], axis=1)
        up = plan.per_length[..., 2].sum(axis=1) > 0.0
        colours = [UPLIFT if x else DOWNWARD for x in up]
        add_polygons(axes, quads, facecolors=colours, alpha=0.35, edgecolors="none")
        add_lines(axes, outer, colors=INK, linewidths=0.6)
    add_lines(axes, plan.outline[..., :2], colors="#9aa3ad", linewidths=0.7, zorder=1)
    add_lines(axes, plan.rim[..., :2], colors=RIM, linewidths=1.4)
    named = list[tuple[str, list[Place]]]()
    for name, (at, one) in plan.points.items():
        size_of = float(np.linalg.norm(one))
        colour = INK if size_of == 0.0 else UPLIFT if one[2] > 0.0 else DOWNWARD
        axes.plot(at[0], at[1], "s", color=colour, markersize=4, zorder=4)
        tip = at[:2] + one[:2] * (ROOM * size / plan.most if plan.most > 0.0 else 0.0)
        if np.linalg.norm(tip - at[:2]) > 0.01 * size:
            axes.annotate(
                "", tip, at[:2], zorder=4,
                arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.3},
            )  # fmt: skip
        side = (at[:2] - centre) / np.maximum(np.ptp(flats, axis=0), 1e-300)
        across = abs(side[1]) > abs(side[0])  # at the upper or lower side
        out = np.sign(side) * (not across, across)
        text_at = at[:2] + 1.04 * high * out
        sign = "" if size_of == 0.0 else "↑" if one[2] > 0.0 else "↓"
        value = f" {sign}{abs(one[2]):.3g}" if few else ""
        if not high:
            named.append((f"{name}{value}", [(at[:2], way) for way in _ways(at[:2] - centre)]))
            continue
        _name(axes, f"{name}{value}", text_at, out * 9.0)
        if across:
            axes.texts[-1].set(rotation=90, va="bottom" if out[1] > 0.0 else "top")
    _write_apart(axes, named, plan.rim[..., :2])
    text = [f"arrows up to {plan.most:.4g} {force} in all plans"] if plan.points else []
    if plan.most_per_length > 0.0:
        per = f"{force}/{unit}" if force and unit else ""
        text.append(f"rim up to {plan.most_per_length:.4g} {per} in all plans")
    axes.set_title("\n".join(text), fontsize=8, color=INK)
    return png_of(axes.figure, dpi)


@dataclass(frozen=True)
class ModelPlan:
    """Contents of a plan of the model."""

    corners: Array  # (m, 3, 3) triangles (length)
    rim: Array  # (k, 2, 3) held edges
    points: Sequence[tuple[str, Array]]  # held points and joints by name; "" is not written
    cables: Sequence[Line]
    bars: Sequence[Line]  # bars with the name "" get no label
    warp: tuple[Array, Array]  # positions and directions


def draw_model(plan: ModelPlan, unit: str, dpi: int, width: float = 6.0) -> bytes:
    """Draw the mesh, supports, warp directions, and cables and bars with their names."""
    from matplotlib.lines import Line2D

    lines = [np.asarray(line.points)[:, :2] for line in (*plan.cables, *plan.bars)]
    places = [plan.corners[..., :2].reshape(-1, 2), *lines]
    axes, size = _axes(np.concatenate(places), unit, width, 0.04)
    centre = plan.corners[..., :2].reshape(-1, 2).mean(axis=0)
    add_polygons(axes, plan.corners[..., :2], facecolors="#eef2f7", edgecolors="#cfd6de",
                 linewidths=0.3, zorder=1)  # fmt: skip
    at, way = plan.warp
    half = 0.02 * size * way[:, :2]
    strokes = np.stack([at[:, :2] - half, at[:, :2] + half], axis=1)
    add_lines(axes, strokes, colors=DISTINCT[2], linewidths=1.4, zorder=2)
    add_lines(axes, plan.rim[..., :2], colors=RIM, linewidths=2.2, zorder=3)
    colours = [CABLE] * len(plan.cables) + [BAR] * len(plan.bars)
    add_lines(axes, lines, colors=colours, linewidths=1.2, zorder=3)
    for _, place in plan.points:
        axes.plot(place[0], place[1], "^", color=RIM, markersize=5, zorder=4)
    named = _line_names(plan, centre, 1e-3 * size)
    names = named if len(named) <= 80 else []
    if len(plan.points) <= 30:
        names += [(name, [(place[:2], way) for way in _ways(place[:2] - centre)])
                  for name, place in plan.points if name]  # fmt: skip
    _write_apart(axes, names, plan.rim[..., :2])
    told = [
        (RIM, "held edges", len(plan.rim)), (CABLE, "cables", len(plan.cables)),
        (BAR, "bars", len(plan.bars)), (DISTINCT[2], "warp", len(at)),
    ]  # fmt: skip
    handles = [Line2D([], [], color=c, linewidth=2, label=text) for c, text, n in told if n]
    axes.legend(
        handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return png_of(axes.figure, dpi)


Place = tuple[Array, Array]
"""Candidate position of a name, (2,) (length), and the side on which it is written, (2,)."""


def _line_names(plan: ModelPlan, centre: Array, near: float) -> list[tuple[str, list[Place]]]:
    """Names of cables and bars, joined where they coincide, and candidate positions."""
    found: list[tuple[str, Array, list[Place]]] = []
    ends = [np.asarray(line.points)[k, :2] for line in plan.cables for k in (0, -1)]
    for line in (*plan.cables, *plan.bars):
        flat = np.asarray(line.points)[:, :2]
        middle = flat[len(flat) // 2]
        same = (k for k, (_, one, _) in enumerate(found)
                if np.abs(one[[0, -1]] - flat[[0, -1]]).max() < near
                and np.linalg.norm(one - middle, axis=1).min() < near)  # fmt: skip
        if not line.name:
            continue
        if (k := next(same, None)) is not None:
            found[k] = (f"{found[k][0]}, {line.name}", *found[k][1:])
            continue
        within = list[Place]()
        for part in (0.5, 0.35, 0.65, 0.2, 0.8):
            k = min(int(part * (len(flat) - 1)), len(flat) - 2)
            along = flat[k + 1] - flat[k]
            place = flat[k] + (part * (len(flat) - 1) - k) * along
            out = np.array([along[1], -along[0]])
            out = out if out @ (place - centre) >= 0.0 else -out
            within += [(place, out), (place, -out)]
        beyond = list[Place]()
        for end, before in ((flat[0], flat[1]), (flat[-1], flat[-2])):
            beyond += [(end, end - before), *((end, way) for way in _sides(end - centre))]
        own_end = sum(np.linalg.norm(end - flat[0]) < near for end in ends) == 1
        found.append((line.name, flat, beyond + within if own_end else within + beyond))
    return [(name, places) for name, _, places in found]


def _ways(out: Array) -> list[Array]:
    """Diagonal directions, the most outward one first."""
    sides = [np.array(way) for way in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))]
    return sorted(sides, key=lambda way: -float(way @ out))


def _sides(out: Array) -> list[Array]:
    """Outward directions along the axes, the longer component first."""
    sides = np.diag(np.sign(out))
    return [sides[k] for k in np.argsort(-np.abs(out))]


def _write_apart(axes: Any, names: Sequence[tuple[str, Sequence[Place]]], rim: Array) -> None:
    """Write each name at the candidate position that least covers names, rim (k, 2, 2) and
    frame."""
    axes.apply_aspect()
    taken: Array = np.zeros((0, 4))
    points = 72.0 / axes.figure.dpi
    frame = axes.bbox.extents * points
    part = np.linspace(0.0, 1.0, 6)[:, None]
    dots = (rim[:, None, 0] * (1.0 - part) + rim[:, None, 1] * part).reshape(-1, 2)
    dots = axes.transData.transform(dots) * points
    for name, places in names:
        tried = list[tuple[float, int, Array, Array, Array]]()
        for at, out in places:
            away = 9.0 * out / (np.linalg.norm(out) or 1.0)
            x, y = axes.transData.transform(at) * points + away
            wide = 3.9 * len(name)
            left = x if away[0] > 4.0 else x - wide if away[0] < -4.0 else x - wide / 2
            box = np.array([left - 2.0, y - 4.5, left + wide + 2.0, y + 4.5])
            over = np.minimum(taken[:, 2:], box[2:]) - np.maximum(taken[:, :2], box[:2])
            covered = float(over.clip(0.0).prod(axis=1).sum())
            covered += 9.0 * float((frame - box)[:2].clip(0.0).sum()
                                   + (box - frame)[2:].clip(0.0).sum())  # fmt: skip
            hidden = ((dots > box[:2]) & (dots < box[2:])).all(axis=1)
            covered += 9.0 * float(hidden.sum())
            tried.append((covered, len(tried), box, at, away))
        _, _, box, at, away = min(tried, key=lambda one: one[:2])
        taken = np.vstack([taken, box])
        _name(axes, name, at, away)


def _axes(places: Array, unit: str, width: float, air: float) -> tuple[Any, float]:
    """Axes of equal scale around places in plan, and their size (length)."""
    low, high = places.min(axis=0), places.max(axis=0)
    size = float((high - low).max()) or 1.0
    low, high = low - (air + 0.05) * size, high + (air + 0.05) * size
    tall = width * (high - low)[1] / (high - low)[0]
    figure = new_figure(width, min(max(tall, 0.3 * width), 1.1 * width))
    axes: Any = figure.add_axes((0.1, 0.1, 0.85, 0.8))
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel(with_unit("x", unit), fontsize=8.5, color=INK)
    axes.set_ylabel(with_unit("y", unit), fontsize=8.5, color=INK)
    style_axes(axes, 8.0)
    return axes, size


def _name(axes: Any, text: str, at: Array, away: Array) -> None:
    """Write a name beside a place, on the side of the offset `away` (points)."""
    annotate(axes, text, at, (float(away[0]), float(away[1]) - 2.5), 7.0)
    axes.texts[-1].set_horizontalalignment(
        "left" if away[0] > 4.0 else "right" if away[0] < -4.0 else "center"
    )
