"""Sphinx settings. Nothing here needs a network; `make linkcheck` does."""

import importlib
import os
import re
import sys
from importlib.metadata import metadata
from importlib.metadata import version as version_of
from itertools import accumulate
from pathlib import Path
from typing import Any

import joblib
from docutils import nodes
from numpydoc.numpydoc import mangle_signature
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
sys.path.insert(0, str(Path(__file__).parents[1]))  # for benchmarks, which a picture needs

import droplet
import rooms

import openmm_exactrb

log = logging.getLogger(__name__)

project = "openmm-exactrb"
author = "The openmm-exactrb developers"
project_copyright = author
release = version = version_of("openmm-exactrb")

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.doctest",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_static", "_templates", "appendix/joss.md", "examples/**/*.ipynb"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

highlight_language = "none"  # of blocks that do not name theirs

# Links into the documentation of others, where the service that builds and publishes the pages has a network.
if os.environ.get("GITHUB_ACTIONS") or os.environ.get("READTHEDOCS"):
    intersphinx_mapping = {
        "numpy": ("https://numpy.org/doc/stable/", None),
        "openmm": ("https://docs.openmm.org/latest/api-python/", None),
        "scipy": ("https://docs.scipy.org/doc/scipy/", None),
    }

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings tell the types, with shapes and units
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [
    # Of OpenMM and others, whose inventories a build without a network cannot read.
    (
        r"py:.*",
        r"(openmm|State|Simulation|[A-Z]\w*Force|numpy|scipy|argparse|matplotlib|functools|collections)(\..*)?",
    ),
    (r"py:.*", r"openmm_exactrb\.mechanics\.state\._S"),  # a type variable
    (r"py:obj", r"[a-z0-9_.]+"),  # parameters and formulas in docstrings
]

#: Of each notebook: a checkout is installed, and the options of the script keep their defaults.
FIRST_CELL = """\
# Run this notebook in the folder `examples` of a checkout.
%pip install --quiet "..[examples]"
import sys

sys.argv = ["notebook"]"""

#: Examples that the build does not execute: their pages show stored pictures, with the commands that made them.
LONG_RUNS = "dielectric_constant", "ellipsoids", "ferrofluid", "stockmayer_fluid"
#: Their pages are without the code, which is there to download.
PROGRAMS = {f"examples/{name}" for name in (*LONG_RUNS, "rigid_domains")}

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "examples",
    "filename_pattern": rf"^(?!.*({'|'.join(LONG_RUNS)})\.py)",
    "remove_config_comments": True,
    "ignore_pattern": r"(^|[\\/])(sphere|dipole_runs)\.py",  # which others import
    "parallel": joblib.cpu_count(),
    "run_stale_examples": True,  # the package may have changed since
    "reset_argv": "gallery.arguments",
    "reset_modules": ("matplotlib",),
    "image_srcset": ["2x"],
    "capture_repr": (),
    "notebook_extensions": {".py"},
    "first_notebook_cell": FIRST_CELL,
    "download_all_examples": False,
    "write_computation_times": False,
    "show_signature": False,
}
os.environ["TQDM_DISABLE"] = "1"

pygments_dark_style = "github-dark"  # names of modules do not look like links

html_theme = "furo"
html_title = f"openmm-exactrb {release}"
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_js_files = ["versions.js"]
templates_path = ["_templates"]
_SIDEBAR = ("brand", "versions", "search", "scroll-start", "navigation", "scroll-end", "variant-selector")
html_sidebars = {"**": [f"sidebar/{part}.html" for part in _SIDEBAR]}
html_favicon = "_static/favicon.svg"
html_theme_options = {"source_directory": "docs/", "source_branch": "main"}
_ADDRESSES = dict(line.split(", ", 1) for line in metadata("openmm-exactrb").get_all("Project-URL") or ())
if "Repository" in _ADDRESSES:
    html_theme_options["source_repository"] = _ADDRESSES["Repository"]

linkcheck_ignore = [r"https://doi\.org/.*"]  # publishers refuse robots; the numbers are checked by hand


def by_last_name(app: Sphinx, env: Any, node: nodes.Element, shown: nodes.Element) -> nodes.Element | None:
    """Find what a docstring calls by its name alone in another module."""
    found = env.domains["py"].find_obj(env, None, None, node.get("reftarget", ""), None, 1)
    if node.get("reftype") != "obj" or not found:
        return None
    name, entry = found[0]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, shown, name)


def undocumented(app: Sphinx, env: Any) -> None:
    """Warn of public names that are on no page of the API."""
    shown = env.domains["py"].objects
    for name in openmm_exactrb.__all__:
        if f"openmm_exactrb.{name}" not in shown:
            log.warning("openmm_exactrb.%s is on no page of docs/reference/api", name)


def outdated(app: Sphinx) -> None:
    """Warn if the map of the package is not that of its imports."""
    if rooms.PICTURE.read_text(encoding="utf-8") != rooms.svg():
        log.warning("docs/pictures/rooms.svg is out of date: run docs/_ext/rooms.py")


def in_the_pages(app: Sphinx, page: str, source: list[str]) -> None:
    """Let links to examples, which lead to scripts on a forge, lead to the pages that are made from them."""
    source[0] = re.sub(
        r"\]\(((?:\.\./)*)\.\./(examples)(?:(/[\w/]+)\.py)?\)",
        lambda found: f"]({found[1]}{found[2]}{found[3] or '/index'}.rst)",
        source[0],
    )
    if page in PROGRAMS:
        source[0] = re.sub(r"^\.\. code-block:: Python\n(?:\n|[ \t]+.*\n)*", "", source[0], flags=re.MULTILINE)


def reachable_from_source(app: Sphinx, doctree: nodes.document) -> None:
    """Give names of the API the addresses that pages of source use: in each package above their module."""
    for node in doctree.findall(addnodes.desc_signature):
        if not (node.get("module") and node.get("fullname")):
            continue
        outer = node["fullname"].split(".")[0]
        shown = getattr(importlib.import_module(node["module"]), outer, None)
        home = getattr(shown, "__module__", None) or node["module"]
        for package in accumulate(home.split("."), "{}.{}".format):
            address = f"{package}.{node['fullname']}"
            if address not in node["ids"]:
                node["ids"].append(address)


def signature(app: Sphinx, what: str, *rest: Any) -> tuple[str, str] | None:
    """Return the signature that numpydoc makes; a type alias has none."""
    made: tuple[str, str] | None = None if what == "data" else mangle_signature(app, what, *rest)
    return made


def moving_droplet(app: Sphinx) -> None:
    """Make the trajectory that a page shows."""
    if app.builder.format == "html":
        droplet.write(Path(__file__).parent / "_static" / "droplet.xyz")


def breakable(app: Sphinx, tree: nodes.document, name: str) -> None:
    """Let long names in cells of tables wrap between their words, not within them."""
    for entry in tree.findall(nodes.entry):
        for literal in entry.findall(nodes.literal):
            words = re.split(r"(?<=[a-z])(?=[A-Z])", literal.astext())
            literal.clear()
            literal += nodes.Text(words[0])
            for word in words[1:]:
                literal += [nodes.raw("", "<wbr>", format="html"), nodes.Text(word)]


def setup(app: Sphinx) -> None:
    """Connect what is above."""
    app.connect("builder-inited", moving_droplet)
    app.connect("builder-inited", outdated)
    for listener in tuple(app.events.listeners["autodoc-process-signature"]):
        if listener.handler is mangle_signature:
            app.disconnect(listener.id)
    app.connect("autodoc-process-signature", signature)
    app.connect("source-read", in_the_pages)
    app.connect("missing-reference", by_last_name)
    app.connect("env-check-consistency", undocumented)
    app.connect("doctree-read", reachable_from_source)
    app.connect("doctree-resolved", breakable)
