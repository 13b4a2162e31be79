"""Checkpoints and States that an integrator cannot read."""

from functools import partial

import openmm
from test_nose_hoover_state import langevin
from test_states import OURS, THEIRS, water

import openmm_exactrb as rb
from chains import nose_hoover
from refusals import assert_refused, refused
from starts import droplet_of, simulation_of

ANOTHER = "is from another kind of integrator"


def numbers_of_another(use):
    """Positions and velocities are the same, and only the numbers of the integrator are those of another."""
    run, other = droplet_of(nose_hoover()), droplet_of(langevin())
    other.integrator.step(3)
    state = other.context.getState(positions=True, velocities=True)
    run.context.setPositions(state.getPositions(asNumpy=True))
    run.context.setVelocities(state.getVelocities(asNumpy=True))
    run.integrator.temperatures()
    run.context.loadCheckpoint(other.context.createCheckpoint())
    use(run.integrator)


def checkpoint_of_openmms():
    theirs, run = droplet_of(openmm.LangevinMiddleIntegrator(30.0, 2.0, 1e-4)), droplet_of(nose_hoover())
    theirs.step(2)
    run.integrator.step(1)
    run.context.loadCheckpoint(theirs.context.createCheckpoint())
    run.integrator.step(1)


def state_of_another():
    first, second = water(OURS["W2_1"]()), water(OURS["NoseHoover"]())
    first.step(2)
    second.context.setState(first.context.getState(positions=True, velocities=True, integratorParameters=True))
    second.step(1)


def state_of(n, integrator, parameter=None, **content):
    """Return a State of water, whose Context has maybe a parameter of its own."""
    topology, system, positions = rb.rigid_water(n)
    if parameter:
        force = openmm.CustomExternalForce(f"{parameter}*x")
        force.addGlobalParameter(parameter, 1.0)
        system.addForce(force)
    return simulation_of(topology, system, integrator, positions).context.getState(positions=True, **content)


@refused(
    (partial(numbers_of_another, lambda integrator: integrator.effectiveEnergy()), ANOTHER),
    (partial(numbers_of_another, lambda integrator: integrator.setVelocitiesToTemperature(30.0)), ANOTHER),
    (checkpoint_of_openmms, ANOTHER),
    (state_of_another, "from another kind of integrator"),
    # Errors of OpenMM, and so are those of its own integrators.
    *(
        (
            lambda n=n, options=options, ours=ours, data=data: water(ours()).context.setState(
                state_of(n, THEIRS["Verlet"](), integratorParameters=data, **options)
            ),
            sentence,
            openmm.OpenMMException,
        )
        for n, options, ours, every, sentence in [
            (8, {"parameter": "pull", "parameters": True}, OURS["S2_2"], (False, True), "pull"),
            (9, {}, OURS["S2_2"], (False, True), "wrong number of positions"),
            (8, {}, THEIRS["Custom"], (True,), "Unknown property 'version'"),
        ]
        for data in every
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
