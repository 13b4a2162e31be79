"""The map of the package is that of its imports, and names files that exist."""

import re
from pathlib import Path

import rooms

PAGE = (rooms.ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_picture_shows_the_present_imports():
    assert rooms.PICTURE.read_text(encoding="utf-8") == rooms.svg(), "run docs/_ext/rooms.py"


def test_the_page_describes_each_package_once():
    table = PAGE.partition("## Packages")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.M) == sorted(rooms.rooms())


def test_the_files_that_the_page_names_exist():
    named = set(re.findall(r"`(\w+(?:/\w+)+(?:\.\w+)?)`", PAGE))
    assert len(named) > 30
    assert not [name for name in sorted(named) if not Path(rooms.PACKAGE, name).exists()]


def test_the_core_has_about_3500_lines():
    core = PAGE.partition("## The core")[2].partition("\n## ")[0]
    counts = [
        len((rooms.PACKAGE / name).read_text(encoding="utf-8").splitlines())
        for name in re.findall(r"`([\w/.]+)`", core)
    ]
    assert 3000 < sum(counts) < 4000
