"""What reporters of averages and their theory refuse."""

from pathlib import Path
from tempfile import TemporaryDirectory

from openmm import unit

import openmm_exactrb as rb
from averages.test_reporter import first, ours, reported, simulation_of
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.step_errors import step_errors
from openmm_exactrb.schemes.thermostatted import with_thermostat
from openmm_exactrb.steps.sequence import spelled
from refusals import assert_refused, for_each, refused, with_options

NAME = "an observable cannot have the name"


def made(**options):
    """Create a reporter, which writes nothing before its first frame."""
    return rb.AverageReporter("averages.csv", 2, **options)


def started(**options):
    """Report the first frame."""
    with TemporaryDirectory() as folder:
        reported(simulation_of(ours()), Path(folder) / "averages.csv", 2, **options)


@refused(
    *for_each(
        lambda name: made(observables={name: first}),
        NAME,
        ["volume", "potential", "potential energy", "density", "pressure slope", "frame", "a,b", "d (D)", " a", ""],
    ),
    (lambda: made(observables={"a": first, "volume": first}), f"{NAME} 'volume'"),
    (lambda: made(observables={"a": first, "a slope": first}), f"{NAME} 'a'"),
    *with_options(
        made,
        {},
        [
            ({"observables": [first]}, "observables must be a mapping from names to functions of the positions, not"),
            ({"observables": {"a": 1.0}}, "not a mapping that contains 'a': 1.0"),
            ({"observables": {1: first}}, "not a mapping that contains 1: "),
            ({"append": "no"}, "append must be True or False"),
            ({"around": 5}, r"around= must be a tuple of particle indices and a distance in nm, .*, not 5"),
            (
                {"around": ([0], 1, 2)},
                r"around= must be a tuple of particle indices and a distance in nm, such as \(\[0, 1, 2\], 0\.5\), not",
            ),
            (
                {"around": ([], 0.5)},
                r"the particles of around= must be a list of particle indices, such as \[0, 1, 2\], not",
            ),
            (
                {"around": ([-1], 0.5)},
                r"the particles of around= must be a list of particle indices, such as \[0, 1, 2\], not",
            ),
            (
                {"around": ([0.5], 0.5)},
                r"the particles of around= must be a list of particle indices, such as \[0, 1, 2\], not",
            ),
            ({"around": ([0], -1.0)}, "the distance of around= must be a positive number"),
        ],
    ),
    (lambda: started(around=([3], 0.5)), "the particles of around= must be numbers from 0 to 2, not 3"),
    *for_each(
        lambda value: started(observables={"mine": lambda x: value}),
        "the observable 'mine' must be a finite number, not",
        [float("nan"), None, [1.0], "1", 1.0 * unit.nanometer],
    ),
    *for_each(
        step_errors,
        "cannot be corrected, because the theory needs a single heat exchange",
        [
            Scheme("two exchanges", 2, spelled("B A O A B O")),
            Scheme("lopsided", 2, spelled("B O A")),
            Scheme("by groups", 2, spelled("B1 A O A B1")),
            with_thermostat(rb.SCHEMES["W2_1"]),
        ],
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
