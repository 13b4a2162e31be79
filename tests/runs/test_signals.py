"""Signals: the first one is a wish, the second one an order, and an ignored one stays ignored."""

import os
import signal

import pytest
from small_droplets import droplet, go_on, make

from openmm_exactrb.runs import checkpoint
from openmm_exactrb.runs.signals import ENDING, Signals


@pytest.mark.parametrize("number", ENDING)
def test_signal_handlers_are_there_only_while_it_steps(tmp_path, heard, number):
    before = [signal.getsignal(each) for each in ENDING]
    with pytest.raises(SystemExit) as left:
        make(tmp_path).advance(droplet(), 1000, lambda steps: os.kill(os.getpid(), number) if steps else None)
    assert left.value.code == 128 + number
    assert [signal.getsignal(each) for each in ENDING] == before
    assert checkpoint.read(tmp_path / "checkpoint").step == 10


def test_a_second_ctrl_c_ends_at_once_and_loses_only_what_came_after_the_checkpoint(half, heard):
    def impatient(steps):
        for _ in range(2 if steps == 10 else 0):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        make(half, resume=True).advance(droplet(), 60, impatient)
    assert checkpoint.read(half / "checkpoint").step == 33
    go_on(half)


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_that_was_ignored_before_stays_ignored(heard, number):
    """As nohup asks for SIGHUP, and a shell for Ctrl-C of a job in the background."""
    signal.signal(number, signal.SIG_IGN)
    with Signals() as signals:
        for _ in range(2):
            signal.raise_signal(number)
    assert signals.caught == 0
    assert signal.getsignal(number) == signal.SIG_IGN
