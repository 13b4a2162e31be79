"""The command from a checkout: python -m openmm_exactrb.command."""

from __future__ import annotations

import sys

from openmm_exactrb.command.main import main

if __name__ == "__main__":
    sys.exit(main())
