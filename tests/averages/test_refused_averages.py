"""What reporters of averages and their theory refuse."""

import copy
from functools import partial

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
from averages.test_chord import cluster, planar
from averages.test_corrections import reporting, rotors, water
from averages.test_reporter import first, ours, reported, simulation_of
from averages.test_virial import OWN_BOX, Springs, Well, gas, pressure_of, python
from integrator.test_constraint_types import FIRST_STAYS
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.step_errors import step_errors
from openmm_exactrb.schemes.thermostatted import with_thermostat
from openmm_exactrb.steps.sequence import spelled
from openmm_exactrb.thermostats import HybridMonteCarlo
from overriding import THERMOSTATS
from refusals import assert_refused, for_each, in_a_folder, refused, with_options

NAME = "an observable cannot have the name"


def made(**options):
    """Create a reporter, which writes nothing before its first frame."""
    return rb.AverageReporter("averages.csv", 2, **options)


def started(**options):
    """Report the first frame."""
    in_a_folder(lambda folder: reported(simulation_of(ours()), folder / "averages.csv", 2, **options))()


LANGEVIN = partial(rb.ExactRigidBodyLangevinIntegrator, temperature=300.0, frictionCoeff=1.0, stepSize=0.002)
PLAIN = partial(rb.ExactRigidBodyIntegrator, 0.002)
TWICE = Scheme("twice", 2, spelled("B A O A B O"))
NO_ERROR = "no step-size error, so there is nothing to correct: omit the AverageReporter"


def openmms(temperature=300.0, friction=1.0, step=0.002):
    return openmm.LangevinMiddleIntegrator(temperature, friction, step)


def atomic():
    """Return a barostat that moves atoms instead of molecules."""
    barostat = openmm.MonteCarloBarostat(1.0, 300.0, 1)
    barostat.setScaleMoleculesAsRigid(False)
    return barostat


def averaged(folder, make, *forces):
    """Report the first frame of water."""
    simulation = water(make(), *forces)
    with reporting(simulation, folder / "averages.csv", 2):
        simulation.step(2)


def other_groups(folder):
    simulation = rotors(openmms(step=0.02))
    with reporting(simulation, folder / "averages.csv", 1):
        simulation.step(1)
        simulation.integrator.setIntegrationForceGroups({1})
        simulation.step(1)


def chain(n=105):
    """Return a chain of atoms that turns by a helix."""
    x = np.array([[0.1 * np.cos(k), 0.1 * np.sin(k), 0.05 * k] for k in range(n)])
    return x, [(k, k + 1) for k in range(n - 1)]


def chords_of(x, pairs):
    cluster([np.linalg.norm(x[i] - x[j]) for i, j in pairs], [12.0] * len(x), pairs, x)


def with_pressure(folder, make):
    pressure_of(gas(make()), folder / "averages.csv")


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
    *(
        (in_a_folder(averaged, make, *map(copy.copy, forces)), sentence)
        for make, forces, sentence in [
            (openmms, [openmm.AndersenThermostat(300.0, 1.0)], "AndersenThermostat, but this integrator"),
            (
                openmms,
                [openmm.MonteCarloBarostat(1.0, 310.0, 1)],
                "the MonteCarloBarostat is 310 K, but that of the integrator is 300 K: call context.setParameter",
            ),
            (openmms, [atomic()], "would change distances within bodies"),
            (
                openmms,
                [openmm.MonteCarloAnisotropicBarostat([1.0] * 3, 300.0)],
                "AnisotropicBarostat: use a MonteCarloBarostat",
            ),
            (partial(openmms, temperature=0.0), [], "only at a temperature above 0 K"),
            (partial(openmms, friction=0.0), [], "create the integrator with a friction above 0"),
            (partial(LANGEVIN, frictionCoeff=0.0), [], "create the integrator with a friction above 0"),
            (partial(LANGEVIN, scheme=TWICE, fast=None), [], "twice cannot be corrected"),
            (partial(LANGEVIN, constraints=[FIRST_STAYS]), [], "create the integrator without constraints="),
            (PLAIN, [], "only for Langevin dynamics: use ExactRigidBodyLangevin"),
            (
                lambda: rb.ExactRigidBodyNoseHooverIntegrator(300.0, 1.0, 0.002),
                [],
                "LangevinMiddleIntegrator instead of Exact",
            ),
            (lambda: openmm.BrownianIntegrator(300.0, 1.0, 0.002), [], "instead of BrownianIntegrator"),
            (lambda: rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.002), [], NO_ERROR),
            (lambda: rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.006, "S2_3", stepsPerProposal=3), [], NO_ERROR),
            (partial(PLAIN, scheme="V2", thermostat=HybridMonteCarlo(300.0, 1.0)), [], NO_ERROR),
        ]
    ),
    *(
        (
            in_a_folder(averaged, partial(PLAIN, thermostat=thermostat)),
            "averages can be corrected only for Langevin dynamics",
        )
        for name, thermostat in THERMOSTATS.items()
        if name.startswith("Langevin")  # which exchange heat in another way
    ),
    (in_a_folder(other_groups), r"the force groups, a parameter of the Context, or .* has changed"),
    *(
        (lambda molecule=molecule: chords_of(*molecule()), sentence)
        for molecule, sentence in [
            (planar, "linear molecules with more than two"),
            (chain, "because 104 constraints join .* of one molecule, but at most .* are supported: create the System"),
        ]
    ),
    *(
        (
            in_a_folder(with_pressure, make),
            r"\(force 2\) does not follow the periodic box of the Context, .* or create .* with pressure=False",
        )
        for make in OWN_BOX.values()
    ),
    *(
        (
            in_a_folder(with_pressure, python(function, local=True)),
            r"cannot be copied, .* top level of a module, .* a force group of its own",
        )
        for function in (Well(), Springs())
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
