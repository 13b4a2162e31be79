"""The command as a process of its own, as from a shell."""

import os
import subprocess
import sys

import compilation

COMMAND = [sys.executable, "-m", "openmm_exactrb.command.main"]
ENVIRONMENT = os.environ | {"OPENMM_CPU_THREADS": "1"}


def launch(*arguments):
    """Start the command, which finds the library compiled: else it would say that it compiles it."""
    compilation.of_library()
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(*arguments):
    """Run the command to its end; return its exit status, output and errors."""
    process = launch(*arguments)
    out, errors = process.communicate()
    return process.returncode, out, errors
