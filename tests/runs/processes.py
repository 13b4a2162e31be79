"""Real processes that run a script: they can be killed, get signals and meet limits as those from a shell do."""

import multiprocessing
import os
import runpy
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from forked import FORKED
from openmm_exactrb.runs.signals import ENDING

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
#: On a busy machine a bar would be a second line of errors.
SETTINGS = {"TQDM_DISABLE": "1"}


@dataclass
class Script:
    """A process that runs a script."""

    process: multiprocessing.Process
    errors_file: Path

    @property
    def errors(self):
        return self.errors_file.read_text(encoding="utf-8")

    @property
    def running(self):
        return self.process.is_alive()

    def send(self, number):
        os.kill(self.process.pid, number)

    def status(self, timeout=None):
        """Wait for its end; return the exit status, that of a signal negative."""
        self.process.join(timeout)
        return self.process.exitcode


def launch(errors_file, script, *arguments, before=None):
    """Start a script of the examples; `before` is called in its process."""
    words = [str(EXAMPLES / script), *map(str, arguments)]
    process = FORKED.Process(target=_run, args=(str(errors_file), words, before), daemon=True)
    process.start()
    return Script(process, Path(errors_file))


def finish(errors_file, script, *arguments, before=None):
    """Run a script of the examples to its end; return its exit status and its errors."""
    script = launch(errors_file, script, *arguments, before=before)
    return script.status(), script.errors


def _run(errors_file, words, before):
    os.environ.update(SETTINGS)
    for number in ENDING:  # what starts the tests may have these ignored
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    descriptor = os.open(errors_file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(descriptor, 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    if before is not None:
        before()
    sys.argv[:] = words
    runpy.run_path(words[0], run_name="__main__")
