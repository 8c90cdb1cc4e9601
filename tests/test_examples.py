"""The examples of the reference run, each after the script with which its page begins."""

from __future__ import annotations

import doctest
import inspect
import pydoc
import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DOCS = Path(__file__).parents[1] / "docs"
API = DOCS / "api"
blocks = runpy.run_path(str(DOCS / "draw_how_to.py"))["blocks"]
DIRECTIVE = re.compile(r"^\.\. auto(?:function|class)\:\: (\S+)", re.MULTILINE)
LEFT_OUT = {
    "exchange.from_compas": "needs compas",
    "exchange.to_vertices_and_faces": "needs compas",
    "meshes.from_step": "needs a STEP file",
    "patterns.report_sections": "makes a report",
    "Solver.report": "makes a report",
    "Solver.to_pyvista": "opens a window",
    "study.combine_in_groups": "makes a report",
}
"""Examples that are not run here, with the reason."""

LOADED = """
codes.combinations output.write_vtkhdf FanControl Scene.seal analysis.scene.loads.Air.seal
Solver.branch Solver.combine Solver.sensitivities Solver.stage
"""
LOADS = """
winds = ("wind", "wind x", "wind y", "wind along x", "summer wind")
for one in ("weight", "snow", *winds):
    scene.put_load((0.0, 0.0, -0.01), name=one)
"""
NET = """
net = nets.sections(scene, angles=(0.0, np.pi / 2), offsets=[0.0])
scene.lay_net(net, Cable(EA=20e3), tension=5.0)
solver.advance(pressure=1.0)
"""
CLAMPED = """
routes = {"A1": [(0.0, 1.0), (4.0, 1.0)], "B2": [(2.5, 0.0), (2.5, 4.0)]}
scene = Scene(meshes.along(mesh, routes), fabric)
scene.fix("boundary")
scene.clamp(*(scene.lay_cable(Cable(EA=1e3), along=name) for name in routes))
solver = Solver(scene)
solver.advance(pressure=1.0)
"""
PARTS = """
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

vertices, cells = mesh.mesh.geometry.x, geometry_dofmap(mesh.mesh)
first, others = np.array_split(np.arange(len(cells)), 2)
parts = {"roof": first, "wall": others, "walls": others}
points = {"mast head": [0], "low point": [1]}
mesh = meshes.from_arrays(MPI.COMM_WORLD, vertices, cells, parts=parts, point_groups=points)
scene = Scene(mesh, {"roof": fabric, "wall": fabric})
scene.fix("boundary")
solver = Solver(scene)
"""
DESIGNED = (
    PARTS
    + """
from crms_fenicsx import codes
scene.lay_cable(Cable(EA=1e3), [(0.0, 0.5), (4.0, 0.5)], name="ridge")
"""
)
BEFORE = {
    **dict.fromkeys(("nets.lengths_to_order", "nets.tune"), NET),
    **dict.fromkeys(("Scene.put_wind", "Scene.set_material"), PARTS),
    **dict.fromkeys(LOADED.split(), LOADS),
    "exchange.read_dxf": """
import ezdxf
drawing, corners = ezdxf.new(), [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
drawing.modelspace().add_lwpolyline(corners, close=True, dxfattribs={"layer": "ROOF"})
drawing.saveas("site.dxf")
""",
    "Scene.put_forces": "fluid_forces = 0.01",
    "Scene.put_joint_load": """
top = scene.add_joint((0.0, 0.0, 6.0))
for foot in ((0.0, 0.0, 0.0), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0)):
    scene.add_bar(Bar(EA=1e5), foot, top)
""",
    "Rotation": 'scene.remove("ridge")',
    **dict.fromkeys(
        ("Scene.set_strengths", "analysis.scene.design.Design.set_strengths"), DESIGNED
    ),
    **dict.fromkeys(("Scene.set_limits", "analysis.scene.design.Design.set_limits"), PARTS),
    "Solver": "import sys",
    "Scene.unclamp": CLAMPED,
    "Solver.clamp_forces": CLAMPED,
    "Solver.load": 'solver.save("results/dome/checkpoint")',
    "Solver.tangent": "from petsc4py import PETSc",
    "study.combine_governing": f"""
from crms_fenicsx import codes
solver = build(cap)
scene = solver.scene{LOADS}""",
    "study.marked_cells": "solver = build(cap)",
    "taylor_test": """
class Springs(EnergyTerm):
    name = "springs"

    def __init__(self, stiffness):
        self.k = stiffness

    def sums(self, x, out):
        out[0] = self.k / 2 * np.vdot(x[: self.unknowns.n_vertices], x[: self.unknowns.n_vertices])

    def add_gradient(self, x, sums, g):
        g[: self.unknowns.n_vertices] += self.k * x[: self.unknowns.n_vertices]
""",
    "UflMembrane": "import ufl\nmu = 100.0",
}
"""What an example takes for granted beyond the script, such as loads and other meshes."""


def documented(page: str) -> Iterator[tuple[str, str]]:
    """Names and docstrings of the objects of a page that have examples."""
    for name in DIRECTIVE.findall((API / f"{page}.md").read_text()):
        own = name.removeprefix("crms_fenicsx.")
        found = pydoc.locate(name)
        members = inspect.getmembers(found) if inspect.isclass(found) else []
        for label, one in [(own, found), *((f"{own}.{k}", x) for k, x in members if k[0] != "_")]:
            docstring = inspect.getdoc(one) or ""
            if ">>> " in docstring:
                yield label, docstring


EXAMPLES = {
    label: (page.stem, text)
    for page in sorted(API.glob("*.md"))
    for label, text in documented(page.stem)
}


def script(page: str) -> str:
    """The script at the beginning of a page, or that of most."""
    return (blocks(f"api/{page}") or blocks("api/index"))[0].code


@pytest.fixture(scope="module")
def scripts() -> dict[str, dict[str, Any]]:
    """Names after the scripts that have run."""
    return {}


def names_after(code: str, known: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The names after a script, which runs once; its scene is as at its end."""
    if code not in known:
        names: dict[str, Any] = {}
        exec(compile(code, "script", "exec"), names)
        names["_end"] = names["solver"].snapshot() if "solver" in names else None
        known[code] = names
    names = dict(known[code])
    if names["_end"] is not None:
        names["solver"].restore(names["_end"])
    return names


class Rounded(doctest.OutputChecker):
    """Numbers that differ by 2 % are equal, as meshes differ between versions of gmsh."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        """Whether an output is the one that is shown, if one is."""
        number = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
        if not want or super().check_output(want, got, doctest.ELLIPSIS):
            return True
        if "".join(number.sub("0", want).split()) != "".join(number.sub("0", got).split()):
            return False
        shown, found = ([float(x) for x in number.findall(text)] for text in (want, got))
        return np.allclose(shown, found, rtol=0.02)


@pytest.mark.parametrize("label", [label for label in EXAMPLES if label not in LEFT_OUT])
def test_example(
    label: str, scripts: dict[str, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It raises nothing, and prints what it shows."""
    monkeypatch.chdir(tmp_path)
    page, text = EXAMPLES[label]
    names = names_after(script(page), scripts)
    exec(BEFORE.get(label, ""), names)
    examples = doctest.DocTestParser().get_examples(text)
    runner = doctest.DocTestRunner(Rounded(), verbose=False)
    said: list[str] = []
    test = doctest.DocTest(examples, names, label, None, None, text)
    found = runner.run(test, out=said.append, clear_globs=False)
    assert found.failed == 0, "".join(said)
