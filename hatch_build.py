"""Metadata that depends on where the package is published, and the library of C++ integrators in wheels.

The addresses are those of `[tool.hatch.metadata.hooks.custom]` in pyproject.toml. With them, links of the README are
absolute, since the page of a package index has no files next to it. Without them nothing is claimed.
"""

from __future__ import annotations

import os
import re
import runpy
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

_PAPER = "https://doi.org/10.1137/070704393"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]+)\)")


#: The environment variable that asks for a wheel with the library, for the OpenMM of where it is built (python -m build
#: --no-isolation). Other wheels are pure, and compile it at first use.
PLATFORM_WHEEL = "EXACTRB_PLATFORM_WHEEL"
_LIBRARY = "openmm_exactrb/library"


class Library(BuildHookInterface):
    """Compiles the library into a wheel for one platform."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the library and the tag of the wheel."""
        if self.target_name != "wheel" or version == "editable" or not os.environ.get(PLATFORM_WHEEL):
            return
        # The file alone, because the package cannot be imported where its requirements are not installed.
        compilation = runpy.run_path(str(Path(self.root) / _LIBRARY / "compilation.py"))
        self._folder = tempfile.TemporaryDirectory()
        built = Path(self._folder.name) / compilation["BUNDLED"].name
        compilation["build"](built)
        built.chmod(0o755)
        build_data["force_include"][str(built)] = f"{_LIBRARY}/{built.name}"
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{_platform()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def _platform() -> str:
    """Return the tag of this platform: the newest that package indexes accept, or the system that macOS builds for."""
    from packaging.tags import sys_tags

    if sys.platform == "darwin":
        return re.sub(r"[-.]", "_", sysconfig.get_platform())  # with MACOSX_DEPLOYMENT_TARGET
    platforms = [tag.platform for tag in sys_tags()]
    return next((name for name in platforms if name.startswith(("manylinux", "musllinux"))), platforms[0])


class PublishedMetadata(MetadataHookInterface):
    """The long description and the addresses of the project."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add `readme` and `urls`."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        repository, pages = (self.config[name].rstrip("/") for name in ("repository", "documentation"))
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": absolute(text, f"v{metadata['version']}", repository, pages) if repository else text,
        }
        metadata["urls"] = addresses(repository, pages)


def absolute(text: str, tag: str, repository: str, pages: str = "") -> str:
    """Return Markdown whose links lead to the pages, if there are any, and otherwise to files of a tag."""

    def link(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        page = re.fullmatch(r"docs/(.*)\.md(#.*)?", target)
        if page and pages:
            return f"[{words}]({pages}/{page[1]}.html{page[2] or ''})"
        return f"{picture}[{words}]({repository}/{'raw' if picture else 'blob'}/{tag}/{target})"

    return _LINK.sub(link, text)


def addresses(repository: str, pages: str = "") -> dict[str, str]:
    """Return the addresses of the project: the paper's alone where there is no repository."""
    own = {"Repository": "", "Issues": "/issues", "Changelog": "/blob/main/CHANGELOG.md"}
    found = {"Documentation": pages} if pages else {}
    return found | {"Paper": _PAPER} | ({name: repository + path for name, path in own.items()} if repository else {})
