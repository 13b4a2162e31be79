"""Tables of what is refused: what is tried, and the sentence with which it is."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest


def refused(*rows):
    """Parametrise a test by rows of a function without arguments, a pattern of the sentence, and maybe an error."""
    cases = [(call, sentence, *(error or [ValueError])) for call, sentence, *error in rows]
    return pytest.mark.parametrize(("call", "sentence", "error"), cases, ids=[case[1][:60] for case in cases])


def with_options(function, defaults, rows):
    """Return the rows of a function that is called with these options, or with others, which are given by name."""
    return [(partial(function, **defaults | options), sentence, *error) for options, sentence, *error in rows]


def assert_refused(call, sentence, error):
    """Assert that a call raises an error with a sentence."""
    with pytest.raises(error, match=sentence):
        call()


def for_each(function, sentence, values):
    """Return the rows of a function of one argument, each value of which is refused with the same sentence."""
    return [(partial(function, value), sentence) for value in values]


def in_a_folder(function, *arguments, **options):
    """Return a function without arguments, which calls another with an empty folder and these arguments."""

    def call():
        with TemporaryDirectory() as folder:
            function(Path(folder), *arguments, **options)

    return call
