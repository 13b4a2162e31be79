"""The command as a process of its own, as from a shell."""

import os
import subprocess
import sys

from openmm_exactrb import kernels

COMMAND = [sys.executable, "-m", "openmm_exactrb.command.main"]
#: In numpy each starts sooner.
ENVIRONMENT = os.environ | {kernels.SWITCH: "0", "OPENMM_CPU_THREADS": "1"}


def launch(*arguments):
    """Start the command."""
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(*arguments):
    """Run the command to its end; return its exit status, output and errors."""
    process = launch(*arguments)
    out, errors = process.communicate()
    return process.returncode, out, errors
