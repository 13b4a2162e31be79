"""The pressure of single configurations and of exact averages, against quadrature and other kernels."""

import itertools

import numpy as np
import openmm
import pytest
from openmm import app
from scipy.special import betainc

import openmm_exactrb as rb
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import read
from places import REFERENCE
from products import spread_over
from starts import context_of

R = 0.00831446261815324


class Pressures:
    """The pressures that a reporter writes for given configurations."""

    def __init__(self, topology, system, file, temperature=160.0, integrator=None):
        integrator = integrator or rb.ExactRigidBodyLangevinIntegrator(temperature, 5.0, 0.002)
        self.simulation = app.Simulation(topology, system, integrator, REFERENCE)
        self.context, self._file = self.simulation.context, file
        self._reporter = rb.AverageReporter(file, 1, pressure=True)

    def report(self, x, box=None):
        """Report positions (nm), in a box (3, 3) if it changes."""
        if box is not None:
            self.context.setPeriodicBoxVectors(*box)
        self.context.setPositions(x)
        self._reporter.report(self.simulation, self.context.getState(positions=True, energy=True, forces=True))

    def read(self):
        """Return the pressures (bar) and their slopes (bar/ps²)."""
        self._reporter.close()
        columns = read(self._file)[1]
        return columns["pressure"], columns["pressure slope"]


# -- kernels ----------------------------------------------------------------------------------------------------------


BOUNDARIES = [
    (rb.ReactionField(cutoff=1.7), {}, ("openmm",)),
    (rb.ReactionField(), {"n": 27}, ("bonds",)),
    (rb.ReactionField(cutoff=1.2, dielectric=1.0), {"n": 27, "density": 0.3, "attraction": 0.4}, ("bonds", "openmm")),
    (rb.ReactionField(cutoff=1.4, switch=0.2), {"n": 27, "wca": True, "sphere_cutoff": 1.9}, ("bonds",)),
    (rb.ReactionField(cutoff=1.6), {"shifted": True, "epsilon": 2.0, "sigma": 0.9}, ("openmm",)),
    (rb.ReactionField(cutoff=1.6), {"n": 27, "shifted": True, "epsilon": 2.0, "sigma": 0.9}, ("bonds",)),
]


@spread_over({"boundary, options, kernels": BOUNDARIES, "scales": [(1.0, 1.0, 1.0), (1.2, 1.2, 1.2), (1.0, 1.1, 1.9)]})
def test_kernels_have_the_same_pressure_in_every_box(boundary, options, kernels, scales, tmp_path):
    law = {"n": 64, "dipole": (0.0, 0.0, 3.0**0.5), "attraction": 1.0, "density": 0.4, "perturbation": 0.05} | options
    found = []
    for kernel in ("compiled", *kernels):
        topology, system, positions = rb.dipole_fluid(boundary=boundary, kernel=kernel, **law)
        pressures = Pressures(topology, system, tmp_path / f"{kernel}.csv")
        x = positions._value.reshape(law["n"], -1, 3)
        edge = system.getDefaultPeriodicBoxVectors()[0][0]._value
        centres = x.mean(axis=1, keepdims=True)
        moved = centres * (np.array(scales) - 1.0)
        pressures.report((x + moved).reshape(-1, 3), np.diag(scales) * edge)
        found.append(pressures.read())
    for others in found[1:]:
        np.testing.assert_allclose(others, found[0], rtol=1e-9, atol=1e-8)
    assert found[0][0] != pytest.approx(BAR * law["n"] * R * 160.0 / (np.prod(scales) * edge**3), rel=1e-5)


# -- boxes of twice the cutoff ----------------------------------------------------------------------------------------


def dipoles(n, boundary, **options):
    return lambda **more: rb.dipole_fluid(n, boundary=boundary(**more), perturbation=0.05, **options)


def ewald(tolerance=1e-4, **options):
    return rb.Ewald(tolerance=tolerance, **options)


def tip3p(tolerance=1e-6):
    options = {"nonbondedMethod": app.PME, "switchDistance": 0.4, "ewaldErrorTolerance": tolerance}
    return rb.rigid_water(27, nonbondedCutoff=0.5 * 3.0 * 0.3104, **options)


#: Functions that build boxes whose edges are twice a cutoff, with the tolerance of their sum over images, if any.
NARROW = {
    "Stockmayer, reaction field": dipoles(64, rb.ReactionField, attraction=1),
    "Stockmayer, Ewald": dipoles(64, ewald, attraction=1),
    "soft, reaction field": dipoles(27, rb.ReactionField),
    "soft, Ewald": dipoles(30, ewald),
    "shifted": dipoles(50, rb.ReactionField, attraction=1, shifted=True),
    "ferrofluid, Ewald": dipoles(40, ewald, attraction=1, wca=True, density=0.3),
    "few, Ewald": dipoles(8, ewald, attraction=1, density=0.2),
    "bonds": dipoles(27, rb.ReactionField, attraction=1, kernel="bonds"),
    "ellipsoids": lambda: rb.ellipsoids(36, cutoff=0.5 * (36 / 0.3) ** (1 / 3), switch=2.0),
    "discs": lambda: rb.ellipsoids(32, kappa=0.5, kappa_prime=0.2, cutoff=0.5 * (32 / 1.8) ** (1 / 3)),
    "TIP3P, Ewald": tip3p,
}


@pytest.mark.parametrize("name", NARROW)
def test_the_pressure_in_a_box_of_twice_the_cutoff_is_the_derivative_from_above(name, tmp_path):
    topology, system, positions = NARROW[name]()
    pressures = Pressures(topology, system, tmp_path / "averages.csv", 300.0)
    pressures.report(positions)
    (found,), _ = pressures.read()
    images = "Ewald" in name
    _, fine, _ = NARROW[name](**({"tolerance": 1e-7} if images else {}))
    context = context_of(fine, openmm.VerletIntegrator(0.001), positions)
    context.computeVirtualSites()
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    box = np.array([vector._value for vector in system.getDefaultPeriodicBoxVectors()])
    molecules = [list(molecule) for molecule in context.getMolecules()]

    def energy(scale):
        y = x.copy()
        for molecule in molecules:
            y[molecule] += (scale - 1.0) * x[molecule].mean(axis=0)
        context.setPeriodicBoxVectors(*(scale * box))
        context.setPositions(y)
        return context.getState(energy=True).getPotentialEnergy()._value

    s = 5e-4  # the derivative of a polynomial of degree 4 at the first of five points
    slope = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) @ [energy(1.0 + k * s) for k in range(5)] / (12.0 * s)
    virial, ideal = (BAR * part / np.linalg.det(box) for part in (-slope / 3.0, len(molecules) * R * 300.0))
    # A sum over images has an error of its tolerance, which depends on the box.
    assert found == pytest.approx(virial + ideal, rel=1e-4, abs=(5e-3 if images else 1e-4) * (ideal + abs(virial)))


def test_the_default_fluid_runs_with_its_reporter(tmp_path):
    topology, system, positions = rb.dipole_fluid(64, attraction=1, boundary=rb.Ewald())
    integrator = rb.ExactRigidBodyLangevinIntegrator(160.0, 5.0, 0.002)
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(maxIterations=10)
    reporter = rb.AverageReporter(tmp_path / "averages.csv", 2, pressure=True)
    simulation.reporters.append(reporter)
    simulation.step(10)
    reporter.close()
    assert len(read(tmp_path / "averages.csv")[1]["pressure"]) == 5


# -- averages by quadrature -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [rb.ExactRigidBodyLangevinIntegrator, openmm.LangevinMiddleIntegrator])
@pytest.mark.parametrize("edges", [(2.0, 2.0, 2.0), (1.0, 3.0, 5.0)])
def test_an_ideal_gas_has_the_pressure_of_its_law(integrator, edges, tmp_path):
    """Of water molecules and ions, in any configuration and box."""
    topology, system, positions = rb.rigid_water(10)
    system.removeForce(next(i for i, f in enumerate(system.getForces()) if isinstance(f, openmm.NonbondedForce)))
    nothing = openmm.CustomNonbondedForce("0*r")
    nothing.setNonbondedMethod(nothing.CutoffPeriodic)
    nothing.setCutoffDistance(0.5)
    residue = topology.addResidue("ION", topology.addChain())
    for i in range(34):
        if i >= 30:
            system.addParticle(23.0)
            topology.addAtom("NA", None, residue)
        nothing.addParticle([])
    system.addForce(nothing)
    system.setDefaultPeriodicBoxVectors(*np.diag(edges))
    pressures = Pressures(topology, system, tmp_path / "gas.csv", integrator=integrator(300.0, 5.0, 0.002))
    for scale in (1.0, 1.3):
        pressures.report(
            np.vstack([positions._value, np.random.default_rng(2).uniform(0, 3, (4, 3))]), scale * np.diag(edges)
        )
    found, slopes = pressures.read()
    np.testing.assert_allclose(found, BAR * 14 * R * 300.0 / np.prod(edges) / np.array([1.0, 1.3**3]), rtol=1e-12)
    assert not slopes.any()


class Stockmayer:
    """Two Stockmayer particles with a cutoff and a reaction field, by formulas of this test."""

    def __init__(self, mu2, kT, *, cutoff, sphere_cutoff, dielectric):
        self.mu2, self.kT, self.cutoff, self.sphere_cutoff = mu2, kT, cutoff, sphere_cutoff
        r = np.linspace(0.0, cutoff, 200001)
        volume = 3.0 * np.trapezoid(self.switch(r, cutoff) * r**2, r)
        self.reaction = 2.0 * (dielectric - 1.0) / (2.0 * dielectric + 1.0) / volume

    @staticmethod
    def switch(r, cutoff):
        begin = 0.75 * cutoff
        return betainc(7.0, 7.0, np.clip((cutoff**2 - r**2) / (cutoff**2 - begin**2), 0.0, 1.0))

    def energy(self, r, one, other, angle, *, whole=False):
        """Return the energy for the cosines of the dipoles to the vector between them, and the angle about it."""
        product = np.sqrt((1.0 - one**2) * (1.0 - other**2)) * np.cos(angle) + one * other
        S, T = (1.0, 1.0) if whole else (self.switch(r, end) for end in (self.cutoff, self.sphere_cutoff))
        field = 0.0 if whole else self.reaction
        dipoles = self.mu2 * ((r**-3.0 - field) * product - 3.0 * one * other * r**-3.0)
        return T * 4.0 * (r**-12.0 - r**-6.0) + S * dipoles

    def nodes(self, ends, n, angles):
        """Return nodes (r, cosine, cosine, angle) and weights of a quadrature over space and directions."""
        x, w = np.polynomial.legendre.leggauss(n)
        parts = [(a + 0.5 * (b - a) * (1.0 + x), 0.5 * (b - a) * w) for a, b in itertools.pairwise(ends)]
        r, of_r = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        c, of_c = np.polynomial.legendre.leggauss(angles)
        phi = np.pi * (np.arange(angles) + 0.5) / angles  # a period of an even function
        places = np.stack(np.meshgrid(r, c, c, phi, indexing="ij"), axis=-1).reshape(-1, 4)
        weights = np.einsum(
            "i,j,k,l->ijkl", 4.0 * np.pi * r**2 * of_r, of_c / 2.0, of_c / 2.0, np.full(angles, 1.0 / angles)
        )
        return places, weights.ravel()

    def mayer(self, *, whole):
        """Return the integral of exp(-u/kT) - 1."""
        ends = (1e-3, 0.7, 1.0, 1.5, 2.25, 3.0, 4.0) + ((8.0, 20.0, 100.0) if whole else ())
        places, weights = self.nodes(ends, 24, 8)
        return weights @ np.expm1(-self.energy(*places.T, whole=whole) / self.kT)


@pytest.mark.validate
@pytest.mark.parametrize(
    ("mu2", "temperature", "kernel"), [(0.2, 220.0, "compiled"), (0.25, 190.0, "bonds"), (0.3, 160.0, "openmm")]
)
def test_two_stockmayer_particles_have_their_second_virial_coefficient(mu2, temperature, kernel, tmp_path):
    """The average pressure over all places and directions is the derivative of the partition function.

    With the integral I of exp(-u/kT) - 1, the partition function of two particles in a volume V is V (V + I), times the
    Boltzmann factor of the long-range correction A/V. With this correction, I is that of whole spheres.
    """
    edge, kT = 8.5, R * temperature
    law = Stockmayer(mu2, kT, cutoff=3.0, sphere_cutoff=4.0, dielectric=1.0 if kernel == "compiled" else 4.0)
    topology, system, _ = rb.dipole_fluid(
        2, density=2.0 / edge**3, dipole=(0.0, 0.0, mu2**0.5), inertia=(0.3, 0.3, 0.3), attraction=1.0, kernel=kernel,
        boundary=rb.ReactionField(cutoff=3.0, dielectric=1.0 if kernel == "compiled" else 4.0), sphere_cutoff=4.0,
    )  # fmt: skip
    places, weights = law.nodes((0.75, 1.0, 1.5, 2.25, 3.0, 4.0), 8, 4)
    pressures = Pressures(topology, system, tmp_path / "pair.csv", temperature)
    _, _, start = rb.dipole_fluid(1, dipole=(0.0, 0.0, 1.0), inertia=(0.3, 0.3, 0.3), perturbation=0.0)
    body = start._value - start._value[-2]
    frame = np.linalg.qr(np.column_stack([body[-1], body[0], body[1]]))[0]
    frame *= np.sign(frame[:, 0] @ body[-1])
    frame[:, 2] = np.cross(frame[:, 0], frame[:, 1])
    body = body @ frame  # with the dipole along x
    for r, one, other, angle in places:
        first, second = turned(body, one, 0.0), turned(body, other, angle)
        pressures.report(np.vstack([first, second + np.array([r, 0.0, 0.0])]) + 1.0)
    pressures.report(np.vstack([turned(body, 0.2, 0.0), turned(body, 0.5, 1.0) + 4.2]))  # beyond the cutoffs
    found, _ = pressures.read()
    volume, factors = edge**3, weights * np.exp(-law.energy(*places.T) / kT)
    rest = volume - 4.0 * np.pi / 3.0 * (4.0**3 - 0.75**3)  # within 0.75 the factor is less than 1e-9
    core = 4.0 * np.pi / 3.0 * 0.75**3
    mean = (factors @ found[:-1] + (rest - core) * found[-1]) / (factors.sum() + rest - core) / BAR
    assert found[-1] != pytest.approx(2.0 * kT / volume * BAR, rel=1e-6)  # but for the correction
    correction = found[-1] / BAR - 2.0 * kT / volume
    exact = kT * (1.0 / volume + 1.0 / (volume + law.mayer(whole=False))) + correction
    assert mean == pytest.approx(exact, rel=1e-5)  # of difference quotients
    # The same partition function with whole particles, without a correction: dipoles beyond the cutoff matter little.
    integral = 1.0 / (mean / kT - 1.0 / volume) - volume
    whole = law.mayer(whole=True)
    assert integral == pytest.approx(whole, rel=5e-3)
    uncorrected = 1.0 / ((mean - correction) / kT - 1.0 / volume) - volume
    assert abs(uncorrected - whole) > 2.0 * abs(integral - whole)


def turned(body, cosine, angle):
    """Return places with the dipole, which is along x, at a cosine to x and at an angle about x."""
    sine = np.sqrt(1.0 - cosine**2)
    tilt = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    about = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    return body @ (about @ tilt).T
