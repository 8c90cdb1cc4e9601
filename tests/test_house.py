"""The structure of the package: imports go down, no circle, small files, few doors."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import crms_fenicsx

PACKAGE = Path(crms_fenicsx.__file__).parent
FLOORS = (
    "runtime dofs meshes surface geodesics model energies energies.paper minimization cables "
    "contact friction paths scene contributions equilibrium results verification steps output "
    "output.figures checkpoint solver crms_fenicsx"
).split()
"""Ground first: a module imports from its own package and from those before it."""


def modules() -> dict[str, ast.Module]:
    """The syntax trees of all modules, by their names without the package's."""
    trees = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        trees[".".join(parts)] = ast.parse(path.read_text())
    return trees


MODULES = modules()


def floor(module: str) -> int:
    """The number of the floor on which a module lies."""
    package, _, last = module.rpartition(".")
    if last == "__init__":  # it hands on names of what lies below it, in it
        within = [name for name in FLOORS if f"{name}.".startswith(f"{package}.".lstrip("."))]
        return FLOORS.index(within[-1])
    package = module
    while package not in FLOORS:
        package = package.rpartition(".")[0]
    return FLOORS.index(package)


def imports(module: str) -> Iterator[str]:
    """The package's modules that a module imports, wherever it does."""
    for node in ast.walk(MODULES[module]):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("crms_fenicsx"):
            base = (node.module or "").removeprefix("crms_fenicsx").lstrip(".")
            for alias in node.names:
                whole = f"{base}.{alias.name}".lstrip(".")
                for name in (whole, base, f"{whole}.__init__", f"{base}.__init__"):
                    if name in MODULES:
                        yield name
                        break


def test_imports_go_down() -> None:
    wrong = [
        f"{module} imports {other}"
        for module in MODULES
        for other in imports(module)
        if floor(other) > floor(module)
    ]
    assert not wrong, "\n".join(wrong)


def test_tests_lie_where_what_they_test_does() -> None:
    """In the folder of its package; only what belongs to none lies beside these."""
    tests = Path(__file__).parent
    folders = {path.parent.relative_to(tests).as_posix() for path in tests.rglob("test_*.py")}
    packages = {path.parent.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py")}
    assert folders - {"runs"} <= packages
