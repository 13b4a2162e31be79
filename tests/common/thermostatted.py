"""Systems at a thermostat whose distributions are known, as OpenMM runs them."""

import copy

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
import starts
from openmm_exactrb.schemes import scheme_for_thermostat
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.substeps import DRIFT
from places import platform_for

R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
KT = 300.0 * R


def molecules(waters=0, rods=0, ions=0):
    """Return a System of rigid water (moments of TIP3P), rods of two masses and single particles, without forces."""
    system, places = openmm.System(), []
    angle = np.radians(104.52) / 2.0
    half, height = 0.09572 * np.sin(angle), 0.09572 * np.cos(angle)
    for _ in range(waters):
        o, h1, h2 = (system.addParticle(mass) for mass in (15.9994, 1.008, 1.008))
        system.addConstraint(o, h1, 0.09572)
        system.addConstraint(o, h2, 0.09572)
        system.addConstraint(h1, h2, 2.0 * half)
        places += [(0.0, 0.0, 0.0), (half, 0.0, height), (-half, 0.0, height)]
    for _ in range(rods):
        system.addConstraint(system.addParticle(14.0), system.addParticle(16.0), 0.11)
        places += [(0.0, 0.0, 0.0), (0.0, 0.0, 0.11)]
    for _ in range(ions):
        system.addParticle(23.0)
        places.append((0.0, 0.0, 0.02))
    return system, np.array(places)


def dipoles_in_a_field(n, x):
    """Return a System of n water molecules, each with the energy -x kT cos(theta), and positions along the field."""
    system, places = molecules(waters=n)
    field = openmm.CustomExternalForce("-strength*charge*z")
    height = places[1, 2]
    field.addGlobalParameter("strength", x * KT / (2.0 * height))
    field.addPerParticleParameter("charge")
    for i in range(3 * n):
        field.addParticle(i, [-2.0 if i % 3 == 0 else 1.0])
    system.addForce(field)
    return system, places


def trapped(waters, rods, ions, strength=1e4):
    """Return a System of molecules whose particles are all drawn to a plane, and positions."""
    system, places = molecules(waters, rods, ions)
    trap = openmm.CustomExternalForce(f"{strength}/2*(z-0.02)^2+{strength}/4*x^2+{strength}/8*y^2")
    for i in range(system.getNumParticles()):
        trap.addParticle(i)
    system.addForce(trap)
    return system, places


def simulation_of(integrator, system, places):
    """Return a Simulation of molecules."""
    return starts.simulation_of(None, system, integrator, places)


def snapshot(simulation):
    """Return positions and velocities as bytes: all of their bits."""
    state = simulation.context.getState(positions=True, velocities=True)
    return state.getPositions(asNumpy=True)._value.tobytes() + state.getVelocities(asNumpy=True)._value.tobytes()


def saved(context, kind):
    """Return a checkpoint, or a State with everything as XML."""
    if kind == "checkpoint":
        return context.createCheckpoint()
    everything = {"positions": True, "velocities": True, "parameters": True, "integratorParameters": True}
    return openmm.XmlSerializer.serialize(context.getState(**everything))


def load(context, kind, content):
    """Load what `saved` returned."""
    if kind == "checkpoint":
        context.loadCheckpoint(content)
    else:
        context.setState(openmm.XmlSerializer.deserialize(content))


def mean_and_error(values):
    """Return the mean of a series and its error, from twenty blocks."""
    values = np.asarray(values)[len(values) % 20 :]
    blocks = values.reshape(20, -1).mean(axis=1)
    return float(blocks.mean()), float(blocks.std(ddof=1) / np.sqrt(20))


def reduced_energies(integrator, n, x, burn, steps, every):
    """Return a series of the error of U/kT of a dipole in a field."""
    simulation = simulation_of(integrator, *dipoles_in_a_field(n, x))
    integrator.setRandomNumberSeed(4)
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.step(burn)
    exact = -x * (1.0 / np.tanh(x) - 1.0 / x)
    series = []
    for _ in range(steps // every):
        integrator.step(every)
        series.append(simulation.context.getState(energy=True).getPotentialEnergy()._value / (n * KT) - exact)
    return series


def ending_at_kicks():
    """Return the steps of W2_3m from a kick to the next: they end where its barostat acts."""
    first, *rows, last = scheme_for_thermostat("W2_3m").sequence
    return Scheme("W2_3m, ending at kicks", 2, (*rows, (DRIFT, last[1] + first[1])))


def boxes_and_momenta(system, positions, scheme, engine="host", steps=12, **options):
    """Return volumes and momenta in steps that begin at rest, with a barostat that acts after each."""
    system, volumes = copy.deepcopy(system), []
    barostat = openmm.MonteCarloBarostat(1.0, 300.0, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.006, scheme, engine=engine, **options)
    integrator.setRandomNumberSeed(2)
    platform, properties = platform_for(engine)
    context = starts.context_of(system, integrator, positions, platform=platform, properties=properties)
    for _ in range(steps):
        integrator.step(1)
        volumes.append(context.getState().getPeriodicBoxVolume()._value)
    return np.array(volumes), integrator.bodyState()[1].P


def ideal_gas(integrator, pressure, force=0.0, temperature=300.0, **counts):
    """Return a Context of molecules that do not see each other, in a periodic box with a barostat."""
    system, places = molecules(**counts)
    # A System is periodic when one of its forces says so.
    pull = openmm.CustomExternalForce(f"{-force}*x+0*periodicdistance(x,y,z,1,2,3)")
    for i in range(system.getNumParticles()):
        pull.addParticle(i)
    system.addForce(pull)
    barostat = openmm.MonteCarloBarostat(pressure, temperature, 1)
    barostat.setRandomNumberSeed(2)
    system.addForce(barostat)
    system.setDefaultPeriodicBoxVectors(*np.diag([6.0, 6.0, 6.0]))
    context = starts.context_of(system, integrator, places)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return context
