"""Pictures and interactive views of a report: load cases, model, loads, foundation forces."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import raised_together
from crms_fenicsx.results.design_checks import governing_of
from crms_fenicsx.results.foundations import held_rim
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.output.figures.axes3d import RIM
from crms_fenicsx.results.output.figures.draw_scene import (
    LOAD,
    MOST_STROKES,
    SIGNED,
    draw,
    label_of,
    spread,
)
from crms_fenicsx.results.output.figures.draw_surface import outline_of
from crms_fenicsx.results.output.figures.plans import ForcePlan, ModelPlan, draw_forces, draw_model
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.foundation_tables import FoundationTables
from crms_fenicsx.results.output.report.page import Figure, Units, rendered
from crms_fenicsx.results.output.report.results_tables import families
from crms_fenicsx.results.quantities import (
    QUANTITIES,
    QUANTITY_OF,
    SUMMED_UP,
    Solved,
    fields_of,
    load_label,
)
from crms_fenicsx.results.reactions import gap
from crms_fenicsx.results.recovered_values import judged_utilisation, patches
from crms_fenicsx.results.view_data import Line, to_pyvista, whole_shape

SHARPEST = 190
"""Resolution of pictures (pixels per inch)."""

PICTURED = 12
"""Number of pictures up to which each state has one of each colour; of more, those that govern."""


def with_pictures(
    solver: Solved, case: Case, every: Sequence[Case], colours: Sequence[str], look: Any
) -> Case:
    """The case with pictures of the solver's current state. Collective."""
    common = _common(every)
    options = {"box": common[0], "line_limits": common[1], **look}
    if common[1] is not None and common[1][0] < 0.0:
        options.setdefault("line_colours", SIGNED)
    pictures = []
    for colour in colours:  # one colour bar per picture, to leave room for the shape
        if colour == "utilisation" and not case.summary.design:
            continue  # strengths do not judge it
        fabric = None if colour == TENSION else colour
        forces = label_of(colour)[1] == "stress"
        options |= {
            "colour": fabric, "tensions": fabric is None, "ghost": colour == "displacement",
            "directions": forces, "loose": "lifted" if fabric is None else None,
        }  # fmt: skip
        png = draw_png(solver, dpi=SHARPEST, limits=_limits(every, colour), **options)
        if png:
            label = LINES if fabric is None else label_of(colour)[0]
            label += "; strokes: direction of the major principal section force" if forces else ""
            pictures.append(Figure(png, f"{case.name}: {label}"))
    return replace(case, pictures=tuple(pictures))


def pictured(every: Sequence[Case], colours: Sequence[str]) -> dict[str, list[str]]:
    """Colours of the pictures of each case: all of few cases; of many, of the least deflected one
    and where the colour is largest, in each limit state."""
    if len(every) * len(colours) <= PICTURED:
        return {case.name: list(colours) for case in every}
    found = dict[str, list[str]]()
    base = min(every, key=lambda case: case.deflection.value)
    for colour in colours:
        governs = {one.name: one for one in [base] if _largest(one, colour) != 0.0}
        rest = [case for case in every if case is not base]
        for state in dict.fromkeys(case.state for case in rest):
            own = [case for case in rest if case.state == state]
            sizes = [(case, _largest(case, colour)) for case in own]
            most, _ = governing_of(sizes, lambda one: one[1])
            governs[most.name] = most
        for name in governs:
            found.setdefault(name, []).append(colour)
    return found


def _largest(case: Case, colour: str) -> float:
    """The largest value of a colour in a case; -1 without any."""
    of = case.summary
    if colour == TENSION:
        forces = [one.largest for one in of.cables.values()]
        return max([*forces, *(abs(bar.force) for bar in of.bars.values())], default=-1.0)
    if colour == "displacement":
        return case.deflection.value
    found = of.membrane.largest.get(QUANTITY_OF.get(colour, ""))
    return -1.0 if found is None else found.value


def with_view(
    solver: Solved, case: Case, every: Sequence[Case], colours: Sequence[str], units: Units
) -> Case:
    """The case with an interactive page of the solver's current state. Collective."""
    known = (one for one in colours if QUANTITY_OF.get(one) in SUMMED_UP)
    colour, results = next(known, "stress"), membrane_results(solver.system)
    fields, scene, page = fields_of(results), solver.scene, ""
    if "utilisation" in fields:
        judged = judged_utilisation(results, patches(scene)).shown
        fields["utilisation"] = judged.mean(axis=1)
    blocks = to_pyvista(scene, fields, None)
    with raised_together(solver.comm):
        if blocks is not None:
            limits = {"membrane": _limits(every, colour), "lines": _common(every)[1]}
            view, scales = _view(blocks, colour, limits, units)
            page = _with_scales(view, case.name, scales)
    return replace(case, view=page)


def draw_png(solver: Solved, *, dpi: int, **options: Any) -> bytes:
    """PNG of a scene as bytes, on the first rank; empty if the scene is too large. Collective."""
    figure, buffer = draw(solver, width=4.6, **options), io.BytesIO()
    if figure is not None:
        from PIL import Image

        png: bytes = figure._repr_png_(dpi)  # type: ignore[attr-defined]
        with Image.open(io.BytesIO(png)) as picture:  # 256 colours take a third of the space
            # not the default, "median cut", which replaces the ends of colour bars
            reduced = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
            reduced.save(buffer, "PNG")
    return buffer.getvalue()


def _common(every: Sequence[Case]) -> tuple[tuple[Array, Array], tuple[float, float] | None]:
    """Box and force range common to all cases; no range without forces."""
    low = np.min([case.low for case in every], axis=0)
    high = np.max([case.high for case in every], axis=0)
    air = 0.03 * float((high - low).max())
    box = low - np.array([air, air, 0.0]), high + np.array([air, air, air / 2])
    forces = [0.0]
    for case in every:
        forces += [one.largest for one in case.summary.cables.values()]
        forces += [one.force for one in case.summary.bars.values()]
    low, high = min(forces), max(forces)
    if low < 0.0:  # symmetric, as the colours of compression and tension
        low, high = min(low, -high), max(-low, high)
    return box, (low, high) if any(forces) else None


TENSION, LINES = "tension", "axial forces of cables and bars"
"""Name and caption of the picture of axial forces on plain fabric."""


def _limits(every: Sequence[Case], colour: str) -> tuple[float, float] | None:
    """Range of a colour over all cases; None if unknown."""
    if colour == "displacement":
        return 0.0, max(case.summary.displacement.value for case in every) or 1.0
    name, parts = QUANTITY_OF.get(colour), [case.summary.membrane for case in every]
    if name not in SUMMED_UP:
        return None
    known = [part for part in parts if name in part.least]
    if not known:
        return None
    low = min(part.least[name].value for part in known)
    high = max(part.largest[name].value for part in known)
    low = 0.0 if low > -1e-9 * high else low
    return (low, max(high, 0.0)) if low < high else None


def model_figures(solver: Solved, caption: str, unit: str, look: Any) -> list[Figure]:
    """The model in space and in plan, on the first rank. Collective."""
    scene, found = solver.system.scene, list[Figure]()
    png = draw_png(solver, dpi=SHARPEST, ghost=True, tensions=False, loose=None, **look)
    if png:
        found.append(Figure(png, f"{caption}; the stress-free shape is faint", "model"))
    # more would print black
    if scene.mesh.mesh.topology.index_map(2).size_global <= 40_000:
        plan = _model_plan(solver)
        if scene.comm.rank == 0:
            warp = "warp, " if len(plan.warp[0]) else ""
            kinds = [kind for kind in ("cables", "bars") if getattr(scene, kind)]
            names = f"and the names of {' and '.join(kinds)}" if kinds else "and parts"
            text = f"Plan of the model with supports, {warp}{names}"
            found.append(Figure(draw_model(plan, unit, 150), text, "model"))
    return found


def _model_plan(solver: Solved) -> ModelPlan:
    """Contents of the model's plan, on all ranks. Collective."""
    scene, comm = solver.system.scene, solver.comm
    own = scene.mesh.mesh.topology.index_map(2).size_local
    corners = scene.positions()[scene.V.dofmap.list[:own]]
    pieces = comm.allgather((corners, membrane_results(solver.system).warp))
    corners, warp = (np.concatenate([one[k] for one in pieces]) for k in (0, 1))
    woven = np.isfinite(warp[:, 0])
    shared = {
        own[len(own) // 2]: label
        for label, own in families([bar.name for bar in scene.bars]).items()
    }
    bars = [Line(bar.points, name=shared.get(bar.name, "")) for bar in scene.bars]
    cables = [Line(cable.line, name=cable.name) for cable in scene.cables]
    joints = [
        ("" if re.match("(start|end) of ", joint.name) else joint.name, joint.position)
        for joint in scene.joints if joint.held.any()
    ]  # fmt: skip
    held = [*_held_points(scene).items(), *joints]
    centres = corners.mean(axis=1) * (1.0, 1.0, 0.0)
    step = float(np.ptp(centres, axis=0).max()) / MOST_STROKES
    chosen = spread(centres[woven], step)
    strokes = centres[woven][chosen], warp[woven][chosen]
    return ModelPlan(corners, held_rim(scene), held, cables, bars, strokes)


def _held_points(scene: Scene) -> dict[str, Array]:
    """Positions of named held mesh points off the held edges. Collective."""
    found, n = dict[str, Array](), scene.V.dofmap.index_map.size_local
    rim = held_rim(scene)
    for name in scene.mesh.points:
        dofs = scene.vertices(name)
        own = dofs[dofs < n]
        places = scene.positions()[own[scene.held[own].any(axis=1)]]
        every = np.concatenate(scene.comm.allgather(places))
        if len(every) and gap(every[0], rim) > 1e-9 * scene.membrane.size:
            found[name] = every[0]
    return found


def load_figures(solver: Solved, units: Units, look: Any) -> list[Figure]:
    """A picture of each load at factor 1, on the first rank. Collective."""
    scene, found = solver.system.scene, list[Figure]()
    sizes = {x.name: scene.comm.allreduce(float(np.abs(x.forces).sum())) for x in scene.loads}
    peaks = {load.name: load.peak for load in scene.loads if load.suction is not None}
    for name in scene.loads.factors:
        if sizes.get(name) != 0.0:  # not on joints alone, nor a temperature
            colour = f"{LOAD}{name}"
            png = draw_png(solver, dpi=SHARPEST, colour=colour, tensions=False, loose=None, **look)
            if png:
                label = load_label(scene, name)[0]
                text = f"q_p = {peaks[name]:.4g}{units.plain('pressure')}" if name in peaks else ""
                found.append(Figure(png, f"{label}{text and ', '}{text}, at the factor 1"))
    return found


def outline_in_plan(scene: Scene) -> Array:
    """Current edges of membrane and bars, (k, 2, 3), on all ranks. Collective."""
    surface = whole_shape(scene)
    edges = np.zeros((0, 2, 3)) if surface is None else outline_of(surface)
    bars = [bar.points for bar in scene.bars]
    return np.concatenate([scene.comm.bcast(edges), np.reshape(bars, (-1, 2, 3))])


def force_figures(held: FoundationTables, outline: Array) -> list[Figure]:
    """Plans of the foundation forces in the cases in which they are largest, at one scale."""
    points, figures = held.points, list[Figure]()
    flat = [np.hypot(*x.force[:2]) for one in points.values() for x in one.values()]
    sizes = [np.linalg.norm(case.foundations.per_length, axis=2) for case in held.cases]
    greatest = max((float(x.max(initial=0.0)) for x in sizes), default=0.0)
    largest = max(map(float, flat), default=0.0)
    wanted = {case for *_, case in held.largest()}
    if greatest > 0.0:
        rims = zip(sizes, held.cases, strict=True)
        wanted.add(governing_of(rims, lambda one: float(one[0].max(initial=0.0)))[1].name)
    wanted.add(held.cases[0].name)
    for case in (case for case in held.cases if case.name in wanted):
        of = case.foundations
        own = {
            label: (np.array(one[case.name].at), np.array(one[case.name].force))
            for label, one in points.items() if case.name in one
        }  # fmt: skip
        if own or len(of.rim):
            plan = ForcePlan(of.rim, of.per_length, own, outline, largest, greatest)
            png = draw_forces(plan, held.units.length, held.units.force, 165, 4.0)
            figures.append(Figure(png, f"{case.name}: forces on the foundations"))
    return figures


INSTALL = (
    "report: interactive=True needs pyvista and its trame: pip install "
    '"pyvista[jupyter]", or this package with its extra [interactive].'
)
FABRIC_MAP, LINES_MAP, TICKS = "viridis", "YlOrRd", 5
"""Colour maps of the fabric and of cables and bars, and number of ticks of a scale."""
PLAIN, EDGES, SHAPE = "#dfe5ec", "#8a94a0", (1100, 760)
"""Colours of plain fabric and cell edges; window size (pixels)."""


def check_interactive() -> None:
    """Raise `ImportError` if interactive pages cannot be made, by making a small one."""
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(f"{INSTALL} ({error})") from None
    with _plotter(pyvista) as plotter:
        plotter.add_mesh(pyvista.PolyData(np.zeros((1, 3))))
        _export(plotter)


@contextmanager
def _plotter(pyvista: Any) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyvista's deprecations and missing displays
        plotter = pyvista.Plotter(off_screen=True, window_size=list(SHAPE))
        try:
            yield plotter
        finally:
            plotter.close()


def _export(plotter: Any) -> str:
    # pyvista 0.49 has moved it to the package trame-pyvista
    exporter = plotter.trame if hasattr(plotter, "trame") else plotter
    try:
        return str(exporter.export_html(None).getvalue())
    except ImportError as error:
        raise ImportError(f"{INSTALL} ({error})") from None


@dataclass(frozen=True)
class _Scale:
    """A colour scale, shown beside the view, as vtk.js would put all scales in one place."""

    label: str  # with unit
    map: str  # of matplotlib
    limits: tuple[float, float]

    @property
    def colours(self) -> list[str]:
        """Evenly spaced colours, #rrggbb."""
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        return [to_hex(colormaps[self.map](x)) for x in np.linspace(0.0, 1.0, 17)]

    @property
    def ticks(self) -> list[float]:
        """Values of the ticks."""
        return [float(x) for x in np.linspace(*self.limits, TICKS)]


def _with_scales(page: str, title: str, scales: Sequence[_Scale]) -> str:
    """A vtk.js page with its title and colour scales."""
    shown = rendered("scales.html", title=title, scales=scales)
    page = re.sub("<title>.*?</title>", lambda _: f"<title>{escape(title)}</title>", page, count=1)
    return re.sub("<body[^>]*>", lambda found: f"{found[0]}\n{shown}", page, count=1)


def _view(
    blocks: Any, colour: str, limits: Mapping[str, tuple[float, float] | None], units: Units
) -> tuple[str, list[_Scale]]:
    """Interactive page, with the ranges of "membrane" and "lines", and its colour scales."""
    import pyvista

    scales: list[_Scale] = []

    def scaled(mesh: Any, name: str, scale: _Scale, **look: Any) -> None:
        scales.append(scale)
        plotter.add_mesh(mesh, scalars=name, cmap=scale.map, clim=scale.limits,
                         show_scalar_bar=False, **look)  # fmt: skip

    with _plotter(pyvista) as plotter:
        plotter.set_background("white")
        name = QUANTITY_OF.get(colour, "")
        fabric = blocks["membrane"]
        edges = {"show_edges": True, "edge_color": EDGES}
        if name in fabric.cell_data:
            label = f"{QUANTITIES[name].label}{units[QUANTITIES[name].unit]}"
            own = limits["membrane"] or fabric.get_data_range(name)
            scaled(fabric, name, _Scale(label, FABRIC_MAP, own), line_width=0.5, **edges)
        else:
            plotter.add_mesh(fabric, color=PLAIN, **edges)
        present = blocks.keys()
        for kind in (one for one in ("cables", "bars") if one in present):
            own = limits["lines"] or blocks[kind].get_data_range("tension")
            scaled(blocks[kind], "tension", _Scale(f"axial force{units['force']}", LINES_MAP, own))
        if "supports" in present:
            plotter.add_mesh(blocks["supports"], color=RIM, point_size=6.0)
        plotter.view_isometric()
        return _export(plotter), list(dict.fromkeys(scales))
