"""Bars and clocks of stages on a terminal, which appear after a moment, and not at all without tqdm or with --quiet."""

import contextlib
import io
import sys
import time

import pytest

from openmm_exactrb.command.progress import counted, waiting


class Terminal(io.StringIO):
    def isatty(self):
        return True


def stages(quiet):
    """Return what two stages show."""
    with contextlib.redirect_stderr(Terminal()) as shown:
        with waiting("minimising", quiet):
            time.sleep(0.6)
        with counted("equilibrating", 10, "fs", quiet) as tell:
            for _ in range(2):
                time.sleep(0.3)
                tell(5)
    return shown.getvalue()


def test_stages_have_a_clock_or_a_bar():
    shown = stages(quiet=False)
    assert "minimising: 00:0" in shown
    assert "equilibrating: 100%" in shown


def test_a_stage_that_ends_at_once_is_not_shown():
    with contextlib.redirect_stderr(Terminal()) as shown, waiting("compiling", quiet=False):
        pass
    assert "compiling" not in shown.getvalue()


def test_nothing_is_shown_if_quiet_or_without_tqdm(monkeypatch):
    assert stages(quiet=True) == ""
    monkeypatch.setitem(sys.modules, "tqdm", None)
    assert stages(quiet=False) == ""


def test_a_stage_that_fails_ends_its_clock():
    with contextlib.redirect_stderr(Terminal()) as shown:
        with pytest.raises(ValueError, match="no"), waiting("minimising", quiet=False):
            raise ValueError("no")
        before = shown.getvalue()
        time.sleep(0.5)
    assert shown.getvalue() == before
