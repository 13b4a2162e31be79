"""Metadata that depends on where the package is published, and the library of the device engine in wheels.

The release workflow names its repository in `REPOSITORY`. Then links of the README are made absolute, since the page of
a package index has no files beside it, and the project has its addresses. In a checkout nothing of it is claimed.
"""

from __future__ import annotations

import importlib.util
import os
import re
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

#: The environment variable with the address of the repository, such as https://github.com/owner/openmm-exactrb.
REPOSITORY = "OPENMM_EXACTRB_REPOSITORY"
_PAPER = "https://doi.org/10.1137/070704393"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]+)\)")


#: The environment variable that asks for a wheel with the library of the device engine, for the OpenMM of where it is
#: built (python -m build --no-isolation). Other wheels are pure, and compile it at first use.
PLATFORM_WHEEL = "EXACTRB_PLATFORM_WHEEL"
_DEVICE = "openmm_exactrb/engines/device"


class DeviceLibrary(BuildHookInterface):
    """Compiles the library of the device engine into a wheel for one platform and one minor version of OpenMM."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the library, its version of OpenMM and the tag of the wheel."""
        if self.target_name != "wheel" or version == "editable" or not os.environ.get(PLATFORM_WHEEL):
            return
        import openmm
        from packaging.tags import sys_tags

        source = Path(self.root) / _DEVICE / "library.py"
        spec = importlib.util.spec_from_file_location("device_library", source)
        assert spec is not None
        assert spec.loader is not None
        library = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(library)
        self._folder = tempfile.TemporaryDirectory()
        built, made_for = (Path(self._folder.name) / library.BUNDLED.with_suffix(end).name for end in (".so", ".txt"))
        library.build(built)
        built.chmod(0o755)
        made_for.write_text(openmm.__version__, encoding="utf-8")
        build_data["force_include"] |= {str(file): f"{_DEVICE}/{file.name}" for file in (built, made_for)}
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{next(sys_tags()).platform}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


class PublishedMetadata(MetadataHookInterface):
    """The long description and the addresses of the project."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add `readme` and `urls`."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        repository = os.environ.get(REPOSITORY, "").rstrip("/")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": absolute(text, repository, f"v{metadata['version']}") if repository else text,
        }
        metadata["urls"] = addresses(repository)


def absolute(text: str, repository: str, tag: str) -> str:
    """Return Markdown whose links and pictures lead to the files of a tag."""

    def link(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        return f"{picture}[{words}]({repository}/{'raw' if picture else 'blob'}/{tag}/{target})"

    return _LINK.sub(link, text)


def addresses(repository: str) -> dict[str, str]:
    """Return the addresses of the project: the paper's alone where there is no repository."""
    own = {"Repository": "", "Issues": "/issues", "Changelog": "/blob/main/CHANGELOG.md"}
    return {"Paper": _PAPER} | ({name: repository + path for name, path in own.items()} if repository else {})
