"""Forces without a virial pressure are named when the reporter begins; those that have one are served."""

import re

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from averages.test_corrections import reporting
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import read
from places import REFERENCE
from starts import topology_of

KT, EDGE = 0.00831446261815324 * 300.0, 3.0


def gas(*forces, n=12, frozen=(), integrator=None, bonded=False):
    """Return a Simulation of Lennard-Jones atoms with charges +-0.3, or of pairs of such atoms, and other forces."""
    system, pairs = openmm.System(), openmm.NonbondedForce()
    pairs.setNonbondedMethod(pairs.CutoffPeriodic)
    pairs.setCutoffDistance(1.2)
    bonds = openmm.HarmonicBondForce()
    for i in range(n):
        system.addParticle(0.0 if i in frozen else 20.0)
        pairs.addParticle(0.3 * (-1) ** i, 0.25, 0.4)
        if bonded and i % 2:
            bonds.addBond(i - 1, i, 0.2, 1e4)
            pairs.addException(i - 1, i, 0.0, 1.0, 0.0)
    for force in (pairs, bonds, *forces):
        system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(EDGE * np.eye(3)))
    integrator = integrator or rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002)
    simulation = app.Simulation(topology_of(system), system, integrator, REFERENCE)
    places = 0.7 + 0.8 * np.argwhere(np.ones((3, 3, 3)))[:n] + 0.1 * np.random.default_rng(1).standard_normal((n, 3))
    if bonded:
        places[1::2] = places[::2] + np.array([0.0, 0.2, 0.0])
    simulation.context.setPositions(places)
    return simulation


def pressure_of(simulation, file):
    """Return the pressure (bar) of the present configuration."""
    reporter = rb.AverageReporter(file, 1, pressure=True)
    reporter.report(simulation, simulation.context.getState(positions=True, energy=True, forces=True))
    reporter.close()
    return float(read(file)[1]["pressure"][-1])


# -- members ----------------------------------------------------------------------------------------------------------


def external(energy, **parameters):
    def force():
        made = openmm.CustomExternalForce(energy)
        for name, value in parameters.items():
            made.addGlobalParameter(name, value)
        for i in range(0, 12, 2):
            made.addParticle(i)
        return made

    return force


def on_two_ions(made):
    """Return a function that makes a field on two atoms that are neutral together."""
    kind = "Particle" if isinstance(made, openmm.CustomExternalForce) else "Bond"
    getattr(made, f"addPer{kind}Parameter")("q")
    for i, charge in ((2, 3.0), (7, -3.0)):
        if isinstance(made, openmm.CustomExternalForce):
            made.addParticle(i, [charge])
        else:
            made.addBond([i if isinstance(made, openmm.CustomCompoundBondForce) else made.addGroup([i])], [charge])
    return lambda: made


def bonds_by_formula(energy, *, periodic=False, particles=((0, 3), (5, 7), (2, 11))):
    def force():
        made = openmm.CustomCompoundBondForce(2, energy)
        for pair in particles:
            made.addBond(pair)
        made.setUsesPeriodicBoundaryConditions(periodic)
        return made

    return force


def centroids(energy, *groups, periodic=False):
    def force():
        made = openmm.CustomCentroidBondForce(len(groups), energy)
        made.addBond([made.addGroup(list(group)) for group in groups])
        made.setUsesPeriodicBoundaryConditions(periodic)
        return made

    return force


def triples(energy):
    def force():
        made = openmm.CustomManyParticleForce(2, energy)
        made.setNonbondedMethod(made.CutoffPeriodic)
        made.setCutoffDistance(1.0)
        for _ in range(12):
            made.addParticle([], 0)
        return made

    return force


def born(energy):
    def force():
        made = openmm.CustomGBForce()
        made.addComputedValue("nothing", "0*r", made.ParticlePair)
        made.addComputedValue("depth", energy, made.SingleParticle)
        made.addEnergyTerm("5*depth", made.SingleParticle)
        for _ in range(12):
            made.addParticle([])
        return made

    return force


def collective(energy, **variables):
    def force():
        made = openmm.CustomCVForce(energy)
        for name, variable in variables.items():
            made.addCollectiveVariable(name, variable())
        return made

    return force


def alchemical(inner):
    def force():
        made = openmm.ATMForce("u0 + 0.1*(u1 - u0)")
        made.addForce(inner())
        for _ in range(12):
            made.addParticle(openmm.Vec3(0, 0, 0))
        return made

    return force


class Well:
    """A harmonic well about a point, or with an edge about its nearest image."""

    def __init__(self, edge=None):
        self.edge = edge

    def __call__(self, state):
        x = state.getPositions(asNumpy=True)._value - 1.3
        if self.edge:
            x -= self.edge * np.round(x / self.edge)
        return float((x**2).sum()), -2.0 * x


class Springs:
    """Springs between successive atoms, whole or to nearest images in a box of fixed edges, or of the State's."""

    def __init__(self, edge=None, single=False):
        self.edge, self.single = edge, single

    def __call__(self, state):
        x = state.getPositions(asNumpy=True)._value
        d = x[1::2] - x[::2]
        if self.single:
            d = d.astype(np.float32)
        edge = state.getPeriodicBoxVectors()[0][0]._value if self.edge == "present" else self.edge
        if edge:
            d = d - edge * np.round(d / edge)
        forces = np.zeros_like(x)
        forces[1::2], forces[::2] = -10.0 * d, 10.0 * d
        return float((5.0 * d**2).sum()), forces


def python(function, *, periodic=False, group=0, local=False):
    def force():
        made = openmm.PythonForce((lambda state: function(state)) if local else function)
        made.setUsesPeriodicBoundaryConditions(periodic)
        made.setForceGroup(group)
        return made

    return force


ABSOLUTE = {
    "restraint to points": external("50*((x-1)^2 + (y-1)^2 + (z-1)^2)"),
    "restraint to nearest images of a point": external("50*periodicdistance(x, y, z, 1, 1, 1)^2"),
    "weak restraint": external("1e-3*periodicdistance(x, y, z, 0.2, 1, 2)^2"),
    "gravity": external("9.8e-6*z"),
    "field on some of the charges": external("0.3*x"),
    "field on ions of opposite charges": on_two_ions(openmm.CustomExternalForce("q*(x - 2*z)")),
    "field by compound bonds of one atom": on_two_ions(openmm.CustomCompoundBondForce(1, "q*(y1 + z1)")),
    "field on centres": on_two_ions(openmm.CustomCentroidBondForce(1, "q*x1")),
    "wave": external("2*sin(2*3.14159265358979*x/3)"),
    "walls out of reach": external("1000*max(0, abs(z - 1.5) - 2.9)^2"),
    "walls far away": external("1000*max(0, abs(z) - 14)^2"),
    "flat bottom about images": external("100*max(0, periodicdistance(x, y, z, 1.5, 1.5, 1.5) - 1.7)^2"),
    "slab": external("100*max(0, periodicdistance(0, 0, z, 0, 0, 1.5) - 1.3)^2"),
    "wall of spheres": external("4*((0.3/(z + 1))^9 - (0.3/(z + 1))^3)"),
    "parameter of the Context": external("force*y", force=7.0),
    "by intermediate values": external("k*r2; k = 30; r2 = u*u; u = z - 2"),
    "compound bond to a point": bonds_by_formula("10*distance(p1, p2)^2 + 3*(x1 - 1)^2"),
    "compound bond to nearest images": bonds_by_formula(
        "10*pointdistance(x1, y1, z1, 1, 1, 1)^2 + 0*x2", periodic=True
    ),
    "centroid to a plane": centroids("40*(z1 - 1.5)^2", range(6)),
    "centroids in absolute places": centroids("distance(g1, g2) + y1^2", range(6), range(6, 12)),
    "many particles": triples("0.1*distance(p1, p2)*x1^2"),
    "generalised Born": born("z^2 + x"),
    "collective variable": collective("30*height^2", height=external("z - 1")),
    "nested collective variables": collective("deep^2", deep=collective("2*height", height=external("z"))),
    "beside a restraint of distances": collective("a + b", a=bonds_by_formula("distance(p1, p2)"), b=external("y^2")),
    "alchemical": alchemical(external("20*(x - 1)^2")),
    "function of Python": python(Well()),
    "function of Python with images": python(Well(EDGE), periodic=True),
    "local function alone in its group": python(Well(), group=7, local=True),
}

OWN_BOX = {
    "compound bonds": bonds_by_formula("5*(dx - 3*floor(dx/3 + 0.5))^2; dx = x1 - x2", periodic=True),
    "compound bonds that are said to be open": bonds_by_formula("5*(dx - 3*floor(dx/3 + 0.5))^2; dx = x1 - x2"),
    "many particles": triples("cos(2*3.14159265358979*(y1 - y2)/3)"),
    "collective variable": collective("a^2", a=bonds_by_formula("cos(6.28318530717959*(z1 - z2)/3)")),
    "function of Python": python(Springs(EDGE)),
    "periodic function of Python": python(Springs(EDGE), periodic=True),
    "local function alone in its group": python(Springs(EDGE), group=3, local=True),
}

SERVED = {
    "nothing that depends on places": external("3*k; k = 2"),
    "distances": bonds_by_formula("10*distance(p1, p2)^2"),
    "distances of nearest images": bonds_by_formula("10*distance(p1, p2)^2", periodic=True),
    "differences of coordinates": bonds_by_formula("5*(x1 - x2)^2 + 2*(z1 - z2)^4"),
    "points relative to others": bonds_by_formula("pointdistance(x1, y1, z1, x2 + 0.1, y2, z2)^2", periodic=True),
    "constant force between centres of mass": centroids("9*(x1 - x2)", range(6), range(6, 12)),
    "two centres of mass": centroids("40*distance(g1, g2)^2", range(6), range(6, 12)),
    "height over a centre of mass": centroids("40*(z1 - z2 - 0.3)^2", range(6), range(6, 12)),
    "many particles": triples("0.1*exp(-distance(p1, p2))"),
    "a tension": lambda: openmm.CustomVolumeForce("3*v + ax"),
    "gyration": lambda: collective("20*(r - 1)^2", r=lambda: openmm.RGForce(list(range(12))))(),
    "alchemical": alchemical(bonds_by_formula("10*distance(p1, p2)^2")),
    "springs of Python": python(Springs()),
    "springs of Python in single precision": python(Springs(single=True)),
    "springs to nearest images": python(Springs("present"), periodic=True),
    "local springs alone in their group": python(Springs(), group=7, local=True),
}


@pytest.mark.parametrize("name", ABSOLUTE)
def test_forces_at_absolute_places_have_no_pressure(name, tmp_path):
    force = ABSOLUTE[name]()
    force.setName("mine")
    sentence = r" depends on absolute positions, .* relative to a centre of mass .* or create .* with pressure=False"
    inner = "collective" in name or name in ("beside a restraint of distances", "alchemical")
    named = r"the \w+ '\w+' \(force 2\)" if inner else rf"the {type(force).__name__} 'mine' \(force 2\)"
    with pytest.raises(ValueError, match=named + sentence):
        pressure_of(gas(force), tmp_path / "averages.csv")
    assert not (tmp_path / "averages.csv").exists()


@pytest.mark.parametrize("name", ["gravity", "slab", "collective variable", "function of Python", "compound bonds"])
def test_without_pressure_these_forces_are_reported(name, tmp_path):
    simulation = gas((ABSOLUTE | OWN_BOX)[name]())
    with reporting(simulation, tmp_path / "averages.csv", 1):
        simulation.step(1)


@pytest.mark.parametrize("shift", [0.0, 5.0, -20.0])
@pytest.mark.parametrize("name", SERVED)
def test_the_pressure_of_other_forces_is_the_derivative_of_the_energy_anywhere(name, shift, tmp_path):
    simulation = gas(SERVED[name](), bonded=True)
    context = simulation.context
    x = context.getState(positions=True).getPositions(asNumpy=True)._value + shift
    molecules = [list(molecule) for molecule in context.getMolecules()]

    def energy(scale):
        y = x.copy()
        for molecule in molecules:
            y[molecule] += (scale - 1.0) * x[molecule].mean(axis=0)
        context.setPeriodicBoxVectors(*(scale * EDGE * np.eye(3)))
        context.setPositions(y)
        return context.getState(energy=True).getPotentialEnergy()._value

    s = 1e-4
    slope = (8.0 * (energy(1 + s) - energy(1 - s)) - energy(1 + 2 * s) + energy(1 - 2 * s)) / (12.0 * s)
    energy(1.0)
    found = pressure_of(simulation, tmp_path / "averages.csv")
    assert found == pytest.approx(BAR * (len(molecules) * KT - slope / 3.0) / EDGE**3, rel=1e-5, abs=2e-2)


def test_a_field_on_neutral_molecules_has_a_pressure(tmp_path):
    """The molecules turn in it, and move to nowhere."""

    def field(charge):
        made = openmm.CustomExternalForce("-40*charge*z")
        made.addPerParticleParameter("charge")
        for i in range(12):
            made.addParticle(i, [charge if i % 2 else -0.3])
        return made

    with_field, without = (
        pressure_of(gas(*forces, bonded=True), tmp_path / f"{len(forces)}.csv") for forces in ((field(0.3),), ())
    )
    assert with_field == pytest.approx(without, rel=1e-9)
    with pytest.raises(ValueError, match="depends on absolute positions"):
        pressure_of(gas(field(0.301), bonded=True), tmp_path / "ions.csv")


def test_langevin_of_openmm_is_served_and_refused_alike(tmp_path):
    for name, refused in (("gravity", True), ("slab", True), ("walls out of reach", True), ("distances", False)):
        simulation = gas((ABSOLUTE | SERVED)[name](), integrator=openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002))
        file = tmp_path / f"{name}.csv"
        if refused:
            with pytest.raises(ValueError, match="depends on absolute positions"):
                pressure_of(simulation, file)
        else:
            assert np.isfinite(pressure_of(simulation, file))


def test_restrained_water_is_refused_at_its_first_step(tmp_path):
    """Its pressure would depend on where it is."""
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.PME, nonbondedCutoff=0.45)
    restraint = openmm.CustomExternalForce("500*periodicdistance(x, y, z, x0, y0, z0)^2")
    restraint.addPerParticleParameter("x0")
    restraint.addPerParticleParameter("y0")
    restraint.addPerParticleParameter("z0")
    for i in range(0, 30, 3):
        restraint.addParticle(i, positions[i]._value)
    restraint.setName("held oxygens")
    system.addForce(restraint)
    simulation = app.Simulation(topology, system, rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002), REFERENCE)
    simulation.context.setPositions(positions)
    simulation.reporters.append(rb.AverageReporter(tmp_path / "averages.csv", 10, pressure=True))
    with pytest.raises(ValueError, match=re.escape("the CustomExternalForce 'held oxygens' (force")):
        simulation.step(1)
    assert simulation.currentStep == 0
