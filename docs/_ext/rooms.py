"""The map of the package: its rooms (packages and single modules) and their imports, drawn from the source as SVG.

``python docs/_ext/rooms.py`` writes docs/pictures/rooms.svg. The build of the pages fails if the file is out of date.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "openmm_exactrb"
PICTURE = ROOT / "docs" / "pictures" / "rooms.svg"
_WIDTH, _HEIGHT, _GAP, _FLOOR = 1000, 34, 14, 62
_CORE = {"constraints", "mechanics", "random", "rotors", "schemes", "steps", "thermostats"}


def rooms() -> dict[str, set[str]]:
    """Return the rooms with the rooms that they import, without the module that contains the public names."""
    names = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    names.discard("__init__")
    return {name: _imported(name) & names - {name} for name in sorted(names)}


def floors() -> list[list[str]]:
    """Return the rooms by floor, the ground floor first: a room stands above all that it imports."""
    imports, found = rooms(), list[list[str]]()
    placed: set[str] = set()
    while len(placed) < len(imports):
        floor = [room for room, below in imports.items() if room not in placed and below <= placed]
        if not floor:
            raise ValueError(f"rooms import each other in a circle: {', '.join(sorted(set(imports) - placed))}")
        found.append(floor)
        placed |= {*floor}
    return found


def svg() -> str:
    """Return the map as SVG."""
    rows = floors()
    height = _FLOOR * len(rows) + _GAP
    parts, places = list[str](), dict[str, tuple[float, float, float]]()
    for floor, names in enumerate(rows):
        top = height - _FLOOR * (floor + 1)
        widths = [max(10.3 * len(name) + 22, 60) for name in names]
        left = (_WIDTH - sum(widths) - _GAP * (len(names) - 1)) / 2
        for name, width in zip(names, widths, strict=True):
            places[name] = left, top, width
            left += width + _GAP
    for name, below in rooms().items():
        x, y, width = places[name]
        for other in sorted(below):
            to_x, to_y, to_width = places[other]
            ends = f'x1="{x + width / 2:.0f}" y1="{y + _HEIGHT:.0f}" x2="{to_x + to_width / 2:.0f}" y2="{to_y:.0f}"'
            parts.append(f'<line class="{"near" if to_y - y <= _FLOOR else "far"}" {ends}/>')
    for name, (x, y, width) in places.items():
        kind = "core" if name in _CORE else "room"
        parts.append(f'<rect class="{kind}" x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{_HEIGHT}" rx="5"/>')
        parts.append(f'<text x="{x + width / 2:.0f}" y="{y + 22:.0f}"><tspan class="name">{name}</tspan></text>')
    return "\n".join((_HEAD.format(width=_WIDTH, height=height), *parts, "</svg>", ""))


def _files(room: str) -> list[Path]:
    folder = PACKAGE / room
    if not folder.is_dir():
        return [folder.with_suffix(".py")]
    return sorted(folder.rglob("*.py"))


def _imported(room: str) -> set[str]:
    """Return the second parts of the names of the modules that a room imports."""
    found = set[str]()
    for file in _files(room):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "openmm_exactrb":
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("openmm_exactrb."):
                found.add(str(node.module).split(".")[1])
    return found


_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" font-family="sans-serif">
<title>The rooms of the package by floor: each room imports only rooms below it</title>
<style>
rect {{ stroke: #57606a; stroke-width: 1.2 }} .room {{ fill: #f6f8fa }} .core {{ fill: #ffd8a8 }}
text {{ font-size: 15px; text-anchor: middle; fill: #24292f }} .name {{ font-weight: bold }}
line {{ stroke: #8c959f }} .near {{ stroke-width: 1.2 }} .far {{ stroke-width: 0.5; opacity: 0.45 }}
</style>
<rect x="0" y="0" width="{width}" height="{height}" fill="#ffffff" style="stroke: none"/>"""

if __name__ == "__main__":
    PICTURE.write_text(svg(), encoding="utf-8")
