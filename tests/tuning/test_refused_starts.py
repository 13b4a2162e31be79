"""What tunings refuse: arguments, starts, and promises that were not measured."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import openmm
from equilibrium import equilibrated
from openmm import unit
from test_advice import recorded
from test_benchmark import PLENTY, at_rest, made

import openmm_exactrb as rb
from openmm_exactrb import schemes, tuning
from openmm_exactrb.tuning.benchmark import Method
from openmm_exactrb.tuning.initial_state import initial_state, others, thermalised
from refusals import assert_refused, refused, with_options
from starts import context_of


@cache
def droplet():
    """Return System and State of two TIP3P molecules."""
    _, system, positions = rb.rigid_water(2)
    return system, equilibrated(system, positions, picoseconds=0.1)


def tuned(**options):
    system, start = droplet()
    rb.tune(**({"system": system, "start": start, "platform": "Reference"} | options))


def from_state(**content):
    system, state = droplet()
    tuned(start=context_of(system, openmm.VerletIntegrator(0.001), state.getPositions()).getState(**content))


def with_a_thermostat():
    bench = made(*droplet())
    bench.run(Method(schemes.Scheme("strange", 2, schemes.spelled("A O A"))), 0.001, 0.1, bench.state)


def flying_apart():
    """Bodies that a potential without a minimum drives outwards become ever faster."""
    _, system, positions = rb.rigid_water(2)
    outwards = openmm.CustomExternalForce("-50000*x^2")
    for i in range(0, 6, 3):
        outwards.addParticle(i)
    system.addForce(outwards)
    thermalised(at_rest(system, positions._value + np.array([0.5, 0.0, 0.0])), 300.0, 1, False, PLENTY)


def with_a_force_of_its_own():
    """Its function is not at the top level of a module."""
    _, system, positions = rb.rigid_water(2)
    system.addForce(openmm.PythonForce(lambda _: (0.0, np.zeros((6, 3)))))
    tuned(system=system, start=positions)


def beside_a_wall():
    """No step is short enough for it."""
    system, force = openmm.System(), openmm.CustomExternalForce("x+1e14*step(x-1e-7)*(x-1e-7)^2")
    system.addParticle(18.0)
    force.addParticle(0)
    system.addForce(force)
    begin, _ = initial_state(system, np.zeros((1, 3)), np.full((1, 3), 0.3), "Reference")
    others(begin, 2, 0)


@refused(
    *with_options(
        tuned,
        {},
        [
            ({"start": None}, "start= is missing"),
            ({"start": np.zeros((3, 3))}, r"the shape \(6, 3\), not \(3, 3\)"),
            ({"start": np.full((6, 3), np.nan)}, "positions must be finite"),
            ({"start": "water.pdb"}, "positions must be numbers"),
            ({"velocities": np.zeros((6, 3))}, "all velocities of the start are zero"),
            ({"velocities": np.ones((6, 3)) * unit.nanometer}, "velocities must be numbers"),
            ({"target": 0.0}, "target must be a positive number"),
            ({"target": "small"}, "target must be a positive number"),
            ({"duration": -1.0}, "duration must be a positive number"),
            ({"budget": 0.0}, "budget must be a positive number of s"),
            ({"horizon": 0.0}, "horizon must be a positive number"),
            ({"horizon": 30.0 * unit.kelvin}, "horizon must be a positive number"),
            ({"temperature": math.inf}, "temperature must be a positive number"),
            ({"levels": 0}, "levels must be a whole number"),
            ({"schemes": []}, "schemes must contain at least one scheme"),
            ({"schemes": ["RK4"]}, "scheme 'RK4' is unknown"),
            ({"schemes": ["V2", replace(rb.SCHEMES["S2_2"], name="V2")]}, "has the name of another method, 'V2'"),
            ({"schemes": replace(rb.SCHEMES["S2_2"], name="VerletIntegrator")}, "of another method"),
            ({"platform": "Abacus"}, "platform 'Abacus' is not available"),
            ({"system": "system.xml"}, "must be an openmm.System or a Simulation"),
        ],
    ),
    (lambda: from_state(energy=True), "the State contains no positions"),
    (lambda: from_state(positions=True), "all velocities of the start are zero"),
    (with_a_thermostat, "contains a thermostat, but the integrator has none"),
    (with_a_force_of_its_own, "define the function of each PythonForce at the top level of a module"),
    (flying_apart, "300 K was not reached from the given start"),
    (beside_a_wall, r"every short run at .* K from the given start diverges: minimise"),
    (
        recorded(target=1e-2, points=(tuning.Point("V2", 0.006, 9e-3, 1.0, 1.0),)).best,
        r"not confirmed within the budget: .* is 0.009",
        tuning.UnreachableError,
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
