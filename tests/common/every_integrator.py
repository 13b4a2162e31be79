"""Integrators with another value for each argument, and the ways in which integrators are copied."""

import copy
import pickle

import numpy as np
import openmm

import openmm_exactrb as rb
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from starts import context_of, system_of

THERMOSTATS = [
    Langevin(300.0, 2.0, 3.0, flexibleFriction=4.0),
    Langevin(310.0, 2.0),
    StochasticRescaling(300.0, 0.5),
    NoseHooverChain(300.0, 20.0, 4),
    HybridMonteCarlo(300.0, 1.0, stepsPerProposal=2),
]


def unconstrained(free, bodies):
    """Return the free motion: a type of constraint that constrains nothing."""
    return free


# Other values of the arguments that all classes have.
_COMMON = {
    "stepSize": [0.003],
    "scheme": ["S2_2", "V2"],
    "rotor": ["exact_numpy", "dmv8"],
    "bodies": [[[0, 1, 2]], [[3, 4, 5], [0, 1, 2]]],
    "fast": [None, "bonded", (1, 7)],
    "inner": ["V2", "SRKN4_6b"],
    "innerSteps": [7],
    "engine": ["host"],
    "forceInterval": [0.0035],
    "checkDivergence": [False],
    "constraints": [(unconstrained,)],
}
_TEMPERATURES = {"temperature": [310.0]}
_FRICTIONS = {"frictionCoeff": [0.1 + 0.2], "rotationalFriction": [1.0, 3.0], "flexibleFriction": [1.0, 4.0]}
_CHAINS = {"collisionFrequency": [25.0], "chainLength": [4], "numMTS": [2], "numYoshidaSuzuki": [5], "together": [True]}
# The arguments that each class needs, and other values of its own arguments.
_OWN = {
    rb.ExactRigidBodyIntegrator: ({}, {"thermostat": THERMOSTATS, "scheme": ["V2", "SABA_3", "W4_4"]}),
    rb.ExactRigidBodyLangevinIntegrator: (
        {"temperature": 300.0, "frictionCoeff": 1.0},
        _TEMPERATURES | _FRICTIONS | {"scheme": ["W2_3m", "BAOAB", "S2_2"]},
    ),
    rb.ExactRigidBodyRescalingIntegrator: (
        {"temperature": 300.0, "relaxationTime": 0.5},
        _TEMPERATURES | {"relaxationTime": [0.7], "together": [False]},
    ),
    rb.ExactRigidBodyNoseHooverIntegrator: (
        {"temperature": 300.0, "collisionFrequency": 20.0},
        _TEMPERATURES | _CHAINS,
    ),
    rb.ExactRigidBodyHybridIntegrator: (
        {"temperature": 300.0, "frictionCoeff": 1.0},
        _TEMPERATURES | _FRICTIONS | {"stepsPerProposal": [2], "scheme": ["V2"]},
    ),
}
KINDS = list(_OWN)


def others(kind):
    """Return another value for each argument of a class, as pairs of a name and a value."""
    values = _COMMON | _OWN[kind][1]
    return [(name, value) for name in values for value in values[name]]


def made(kind=rb.ExactRigidBodyIntegrator, **arguments):
    """Return an integrator of a class, with the arguments that it needs and these."""
    if "forceInterval" not in arguments:
        arguments = {"stepSize": 0.002} | arguments
    return kind(**(_OWN[kind][0] | arguments))


def every():
    """Return the integrators of all classes with each of the other values."""
    return [made(kind, **{name: value}) for kind in KINDS for name, value in others(kind)]


#: The ways in which Python and OpenMM copy an integrator.
WAYS = {
    "clone": openmm.XmlSerializer.clone,
    "XML": lambda one: openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(one)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}

WATER = rb.rigid_water(8)[1:]


def _diatomics():
    """Return a System of four diatomic molecules with stiff bonds, and positions."""
    system, bonds, pairs = system_of([14.0] * 8), openmm.HarmonicBondForce(), openmm.NonbondedForce()
    for _ in range(8):
        pairs.addParticle(0.0, 0.3, 0.5)
    for i in range(0, 8, 2):
        bonds.addBond(i, i + 1, 0.11, 3e5)
        pairs.addException(i, i + 1, 0.0, 1.0, 0.0)
    system.addForce(bonds)
    system.addForce(pairs)
    return system, np.array([[0.4 * (i // 2), 0.12 * (i % 2), 0.05 * i] for i in range(8)])


DIATOMICS = _diatomics()
#: Integrators of all kinds of dynamics, and what they move.
MOVING = {
    "default": (made(), WATER),
    "thermostat": (made(thermostat=Langevin(310.0, 3.0), scheme="W2_3m"), WATER),
    "bodies": (made(bodies=[[0, 1, 2, 3, 4, 5]], rotor="dmv8"), WATER),
    "inner": (made(fast="bonded", inner="V2", innerSteps=6, scheme="S2_2"), DIATOMICS),
    **{kind.__name__: (made(kind), WATER) for kind in KINDS[1:]},
}


def seeded(integrator, **arguments):
    """Return a new integrator with the arguments of another, these arguments, and a seed."""
    new = type(integrator)(**(integrator.getSettings()["arguments"] | arguments))
    new.setRandomNumberSeed(7)
    return new


def begun(name, integrator, platform, properties):
    """Return the Context of an integrator that moves what the integrator of this name in `MOVING` moves."""
    system, start = MOVING[name][1]
    return context_of(system, integrator, start, kelvin=300.0, platform=platform, properties=properties)


def ends(name, integrator, platform, properties):
    """Return positions and velocities after some steps from the start."""
    context = begun(name, integrator, platform, properties)
    integrator.step(4)
    state = context.getState(positions=True, velocities=True)
    return np.array([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value])
