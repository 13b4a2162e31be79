"""The quantities of a frame, against difference quotients and OpenMM."""

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from averages.test_corrections import KT, SMOOTH, reporting, water
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import read
from starts import topology_of


def energy_of(system, scale=1.0, sizes=3):
    """Return the potential energy as a function of the positions of atoms, with the centres of molecules scaled."""
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    box = system.getDefaultPeriodicBoxVectors()
    context.setPeriodicBoxVectors(*(scale * vector for vector in box))

    def energy(x):
        context.setPositions(x)
        context.computeVirtualSites()
        x = context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(-1, sizes, 3)
        context.setPositions((x + (scale - 1.0) * x.mean(axis=1, keepdims=True)).reshape(-1, 3))
        return context.getState(energy=True).getPotentialEnergy()._value

    return energy


@pytest.mark.parametrize(("model", "sizes"), [("tip3p", 3), ("tip4pew", 4), ("tip5p", 5)])
def test_work_pressure_and_its_slope_are_difference_quotients(tmp_path, model, sizes):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, scheme="BAOA")
    integrator.setRandomNumberSeed(3)
    system = rb.rigid_water(64, model=model, **SMOOTH)[1]
    plain = energy_of(system, sizes=sizes)
    volume = np.linalg.det(np.array([v._value for v in system.getDefaultPeriodicBoxVectors()]))

    def pressure(stretch):
        wide, narrow = (energy_of(system, 1.0 + s, sizes) for s in (stretch, -stretch))
        change = volume * ((1.0 + stretch) ** 3 - (1.0 - stretch) ** 3)
        return lambda x: BAR * (64 * KT / volume - (wide(x) - narrow(x)) / change)

    # Roundoff of the energies is a thousandth of the slope of the pressure unless the range is wide.
    observables = {"energy": plain, "pressure again": pressure(0.001), "wide pressure": pressure(0.01)}
    file, simulation = tmp_path / "water.csv", water(integrator, model=model)
    with reporting(simulation, file, 2, pressure=True, observables=observables):
        simulation.step(4)
    columns = read(file)[1]
    assert columns["potential"] == pytest.approx(columns["energy"], rel=1e-9)
    assert columns["energy slope"] == pytest.approx(-columns["work"], rel=5e-5)
    assert columns["square"] == pytest.approx(columns["work"], rel=1e-12)  # no force is in the drifts
    assert columns["damped work"] == pytest.approx(columns["work"], rel=1e-12)
    assert columns["pressure"] == pytest.approx(columns["pressure again"], rel=1e-5)
    assert columns["pressure slope"] == pytest.approx(columns["wide pressure slope"], rel=1e-3)


def place_of(particle, axis):
    return lambda x: x[particle, axis]


@pytest.mark.parametrize("pressure", [False, True])
def test_virtual_sites_move_with_their_atoms_in_the_slopes_of_observables(tmp_path, pressure):
    """The lone pairs of TIP5P: a linear combination of the bonds of the oxygen and of their cross product."""
    simulation = water(rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002), model="tip5p")
    site = simulation.system.getVirtualSite(3)
    observables = {f"{particle} {axis}": place_of(particle, axis) for particle in range(4) for axis in range(3)}
    with reporting(simulation, tmp_path / "water.csv", 1, observables=observables, pressure=pressure):
        simulation.step(3)
    columns = read(tmp_path / "water.csv")[1]
    x, v = (
        np.array([[columns[f"{particle} {axis}{kind}"] for axis in range(3)] for particle in range(4)]).swapaxes(1, 2)
        for kind in ("", " slope")
    )
    (a, b), (of_a, of_b) = ((of[1:3] - of[0]) for of in (x, v))
    across = np.cross(of_a, b) + np.cross(a, of_b)
    moved = v[0] + site.getWeight12() * of_a + site.getWeight13() * of_b + site.getWeightCross() * across
    assert v[3] == pytest.approx(moved, rel=1e-5, abs=1e-6 * np.abs(moved).max())


def test_the_slow_forces_are_those_of_the_kicks(tmp_path):
    """Forces by groups: the energy of the slow one changes along M⁻¹f_s by minus the square of f_s."""
    system = openmm.System()
    slow, fast = openmm.CustomExternalForce("10*x^4+7*y^2*z"), openmm.HarmonicBondForce()
    for _ in range(4):
        slow.addParticle(system.addParticle(12.0))
    fast.addBond(0, 1, 0.1, 5e4)
    fast.addBond(2, 3, 0.1, 5e4)
    fast.setForceGroup(1)
    system.addForce(slow)
    system.addForce(fast)
    other = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))

    def energy(groups):
        def of(x):
            other.setPositions(x)
            return other.getState(energy=True, groups=groups).getPotentialEnergy()._value

        return of

    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.002, scheme="BAOA", fast=[1], innerSteps=4)
    simulation = app.Simulation(topology_of(system), system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions([[0.3, 0.1, 0.2], [0.42, 0.1, 0.2], [0.0, 0.5, 0.1], [0.0, 0.61, 0.1]])
    integrator.setVelocitiesToTemperature(300.0, 3)
    file = tmp_path / "groups.csv"
    observables = {"all": energy({0, 1}), "slow": energy({0})}
    with reporting(simulation, file, 1, observables=observables):
        simulation.step(3)
    columns = read(file)[1]
    assert columns["all slope"] + columns["all inner slope"] == pytest.approx(
        -columns["work"] - columns["inner work"], rel=1e-5
    )
    for bodies in ("", "inner "):
        assert columns[f"slow {bodies}slope"] == pytest.approx(-columns[f"{bodies}square"], rel=1e-5)


@pytest.mark.parametrize("model", ["tip4pew", "tip5p"])
def test_the_pressure_is_that_of_openmm(tmp_path, model):
    """But for kinetic energy: OpenMM takes that of the moment, the reporter its mean. Virtual sites count as atoms."""
    topology, system, positions = rb.rigid_water(27, model=model, nonbondedMethod=app.PME, nonbondedCutoff=0.4)
    barostat = openmm.MonteCarloBarostat(1.0, 300.0, 0)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.001)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    simulation.context.setVelocitiesToTemperature(300.0, 2)
    file = tmp_path / "water.csv"
    with reporting(simulation, file, 1, pressure=True):
        simulation.step(3)
    momenta = integrator.bodyState()[1].P
    state = simulation.context.getState()
    kinetic = (momenta**2).sum() / integrator.bodyState()[0].mass[0]
    moment = BAR * (27 * KT - kinetic / 3.0) / state.getPeriodicBoxVolume()._value
    theirs = barostat.computeCurrentPressure(simulation.context).value_in_unit(unit.bar)
    assert read(file)[1]["pressure"][-1] == pytest.approx(theirs + moment, abs=1.0)


def test_the_pressure_has_the_parameters_of_the_context(tmp_path):
    tension = openmm.CustomVolumeForce("tension*v")
    tension.addGlobalParameter("tension", 0.0)
    simulation = water(rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002), tension)
    found = []
    for value in (0.0, 50.0):
        file = tmp_path / f"averages_{value:.0f}.csv"
        reporter = rb.AverageReporter(file, 1, pressure=True)
        simulation.context.setParameter("tension", value)
        reporter.report(simulation, simulation.context.getState(positions=True, energy=True, forces=True))
        reporter.close()
        found.append(read(file)[1]["pressure"][0])
    before, after = found
    assert after - before == pytest.approx(-50.0 * BAR, rel=1e-5)


def test_sites_follow_beside_a_force_that_cannot_be_copied(tmp_path):
    """A function that is not at the top level of a module is not saved with a System."""
    topology, system, positions = rb.rigid_water(8, model="tip4pew")
    nothing = np.zeros((system.getNumParticles(), 3))
    system.addForce(openmm.PythonForce(lambda state: (0.0, nothing)))
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    reporter = rb.AverageReporter(tmp_path / "averages.csv", 1, observables={"site": lambda x: x[3, 0]})
    simulation.reporters.append(reporter)
    simulation.step(2)
    reporter.close()
    values = read(tmp_path / "averages.csv")[1]
    assert len(values["site"]) == 2
    assert np.isfinite(values["site"]).all()
