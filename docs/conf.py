"""Sphinx configuration for `./run docs`."""

import shutil
import sys
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst
from sphinx_gallery.sorting import ExplicitOrder

import crms_fenicsx

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

TUTORIALS = [
    "inflated_square",
    "single_element",
    "paper",
    "sliding_cable",
    "cable_net",
    "tent",
    "air_hall",
    "code_loads",
    "clamped_net",
    "net_tuning",
    "patterns",
    "wind_coupling",
    "friction_experiment",
    "capstan",
    "air_dome",
    "own_term",
]

project = "crms_fenicsx"
author = "the crms_fenicsx developers"
copyright = author
release = crms_fenicsx._RELEASE

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "demos",
    "formulas",
    "linked",
    "typed",
    "words",
]
intersphinx_mapping = {  # with the classes that are named here, so that no network is needed
    name: (url, f"inventories/{name}.txt")
    for name, url in {
        "dolfinx": "https://docs.fenicsproject.org/dolfinx/v0.9.0/python",
        "matplotlib": "https://matplotlib.org/stable",
        "mpi4py": "https://mpi4py.readthedocs.io/en/stable",
        "numpy": "https://numpy.org/doc/stable",
        "petsc4py": "https://petsc.org/release/petsc4py",
        "pyvista": "https://docs.pyvista.org",
        "scipy": "https://docs.scipy.org/doc/scipy",
    }.items()
}
exclude_patterns = [
    "tutorials/**/*.ipynb",
    "tutorials/**/*.py",
    "tutorials/sg_execution_times.rst",
    "sg_execution_times.rst",
]
suppress_warnings = ["config.cache"]  # the scraper below is a function, which cannot be pickled
nitpicky = False

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # `typed` writes them into numpydoc's sections
toc_object_entries_show_parents = "hide"
add_module_names = False  # each page names the module to import from
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "crms_fenicsx"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["site.js", ("scorer.js", {"priority": 100})]
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "use_edit_page_button": False,
}
html_sidebars = {
    page: [] for page in ("index", "start", "hall", "features", "contributing", "changelog")
}
html_show_sourcelink = False
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


class Order(ExplicitOrder):
    """Order of the tutorials, the simplest first."""

    def __init__(self, folder):
        super().__init__([f"{name}.py" for name in TUTORIALS])


demos = Path(__file__).parents[1] / "demos"
made = [path for kind in ("png", "html") for path in demos.rglob(f"*.{kind}")]
seen = {path: path.stat().st_mtime for path in made}


def new(kind):
    """The files of a kind that the demos have written since they were asked for last."""
    written = sorted(demos.rglob(f"*.{kind}"), key=lambda path: path.stat().st_mtime)
    found = [path for path in written if seen.get(path) != path.stat().st_mtime]
    seen.update((path, path.stat().st_mtime) for path in found)
    return found


def pictures(block, block_vars, gallery_conf):
    """Show the pictures written by a block of a demo, except the parts of joined ones, and link its
    reports and views.
    """
    shown, names = [], []
    for path in new("png"):
        if path.stem != "both":
            shown.append(next(block_vars["image_path_iterator"]))
            names.append(f"{path.parent.name}, {path.stem}".replace("_", " "))
            shutil.copy(path, shown[-1])
    links = [
        f'<a href="../results/{path.parent.name}/{path.name}">{path.stem.replace("_", " ")}</a>'
        for path in new("html")
    ]
    linked = ".. raw:: html\n\n    <p>Open the " + ", the ".join(links) + ".</p>\n"
    return figure_rst(shown, gallery_conf["src_dir"], "; ".join(names)) + linked * bool(links)


def copy_reports(app, error):
    """Put the reports and views of the demos where the tutorials link them."""
    for path in demos.glob("results/*/*.html"):
        folder = Path(app.outdir) / "results" / path.parent.name
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder)


def setup(app):
    """Sphinx calls this."""
    app.connect("build-finished", copy_reports)


sphinx_gallery_conf = {
    "examples_dirs": "../demos",
    "gallery_dirs": "tutorials",
    "filename_pattern": r"\.py$",
    "image_scrapers": (pictures,),
    "within_subsection_order": Order,
    "abort_on_example_error": True,
    "capture_repr": (),
    "download_all_examples": False,
    "min_reported_time": 1e9,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "reset_modules": (),
    "reference_url": {"crms_fenicsx": None},
}
