"""The directive `run-example`: executes a script while the documentation is built, and shows what it printed and drew.

A script that fails is a warning, so that a build with -W fails. What a script left is kept in docs/_build/run
until it, its arguments or the package change. With `-D run_examples=0` scripts are not executed, and the page says so.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
log = logging.getLogger(__name__)


class RunExample(SphinxDirective):
    """`run-example:: examples/name.py` with its arguments and the picture that it writes, from the root."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "arguments": directives.unchanged,
        "picture": directives.unchanged,
        "alt": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        """Execute the script, or find what it left."""
        script = self.arguments[0]
        options = shlex.split(self.options.get("arguments", ""))
        command = " ".join(["python", script, *options])
        self.env.note_dependency(str(ROOT / script))
        if str(self.config.run_examples) in ("0", "False"):
            return [*_console(f"$ {command}"), nodes.paragraph(text="(Not executed in this build.)")]
        folder = self._executed(script, options)
        if folder is None:
            return _console(f"$ {command}")
        shown: list[nodes.Node] = _console(f"$ {command}\n{(folder / 'output.txt').read_text()}")
        if "picture" in self.options:
            # Inside the sources, where Sphinx looks for pictures.
            name = f"{Path(script).stem}-{Path(self.options['picture']).name}"
            target = Path(self.env.srcdir) / "_run" / name
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(folder / "picture.png", target)
            shown.append(nodes.image(uri=f"/_run/{name}", alt=self.options.get("alt", "")))
        return shown

    def _executed(self, script: str, options: list[str]) -> Path | None:
        folder = Path(self.env.srcdir) / "_build" / "run" / _digest(script, options, self.options.get("picture", ""))
        if (folder / "output.txt").exists():
            return folder
        with tempfile.TemporaryDirectory() as work:
            start = time.perf_counter()
            environment = os.environ | {"MPLBACKEND": "Agg"}
            done = subprocess.run(
                [sys.executable, str(ROOT / script), *options],
                cwd=work,
                capture_output=True,
                text=True,
                env=environment,
                timeout=600,
            )
            if done.returncode:
                log.warning(
                    "%s ended with status %d:\n%s", script, done.returncode, done.stderr, location=self.get_location()
                )
                return None
            log.info("%s %s took %.1f s", script, shlex.join(options), time.perf_counter() - start)
            folder.mkdir(parents=True, exist_ok=True)
            if "picture" in self.options:
                shutil.copyfile(Path(work) / self.options["picture"], folder / "picture.png")
        (folder / "output.txt").write_text(done.stdout)
        return folder


def _console(text: str) -> list[nodes.Node]:
    return [nodes.literal_block(text, text.rstrip(), language="text")]


def _digest(script: str, options: list[str], picture: str) -> str:
    """Name what decides the outcome: script, arguments, and all of the package."""
    digest = hashlib.sha256(json.dumps([script, options, picture, sys.version]).encode())
    for file in [ROOT / script, *sorted((ROOT / "src").rglob("*.py"))]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("run-example", RunExample)
    app.add_config_value("run_examples", True, "env", types=(bool, int, str))
    return {"parallel_read_safe": True}
