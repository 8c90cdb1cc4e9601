"""Links from names to the reference, on all pages, and tables of what a page documents.

Names of public objects in backticks become links: `Scene.put_load`, `meshes.refine`, and inside of
a class its own members. So do classes in the types of arguments, of attributes and of what is
returned. Classes of other projects are in `inventories`. The directive `summary` makes a table of
the objects of its page; its option `members` adds the members of their classes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext.intersphinx import InventoryAdapter
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

CALL = re.compile(r"([A-Za-z_]\w*(?:\.\w+)*)(?:\([^()]*(?:\([^()]*\)[^()]*)*\))?")
"""A name, which may be that of a call."""
OUTSIDE = {"array": "numpy.ndarray", "array-like": "numpy.typing.ArrayLike"}
INSTANCES = {"scene": "Scene", "solver": "Solver", "cable": "LaidCable", "found": "FoundForm"}
"""Classes of the objects that pages and examples call by these names."""
MEMBERS = ("attribute", "method", "property")
TYPED = ("Returns", "Yields", "Raises", "Warns")
"""Sections whose entries are types."""


class Place(NamedTuple):
    """Where an object is documented."""

    page: str
    anchor: str
    kind: str


class Summary(SphinxDirective):
    """A table of the objects of the page, filled in when the page has been read."""

    option_spec: ClassVar[dict[str, Any]] = {"members": directives.flag}

    def run(self) -> list[nodes.Node]:
        """A placeholder."""
        return [SummaryTable(members="members" in self.options)]


class SummaryTable(nodes.General, nodes.Element):
    """Where the table of a page's objects is put."""


def fill_summaries(app: Sphinx, doctree: nodes.document) -> None:
    """Put the tables in their places, and anchors at attributes without an entry of their own."""
    anchors = app.env.attribute_anchors.setdefault(app.env.docname, set())  # type: ignore[attr-defined]
    for desc in doctree.findall(addnodes.desc):
        if desc["domain"] == "py" and desc["objtype"] in ("class", "exception"):
            anchors.update(anchored_attributes(desc))
        elif desc["objtype"] in ("attribute", "property"):
            add_type(desc, app.property_types)  # type: ignore[attr-defined]
    for table in list(doctree.findall(SummaryTable)):
        table.replace_self(table_of(list(tables_of(doctree, table["members"]))))


def anchored_attributes(desc: addnodes.desc) -> Iterator[str]:
    """Names of a class's attributes in the section "Attributes", which become anchors."""
    owner = name_of(desc)
    for field in desc.findall(nodes.field):
        if field[0].astext() == "Attributes":
            for term in field.findall(nodes.term):
                for name in re.findall(r"\w+", term.astext()):
                    term["ids"].append(f"{owner}.{name}")
                    yield f"{owner}.{name}"


def name_of(desc: addnodes.desc) -> str:
    """The full name of a documented object."""
    ids = desc[0]["ids"]
    return str(ids[0]) if ids else ""


def ancestors(node: nodes.Node) -> Iterator[nodes.Node]:
    """The nodes that a node is in, the innermost first."""
    while node.parent is not None:
        node = node.parent
        yield node


def owner_of(node: nodes.Node) -> addnodes.desc | None:
    """The innermost documented object that a node describes."""
    return next((one for one in ancestors(node) if isinstance(one, addnodes.desc)), None)


def tables_of(doctree: nodes.document, members: bool) -> Iterator[nodes.row]:
    """Rows with the name and first sentence of each object; members after their class, by kind."""
    for desc in doctree.findall(addnodes.desc):
        if name_of(desc) and owner_of(desc) is None:
            yield row_of(desc)
            within = [one for one in desc[-1].findall(addnodes.desc) if name_of(one)]
            for kinds, title in KINDS.items() if members and len(within) >= MANY else ():
                own = [one for one in within if one["objtype"] in kinds]
                if own:
                    yield heading(title)
                    yield from map(row_of, own)


MANY = 5
"""Members of a class that a table lists; fewer are found at the class."""
KINDS = {("method",): "Methods", ("attribute", "property"): "Attributes"}


def heading(title: str) -> nodes.row:
    """A row over all columns."""
    text = nodes.paragraph("", "", nodes.emphasis("", title))
    return nodes.row("", nodes.entry("", text, morecols=1), classes=["kind"])


def row_of(desc: addnodes.desc) -> nodes.row:
    """A row with the name and the first sentence of an object."""
    kind = desc["objtype"]
    said = name_of(desc).rpartition(".")[2] + "()" * (kind in ("function", "method"))
    link = nodes.reference("", "", nodes.literal("", said), refid=name_of(desc), internal=True)
    name = nodes.entry("", nodes.paragraph("", "", link))
    owner = owner_of(desc)
    row = nodes.row("", name, nodes.entry("", first_sentence(desc[-1])))
    if owner is not None:
        row["classes"], row["owner"] = ["member"], name_of(owner)
    return row


def first_sentence(content: nodes.Element) -> nodes.paragraph:
    """The first sentence of a docstring."""
    said = nodes.paragraph()
    whole = next((n for n in content if isinstance(n, nodes.paragraph)), nodes.paragraph())
    for part in whole.deepcopy().children:
        end = re.match(r"(.*?\w{3}[)\"]?\.)\s", part.astext(), re.DOTALL)
        if end and isinstance(part, nodes.Text):
            said += nodes.Text(end[1])
            break
        said += part
    return said


def table_of(rows: list[nodes.row]) -> nodes.table:
    """A table of two columns without a header."""
    columns = [nodes.colspec(colwidth=width) for width in (30, 70)]
    group = nodes.tgroup("", *columns, nodes.tbody("", *rows), cols=2)
    return nodes.table("", group, classes=["summary"])


def add_type(desc: addnodes.desc, types: dict[str, str]) -> None:
    """Add the type of a property to its signature."""
    if said := types.get(name_of(desc)):
        desc[0] += addnodes.desc_annotation(
            "", "", addnodes.desc_sig_punctuation("", " : "), addnodes.desc_type("", said)
        )


class Links:
    """Links from the names on the pages of a build."""

    def __init__(self, app: Sphinx) -> None:
        self.app = app
        self.places: dict[str, Place] = {}
        self.tails = defaultdict[str, list[str]](list)
        for page, anchors in app.env.attribute_anchors.items():  # type: ignore[attr-defined]
            self.places |= {name: Place(page, name, "attribute") for name in anchors}
        for name, entry in app.env.domaindata["py"]["objects"].items():
            if not entry.aliased:
                self.places[name] = Place(entry.docname, entry.node_id, entry.objtype)
        for name, place in self.places.items():
            parts = name.split(".")
            for k in range(1 + (place.kind in MEMBERS), len(parts) + 1):
                self.tails[".".join(parts[-k:])].append(name)
        classes = InventoryAdapter(app.env).main_inventory.get("py:class", {})
        self.outside = {name.rpartition(".")[2]: item for name, item in classes.items()}
        self.outside |= {word: classes[name] for word, name in OUTSIDE.items() if name in classes}
        self.outside |= classes

    def place(self, name: str, page: str, node: nodes.Node) -> Place | None:
        """Where the object with a name is documented, as far as it is clear which one is meant."""
        text, called = name, CALL.fullmatch(name)
        if called is None:
            return None
        name = called[1]
        owner = owner_of(node)
        if owner is not None and name in arguments_of(owner):
            return None
        for scope in scopes(node):
            if found := self.places.get(f"{scope}.{name}"):
                return found
        first, dot, rest = name.partition(".")
        if first in INSTANCES:
            name = f"{INSTANCES[first]}{dot}{rest}" if dot else ""
        known = [self.places[full] for full in self.tails.get(name, ())]
        here = [place for place in known if place.page == page]
        word = text.islower() and text.isalpha()  # such as a variable
        known = here if word or len(known) > 1 else known
        return known[0] if len(known) == 1 else None

    def link(self, place: Place, page: str, shown: nodes.Node) -> nodes.Node:
        """A link to a documented object."""
        return make_refnode(self.app.builder, page, place.page, place.anchor, shown)

    def link_names(self, doctree: nodes.document, page: str) -> None:
        """Make links of the names in backticks."""
        for node in list(doctree.findall(lambda n: isinstance(n, NAMED))):
            if linkable(node):
                place = self.place(node.astext(), page, node)
                own = owner_of(node)
                if place is not None and (own is None or place.anchor != name_of(own)):
                    shown = nodes.literal("", node.astext(), classes=["xref", "py"])
                    node.replace_self(self.link(place, page, shown))

    def link_types(self, doctree: nodes.document, page: str) -> None:
        """Make links of the classes in types."""
        for node in list(doctree.findall(lambda n: isinstance(n, TYPES))):
            if not isinstance(node, nodes.term) or section_of(node) in TYPED:
                for text in list(node.findall(nodes.Text)):
                    if linkable(text):
                        text.parent.replace(text, list(self.parts(text.astext(), page)))

    def parts(self, text: str, page: str) -> Iterator[nodes.Node]:
        """A type in words, its classes as links."""
        for part in re.split(r"([A-Za-z_][\w.-]*)", text):
            names = self.tails.get(part, ()) if not part.islower() else ()
            if len(names) == 1:
                yield self.link(self.places[names[0]], page, nodes.Text(part))
            elif part in self.outside:
                project, _, uri, _ = tuple(self.outside[part])
                yield nodes.reference("", part, refuri=uri, reftitle=f"in {project}")
            else:
                yield nodes.Text(part)


NAMED = (nodes.title_reference, nodes.literal)
TYPES = (nodes.classifier, nodes.term, addnodes.desc_type)


def scopes(node: nodes.Node) -> Iterator[str]:
    """The names of the objects that a node describes, the innermost first."""
    for one in ancestors(node):
        if isinstance(one, addnodes.desc):
            yield name_of(one)
        elif isinstance(one, nodes.row) and "owner" in one:
            yield one["owner"]


def arguments_of(desc: addnodes.desc) -> set[str]:
    """The arguments of a documented callable."""
    given = desc[0].findall(addnodes.desc_parameter)
    return {found[0] for a in given if (found := re.search(r"\w+", a.astext()))}


def linkable(node: nodes.Node) -> bool:
    """Whether a node is in running text and not yet part of a link."""
    others = nodes.reference | nodes.title | nodes.literal_block | nodes.rubric
    return not any(isinstance(one, others) for one in ancestors(node))


def section_of(node: nodes.Node) -> str:
    """The name of the section of a docstring in which a node is."""
    fields = (one for one in ancestors(node) if isinstance(one, nodes.field))
    return next((str(one[0].astext()) for one in fields), "")


def link_page(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Make links of names and of types on a page."""
    links = getattr(app, "reference_links", None)
    if links is None:
        links = app.reference_links = Links(app)  # type: ignore[attr-defined]
    links.link_names(doctree, page)
    links.link_types(doctree, page)


def begin(app: Sphinx) -> None:
    """Anchors of the pages read in earlier builds."""
    if not hasattr(app.env, "attribute_anchors"):
        app.env.attribute_anchors = {}  # type: ignore[attr-defined]


def forget(app: Sphinx, env: BuildEnvironment, page: str) -> None:
    """Remove the anchors of a page that is read again."""
    getattr(env, "attribute_anchors", {}).pop(page, None)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive and the hooks."""
    app.add_directive("summary", Summary)
    app.add_node(SummaryTable)
    app.connect("builder-inited", begin)
    app.connect("env-purge-doc", forget)
    app.connect("doctree-read", fill_summaries)
    app.connect("doctree-resolved", link_page)
    return {"env_version": 2, "parallel_read_safe": False, "parallel_write_safe": True}
