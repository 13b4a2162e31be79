"""What jobs and ensembles refuse."""

from functools import partial

import numpy as np
from job_functions import SHORT, Multiple, Other, disguised, energies, square
from openmm import unit

from openmm_exactrb import ensemble
from openmm_exactrb.ensemble import Job
from refusals import assert_refused, in_a_folder, refused

NO_FUNCTION, NO_ARGUMENT = "module-level function", "argument x of a job cannot contain an object of type {}"


def run(folder, **options):
    ensemble.run(**{"jobs": [Job(square, x=1)], "folder": folder, "progress": False} | options)


@refused(
    *(
        (in_a_folder(run, **options), sentence, error)
        for options, error, sentence in [
            ({"jobs": [square]}, TypeError, "jobs must be Job objects, not the function square"),
            ({"workers": 0}, ValueError, "workers must be a whole number of at least 1, not 0"),
            ({"workers": 1, "scheduler": "tcp://node:1"}, ValueError, "scheduler= and workers= are mutually exclusive"),
            ({"scheduler": 8786}, ConnectionError, "no dask scheduler answers at 8786"),
            ({"scheduler": "nonsense://node:1"}, ConnectionError, "no dask scheduler answers at 'nonsense://node:1'"),
        ]
    ),
    *(
        (partial(Job, function, **arguments), sentence, TypeError)
        for function, arguments, sentence in [
            (lambda: 1, {}, NO_FUNCTION),
            ("square", {}, NO_FUNCTION),
            (square, {"y": 1}, "missing a required argument: 'x'"),
            (square, {"x": object()}, NO_ARGUMENT.format("object")),
            (square, {"x": {1, 2}}, NO_ARGUMENT.format("set")),
            (Multiple(3).of, {"x": 1}, NO_FUNCTION),
            (Other.named, {"x": 1}, NO_FUNCTION),  # its name is Multiple.named
            (disguised, {"x": 1}, NO_FUNCTION),
            (square, {"x": Multiple(3).of}, NO_ARGUMENT.format("method")),
            (square, {"x": disguised}, NO_FUNCTION),
            (square, {"x": np.ma.array([1, 2], mask=[0, 1])}, NO_ARGUMENT.format("MaskedArray")),
            (square, {"x": np.ma.array([1], mask=[1]) * unit.nanometer}, NO_ARGUMENT.format("MaskedArray")),
        ]
    ),
    (lambda: ensemble.sweep(square, {"x": "V2"}), "axis x must be a list of values, not 'V2'", TypeError),
    (lambda: ensemble.sweep(energies, {"seed": range(3)}, **SHORT, seed=1), "seed", TypeError),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
