"""Add the built pages of one version to a site with all versions: publish.py HTML SITE NAME.

The site has a folder for each version, `versions.json` for the menu in the sidebar, newest first, and a first page that
leads to the newest release, or to `dev` before there is one.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path


def age(name: str) -> tuple[int, ...]:
    """Return what versions are sorted by; `dev` and other names come last."""
    return tuple(map(int, re.findall(r"\d+", name))) if re.fullmatch(r"v?\d+(\.\d+)*", name) else ()


def publish(html: Path, site: Path, name: str) -> list[str]:
    """Add a version to a site, and return the names of all versions, newest first."""
    shutil.rmtree(site / name, ignore_errors=True)
    shutil.copytree(html, site / name)
    names = [folder.name for folder in site.iterdir() if (folder / "index.html").exists()]
    names.sort(key=age, reverse=True)
    (site / "versions.json").write_text(json.dumps(names), encoding="utf-8")
    (site / ".nojekyll").touch()  # folders that begin with an underscore are published too
    first = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={names[0]}/index.html">\n'
    (site / "index.html").write_text(first, encoding="utf-8")
    return names


if __name__ == "__main__":
    print(*publish(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
