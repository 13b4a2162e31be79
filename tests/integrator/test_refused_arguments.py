"""What integrators refuse: arguments, settings, states, and what is asked of one without a Context."""

from functools import cache, partial

import numpy as np
import openmm
from openmm import app, unit
from test_constraint_types import FIRST_STAYS

import openmm_exactrb as rb
import starts
import three_masses
from every_integrator import unconstrained
from openmm_exactrb.schemes import Scheme, spelled
from openmm_exactrb.steps.substeps import DRIFT
from refusals import assert_refused, for_each, refused, with_options

EVERY = [
    rb.ExactRigidBodyIntegrator,
    partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 1.0),
    partial(rb.ExactRigidBodyRescalingIntegrator, 300.0, 1.0),
    partial(rb.ExactRigidBodyNoseHooverIntegrator, 300.0, 1.0),
    partial(rb.ExactRigidBodyHybridIntegrator, 300.0, 1.0, stepsPerProposal=3),
]


def made():
    return rb.ExactRigidBodyIntegrator(0.002)


@cache
def started():
    """Return the integrator of two molecules of water in a Context."""
    _, system, positions = rb.rigid_water(2)
    integrator = made()
    integrator.context = starts.context_of(system, integrator, positions)
    return integrator


def set_state(change):
    """Set a changed state of the bodies."""
    started().setBodyState(change(started().bodyState()))


def one_step(system, positions):
    integrator = made()
    _context = starts.context_of(system, integrator, positions)
    integrator.step(1)


def without_a_position():
    started().step(1)
    before, context = starts.positions_of(started().context), started().context
    x = before.copy()
    x[4, 1] = np.nan
    context.setPositions(x)
    try:
        started().step(1)
    finally:
        context.setPositions(before)


def alone():
    """A body that diverges without another one that would be its closest."""
    system = three_masses.system()
    force = openmm.CustomExternalForce("1e300*exp(x*1e3)")
    force.addParticle(0, [])
    system.addForce(force)
    one_step(system, three_masses.POSITIONS)


@cache
def held():
    """Return the integrator of two molecules with a constraint of its own, in a Context."""
    _, system, positions = rb.rigid_water(2)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, constraints=[FIRST_STAYS])
    integrator.context = starts.context_of(system, integrator, positions)
    return integrator


@refused(
    *with_options(
        rb.ExactRigidBodyIntegrator,
        {"stepSize": 0.01},
        [
            ({"scheme": "RK4"}, r"scheme 'RK4' is unknown: all names are in openmm_exactrb.SCHEMES$"),
            ({"scheme": "S6_01"}, r"scheme 'S6_01' is unknown: did you mean 'S6_10'\? All names"),
            (
                {"scheme": "W4"},
                r"scheme 'W4' is unknown: did you mean 'W4_4'\? All names are in openmm_exactrb.SCHEMES$",
            ),
            ({"rotor": "euler"}, "the rotor 'euler' is unknown: choose one of exact"),
            ({"stepSize": 1.0 * unit.nanometer}, "is not a time step"),
            ({"stepSize": float("nan")}, "finite number of ps"),
            ({"stepSize": "fast"}, "finite number of ps"),
            ({"stepSize": -0.001}, "a time step must be at least 0"),
        ],
    ),
    *with_options(
        rb.ExactRigidBodyIntegrator,
        {"stepSize": 0.001},
        [
            ({"fast": "angles"}, 'fast must be "auto", None, "bonded" or force groups'),
            ({"fast": (32,)}, 'fast must be "auto", None, "bonded" or force groups'),
            ({"fast": ()}, 'fast must be "auto", None, "bonded" or force groups'),
            ({"fast": 1}, 'fast must be "auto", None, "bonded" or force groups'),
            ({"fast": (0.5,)}, 'fast must be "auto", None, "bonded" or force groups'),
            ({"fast": openmm.NonbondedForce()}, r"call force\.getForceGroup\(\)"),
            ({"fast": (openmm.NonbondedForce(),)}, r"call force\.getForceGroup\(\)"),
            ({"fast": None, "inner": "S2_2"}, "have no effect with fast=None: omit them"),
            ({"fast": None, "innerSteps": 2}, "have no effect with fast=None: omit them"),
            ({"fast": "bonded", "inner": "V2_C17"}, "only of drifts and kicks"),
            ({"fast": "bonded", "innerSteps": 0}, "innerSteps"),
        ],
    ),
    *with_options(
        rb.ExactRigidBodyIntegrator,
        {"stepSize": 0.001},
        [
            *(
                ({"scheme": scheme}, r"a scheme must be a name in openmm_exactrb\.SCHEMES, .* or a Scheme, not")
                for scheme in ((), (DRIFT, 1.0))
            ),
            ({"rotor": np.cross}, "pass a Rotor"),
            ({"checkDivergence": "no"}, "checkDivergence must be True or False, not 'no'"),
            *(
                ({"constraints": wrong}, "constraints must be a sequence of functions, such as")
                for wrong in [unconstrained, "HBonds", openmm.app.HBonds, None, [1], [unconstrained, None], {"z": 0}]
            ),
        ],
    ),
    *(
        row
        for make in EVERY
        for row in with_options(
            make,
            {},
            [
                ({}, "stepSize= is missing"),
                ({"stepSize": 0.002, "forceInterval": 0.002}, "stepSize= and forceInterval= are mutually exclusive"),
            ],
        )
    ),
    (
        lambda: rb.ExactRigidBodyIntegrator(forceInterval=0.002, scheme=Scheme("free", 2, spelled("A"))),
        "evaluates no forces: pass stepSize=",
    ),
    *for_each(
        lambda groups: made().setIntegrationForceGroups(groups),
        "force groups must be a set of integers from 0 to 31, or a bit mask",
        [{32}, {-1}, [0.5], [[1]], 1.5, None, "1", True, 2**33],
    ),
    *for_each(lambda time: made().stepsFor(time), "time", [-1.0, float("nan"), 1.0 * unit.kelvin, "1 ns"]),
    (lambda: rb.ExactRigidBodyIntegrator(0.0).stepsFor(1.0), "the step size is 0"),
    (lambda: rb.ExactRigidBodyIntegrator(1e-300).stepsFor(1e9), "too short for 1e\\+09 ps"),
    (lambda: made().setStepSize(np.array([0.002])), r"finite number of ps, not array\(\[0.002\]\)"),
    (lambda: made().setKineticEnergyExpression("0"), r"has no setKineticEnergyExpression\(\)"),
    (lambda: made().step(1), "no Context yet"),
    *for_each(lambda steps: started().step(steps), "number of steps must be", [-1, 1.5, "ten", None]),
    *for_each(lambda seed: started().setVelocitiesToTemperature(1.0, seed), "randomSeed must be", [-1, 1.5, "one"]),
    (lambda: started().setVelocitiesToTemperature(300.0 * unit.nanometer), "is not a temperature"),
    (lambda: started().setVelocitiesToTemperature(-1.0), "must be at least 0"),
    *(
        (lambda change=change: set_state(change), sentence)
        for change, sentence in [
            (lambda found: found[1]._replace(q=1.1 * found[1].q), "quaternions of unit length"),
            (lambda found: found[1]._replace(q=0.0 * found[1].q), "quaternions of unit length"),
            (lambda found: found[1]._replace(R=found[1].R[:, :1]), r"pass a state such as bodyState\(\)\[1\]"),
            (
                lambda found: found[1]._replace(m=np.full_like(found[1].m, np.nan)),
                r"pass a state such as bodyState\(\)\[1\]",
            ),
            (lambda found: found, r"setBodyState\(\) takes a state such as bodyState\(\)\[1\], not tuple"),
            (lambda found: None, "not NoneType"),
        ]
    ),
    *(
        (partial(rb.separate_bonded, given), rf"takes an openmm\.System.* not {name}")
        for given, name in [(None, "NoneType"), (app.Topology(), "Topology")]
    ),
    (
        lambda: one_step(starts.system_of([0.0]), np.zeros((1, 3))),
        "contains no particle with mass, so nothing can move",
    ),
    (without_a_position, r"body 1 .* not finite"),
    (alone, r"body 0 \(particles 0, 1, 2\)\. The", rb.NonFiniteError),
    (lambda: held().temperatures(groups={"first": range(3)}), r"call temperatures\(\) without groups"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
