import os
import signal

import pytest
from small_droplets import droplet, make

from openmm_exactrb.runs.signals import ENDING

#: Accidents are signals of POSIX, and need processes that are forked.
collect_ignore_glob = ["*"] if os.name == "nt" else []


@pytest.fixture
def half(tmp_path):
    """A run stopped at step 33 of 60, and one that was not."""
    make(tmp_path / "half").advance(droplet(), 33)
    make(tmp_path / "whole").advance(droplet(), 60)
    return tmp_path / "half"


@pytest.fixture
def heard():
    """Have this process hear the signals that end it, also if what started it had them ignored, as nohup does."""
    before = [(number, signal.getsignal(number)) for number in ENDING]
    for number in ENDING:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield
    for number, handler in before:
        signal.signal(number, handler)
