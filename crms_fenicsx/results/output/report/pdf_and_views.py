"""Other forms of a report: PDF by a headless browser, interactive 3D pages by pyvista."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.output.figures.draw_scene import QUANTITY_OF
from crms_fenicsx.results.output.report.page import rendered
from crms_fenicsx.results.quantities import QUANTITIES, HasSystem, fields_of
from crms_fenicsx.results.recovered_values import judged_utilisation, patches
from crms_fenicsx.results.view_data import to_pyvista

INSTALL = (
    "report: interactive=True needs pyvista and its trame: pip install "
    '"pyvista[jupyter]", or this package with its extra [interactive].'
)
FABRIC_MAP, LINES_MAP, TICKS = "viridis", "YlOrRd", 5
"""Colour maps of the fabric and of cables and bars, and number of ticks of a scale."""
PLAIN, EDGES, SUPPORT, SHAPE = "#dfe5ec", "#8a94a0", "#1d1f24", (1100, 760)
"""Colours of plain fabric, cell edges and supports; window size (pixels)."""


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
class Scale:
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


def with_scales(page: str, title: str, scales: Sequence[Scale]) -> str:
    """A vtk.js page with its title and colour scales."""
    shown = rendered("scales.html", title=title, scales=scales)
    page = re.sub("<title>.*?</title>", lambda _: f"<title>{escape(title)}</title>", page, count=1)
    return re.sub("<body[^>]*>", lambda found: f"{found[0]}\n{shown}", page, count=1)


def interactive_view(
    solver: HasSystem, title: str, colour: str,
    limits: Mapping[str, tuple[float, float] | None], units: tuple[str, str],
) -> str:  # fmt: skip
    """Interactive page of the scene's current state, on the first rank. Collective.

    `limits`: ranges of "membrane" and "lines"; `units`: units of the colour and of forces.
    """
    results = membrane_results(solver.system)
    fields, scene, page = fields_of(results), solver.system.scene, ""
    if "utilisation" in fields:
        judged = judged_utilisation(results, patches(scene)).shown
        fields["utilisation"] = judged.mean(axis=1)
    blocks = to_pyvista(scene, fields, None)
    with raised_together(solver.comm):
        if blocks is not None:
            view, scales = _view(blocks, colour, limits, units)
            page = with_scales(view, title, scales)
    return page


def _view(
    blocks: Any, colour: str, limits: Mapping[str, tuple[float, float] | None],
    units: tuple[str, str],
) -> tuple[str, list[Scale]]:  # fmt: skip
    import pyvista

    scales: list[Scale] = []

    def scaled(mesh: Any, name: str, scale: Scale, **look: Any) -> None:
        scales.append(scale)
        plotter.add_mesh(mesh, scalars=name, cmap=scale.map, clim=scale.limits,
                         show_scalar_bar=False, **look)  # fmt: skip

    with _plotter(pyvista) as plotter:
        plotter.set_background("white")
        name = QUANTITY_OF.get(colour, "")
        fabric = blocks["membrane"]
        edges = {"show_edges": True, "edge_color": EDGES}
        if name in fabric.cell_data:
            label = f"{QUANTITIES[name].label}{units[0]}"
            own = limits["membrane"] or fabric.get_data_range(name)
            scaled(fabric, name, Scale(label, FABRIC_MAP, own), line_width=0.5, **edges)
        else:
            plotter.add_mesh(fabric, color=PLAIN, **edges)
        present = blocks.keys()
        for kind in (one for one in ("cables", "bars") if one in present):
            own = limits["lines"] or blocks[kind].get_data_range("tension")
            scaled(blocks[kind], "tension", Scale(f"axial force{units[1]}", LINES_MAP, own))
        if "supports" in present:
            plotter.add_mesh(blocks["supports"], color=SUPPORT, point_size=6.0)
        plotter.view_isometric()
        return _export(plotter), list(dict.fromkeys(scales))


BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome",
    "microsoft-edge", "msedge",
)  # fmt: skip
"""Browsers, in the order of search."""


def browser() -> str:
    """Path of the browser: from the variable CRMS_BROWSER, or the first one found."""
    own = os.environ.get("CRMS_BROWSER")
    names = [own] if own else BROWSERS
    found = next((path for name in names if (path := shutil.which(name))), "")
    if not found:
        raise InputError(
            f"report: pdf=True needs a browser that prints, and there is no {own or BROWSERS[0]}; "
            "install one (apt install chromium) or name one in the variable CRMS_BROWSER. Without "
            "pdf=True open the page in any browser, and print it to a file on A4."
        )
    return found


def print_page(html: str, path: Path) -> None:
    """Print an HTML page to PDF on A4."""
    with tempfile.TemporaryDirectory() as folder:
        page, pdf = Path(folder) / "page.html", Path(folder) / "page.pdf"
        page.write_text(html, encoding="utf-8")
        command = [
            browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer",
            f"--user-data-dir={folder}/profile", f"--print-to-pdf={pdf}", page.as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=120)
            trouble = done.stderr.strip().splitlines()[-1:] if done.returncode else []
        except subprocess.TimeoutExpired:
            trouble = ["it took more than 120 s"]
        if not pdf.exists():
            raise InputError(f"report: {command[0]} printed no PDF; {''.join(trouble)}")
        path.write_bytes(pdf.read_bytes())
