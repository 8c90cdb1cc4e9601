"""Types of arguments and attributes in the reference, taken from the annotations.

Docstrings do not repeat the annotations, which appear in words: "sequence of str", "float or None".
"""

from __future__ import annotations

import ast
import inspect
import itertools
import operator
import pydoc
import re
import sys
import typing
from typing import Any

from sphinx.application import Sphinx

SECTIONS = ("Parameters", "Attributes", "Other Parameters")
ARRAYS = {
    "Array": "array",
    "Integers": "array of int",
    "Indices": "array of int",
    "Booleans": "array of bool",
    "Flags": "array of bool",
    "ArrayLike": "array-like",
    "Ranks": "array-like or function",
}
PLAIN = ("ReadOnly", "ClassVar", "Final", "Annotated", "PerRank")
SEQUENCES = ("Sequence", "Iterable", "list", "frozenset", "set", "Iterator", "Collection")


def words(node: ast.expr, names: dict[str, Any]) -> str:
    """An annotation in words; `names` resolves aliases of its module."""
    match node:
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            parts = [words(left, names), words(right, names)]
            return " or ".join(dict.fromkeys(part for part in parts))
        case ast.Constant(value=None):
            return "None"
        case ast.Constant(value=str() as text):
            return words(ast.parse(text, mode="eval").body, names)
        case ast.Name(id=name) if name in ARRAYS:
            return ARRAYS[name]
        case ast.Name(id=name):
            return alias(name, names)
        case ast.Attribute(attr=name):
            return name
        case ast.Subscript(value=value, slice=inner):
            return generic(words(value, {}), inner, names)
    return ast.unparse(node)


def generic(name: str, inner: ast.expr, names: dict[str, Any]) -> str:
    """A type with parameters in words."""
    items = inner.elts if isinstance(inner, ast.Tuple) else [inner]
    if name == "Literal":
        return "{" + ", ".join(ast.unparse(item) for item in items) + "}"
    if name == "Callable":
        return "function"
    said = [words(item, names) for item in items if ast.unparse(item) != "..."]
    if name == "PathLike":
        return "path-like"
    if name == "Union":
        return " or ".join(dict.fromkeys(said))
    if name in PLAIN:
        return said[0]
    if name in ("Mapping", "dict"):
        return f"mapping of {said[0]} to {said[1]}"
    if name == "tuple" and len(said) == len(items):
        return "(" + ", ".join(said) + ")"
    if name in SEQUENCES or name == "tuple":
        return f"sequence of {said[0]}"
    return f"{name} of {', '.join(said)}"


def alias(name: str, names: dict[str, Any]) -> str:
    """A name in words: a class by its name, an alias by its meaning."""
    value = names.get(name)
    if typing.get_origin(value) is typing.Annotated:
        value = typing.get_args(value)[0]
        name = getattr(value, "__name__", name)
    if value is None or (inspect.isclass(value) and not typing.get_args(value)):
        return name
    text = re.sub(r"\b(?:\w+\.)+(\w+)", r"\1", str(value))
    text = re.sub(r"ndarray\[.*?dtype\[\w+\]\]", "Array", text.replace("NoneType", "None"))
    try:
        return words(ast.parse(text, mode="eval").body, {})
    except SyntaxError:
        return name


def annotations(obj: Any, owner: Any) -> dict[str, str]:
    """Types of a callable's arguments and of a class's attributes, in words."""
    names = vars(sys.modules.get(getattr(obj, "__module__", ""), owner))
    found: dict[str, Any] = {}
    if inspect.isclass(obj):
        for base in reversed(obj.__mro__):
            found |= vars(base).get("__annotations__", {})
            for name, value in vars(base).items():
                getter = getattr(value, "fget", None) or getattr(value, "func", None)
                if getter is not None and "return" in getattr(getter, "__annotations__", {}):
                    found[name] = getter.__annotations__["return"]
        obj = obj.__init__
    found |= getattr(inspect.unwrap(obj), "__annotations__", {})
    said = {}
    for name, value in found.items():
        text = value if isinstance(value, str) else inspect.formatannotation(value)
        try:
            said[name] = words(ast.parse(text, mode="eval").body, names)
        except SyntaxError:
            continue
    return said


def entries(names: list[str], types: dict[str, str]) -> list[str]:
    """Entries of names that share a description: one for each type."""
    known = [(types.get(name, ""), name) for name in names]
    of_type = itertools.groupby(known, key=operator.itemgetter(0))
    return [", ".join(n for _, n in group) + f" : {kind}" * bool(kind) for kind, group in of_type]


def tell(app: Sphinx, what: str, name: str, obj: Any, options: object, lines: list[str]) -> None:
    """Add types to the names in a docstring's sections."""
    if what == "property":
        owner, _, own = name.rpartition(".")
        said = annotations(pydoc.locate(owner), None).get(own, "")
        app.property_types[name] = said  # type: ignore[attr-defined]
    if what not in ("class", "exception", "function", "method") or not lines:
        return
    types = annotations(obj, type(obj))
    within, said = False, []
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        if line and set(after) == {"-"}:
            within = line.strip() in SECTIONS
        elif within and re.fullmatch(r"[\w*]+(?:, [\w*]+)*", line):
            said += entries(line.split(", "), types)
            continue
        said.append(line)
    lines[:] = said


def without_arguments(
    app: Sphinx, what: str, name: str, obj: Any, options: object, signature: object, returns: object
) -> tuple[str, None] | None:
    """Omit the arguments of classes that only the package instantiates."""
    made = what == "class" and "Parameters\n" not in inspect.cleandoc(obj.__doc__ or "")
    return ("", None) if made else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the hook that runs before numpydoc."""
    app.property_types = {}  # type: ignore[attr-defined]
    app.connect("autodoc-process-docstring", tell, priority=100)
    app.connect("autodoc-process-signature", without_arguments, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
