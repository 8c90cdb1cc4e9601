"""Run the code of `docs/how_to`, draw its pictures and write what it prints below it.

./run python docs/draw_how_to.py [PAGE...]

A block ```text that follows a block of Python is what that prints. Pictures are of the scenes of
the pages at the end of a block.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from PIL import Image

from crms_fenicsx.results.output import draw_history, join_pictures

DOCS = Path(__file__).parent
PICTURES = DOCS / "how_to" / "pictures"
LARGEST = 80_000  # bytes
CODE = re.compile(
    r"^```python\n(?P<code>.*?)^```\n(?:\n```text\n(?P<shown>.*?)^```\n)?",
    re.DOTALL | re.MULTILINE,
)
SAVED = re.compile(r"`([\w.]+)`:\n\n```\n(.*?)^```", re.DOTALL | re.MULTILINE)
NEEDED = ("precice", "dolfinx.io.gmsh")
"""Modules without which a block of code is left out."""

Names = dict[str, Any]
Draw = Callable[[Names, str], object]


class Block(NamedTuple):
    """A block of Python on a page, and what the page shows of its output."""

    code: str
    shown: str | None


def blocks(page: str) -> list[Block]:
    """The Python code of a page such as "how_to/bars"."""
    text = (DOCS / f"{page}.md").read_text()
    return [Block(found["code"], found["shown"]) for found in CODE.finditer(text)]


def missing(code: str) -> bool:
    """Whether code needs what is not installed, or somebody who closes pyvista's window."""
    if "pyvista" in code:
        return True
    for module in NEEDED:
        try:
            found = importlib.util.find_spec(module) is not None
        except ModuleNotFoundError:
            found = False
        if not found and (f"import {module}" in code or f"{module}." in code):
            return True
    return False


def run(code: str, names: Names, page: str) -> str:
    """Execute code of a page; returns what it prints."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(code, f"{page}.md", "exec"), names)
    return said.getvalue()


def save_files(page: str) -> None:
    """The files that a page tells its reader to save, into the current folder."""
    for name, content in SAVED.findall((DOCS / f"{page}.md").read_text()):
        Path(name).write_text(content)


def play(page: str, names: Names) -> Iterator[tuple[int, Block, str]]:
    """Run a page's blocks from top to bottom; yields each with what it has printed."""
    save_files(page)
    for k, block in enumerate(blocks(page)):
        if not missing(block.code):
            yield k, block, run(block.code, names, page)


def wrapped(line: str) -> str:
    """A line of a page's output; prose goes on in a next one, rows of tables do not."""
    return line if len(line) < 130 else fill(line, 86, subsequent_indent="    ")


def write_output(page: str, said: dict[int, str]) -> None:
    """Write below each block of a page what it prints, by the blocks' numbers."""
    path, k = DOCS / f"{page}.md", -1

    def with_output(found: re.Match[str]) -> str:
        nonlocal k
        k += 1
        if k not in said:  # the block has not run
            return found[0]
        lines = [wrapped(line) for line in said[k].rstrip().splitlines()]
        shown = "\n".join(["", "```text", *lines, "```", ""]) if lines else ""
        return f"```python\n{found['code']}```\n{shown}"

    path.write_text(CODE.sub(with_output, path.read_text()))


# ---------------------------------------------------------------------------------------------
# Pictures

FAMILIES = {"A": "#0072b2", "B": "#d55e00"}
KN: dict[str, Any] = {"unit": "m", "force": "kN", "dpi": 110, "width": 6.0}
HALF = KN | {"width": 4.4}  # two of them side by side
LOAD = HALF | {"tensions": False}


def scene_of(name: str, **look: Any) -> Draw:
    """Draw a scene of the page by its name."""
    return lambda names, file: names["Solver"](names[name]).draw(file, **(KN | look))


def state(**look: Any) -> Draw:
    """Draw the solver's state."""
    return lambda names, file: names["solver"].draw(file, **(KN | look))


def closeup(box: tuple[float, float, float, float], **titles: str) -> Draw:
    """Draw meshes of scenes in plan, side by side, with their cables as they are; in a box (least
    and largest x, least and largest y)."""

    def draw(names: Names, file: str) -> None:
        width, height = box[1] - box[0], box[3] - box[2]
        size = 4.1 * len(titles), 4.1 * height / width + 0.9
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(1, len(titles), squeeze=False, sharey=True)[0]
        for ax, (name, title) in zip(axes, titles.items(), strict=True):
            mesh = names[name].mesh.mesh
            ax.triplot(*mesh.geometry.x[:, :2].T, mesh.geometry.dofmap, color="0.6", lw=0.6)
            for cable in names[name].cables:
                ax.plot(*cable.line[:, :2].T, color=FAMILIES[cable.name[0]], lw=1.8)
            ax.set(aspect="equal", xlim=box[:2], ylim=box[2:], xlabel="x [m]")
            ax.set_title(title, fontsize=11)
        axes[0].set_ylabel("y [m]")
        figure.savefig(file, dpi=92)

    return draw


def beside(*pictures: Draw) -> Draw:
    """Draw several pictures side by side."""

    def draw(names: Names, file: str) -> None:
        parts = [f"{file[:-4]}_{k}.png" for k in range(len(pictures))]
        for picture, part in zip(pictures, parts, strict=True):
            picture(names, part)
        join_pictures(file, parts)
        for part in parts:
            Path(part).unlink()

    return draw


def with_water(names: Names, file: str) -> None:
    """The state with the water of a check."""
    solver, before = names["solver"], names["solver"].snapshot()
    solver.restore(names["check"].snapshot)
    solver.draw(file, colour="height", title="with the water", view=(-60.0, 12.0), **HALF)
    solver.restore(before)


def at_stage(stage: str) -> Draw:
    """The forces of cables and bars at a stage of erection."""

    def draw(names: Names, file: str) -> None:
        solver, before = names["solver"], names["solver"].snapshot()
        solver.restore(solver.stages[stage].snapshot)
        look = HALF | {"line_limits": (-80.0, 80.0), "view": (-65.0, 25.0)}
        solver.draw(file, title=stage, **look)
        solver.restore(before)

    return draw


def roll(names: Names, file: str) -> None:
    """The pieces on the roll, which is long."""
    names["patterns"].draw_sheets(names["pattern"], file, names["sheet"], unit="m")
    with Image.open(file) as image:
        image.thumbnail((700, 760))
        image.save(file)


def levels(names: Names, file: str) -> None:
    """The error over the size of cells."""
    names["study"].draw(file, ["energy", "tension ridge"], width=7.0)
    with Image.open(file) as image:
        image.thumbnail((760, 600))
        image.save(file)


def history(names: Names, file: str) -> None:
    """The history of all load steps."""
    draw_history(names["solver"].history, file, unit="m", force="kN", width=7.0, dpi=100)


def view(names: Names, file: str) -> None:
    """The scene as pyvista shows it, on a screen in memory: `./run plot`."""
    import pyvista

    blocks = names["solver"].to_pyvista()
    plotter = pyvista.Plotter(off_screen=True, window_size=(800, 460))
    bar = {"vertical": True, "position_x": 0.88, "position_y": 0.2, "height": 0.6, "color": "black"}
    plotter.add_mesh(
        blocks["membrane"], scalars="true force 1", show_edges=True, scalar_bar_args=bar
    )
    left = bar | {"position_x": 0.03}
    plotter.add_mesh(blocks["cables"], scalars="tension", cmap="YlOrRd", scalar_bar_args=left)
    plotter.background_color = "white"
    plotter.camera.zoom(1.7)
    plotter.screenshot(file)
    plotter.close()


DRAWN: dict[str, dict[str, tuple[int, Draw]]] = {
    "mesh": {"cushion": (0, state(colour="stress", view=(-60.0, 40.0)))},
    "supports": {},
    "not_converged": {},
    "form_finding": {
        "sail": (0, state(colour="height", view=(-65.0, 25.0), width=5.5)),
        "sail_on_bars": (1, state(view=(-65.0, 25.0), width=5.5)),
    },
    "tents": {
        "cone": (2, state(colour="stress", view=(-60.0, 40.0))),
        "bays": (3, state(colour="height", view=(-55.0, 28.0))),
    },
    "fabric": {"warp": (2, state(colour="warp", directions=True))},
    "edges": {
        "belt_and_pocket": (0, scene_of("scene", colour="stress", view=(-70.0, 52.0))),
        "hole": (1, scene_of("sheet", view=(-60.0, 52.0), width=5.0)),
        "sail_under_snow": (3, state(colour="stress", view=(-30.0, 38.0), width=6.0)),
    },
    "loads": {
        "loads": (
            4,
            beside(
                state(**LOAD | {"colour": "load snow by slope", "title": "snow by slope"}),
                state(**LOAD | {"colour": "load wind", "title": "wind: c_p"}),
            ),
        )
    },
    "codes": {
        "zones": (
            2,
            beside(
                state(**LOAD | {"colour": "load snow drifted", "title": "snow, drifted"}),
                state(**LOAD | {"colour": "load wind x", "title": "wind along x: c_p"}),
            ),
        )
    },
    "limit_states": {},
    "erection": {"stages": (1, beside(at_stage("raised on a prop"), at_stage("guy 2 tightened")))},
    "rain": {
        "hollow": (
            1,
            beside(
                state(
                    **HALF | {"colour": "height", "title": "under the heap", "view": (-60.0, 12.0)},
                    tensions=False,  # slack but for the tolerance
                ),
                with_water,
            ),
        )
    },
    "bars": {"mast": (0, state(view=(-70.0, 22.0), width=7.0))},
    "nets": {
        "nets": (
            2,
            beside(
                scene_of("scene", **HALF | {"title": "between the edges", "view": (-60.0, 35.0)}),
                scene_of(
                    "other", **HALF | {"title": "equidistant, clamped", "view": (-60.0, 45.0)}
                ),
            ),
        )
    },
    "lines": {
        "lines": (
            0,
            closeup(
                (0.0, 12.3, -8.3, 0.0), folded="across the cells", scene="along lines of the mesh"
            ),
        ),
        "lines_slide": (
            2,
            closeup((0.0, 12.0, 0.0, 8.0), laid="as laid", slid="after the load step"),
        ),
        "lines_dome": (4, closeup((0.0, 12.4, -12.4, 0.0), roof="lines of the mesh")),
    },
    "patterns": {
        "roll": (3, roll),
        "sewn": (4, state(colour="warp", view=(-65.0, 28.0), width=5.5)),
    },
    "results": {"utilisation": (4, state(colour="utilisation"))},
    "files": {"from_dxf": (2, state(colour="height", view=(-60.0, 28.0)))},
    "error": {
        "levels": (0, levels),
    },
    "pictures": {
        "storm": (0, state(colour="stress")),
        "history": (0, history),
        "view": (0, view),
    },
    "own_term": {
        "springs": (0, state(colour="stress")),
        "rubber": (1, state(colour="stress", view=(-60.0, 28.0))),
    },
    "coupling": {"fluid": (1, state(colour="stress"))},
}
"""By page its pictures, the block of code after which each is drawn, and how."""


def fewer_colours(file: Path) -> None:
    """Store a picture with a palette, of a third of the bytes."""
    with Image.open(file) as image:
        # not the default, "median cut", which replaces the ends of colour bars
        few = image.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few.save(file, optimize=True)


def main(pages: list[str]) -> None:
    """Run the pages' code, each in an empty folder; write their output and pictures."""
    PICTURES.mkdir(exist_ok=True)
    for page in pages:
        names: Names = {}
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            if "continues `roof.py`" in (DOCS / f"how_to/{page}.md").read_text():
                run(blocks("start")[0].code, names, "start")
            run_page(page, names)


def run_page(page: str, names: Names) -> None:
    """Run a page's code in the current folder; write its output and pictures."""
    said = {}
    for k, _, printed in play(f"how_to/{page}", names):
        said[k] = printed
        for name, (at, draw) in DRAWN[page].items():
            if at == k and (draw is not view or "DISPLAY" in os.environ):
                draw(names, f"{PICTURES}/{name}.png")
                fewer_colours(PICTURES / f"{name}.png")
    write_output(f"how_to/{page}", said)


if __name__ == "__main__":
    main(sys.argv[1:] or list(DRAWN))
