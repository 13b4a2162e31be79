"""The function of the jobs in the tutorial "A hundred runs", in a file that workers can import."""

import openmm

import openmm_exactrb as rb


def energies(seed, scheme, n=8, step=0.02, steps=10, temperature=12.0):
    """Return times (ps) and total energies (kJ/mol) of a droplet of n dipoles that starts at a temperature (K)."""
    _, system, positions = rb.dipole_fluid(n, seed)
    integrator = rb.ExactRigidBodyIntegrator(step, scheme=scheme)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    integrator.setVelocitiesToTemperature(temperature, seed)
    times, totals = [], []
    for _ in range(steps):
        integrator.step(1)
        times.append(context.getTime()._value)
        totals.append(integrator.totalEnergy()._value)
    return {"times": times, "energies": totals}
