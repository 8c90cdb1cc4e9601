"""Pages with a structure that can be turned in a browser, made by pyvista."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from crms_fenicsx.output.figures.draw_scene import QUANTITY_OF, HasSystem
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.quantities import QUANTITIES, fields_of
from crms_fenicsx.runtime.errors import raised_together
from crms_fenicsx.views.view_data import to_pyvista

INSTALL = (
    "report: interactive=True needs pyvista and its trame: pip install "
    '"pyvista[jupyter]", or this package with its extra [interactive].'
)
PLAIN, EDGES, SUPPORT, SHAPE = "#dfe5ec", "#8a94a0", "#1d1f24", (1100, 760)
"""Colours of fabric without values, of edges of cells and of supports; size of the window (pixels).
"""


def check_interactive() -> None:
    """Raise `ImportError` where such pages cannot be made: it makes a small one."""
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
        warnings.simplefilter("ignore")  # of what pyvista will be called next, and of screens
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


def interactive_view(
    solver: HasSystem, colour: str, limits: Mapping[str, tuple[float, float] | None],
    units: tuple[str, str],
) -> str:  # fmt: skip
    """The scene's current state as a page, on the first rank. Collective.

    `limits`: of the "membrane" and of the "lines"; `units`: names of those of the colour and of
    forces."""
    results = membrane_results(solver.system)
    blocks, page = to_pyvista(solver.system.scene, fields_of(results), None), ""
    with raised_together(solver.comm):
        if blocks is not None:
            page = _page(blocks, colour, limits, units)
    return page


def _page(
    blocks: Any, colour: str, limits: Mapping[str, tuple[float, float] | None],
    units: tuple[str, str],
) -> str:  # fmt: skip
    import pyvista

    with _plotter(pyvista) as plotter:
        plotter.set_background("white")
        name = QUANTITY_OF.get(colour, "")
        fabric, bar = blocks["membrane"], {"color": "black", "n_labels": 5}
        if name in fabric.cell_data:
            plotter.add_mesh(
                fabric, scalars=name, cmap="viridis", clim=limits["membrane"], show_edges=True,
                edge_color=EDGES, line_width=0.5,
                scalar_bar_args={"title": f"{QUANTITIES[name].label}{units[0]}", **bar},
            )  # fmt: skip
        else:
            plotter.add_mesh(fabric, color=PLAIN, show_edges=True, edge_color=EDGES)
        present = blocks.keys()
        for kind in (one for one in ("cables", "bars") if one in present):
            plotter.add_mesh(
                blocks[kind], scalars="tension", cmap="YlOrRd", clim=limits["lines"],
                scalar_bar_args={"title": f"axial force{units[1]}", "vertical": True, **bar},
            )  # fmt: skip
        if "supports" in present:
            plotter.add_mesh(blocks["supports"], color=SUPPORT, point_size=6.0)
        plotter.view_isometric()
        return _export(plotter)
