"""Bonds of virtual sites: the masses that they move, their inner steps, and their resonances."""

import itertools

import numpy as np
import openmm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import openmm_exactrb as rb
from openmm_exactrb.multiple_time_steps import virtual_sites
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.multiple_time_steps.stiffness import frequencies
from openmm_exactrb.schemes import splitting
from places import REFERENCE
from products import spread_over
from starts import context_of, positions_of, system_of

SEEDS = st.integers(0, 2**32 - 1)
WATER = np.array([[0.0, 0.0, 0.0], [0.09572, 0.0, 0.0], [-0.023999, 0.092663, 0.0]])
MASSES = [15.999, 1.008, 1.008]
#: Sites of three particles: that of TIP4P, a lone pair of TIP5P, and those in local coordinates.
SITES = {
    "average of two": lambda i: openmm.TwoParticleAverageSite(i, i + 1, 0.7, 0.3),
    "TIP4P": lambda i: openmm.ThreeParticleAverageSite(i, i + 1, i + 2, 0.73, 0.135, 0.135),
    "TIP5P": lambda i: openmm.OutOfPlaneSite(i, i + 1, i + 2, -0.34, -0.34, 6.4),
    "local": lambda i: openmm.LocalCoordinatesSite(
        [i, i + 1, i + 2], [1.0, 0.0, 0.0], [-1.0, 0.5, 0.5], [0.0, -1.0, 1.0], openmm.Vec3(0.03, -0.02, 0.05)
    ),
}


def with_sites(masses, x, sites):
    """Return a System of these particles and sites, and the positions of all."""
    system = system_of([*masses, *(0.0 for _ in sites)])
    for k, site in enumerate(sites):
        system.setVirtualSite(len(masses) + k, site)
    return system, placed(system, np.concatenate([x, np.zeros((len(sites), 3))]))


def placed(system, x):
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    context.computeVirtualSites()
    return positions_of(context)


def masses_of(system, x):
    return virtual_sites.masses(system, lambda: x)


def bonded_to(system, pairs):
    bonds = openmm.HarmonicBondForce()
    for i, j in pairs:
        bonds.addBond(i, j, 0.1, 1e4)
    system.addForce(bonds)


@pytest.mark.parametrize("name", SITES)
@settings(max_examples=5, deadline=None)
@given(SEEDS)
def test_the_mass_of_a_site_is_that_of_its_easiest_direction(name, seed):
    """Against finite differences of the place of the site, for a site on a site too."""
    rng = np.random.default_rng(seed)
    masses, x = rng.uniform(1.0, 20.0, 4), rng.normal(0.0, 0.1, (4, 3))
    system, x = with_sites(masses, x, [SITES[name](0), openmm.TwoParticleAverageSite(4, 3, 0.6, 0.4)])
    bonded_to(system, [(4, 3), (5, 0)])
    found = masses_of(system, x)
    np.testing.assert_array_equal(found[:4], masses)
    mobility, step = np.zeros((2, 3, 3)), 1e-6
    for i in range(4):
        J = np.empty((2, 3, 3))
        for k in range(3):
            moved = np.zeros_like(x)
            moved[i, k] = step
            J[:, :, k] = (placed(system, x + moved)[4:] - placed(system, x - moved)[4:]) / (2.0 * step)
        mobility += J @ J.transpose(0, 2, 1) / masses[i]
    np.testing.assert_allclose(1.0 / found[4:], np.linalg.eigvalsh(mobility)[:, -1], rtol=1e-6)


def test_sites_at_atoms_have_the_frequencies_and_resonances_of_these_atoms(rng):
    masses, x, found = [1.0, 12.0, 14.0, 12.0], 0.1 * rng.standard_normal((4, 3)), []
    for pair in ((0, 3), (4, 5)):
        sites = [openmm.TwoParticleAverageSite(0, 1, 1.0, 0.0), openmm.TwoParticleAverageSite(2, 3, 0.0, 1.0)]
        system, y = with_sites(masses, x, sites)
        bonds = openmm.HarmonicBondForce()
        bonds.addBond(*pair, 0.1, 3e5)
        system.addForce(bonds)
        own = masses_of(system, y)
        resonance = Resonances(system, masses=own).first(splitting("W2_3m"))
        ((frequency, _),) = frequencies(system, masses=own)
        found.append((frequency[0], resonance.step, resonance.period))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def molecules(name, rng, strength, rigid=True, count=4):
    """Return a System of molecules of three atoms and a site, bonded in pairs by their sites, and positions.

    Soft repulsions act between the molecules, and are slow.
    """
    system, x = system_of(count * [*MASSES, 0.0]), []
    soft, bonds = openmm.CustomNonbondedForce("5*exp(-(r/0.3)^2)"), openmm.HarmonicBondForce()
    for first in range(0, 4 * count, 4):
        Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        x.append(np.pad(WATER @ Q.T, ((0, 1), (0, 0))) + 0.1 * first * np.eye(3)[0])
        system.setVirtualSite(first + 3, SITES[name](first))
        for _ in range(4):
            soft.addParticle()
        for i, j in itertools.combinations(range(4), 2):
            soft.addExclusion(first + i, first + j)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            length = float(np.linalg.norm(WATER[i] - WATER[j]))
            if rigid:
                system.addConstraint(first + i, first + j, length)
            else:
                bonds.addBond(first + i, first + j, length, 3e4)
    x = placed(system, np.concatenate(x))
    for k in range(3, 4 * count, 8):
        bonds.addBond(k, k + 4, float(np.linalg.norm(x[k] - x[k + 4])), strength)
    bonds.setForceGroup(1)
    system.addForce(soft)
    system.addForce(bonds)
    return system, x


def started(system, x, h, scheme="S2_2", **options):
    integrator = rb.ExactRigidBodyIntegrator(h, scheme, **options)
    context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300, 1)
    return integrator, context


@spread_over({"name": SITES, "rigid": [True, False]})
@settings(max_examples=1, deadline=None)
@given(SEEDS)
def test_inner_steps_apply_the_forces_on_sites(name, rigid, seed):
    """The same trajectory as with all forces in the kicks, up to the error of a scheme of order 4."""
    system, x = molecules(name, np.random.default_rng(seed), 2e4, rigid)
    ends = []
    for fast in (None, "bonded", (1,)):
        integrator, context = started(system, x, 0.0004, "SRKN4_6b", fast=fast)
        integrator.step(40)
        assert (integrator.timings.fast_evaluations > 0) == (fast is not None)
        ends.append(positions_of(context))
    assert np.abs(ends[0] - x).max() > 1e-3
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=0.0, atol=1e-8)


def spread(system, x, **options):
    """Return the spread of the energy, which is infinite if the run diverges, and the number of fast evaluations."""
    integrator, _context = started(system, x, 0.004, **options)
    energies = []
    try:
        for _ in range(100):
            integrator.step(1)
            energies.append(integrator.totalEnergy()._value)
    except rb.IntegrationError:
        energies += [-np.inf, np.inf]
    return np.ptp(energies), integrator.timings.fast_evaluations


@pytest.mark.parametrize("name", ["TIP4P", "TIP5P", "local"])
@settings(max_examples=1, deadline=None)
@given(SEEDS, st.floats(3.0, 4.0))
def test_stiff_bonds_of_sites_have_inner_steps_by_default(name, seed, omega):
    """The frequency of the bond, in units of that above which the kicks are too far apart."""
    rng = np.random.default_rng(seed)
    system, x = molecules(name, rng, 1e4)
    mass = masses_of(system, x)[3]
    system, x = molecules(name, np.random.default_rng(seed), 0.5 * mass * (omega * 2.0 * np.pi / 0.032) ** 2)
    inner, evaluations = spread(system, x)
    outer, none = spread(system, x, fast=None)
    assert evaluations > none == 0
    assert inner < 0.2 * outer


@pytest.mark.parametrize("name", ["TIP4P", "TIP5P"])
def test_soft_bonds_of_sites_are_slow_unless_inner_steps_are_requested(name, rng):
    system, x = molecules(name, rng, 500.0)
    assert spread(system, x)[1] == 0
    assert spread(system, x, fast="bonded")[1] > 0


@pytest.mark.parametrize("name", ["TIP4P", "TIP5P"])
def test_bonds_of_sites_in_a_named_group_act_in_kernels_too(name, rng):
    system, x = molecules(name, rng, 1e5, rigid=False)
    ends = []
    for engine in ("host", "auto"):
        integrator, context = started(system, x, 0.001, fast=(1,), engine=engine)
        integrator.step(30)
        ends.append(positions_of(context))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-9)


def test_a_changed_bond_of_sites_is_noticed(rng):
    """As in a new Context: the steps after the change are the same."""
    system, x = molecules("TIP5P", rng, 1e5)
    bonds = next(force for force in system.getForces() if isinstance(force, openmm.HarmonicBondForce))
    integrator, context = started(system, x, 0.002, "W2_1")
    integrator.step(3)
    i, j, length, _ = bonds.getBondParameters(0)
    bonds.setBondParameters(0, i, j, length, 3e5)
    bonds.updateParametersInContext(context)
    state = context.getState(positions=True, velocities=True)
    integrator.step(3)
    fresh = rb.ExactRigidBodyIntegrator(0.002, "W2_1")
    other = openmm.Context(system, fresh, REFERENCE)
    other.setState(state)
    fresh.step(3)
    np.testing.assert_allclose(positions_of(context), positions_of(other), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["TIP5P", "local"])
def test_a_step_beyond_the_resonance_of_sites_warns_of_them(name, rng):
    system, x = molecules(name, rng, 3e5)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, forceInterval=0.012, scheme="W2_3m")
    _context = context_of(system, integrator, x)
    with pytest.warns(rb.StepSizeWarning, match=r"bond of particles (3, 7|11, 15), .* evaluation, or monitor"):
        integrator.step(1)


def test_info_states_the_periods_of_bonds_of_sites(tmp_path, capsys, rng):
    from openmm_exactrb.command.main import main

    system, x = molecules("TIP4P", rng, 4e5)
    files = tmp_path / "system.xml", tmp_path / "state.xml"
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    files[0].write_text(openmm.XmlSerializer.serialize(system))
    files[1].write_text(openmm.XmlSerializer.serialize(context.getState(positions=True)))
    assert main(["info", *map(str, files)]) == 0
    period = 2e3 * np.pi * np.sqrt(0.5 * masses_of(system, x)[3] / 4e5)
    assert f"shortest periods: {period:.3g} fs (bond of V4 3, V8 7)" in capsys.readouterr().out
