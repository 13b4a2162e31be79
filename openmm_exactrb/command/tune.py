"""The subcommand ``exactrb tune``: `openmm_exactrb.tune` for files."""

from __future__ import annotations

from openmm_exactrb.tuning.command import PURPOSE, add_options, carry_out

__all__ = ["PURPOSE", "add_options", "carry_out"]
