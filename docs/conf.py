"""Sphinx settings. Nothing here needs a network; `make linkcheck` does."""

import ast
import importlib
import inspect
import os
import pkgutil
import re
import sys
from collections.abc import Iterator
from importlib.metadata import version as version_of
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any

import joblib
from docutils import nodes
from numpydoc.numpydoc import mangle_signature
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
sys.path.insert(0, str(Path(__file__).parents[1]))  # for benchmarks, of which some pictures are made too

import droplet

import openmm_exactrb
from benchmarks import tables
from benchmarks.water.equipartition_record import RECORD, over_frictions, over_goals, over_models, over_steps, read
from openmm_exactrb.schemes import CATALOGUE, stability_limit

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
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_static", "joss.md", "examples/**/*.ipynb"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
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

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "examples",
    "filename_pattern": "",  # executes all of them
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
html_favicon = "_static/favicon.svg"
html_theme_options = {"source_directory": "docs/"}

linkcheck_ignore = [r"https://doi\.org/.*"]  # publishers refuse robots; the numbers are checked by hand


def by_last_name(app: Sphinx, env: Any, node: nodes.Element, shown: nodes.Element) -> nodes.Element | None:
    """Find what a docstring calls by its name alone in another module."""
    found = env.domains["py"].find_obj(env, None, None, node.get("reftarget", ""), None, 1)
    if node.get("reftype") != "obj" or not found:
        return None
    name, entry = found[0]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, shown, name)


class Python(PythonDomain):
    """Names of the modules for contributors, which the search does not find."""

    def get_objects(self) -> Iterator[tuple[str, str, str, str, str, int]]:
        """Yield all names with their pages and priorities; below zero is left out."""
        for *entry, page, anchor, priority in super().get_objects():
            yield *entry, page, anchor, -1 if page.startswith("internals/") else priority


def scheme_table() -> str:
    """Return the catalogue of schemes as a table, for the guide."""
    of_a_step = ("orders", "forces per step", "more per call", "starts with", "kind", "stable step per force")
    head = ("name", *of_a_step, "change of L")
    changes, body = tables.angular_momentum(), []
    for name, scheme in CATALOGUE.items():
        orders = ", ".join(map(str, scheme.generalised or (scheme.order,)))
        stable = stability_limit(scheme) / scheme.forces
        more = scheme.output_forces if scheme.processor else int(scheme.first == "kick")
        numbers = (f"{scheme.forces}", f"{more}", scheme.first, scheme.kind, f"{stable:.2f}", changes.get(name, ""))
        body.append((f"`{name}`", orders, *numbers))
    return tables.table(head, body)


def equipartition_tables() -> dict[str, str]:
    """Return what was measured of equipartition as tables, for the page on temperature."""
    record = read(RECORD)
    models = ("spce", "tip4p2005")
    tables = {
        f"{model}_{name}": over_steps(record, quantity, model, kind)
        for model in models
        for name, quantity, kind in (
            ("temperatures", "T_rot - T_tr", "NVT"),
            ("temperatures_at_pressure", "T_rot - T_tr", "NPT"),
            ("energies", "U", "NVT"),
            ("densities", "density", "NPT"),
        )
    }
    tables |= {f"{model}_frictions": over_frictions(record, model, 6.0) for model in models}
    tables |= {f"{model}_goals": over_goals(record, model) for model in models}
    return tables | {"equipartition_models": over_models(record)}


myst_substitutions = {"scheme_table": scheme_table()} | equipartition_tables() | tables.all_tables()


def undocumented(app: Sphinx, env: Any) -> None:
    """Warn of modules and public names that are on no page of the API."""
    shown = env.domains["py"].objects
    for info in pkgutil.walk_packages(openmm_exactrb.__path__, "openmm_exactrb."):
        module = importlib.import_module(info.name)
        if info.name not in shown:
            log.warning("%s is on no page of docs/internals", info.name)
        packages = list(accumulate(info.name.split("."), "{}.{}".format))  # one of them may show its names
        for name in public_names(module):
            if not any(f"{package}.{name}" in shown for package in packages):
                log.warning("%s.%s is on no page of docs/internals", info.name, name)


def public_names(module: ModuleType) -> list[str]:
    """Return the functions, classes and constants that a module defines: those of its `__all__`, if it has one."""
    names = []
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names += [target.id for target in targets if isinstance(target, ast.Name) and target.id.isupper()]
    public = getattr(module, "__all__", names)
    return [name for name in names if name in public and not name.startswith("_")]


def reachable_from_source(app: Sphinx, doctree: nodes.document) -> None:
    """Give names of the API the addresses that pages of source use: in each package that shows them."""
    for node in doctree.findall(addnodes.desc_signature):
        if not (node.get("module") and node.get("fullname")):
            continue
        outer = node["fullname"].split(".")[0]
        shown = getattr(importlib.import_module(node["module"]), outer, None)
        home = getattr(shown, "__module__", None) or node["module"]
        for package in accumulate(home.split("."), "{}.{}".format):
            address = f"{package}.{node['fullname']}"
            if getattr(sys.modules.get(package), outer, None) is shown and address not in node["ids"]:
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
    app.add_domain(Python, override=True)
    app.connect("builder-inited", moving_droplet)
    for listener in tuple(app.events.listeners["autodoc-process-signature"]):
        if listener.handler is mangle_signature:
            app.disconnect(listener.id)
    app.connect("autodoc-process-signature", signature)
    app.connect("missing-reference", by_last_name)
    app.connect("env-check-consistency", undocumented)
    app.connect("doctree-read", reachable_from_source)
    app.connect("doctree-resolved", breakable)
