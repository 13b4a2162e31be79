"""What sphinx-gallery asks for by name."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any


def arguments(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """Return the arguments of an example: those of the command that its own text shows."""
    script = Path(script_vars["src_file"])
    shown = re.search(rf"``python examples/{script.name} (.+?)``", script.read_text(encoding="utf-8"))
    return [*shlex.split(shown[1]), "--overwrite"] if shown else []
