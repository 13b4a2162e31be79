"""Metadata that depends on where the package is published.

The release workflow names its repository in `REPOSITORY`. Then links of the README are made absolute, since the page of
a package index has no files beside it, and the project has its addresses. In a checkout nothing of it is claimed.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

#: The environment variable with the address of the repository, such as https://github.com/owner/openmm-exactrb.
REPOSITORY = "OPENMM_EXACTRB_REPOSITORY"
_PAPER = "https://doi.org/10.1137/070704393"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]+)\)")


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
