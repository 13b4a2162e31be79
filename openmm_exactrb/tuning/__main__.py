"""The command: python -m openmm_exactrb.tuning system.xml state.xml --target 1e-4."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from openmm_exactrb.tuning import command


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune for serialised System and State; return the exit status, 1 if the target is not reached."""
    parser = argparse.ArgumentParser(prog="python -m openmm_exactrb.tuning", description=command.PURPOSE)
    command.add_options(parser)
    args = parser.parse_args(arguments)
    try:
        return command.carry_out(args)
    except command.ERRORS as error:
        print(f"tune: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
