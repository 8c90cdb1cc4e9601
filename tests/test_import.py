"""Importing does nothing but import: checked in processes of their own."""

from __future__ import annotations

import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import crms_fenicsx

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    ["crms_fenicsx"]
    + [m.name for m in pkgutil.walk_packages(crms_fenicsx.__path__, "crms_fenicsx.")]
)
UNUSED = (
    "crms_fenicsx.results.checkpoint",
    "crms_fenicsx.results.output.figures",
    "crms_fenicsx.results.output.report",
)
"""Packages that nothing loads before they are asked for."""
KERNELS = (
    "crms_fenicsx.cabling.cables.numbering",
    "crms_fenicsx.energy.terms.lateral_friction",
    "crms_fenicsx.energy.terms.cable_tension",
    "crms_fenicsx.energy.terms.fold_penalty",
    "crms_fenicsx.energy.terms.folded_membrane",
    "crms_fenicsx.energy.terms.folded_pressure",
    "crms_fenicsx.energy.terms.paper.cable_elements",
    "crms_fenicsx.energy.terms.paper.step_folded_membrane",
    "crms_fenicsx.energy.terms.ponding",
    "crms_fenicsx.energy.terms.segments",
    "crms_fenicsx.energy.terms.shifted_membrane",
    "crms_fenicsx.energy.terms.compiled_laws",
    "crms_fenicsx.energy.terms.compiled_laws",
)
OPTIONAL = ("gmsh", "meshio", "matplotlib", "tqdm", "pyvista", *KERNELS)

WATCH = """
import logging, os, sys
import {packages}  # what the module stands on; its effects are not the module's
root = logging.getLogger()
before = list(root.handlers), root.level, list(logging.Logger.manager.loggerDict)
class Arguments:
    def __get__(self, *_): raise AssertionError("argv was read")
class Watched(type(sys)):
    argv = Arguments()
del sys.argv
sys.__class__ = Watched
streams, environment, folder = (sys.stdout, sys.stderr), dict(os.environ), os.getcwd()
import {module}
assert (list(root.handlers), root.level) == before[:2]
new = set(logging.Logger.manager.loggerDict) - set(before[2])
for name in new:
    logger = logging.getLogger(name)
    assert not logger.handlers and logger.level == logging.NOTSET and logger.propagate, name
assert (sys.stdout, sys.stderr) == streams and os.environ == environment
assert os.getcwd() == folder
gmsh = sys.modules.get("gmsh")
assert gmsh is None or not gmsh.isInitialized()
loaded = [name for name in {optional!r} if name in sys.modules]
print(",".join(loaded))
"""


def in_a_process(code: str, home: Path) -> str:
    """Run code with empty caches in `home`; it must leave no file there, and say nothing else."""
    caches = {
        "HOME": str(home),
        "XDG_CACHE_HOME": str(home / "cache"),
        "NUMBA_CACHE_DIR": str(home / "numba"),
        "MPLCONFIGDIR": str(home / "matplotlib"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True, text=True, env={**os.environ, **caches}, cwd=home, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert [str(p) for p in home.rglob("*") if p.is_file()] == []
    return done.stdout.strip()


def test_importing_the_package_has_no_side_effects(tmp_path: Path) -> None:
    code = WATCH.format(packages="dolfinx, ufl", module="crms_fenicsx", optional=OPTIONAL)
    assert in_a_process(code, tmp_path) == ""


def test_importing_all_modules_has_no_side_effects(tmp_path: Path) -> None:
    """The modules of the kernels load numba's decorators, but compile nothing."""
    code = WATCH.format(
        packages="dolfinx.fem.petsc, ufl, numba, scipy.sparse",
        module=", ".join(MODULES),
        optional=[name for name in OPTIONAL if name not in KERNELS],
    )
    assert in_a_process(code, tmp_path) == ""


def test_a_scene_without_cables_loads_no_kernels(tmp_path: Path) -> None:
    code = """
import sys
from mpi4py import MPI
from crms_fenicsx import IsotropicMembrane, Scene, Solver, meshes
mesh = meshes.rectangle(MPI.COMM_SELF, 2.0, 2.0, 1.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(1.0, 0.25, 1.0))
scene.fix("boundary")
Solver(scene)
print([name for name in OPTIONAL if name in sys.modules])
"""
    optional = OPTIONAL + UNUSED
    assert in_a_process(f"OPTIONAL = {optional!r}\n{code}", tmp_path) == "[]"


def test_names_of_the_output_are_found_when_asked_for() -> None:
    """`output` knows in which of its modules each of them is, and only these names."""
    from crms_fenicsx import output

    lazy = [name for names in output.NAMES.values() for name in names]
    assert sorted(["History", *lazy]) == output.__all__
    assert all(getattr(output, name).__name__ == name for name in output.__all__)
    with pytest.raises(AttributeError, match="nothing"):
        _ = output.nothing
