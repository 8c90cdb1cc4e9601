"""The structure of the package: imports go down, no circle, small files, few doors."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from mpi4py import MPI

import crms_fenicsx
from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

PACKAGE = Path(crms_fenicsx.__file__).parent
WINGS = {
    "foundation": "runtime dofs meshes surface meshes.cutting",
    "model": "",
    "energy": "terms terms.paper minimization",
    "cabling": "cables contact friction paths",
    "analysis": "scene equilibrium verification steps",
    "results": "results output output.figures output.report checkpoint",
    "solver": "",
    "design": "codes exchange form_finding nets patterns study",
}
"""Packages of the package, ground first, and theirs: a module imports from its own package and from
those before it. Those of design do not import each other."""

FLOORS = [
    wing if room in ("", wing) else f"{wing}.{room}"
    for wing, rooms in WINGS.items()
    for room in rooms.split() or [""]
] + ["crms_fenicsx"]

DOORS = (
    "energy.terms.membrane_energy cabling.cables.deformed_surface cabling.paths.held_vertices "
    "cabling.paths.placing cabling.paths.vertex_trials analysis.scene analysis.equilibrium "
    "energy.minimization.minimizer analysis.verification.cable_checks "
    "analysis.verification.cable_forces analysis.verification.verifier "
    "analysis.steps.increment_solver solver results.output.recorder design.study.groups"
).split()
"""Where functions may import modules of the package: kernels, friction, and what most runs do not
need."""

MOST_LINES, MOST_CODE, MOST_ARGUMENTS = 400, 60, 8
"""Lines of a file without docstrings, lines of code of a function, and its arguments."""

OPTIONS = set(
    "Solver.__init__ Scene.lay_cable laying.lay find_form.find_form plane.rectangle "
    "domes.air_hall".split()
)
"""Functions with more arguments: options of public calls, by name. The list may only shrink."""


BUDGETS = {
    "foundation": 10943,
    "model": 3897,
    "energy": 7589,
    "cabling": 8512,
    "analysis": 8266,
    "results": 12264,
    "solver": 1063,
    "design": 9732,
}
"""Lines of each wing. They may only fall, or rise with a line in docs/features.md."""

RATCHETS = {
    "isinstance of own types": 155,
    "attributes that are born late": 100,
    "files of less than 100 lines": 29,
    "public functions and classes": 1145,
    "classes": 454,
    "module constants": 273,
    "numbers in values": 72,
    "numbers that decide the answer": 29,
}
"""What may only fall."""

MOST_CHANGES = 1156
"""Calls from one package into another in a load step of a membrane of 72 cells with a cable."""

REGISTER = Path(__file__).parents[1] / "docs" / "theory" / "constants.md"
CLASSES = set("answer accuracy cost limit rounding code norm look".split())

VALUES = {"Discretisation", "Budget", "Strategy"}
"""Classes whose fields are such numbers too."""

SCOPES = (ast.Module, ast.ClassDef)

ERRORS = set("InputError MeshError PathError ConvergenceError".split())
STILTED = (
    r"[:;] give |\bis none\b|\b(is|are) due\b|\bcomes twice\b|(?<!there) (is|are) no (?!longer)"
)
"""What no message says: "pass", "is not a", "expected", "is listed twice" are plain."""


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
        assert package, f"{module} lies on no floor"
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


def circles() -> set[frozenset[str]]:
    """Sets of modules each of which imports the others, by way of others or not."""
    below = {module: {other for other in imports(module) if other != module} for module in MODULES}
    for module in MODULES:  # what is imported by way of it
        for others in below.values():
            if module in others:
                others |= below[module]
    return {
        frozenset(other for other in below[module] if module in below[other])
        for module in MODULES
        if module in below[module]
    }


def test_no_imports_go_in_circles() -> None:
    found = circles()
    assert not found, "\n".join(" and ".join(sorted(circle)) for circle in found)


def test_functions_import_at_the_doors_only() -> None:
    wrong = [
        f"{module}, line {node.lineno}, imports {node.module}"
        for module, tree in MODULES.items()
        for function in functions(tree)
        for node in ast.walk(function)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("crms_fenicsx")
        if not any(f"{module}.".startswith(f"{door}.") for door in DOORS)
    ]
    assert not wrong, "\n".join(wrong)


def test_files_are_short() -> None:
    lengths = {module: plain_lines(module) for module in MODULES}
    long = [module for module, n in lengths.items() if n > MOST_LINES]
    assert not long, long


def test_functions_are_short() -> None:
    long = [
        f"{module}.{function.name} has {n} lines of code"
        for module, tree in MODULES.items()
        for function in functions(tree)
        if not any("jit" in ast.unparse(decorator) for decorator in function.decorator_list)
        if (n := lines_of_code(function, text(module))) > MOST_CODE
    ]
    assert not long, "\n".join(long)


def test_functions_have_few_arguments() -> None:
    """Compiled kernels and their callers, `energy.terms`, aside, which take an element's arrays."""
    long = set()
    for module, tree in MODULES.items():
        if floor(module) in (FLOORS.index("energy.terms"), FLOORS.index("energy.terms.paper")):
            continue
        for node in ast.walk(tree):
            within = node.name if isinstance(node, ast.ClassDef) else module.rpartition(".")[2]
            for function in getattr(node, "body", ()) if isinstance(node, SCOPES) else ():
                if isinstance(function, ast.FunctionDef):
                    given = function.args.posonlyargs + function.args.args
                    own = sum(a.arg not in ("self", "cls") for a in given)
                    if own + len(function.args.kwonlyargs) > MOST_ARGUMENTS:
                        long.add(f"{within}.{function.name}")
    assert long <= OPTIONS, sorted(long - OPTIONS)


def test_no_two_modules_or_classes_have_one_name() -> None:
    modules = Counter(module.rpartition(".")[2] for module in MODULES)
    modules = Counter({stem: n for stem, n in modules.items() if stem != "__init__"})
    classes = Counter(
        node.name
        for tree in MODULES.values()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    )
    twice = [name for names in (modules, classes) for name, n in names.items() if n > 1]
    assert not twice, twice


def test_docstrings_name_the_parameters_that_there_are() -> None:
    """And no others, nor texts below them, which belong into notes."""
    wrong = []
    for module, tree in MODULES.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            made = [f for f in node.body if isinstance(f, ast.FunctionDef) and f.name == "__init__"]
            function = node if isinstance(node, ast.FunctionDef) else next(iter(made), None)
            fields = [f.target for f in node.body if isinstance(f, ast.AnnAssign)]
            known = {ast.unparse(field) for field in fields} if function is None else {
                argument.arg for argument in ast.walk(function) if isinstance(argument, ast.arg)
            }  # fmt: skip
            unknown = documented_parameters(ast.get_docstring(node) or "") - known
            wrong += [f"{module}.{node.name}: {name}" for name in sorted(unknown)]
    assert not wrong, "\n".join(wrong)


def test_messages_are_plain_sentences() -> None:
    """Those of the package's errors, whose last words may be those of another error."""
    wrong = []
    for module, tree in MODULES.items():
        for node in ast.walk(tree):
            made = node.exc if isinstance(node, ast.Raise) else None
            if isinstance(made, ast.Call) and ast.unparse(made.func) in ERRORS and made.args:
                parts = getattr(made.args[0], "values", [made.args[0]])
                texts = (str(x.value) if isinstance(x, ast.Constant) else "…" for x in parts)
                words = "".join(texts)
                if not words.endswith((".", "?", "…")) or re.search(STILTED, words):
                    wrong.append(f"{module}, line {made.lineno}: {words}")
    assert not wrong, "\n".join(wrong)


def documented_parameters(docstring: str) -> set[str]:
    """The names in the section "Parameters" of a docstring, that of numpydoc."""
    section = re.search(r"^Parameters\n-+\n(.*?)(\n\n\w+\n---|\Z)", docstring, re.DOTALL | re.M)
    lines = section[1].splitlines() if section else []
    entries = [line.partition(" : ")[0] for line in lines if line[:1].strip()]
    return {name.strip(" *") for entry in entries for name in entry.split(",")}


def text(module: str) -> str:
    """The text of a module."""
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py").read_text()


def plain_lines(module: str) -> int:
    """The lines of a module, but for docstrings: those of `Scene` and `Solver` are the manual."""
    documented = sum(
        (node.end_lineno or node.lineno) - node.lineno + 1
        for node in ast.walk(MODULES[module])
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    )
    return len(text(module).splitlines()) - documented


def functions(tree: ast.Module) -> list[ast.FunctionDef]:
    """The functions and methods of a module, those inside of others too."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def lines_of_code(function: ast.FunctionDef, source: str) -> int:
    """Lines of a function's body that are neither empty nor a docstring or a comment."""
    assert function.end_lineno is not None
    described = {
        line
        for node in ast.walk(function)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = source.splitlines()
    body = range(function.body[0].lineno, function.end_lineno + 1)
    code = [lines[k - 1].strip() for k in body if k not in described]
    return sum(line != "" and not line.startswith("#") for line in code)


def test_tests_lie_where_what_they_test_does() -> None:
    """In the folder of its package; only what belongs to none lies beside these."""
    tests = Path(__file__).parent
    folders = {path.parent.relative_to(tests).as_posix() for path in tests.rglob("test_*.py")}
    packages = {path.parent.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py")}
    assert folders - {"runs"} <= packages
    assert packages - folders <= {
        *("design", "energy", "energy/terms/paper", "foundation", "cabling", "analysis"),
        *("results/output/figures", "results/output/report"),
    }  # with theirs


def test_only_owners_write_what_is_private() -> None:
    """A private attribute is assigned in the module of its class only."""
    wrong = []
    for module, tree in MODULES.items():
        written = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
            if node.attr.startswith("_") and not node.attr.endswith("_")
        ]
        own = {node.attr for node in written if ast.unparse(node.value) == "self"}
        wrong += [f"{module}: {ast.unparse(node)}" for node in written if node.attr not in own]
    assert not wrong, "\n".join(wrong)


def numbers() -> dict[str, str]:
    """Module constants with numbers in them, as ``wing/file.py NAME``, with their values."""
    found = {}
    for module, tree in MODULES.items():
        for node in tree.body:
            if isinstance(node, ast.Assign):
                targets, value = node.targets, node.value
            elif isinstance(node, ast.AnnAssign) and node.value is not None:
                targets, value = [node.target], node.value
            else:
                continue
            parts = [e for t in targets for e in (t.elts if isinstance(t, ast.Tuple) else [t])]
            names = [part.id for part in parts if isinstance(part, ast.Name)]
            kinds = {type(x.value) for x in ast.walk(value) if isinstance(x, ast.Constant)}
            if kinds & {int, float} and str not in kinds:
                found |= {
                    f"{module.replace('.', '/')}.py {name}": ast.unparse(value)
                    for name in names
                    if name.lstrip("_").isupper()
                }
    return found


def fields() -> set[str]:
    """Fields of `VALUES`, as ``wing/file.py Class.field``."""
    return {
        f"{module.replace('.', '/')}.py {owner.name}.{ast.unparse(node.target)}"
        for module, tree in MODULES.items()
        for owner in tree.body
        if isinstance(owner, ast.ClassDef) and owner.name in VALUES
        for node in owner.body
        if isinstance(node, ast.AnnAssign)
    }


def register() -> dict[str, str]:
    """Classes of the constants and fields."""
    rows = re.findall(r"^\| `(\S+)` \| `([\w.]+)` \| (\w+) \|", REGISTER.read_text(), re.MULTILINE)
    known = {f"{file} {name}": kind for file, name, kind in rows}
    assert len(known) == len(rows)
    return known


def test_the_register_of_constants_is_complete() -> None:
    """Each has a class: what would change with it."""
    known = register()
    assert sorted(known) == sorted(numbers().keys() | fields())
    assert set(known.values()) <= CLASSES


def test_wings_keep_their_budgets() -> None:
    """And a budget goes down with its wing."""
    lines = Counter[str]()
    for module in MODULES:
        wing = module.partition(".")[0]
        lines[wing if wing in BUDGETS else ""] += len(text(module).splitlines())
    del lines[""]
    too_long = {wing: n for wing, n in lines.items() if n > BUDGETS[wing]}
    assert not too_long
    to_lower = {wing: n for wing, n in lines.items() if n < BUDGETS[wing] - 50}
    assert not to_lower


def test_ratchets() -> None:
    """And each goes down as soon as it can."""
    assert counted_things() == RATCHETS


def test_a_load_step_goes_from_package_to_package_seldom() -> None:
    assert 100 < changes_of_package() <= MOST_CHANGES


def counted_things() -> dict[str, int]:
    """The numbers of `RATCHETS` as they are."""
    classes = [n for t in MODULES.values() for n in ast.walk(t) if isinstance(n, ast.ClassDef)]
    own = {one.name for one in classes}
    calls = [n for t in MODULES.values() for n in ast.walk(t) if isinstance(n, ast.Call)]
    asked = [c.args[1] for c in calls if ast.unparse(c.func) == "isinstance"]
    public = [
        node
        for tree in MODULES.values()
        for node in tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
    ]
    files = [module for module in MODULES if not module.endswith("__init__")]
    return {
        "isinstance of own types": sum(
            bool({x.id for x in ast.walk(kind) if isinstance(x, ast.Name)} & own) for kind in asked
        ),
        "attributes that are born late": sum(len(born_late(one)) for one in classes),
        "files of less than 100 lines": sum(len(text(m).splitlines()) < 100 for m in files),
        "public functions and classes": len(public),
        "classes": len(classes),
        "module constants": len(numbers()),
        "numbers in values": len(fields()),
        "numbers that decide the answer": list(register().values()).count("answer"),
    }


def born_late(owner: ast.ClassDef) -> set[str]:
    """Attributes that a class sets elsewhere than when it is made."""
    made, late = set[str](), set[str]()
    for node in owner.body:
        if isinstance(node, ast.AnnAssign | ast.Assign):
            made |= {x.id for x in ast.walk(node) if isinstance(x, ast.Name)}
        elif isinstance(node, ast.FunctionDef):
            stored = {
                x.attr
                for x in ast.walk(node)
                if isinstance(x, ast.Attribute) and isinstance(x.ctx, ast.Store)
                if ast.unparse(x.value) == "self"
            }
            if node.name in ("__init__", "__new__", "__post_init__"):
                made |= stored
            else:
                late |= stored
    return late - made


def changes_of_package() -> int:
    """How often a load step of a membrane with a cable goes on in another package."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 6.0, 6.0, 1.0, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.1))
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=0.5)
    cable = scene.lay_cable(Cable(EA=5000.0), [(-1.0, 2.3, 0.0), (7.0, 3.1, 0.0)])
    solver.advance(L0={cable: cable.L0 * 0.98})
    passed: list[Path] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        folder = Path(frame.f_code.co_filename).parent
        if event == "call" and PACKAGE in (folder, *folder.parents):
            if not passed or passed[-1] != folder:
                passed.append(folder)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        solver.advance(pressure=0.6)
    finally:
        sys.setprofile(before)
    return len(passed)
