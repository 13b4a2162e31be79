"""Check the prose of the documentation and of the package's docstrings and messages against `words.toml`."""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORDS = tomllib.loads((Path(__file__).parent / "words.toml").read_text(encoding="utf-8"))
RULES = [
    (re.compile(rf"\b(?:{pattern})\b".replace(" ", r"\s+"), re.IGNORECASE), advice)
    for pattern, advice in WORDS["instead"].items()
]
# Blocks of code, formulas, and pieces of code and addresses of links within a line.
CODE = re.compile(r"^(```|\$\$).*?^\1$|`[^`]*`|\]\([^)]*\)|<[^>\s]*>", re.MULTILINE | re.DOTALL)


def files() -> list[Path]:
    """Return the files with prose of ours that are not in `unchecked`."""
    generated = ROOT / "docs" / "examples", ROOT / "docs" / "_build"
    found = {ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")}
    found |= set((ROOT / "openmm_exactrb").rglob("*.py"))
    skipped = {file for pattern in WORDS["unchecked"] for file in ROOT.glob(pattern)}
    return sorted(file for file in found - skipped if not {*generated} & {*file.parents})


def prose(file: Path) -> Iterator[tuple[int, str]]:
    """Yield prose with the line where it begins: a page without its code, or each docstring, message and comment."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        yield 1, CODE.sub(lambda found: "\n" * found[0].count("\n"), text)
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, CODE.sub(lambda found: "\n" * found[0].count("\n"), node.value)
    yield from comments(text)


def comments(text: str) -> Iterator[tuple[int, str]]:
    """Yield blocks of comments without their signs, and the line where each begins."""
    first, lines, last = 0, [], -2
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT:
            continue
        line = token.start[0]
        if line != last + 1:
            yield first, "\n".join(lines)
            first, lines = line, []
        lines.append(CODE.sub("", token.string.lstrip("#: ")))
        last = line
    yield first, "\n".join(lines)


def faults(file: Path) -> Iterator[str]:
    """Yield a line for each word that has a better one."""
    for first, text in prose(file):
        for pattern, advice in RULES:
            for found in pattern.finditer(text):
                line = first + text.count("\n", 0, found.start())
                word = " ".join(found[0].split())
                yield f"{file.relative_to(ROOT)}:{line}: instead of {word!r} write {advice}"


def main() -> None:
    """Print the faults of all files, and fail if there are any."""
    if found := sorted(line for file in files() for line in faults(file)):
        sys.exit("\n".join(found))


if __name__ == "__main__":
    main()
