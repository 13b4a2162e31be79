"""Sphinx settings. Nothing here needs a network; `make linkcheck` does."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "openmm-exactrb"
author = "The openmm-exactrb developers"
project_copyright = author
release = version = version_of("openmm-exactrb")

extensions = [
    "myst_parser",
    "numpydoc",
    "run_example",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.doctest",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

highlight_language = "none"  # of blocks that do not name theirs

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings tell the types, with shapes and units
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [
    # Of OpenMM and others, whose inventories a build without network cannot read.
    (r"py:.*", r"(openmm|State|numpy|scipy|argparse|matplotlib|functools|collections)(\..*)?"),
    (r"py:obj", r"[a-z0-9_.]+"),  # parameters and formulas in docstrings
]

doctest_global_setup = "from openmm_exactrb import *"

html_theme = "furo"
html_title = f"openmm-exactrb {release}"
html_show_sphinx = False
html_theme_options = {"source_directory": "docs/"}

linkcheck_ignore = [r"https://doi\.org/.*"]  # publishers refuse robots; the numbers are checked by hand


def by_last_name(app: Sphinx, env: Any, node: nodes.Element, shown: nodes.Element) -> nodes.Element | None:
    """Find what a docstring calls by its name alone in another module."""
    found = env.domains["py"].find_obj(env, None, None, node.get("reftarget", ""), None, 1)
    if node.get("reftype") != "obj" or not found:
        return None
    name, entry = found[0]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, shown, name)


def without_missing(app: Sphinx, docname: str, source: list[str]) -> None:
    """Leave pages out of the table of contents that are not there."""
    for page in ("paper", "trust", "ensemble"):
        if docname == "index" and not (Path(app.srcdir) / f"{page}.md").exists():
            source[0] = source[0].replace(f"\n{page}\n", "\n")


def setup(app: Sphinx) -> None:
    """Connect what is above."""
    app.connect("missing-reference", by_last_name)
    app.connect("source-read", without_missing)
