"""Axes of a 3D picture: scale, measured box behind the shape, legend and colour bars."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output.figures.picture import (
    Camera,
    add_lines,
    add_polygons,
    finished,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

INK = "#2b2f36"
RIM = "#1d1f24"
"""Colour of cables' rims, held edges and supports."""
STRIPES = (0.0, (0.9, 0.9))
"""Dashes of cables off the membrane; the rim shows between them."""
_GRID = "#d3d7dc"
DISTINCT = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours safe for colour-blind readers."""
FLAT = 1e-6
"""Range of heights, ways or values, relative to their size, up to which they are one."""
_SMALL = 8.5
Entry = tuple[Any, str, str]
"""Colour, text, kind ("line", "patch", "foot", "clamp" or "stripes") in a legend; "" omits it."""


def with_unit(label: str, unit: str) -> str:
    """Label with its unit, if any, in brackets."""
    return f"{label} [{unit}]" if unit else label


def annotate(axes: Axes, text: str, at: Array, offset: tuple[float, float], size: float) -> None:
    """Write a text with a white outline at an offset in points."""
    from matplotlib.patheffects import withStroke

    written = axes.annotate(
        text, (at[0], at[1]), offset, textcoords="offset points", fontsize=size, color=INK, zorder=5
    )
    written.set_path_effects([withStroke(linewidth=1.8, foreground="white")])


def style_axes(axes: Axes, size: float) -> None:
    """Draw tick labels of a size in points, and a faint grid behind the plot."""
    axes.tick_params(labelsize=size, colors=INK, width=0.7, length=3)
    axes.grid(color="#e3e6ea", linewidth=0.6)
    axes.set_axisbelow(True)


def check_view(view: tuple[float, float]) -> None:
    """Raise `InputError` for a view that is not a pair of finite angles."""
    if np.shape(view) != (2,) or not np.all(np.isfinite(view)):
        raise InputError(f"view {view!r}; pass (azimuth, elevation) in degrees.")


def foot() -> Any:
    """Marker of a support: a triangle below its place, on a piece of ground."""
    from matplotlib.path import Path as Outline

    places = [(0, 0), (-0.7, -1.1), (0.7, -1.1), (0, 0), (-1.1, -1.4), (1.1, -1.4)]
    move, line, close = Outline.MOVETO, Outline.LINETO, Outline.CLOSEPOLY
    return Outline(places, [move, line, line, close, move, line])


class Axes3D:
    """A figure in the camera's picture plane; `point` is the length shown by 1/72 inch.

    It has `room` beside the box, and in height at least (inches).
    """

    def __init__(
        self,
        camera: Camera,
        low: Array,
        high: Array,
        title: str,
        bars: int,
        width: float,
        legend: Sequence[Entry],
        room: tuple[float, float] = (0.0, 2.6),
    ) -> None:
        self.camera, self.low, self.high = camera, low, high
        seen = camera.project(_corners(low, high))[:, :2]
        span = np.maximum(np.ptp(seen, axis=0), 1e-12 * np.ptp(seen))
        told = [entry for entry in legend if entry[1]]
        left, right, bottom = 0.62, 0.58 + 0.95 * bars + room[0], 0.55
        columns = _columns([text for _, text, _ in told], width - left - right + 0.4)
        rows = -(-len(told) // columns)
        top = (0.42 if title else 0.15) + 0.19 * rows
        free = np.array([width - left - right, 0.95 * width])
        scale = float((span / free).max())
        height = span[1] / scale + bottom + top
        height = max(height, room[1])
        self.point = scale / 72.0
        self.figure = new_figure(width, height)
        self._size = np.array([width, height])
        self._bars = bars
        self.axes: Axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes.set_axis_off()
        # centred between margins and colour bars
        middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        origin = middle - scale * np.array(
            [left + 0.5 * free[0], bottom + 0.5 * (height - bottom - top)]
        )
        self.axes.set_xlim(origin[0], origin[0] + scale * width)
        self.axes.set_ylim(origin[1], origin[1] + scale * height)
        if title:
            self.figure.text(
                (left + 0.5 * free[0]) / width, 1 - 0.26 / height, title,
                ha="center", va="center", fontsize=11, color=INK,
            )  # fmt: skip
        if told:
            self._add_legend(told, columns)

    def frame(self) -> Bbox:
        """Rectangle around the box in data coordinates of the axes."""
        from matplotlib.transforms import Bbox

        seen = self._flat(_corners(self.low, self.high))
        return Bbox([seen.min(axis=0), seen.max(axis=0)])

    def finished(self, path: Path | None, dpi: int) -> Figure | None:
        """As `picture.finished`, cropped to the drawing."""
        from matplotlib.transforms import Bbox

        # the axes fill the figure, so "tight" would crop nothing
        renderer = self.figure.canvas.get_renderer()  # type: ignore[attr-defined]
        parts = [*self.axes.texts, *self.figure.texts, *self.figure.axes[1:]]
        parts += [] if (legend := self.axes.get_legend()) is None else [legend]
        drawn = [box for part in parts if (box := part.get_tightbbox(renderer)) is not None]
        drawn.append(self.axes.transData.transform_bbox(self.frame()))
        region = Bbox.union(drawn).transformed(self.figure.dpi_scale_trans.inverted())
        return finished(self.figure, path, dpi, region.padded(0.1))

    def draw_box(self, unit: str) -> None:
        """Draw the box's three far faces with a grid, and tick labels along its near edges."""
        from matplotlib.ticker import MaxNLocator

        towards = self.camera.axes[2]
        far = np.where(towards > 0, self.low, self.high)
        near = self.low + self.high - far
        whole = max(float((self.high - self.low).max()), 1e-300)
        ticks = []
        for axis in range(3):
            size = self.high[axis] - self.low[axis]
            edge = np.tile(far, (2, 1))
            edge[1, axis] = near[axis]
            room = float(np.linalg.norm(np.diff(self._flat(edge), axis=0))) / self.point
            wanted = int(np.clip(round(6 * size / whole), 3, 6))
            wanted = min(wanted, max(int(room / 14.0), 2))
            values = MaxNLocator(wanted, steps=[1, 2, 2.5, 5, 10]).tick_values(
                self.low[axis], self.high[axis]
            )
            slack = 1e-9 * size
            ticks.append(
                values[(values >= self.low[axis] - slack) & (values <= self.high[axis] + slack)]
            )
        faces, grid = [], []
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corners = np.tile(far, (4, 1))
            corners[:, u] = self.low[u], self.high[u], self.high[u], self.low[u]
            corners[:, v] = self.low[v], self.low[v], self.high[v], self.high[v]
            faces.append(self._flat(corners))
            for along, across in ((u, v), (v, u)):
                for value in ticks[along]:
                    ends = np.tile(far, (2, 1))
                    ends[:, along] = value
                    ends[:, across] = self.low[across], self.high[across]
                    grid.append(self._flat(ends))
        wall = {"facecolors": "#f4f5f7", "edgecolors": _GRID}
        add_polygons(self.axes, np.array(faces), linewidths=0.7, zorder=0, **wall)
        add_lines(self.axes, grid, colors=_GRID, linewidths=0.5, zorder=0.1)
        for axis in range(3):
            self._label_edge(axis, self._ruler(axis, far, near), ticks[axis], unit)

    def _flat(self, points: ArrayLike) -> Array:
        return self.camera.project(points)[..., :2]

    def _ruler(self, axis: int, far: Array, near: Array) -> Array:
        """End points (2, 3) of the box edge that carries an axis's tick labels."""
        ends = np.empty((2, 3))
        if axis < 2:  # on the floor (or ceiling), at the near side
            ends[:] = near
            ends[:, 2] = far[2]
            across = 1 - axis
            if abs(self.camera.axes[2, across]) < 0.02:  # neither side is nearer: left or bottom
                ends[:, across] = min(
                    (self.low[across], self.high[across]),
                    key=lambda value: float(value * self.camera.axes[:2, across].sum()),
                )
        else:  # the leftmost upright edge
            sides = [np.array([near[0], far[1], 0.0]), np.array([far[0], near[1], 0.0])]
            ends[:] = min(sides, key=lambda side: float(self._flat(side)[0]))
        ends[:, axis] = self.low[axis], self.high[axis]
        return ends

    def _label_edge(self, axis: int, ends: Array, ticks: Array, unit: str) -> None:
        flat = self._flat(ends)
        along = flat[1] - flat[0]
        length = float(np.linalg.norm(along))
        whole = float(np.ptp(self._flat(_corners(self.low, self.high)), axis=0).max())
        if length < 0.02 * whole or abs(self.camera.axes[2, axis]) > 0.98:
            return  # a flat shape, or seen end-on
        outward = np.array([-along[1], along[0]]) / length
        if outward @ (flat.mean(axis=0) - self._flat(0.5 * (self.low + self.high))) < 0:
            outward = -outward
        rotation = float(np.degrees(np.arctan2(along[1], along[0])))
        rotation = (rotation + 70.0) % 180.0 - 70.0  # readable from below or from the right
        name = with_unit("xyz"[axis], unit)
        decimals = _decimals(ticks)
        texts = [f"{value:.{decimals}f}" if value else "0" for value in ticks]
        points = np.tile(ends[0], (len(ticks), 1))
        points[:, axis] = ticks
        at = self._flat(points)
        for position, text in zip(at, texts, strict=True):
            self.axes.plot(
                *np.transpose([position, position + 3.0 * self.point * outward]),
                color=INK, linewidth=0.7, zorder=0.2,
            )  # fmt: skip
            right, up = position + (9.0 + 2.6 * len(text) * abs(outward[0])) * self.point * outward
            self.axes.text(
                right, up, text, fontsize=_SMALL, color=INK, ha="center", va="center", zorder=0.2
            )
        away = 21.0 + 5.0 * max(map(len, texts), default=0) * abs(outward[0])
        right, up = flat.mean(axis=0) + away * self.point * outward
        self.axes.text(
            right, up, name, fontsize=_SMALL + 0.5, color=INK, ha="center", va="center",
            rotation=rotation, rotation_mode="anchor",
        )  # fmt: skip
        self.axes.plot(*flat.T, color=INK, linewidth=0.9, zorder=0.2)

    def _add_legend(self, entries: Sequence[Entry], columns: int) -> None:
        """Add a legend above the box, where it covers nothing."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        def handle(colour: Any, text: str, kind: str) -> Any:
            if kind == "patch":
                return Patch(facecolor=colour, edgecolor=INK, linewidth=0.6, label=text)
            if kind in ("foot", "clamp"):
                marker, size = (foot(), 8.0) if kind == "foot" else ("o", 3.5)
                return Line2D([], [], linestyle="", marker=marker, markersize=size, label=text,
                              markerfacecolor="white", markeredgecolor=colour)  # fmt: skip
            dashes = STRIPES if kind == "stripes" else "solid"
            return Line2D([], [], color=colour, linewidth=2.2, label=text, gapcolor=RIM,
                          linestyle=dashes)  # fmt: skip

        self.axes.legend(
            handles=[handle(*entry) for entry in entries], loc="lower center",
            bbox_to_anchor=(0.5 * (self.frame().x0 + self.frame().x1), self.frame().y1),
            bbox_transform=self.axes.transData, fontsize=_SMALL + 0.5, labelcolor=INK,
            frameon=False, handlelength=1.6, borderaxespad=0.0, borderpad=0.2, labelspacing=0.3,
            ncols=columns, columnspacing=1.2,
        )  # fmt: skip

    def add_bar(self, mappable: ScalarMappable, label: str, place: int) -> None:
        """Draw a colour bar on the right, at position `place`, counted outwards."""
        width, height = self._size
        tall = min(0.62 * height, 3.2)
        left = width - 0.35 - 0.95 * (self._bars - place) + 0.08
        bar = self.figure.add_axes(
            (left / width, 0.5 * (height - tall) / height, 0.15 / width, tall / height)
        )
        colorbar = self.figure.colorbar(mappable, cax=bar)
        lines = fill(label, max(int(1.1 * tall / 0.072), 12))  # the picture is cut off beyond
        colorbar.set_label(lines, fontsize=_SMALL + 0.5, color=INK)
        colorbar.ax.tick_params(labelsize=_SMALL, colors=INK, width=0.7, length=3)
        colorbar.outline.set_linewidth(0.6)  # type: ignore[operator]
        colorbar.outline.set_edgecolor(INK)  # type: ignore[operator]


def _columns(texts: Sequence[str], width: float) -> int:
    """Number of columns in which texts of a legend fit into a width (inches), at least one."""
    widths = [0.42 + 0.066 * len(text) for text in texts]  # of symbol and letters
    if sum(widths) <= width:
        return max(len(texts), 1)
    return max(int(width / max(widths)), 1)


def bounds(shapes: Sequence[Array]) -> tuple[Array, Array]:
    """Bounding box (low, high) of points with margins, except below, and no zero side."""
    points = np.concatenate([np.reshape(shape, (-1, 3)) for shape in shapes])
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max()) or 1.0
    air = 0.035 * size * np.array([1.0, 1.0, 0.5])
    air[high - low < FLAT * size] = 1e-3 * size
    return low - air * [1.0, 1.0, 0.0], high + air


def _corners(low: Array, high: Array) -> Array:
    return np.array(list(product(*zip(low, high, strict=True))))


def _decimals(ticks: Array) -> int:
    """Number of decimals that shows the ticks as they are."""
    least = 1e-6 * float(np.diff(ticks).min(initial=1.0))
    return next((k for k in range(12) if np.all(abs(np.round(ticks, k) - ticks) <= least)), 12)
