"""What thermostats and their integrators refuse."""

import math
from functools import partial

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, KICK
from openmm_exactrb.thermostats import HybridMonteCarlo, NoseHooverChain
from openmm_exactrb.thermostats.langevin import ornstein_uhlenbeck
from openmm_exactrb.thermostats.rescaling import rescaling
from refusals import assert_refused, for_each, refused, with_options
from starts import droplet_of, simulation_of

LANGEVIN = {"temperature": 300.0, "frictionCoeff": 2.0, "stepSize": 0.002}
RESCALING = {"temperature": 300.0, "relaxationTime": 1.0, "stepSize": 0.002}
LOPSIDED = Scheme("Euler", 1, ((DRIFT, 1.0), (KICK, 1.0)))
AT_REST = np.zeros((1, 3, 1)), np.zeros((1, 3, 1))


def with_drawn_momenta(integrator):
    topology, system, positions = rb.dipole_fluid(8, seed=1)
    simulation = simulation_of(topology, system, integrator, positions)
    simulation.reporters.append(rb.CanonicalMomenta(300.0, 10))
    simulation.step(1)


def with_a_second_thermostat():
    simulation = droplet_of(rb.ExactRigidBodyLangevinIntegrator(**LANGEVIN))
    simulation.system.addForce(openmm.AndersenThermostat(300.0, 1.0))
    simulation.context.reinitialize(preserveState=True)
    simulation.integrator.step(1)


@refused(
    *(
        (partial(rb.ExactRigidBodyLangevinIntegrator, *arguments), sentence)
        for arguments, sentence in [
            ((-1.0, 1.0, 0.002), "a temperature must be at least 0"),
            ((math.nan, 1.0, 0.002), "a temperature must be a finite number of K"),
            ((300.0, -1.0, 0.002), "a friction must be at least 0"),
            ((300.0, math.inf, 0.002), "a friction must be a finite number of 1/ps"),
            ((300.0, 1.0 * unit.picosecond, 0.002), "is not a friction: pass a number in 1/ps"),
            ((1.0 * unit.picosecond**-1, 300.0, 0.002), "is not a temperature: pass a number in K"),
        ]
    ),
    *with_options(
        rb.ExactRigidBodyLangevinIntegrator,
        LANGEVIN,
        [
            ({"rotationalFriction": -2.0}, "must be at least 0"),
            (
                {"scheme": "OBABO"},
                r"scheme 'OBABO' is unknown: did you mean 'BAOA'\? All names are in .*SCHEMES and .*WITH_THERMOSTAT",
            ),
            ({"scheme": "V2_C17"}, "V2_C17 runs in inner coordinates"),
        ],
    ),
    *(
        (lambda seed=seed: rb.ExactRigidBodyLangevinIntegrator(**LANGEVIN).setRandomNumberSeed(seed), sentence)
        for seed, sentence in [(-1, "the seed must be a whole number of at least 0"), (2**31, r"must be below 2\^31")]
    ),
    *with_options(
        rb.ExactRigidBodyRescalingIntegrator,
        RESCALING,
        [
            ({"relaxationTime": 0.0}, "a relaxation time must be a positive number of ps"),
            ({"together": "no"}, "together must be True or False, not 'no'"),
        ],
    ),
    *with_options(
        rb.ExactRigidBodyHybridIntegrator,
        LANGEVIN,
        [
            ({"temperature": 0.0}, "the temperature of the Metropolis test must be a positive number"),
            ({"scheme": "BAOAB"}, "BAOAB contains a thermostat"),
            ({"stepsPerProposal": 0}, "stepsPerProposal must be a whole number"),
            ({"scheme": LOPSIDED}, "Euler is not symmetric in time"),
            (
                {"fast": "bonded", "inner": LOPSIDED, "innerSteps": 3},
                "the inner scheme Euler is not symmetric in time, but proposals must be",
            ),
            ({"fast": "bonded", "inner": LOPSIDED}, "inner scheme"),
        ],
    ),
    (
        lambda: rb.ExactRigidBodyIntegrator(
            0.002, thermostat=HybridMonteCarlo(300.0, 1.0), fast="bonded", inner=LOPSIDED
        ),
        "inner scheme",
    ),
    *with_options(
        rb.ExactRigidBodyNoseHooverIntegrator,
        {"temperature": 300.0, "collisionFrequency": 1.0, "stepSize": 0.002},
        [
            ({"temperature": 0.0}, "a temperature and a collision frequency above zero"),
            ({"temperature": -1.0}, "a temperature must be at least 0"),
            ({"collisionFrequency": 0.0}, "a temperature and a collision frequency above zero"),
            ({"collisionFrequency": -1.0}, "a temperature and a collision frequency above zero"),
            ({"collisionFrequency": math.inf}, "a collision frequency must be a finite number"),
            ({"collisionFrequency": 1.0 * openmm.unit.picosecond}, "is not a collision frequency"),
            ({"chainLength": 0}, "chainLength must be a whole number of at least 1"),
            ({"chainLength": 2.5}, "chainLength must be a whole number"),
            ({"numMTS": 0}, "numMTS must be a whole number of at least 1"),
            ({"numYoshidaSuzuki": 2}, "must be one of 1, 3, 5 and 7, not 2"),
            ({"numYoshidaSuzuki": [3]}, "numYoshidaSuzuki must be a whole number"),
            ({"together": 1}, "together must be True or False, not 1"),
            ({"scheme": "V2_C17"}, "V2_C17 runs in inner coordinates"),
        ],
    ),
    *for_each(
        lambda thing: rb.ExactRigidBodyIntegrator(0.002, thermostat=thing),
        r"thermostat must be a Thermostat such as Langevin\(300, 1\), not",
        ["Langevin", 300.0, rb.ExactRigidBodyLangevinIntegrator(**LANGEVIN)],
    ),
    *for_each(
        partial(rb.CanonicalMomenta, 1.0),
        "reportInterval must be a whole number of steps of at least 1",
        [0, -1, 2.5, None],
    ),
    *(
        (partial(rb.CanonicalMomenta, *arguments), sentence)
        for arguments, sentence in [
            ((-5.0, 10), "a temperature must be at least 0"),
            ((float("nan"), 10), "a temperature must be a finite number"),
            (("warm", 10), "a temperature must be a finite number"),
            ((300.0, 10, -1), "the seed must be a whole number of at least 0"),
            ((300.0, 10, 1.5), "the seed must be a whole number of at least 0"),
        ]
    ),
    (
        lambda: ornstein_uhlenbeck(np.ones(1), np.ones((3, 1)), 2.5, 1.0, 3.0)(*AT_REST, -0.1, None),
        "stepSize must be positive when friction is non-zero",
    ),
    (
        lambda: rescaling(np.ones(1), np.ones((3, 1)), 2.5, 0.7, (3, 3), True)(*AT_REST, -0.1, None),
        "stepSize must be positive with a thermostat",
    ),
    *(
        (
            lambda integrator=integrator: with_drawn_momenta(integrator),
            f"without a thermostat, but this Simulation uses {type(integrator).__name__}",
        )
        for integrator in [
            rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.01),
            rb.ExactRigidBodyIntegrator(0.01, thermostat=NoseHooverChain(300.0, 1.0)),
            openmm.VerletIntegrator(0.001),
        ]
    ),
    (with_a_second_thermostat, "AndersenThermostat, but this integrator also has a thermostat"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
