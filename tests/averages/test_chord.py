"""Averages of OpenMM's LangevinMiddleIntegrator, whose drifts are chords of the constraints."""

import itertools

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from averages.stationary import Rotor, chord
from averages.test_corrections import COUNT, KT, cosine, made, reporting, rotors, water
from openmm_exactrb.averages.chord import Chords
from openmm_exactrb.averages.record import read
from openmm_exactrb.constraints.clusters import ClusterState
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.openmm_access.parameters import constraints
from openmm_exactrb.schemes import scheme_for_thermostat
from openmm_exactrb.schemes.step_errors import step_errors
from openmm_exactrb.schemes.thermostatted import with_thermostat

BAOA = step_errors(with_thermostat(scheme_for_thermostat("BAOA")))


def test_a_drift_of_openmm_is_the_chord_with_noise_off_the_sphere():
    """The velocity after the heat exchange follows from what OpenMM returns, and so does the place by `chord`."""
    h, friction = 0.1, 2.0
    integrator = openmm.LangevinMiddleIntegrator(300.0, friction, h)
    integrator.setConstraintTolerance(1e-12)
    integrator.setRandomNumberSeed(5)
    simulation = rotors(integrator)

    def relative():
        state = simulation.context.getState(positions=True, velocities=True)
        arrays = (state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value)
        return (np.diff(a.reshape(-1, 2, 3), axis=1)[:, 0].T / 0.2 for a in arrays)

    simulation.step(3)
    noise = []
    for _ in range(4):
        x, v = relative()
        v = v + h * 2.0 * np.array([[0.0], [0.0], [1.0]])
        v -= (v * x).sum(axis=0) * x
        simulation.step(1)
        n, w = relative()
        after = 2.0 * w + v - 2.0 / h * (n - x)
        expected, tangent = chord(x, v, after, h)
        assert n == pytest.approx(expected, abs=1e-9)
        assert w - (w * n).sum(axis=0) * n == pytest.approx(tangent, abs=1e-7)
        noise.append(after - np.exp(-h * friction) * v)
        along = (noise[-1] * x).sum(axis=0)
        assert along.var() == pytest.approx(1.0 - np.exp(-2.0 * h * friction), rel=0.25)
    assert np.var(noise) == pytest.approx(1.0 - np.exp(-2.0 * h * friction), rel=0.05)


@pytest.mark.parametrize("friction", [pytest.param(1.0, marks=pytest.mark.validate), 3.0])
def test_the_error_of_averages_has_the_energy_of_the_chord(friction):
    """The errors of a rotor in a field over h², at three steps, go to the prediction; the next order is friction h³."""
    system, steps = Rotor(degree=7, nodes=11), np.array([0.02, 0.01, 0.005])
    start, e = system.basis(system.z) * system.w[:, None], system.z[2]
    exact = np.array([system.mean(of(system.z)) for of, _ in system.observables])
    errors = []
    for h in steps:
        density = system.left_alone(start.T @ system.through_chord(h, friction))
        errors.append((np.array([(start @ density) @ of(system.z) for of, _ in system.observables]) - exact) / h**2)
    once = [2.0 * fine - coarse for coarse, fine in itertools.pairwise(errors)]
    found = (4.0 * once[1] - once[0]) / 3.0
    # The heat exchange of T = e²/24 beside that of v·V''v.
    heat = 2.0 * BAOA.alpha * (system.curvature(system.z) - system.second(system.z)) + (16.0 * e - 4.0 * e**2) / 24.0
    rest = system.remaining(friction, friction * heat)
    predicted = [
        -(BAOA.alpha + BAOA.beta) * system.covariance(of(system.z), system.square(system.z))
        - BAOA.slope * system.mean(slope(system.z))
        + system.mean(of(system.z) * rest)
        for of, slope in system.observables
    ]
    assert found == pytest.approx(predicted, rel=1e-3)
    assert np.abs(found).min() > 0.1  # without the chord they are a fifth of that at most
    sizes = np.abs([error[0] * h**2 for error, h in zip(errors, steps, strict=True)])
    assert np.diff(np.log(sizes)) / np.diff(np.log(steps)) == pytest.approx(2.0, abs=0.05)


def cluster(lengths, masses, pairs, x):
    """Return the bodies, the constraints and the positions of one molecule."""
    system = openmm.System()
    for mass in masses:
        system.addParticle(mass)
    for (i, j), length in zip(pairs, lengths, strict=True):
        system.addConstraint(i, j, length)
    bodies = find_bodies(system, np.array(x))
    return bodies, np.array(x), Chords(bodies, constraints(system)[0], np.array(x))


def test_the_mean_energy_of_the_chord_of_a_flexible_cluster_is_that_of_its_free_motion():
    """Its free motion has the acceleration a; the mean over velocities of a power of four is exact by quadrature."""
    x = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [-0.03, 0.11, 0.02]]
    masses, pairs = [12.0, 1.0, 2.0], [(0, 1), (0, 2)]
    lengths = [np.linalg.norm(np.subtract(x[0], x[k])) for k in (1, 2)]
    bodies, x, chords = cluster(lengths, masses, pairs, x)
    clusters = bodies.clusters
    # An orthonormal basis of velocities that the constraints allow, without those of the centre.
    gradient = np.zeros((5, 3, 3))
    for row, (i, j) in zip(gradient, pairs, strict=False):
        row[i], row[j] = x[i] - x[j], x[j] - x[i]
    gradient[2:] = np.eye(3)[:, None] * np.array(masses)[None, :, None]
    root = np.sqrt(masses)[:, None]
    allowed = np.linalg.svd((gradient / root).reshape(5, 9))[2][5:].reshape(4, 3, 3) / root
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    mean, t, order = 0.0, 1e-4, clusters.particles
    for chosen in itertools.product(range(3), repeat=4):
        v = np.tensordot(nodes[list(chosen)], allowed, axes=1)
        state = [np.zeros((2, 3, 3)), np.zeros((2, 3, 3))]
        state[0][0], state[1][0] = x[order].T, (clusters.mass[:, None] * v[order]).T
        there, back = (clusters.drift(ClusterState(*state), way).x.sum(axis=0) for way in (t, -t))
        a = (there + back - 2.0 * x[order].T) / t**2
        mean += weights[list(chosen)].prod() / weights.sum() ** 4 * (clusters.mass * a * a).sum() / 24.0
    assert chords.mean(x, KT) == pytest.approx(KT**2 * mean, rel=1e-5)


def test_the_mean_energy_of_the_chord_of_water_is_that_of_a_rigid_body():
    """T = (w² w·Iw - (w x Iw)·I⁻¹(w x Iw))/24."""
    _, system, positions = rb.rigid_water(5)
    x = np.array(positions._value)
    bodies = find_bodies(system, x)
    inertia = bodies.inertia[0]
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    mean = 0.0
    for chosen in itertools.product(range(3), repeat=3):
        w = nodes[list(chosen)] / np.sqrt(inertia)
        torque = np.cross(w, inertia * w)
        of = (w @ w) * (w @ (inertia * w)) - torque @ (torque / inertia)
        mean += weights[list(chosen)].prod() / weights.sum() ** 3 * of / 24.0
    assert Chords(bodies, constraints(system)[0], x).mean(x, KT) == pytest.approx(5.0 * KT**2 * mean, rel=1e-6)


def test_a_frame_of_openmms_integrator_is_that_of_baoa_and_the_chord(tmp_path):
    """At the same positions, of rigid water with pressure."""
    rows = []
    for integrator in (
        rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, scheme="BAOA"),
        openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002),
    ):
        simulation = water(integrator)
        file = tmp_path / f"{type(integrator).__name__}.csv"
        reporter = rb.AverageReporter(file, 1, pressure=True)
        reporter.report(simulation, simulation.context.getState(positions=True, energy=True, forces=True))
        reporter.close()
        rows.append(read(file))
    (ours, own), (theirs, found) = rows
    for name, values in own.items():
        assert found[name] == pytest.approx(values, rel=1e-5, abs=1e-9), name
    assert set(found) - set(own) == {"chord"}
    assert theirs.chords
    same = ("step", "alpha", "beta", "slopes", "temperature", "kT", "frictions", "freedom", "mass")
    assert [getattr(theirs, name) for name in same] == [getattr(ours, name) for name in same]


def test_rotation_on_chords_makes_a_run_hotter(tmp_path):
    """By the means of the normal distribution: the energy moves by its heat capacity, and with the chord's energy."""
    file = made(tmp_path, np.random.default_rng(9), barostat="")
    before, (_, columns) = rb.corrected(file, "potential energy"), read(file)
    lines = file.read_text(encoding="utf-8").splitlines()
    lines[0] = lines[0].replace('"observables"', '"chords": true, "observables"')
    lines[1] += ",chord"
    energy = columns["potential"]
    chords = 1e4 - 2.0 * (energy - energy.mean())
    lines[2:] = [f"{line},{value!r}" for line, value in zip(lines[2:], map(float, chords), strict=True)]
    file.write_text("\n".join(lines) + "\n")
    after, fluctuation = rb.corrected(file, "potential energy"), energy.var()
    error = 0.024**2 * (2.0 * fluctuation / KT + 4.0 * chords.mean() * fluctuation / (384 * KT**2))
    for earlier, later in zip(before.bracket, after.bracket, strict=True):
        assert earlier - later == pytest.approx(error, rel=1e-6)


def test_a_run_of_openmms_integrator_ends_with_its_settings(tmp_path):
    integrator = openmm.LangevinMiddleIntegrator(300.0, 1.0, 0.02)
    simulation = rotors(integrator)
    with reporting(simulation, tmp_path / "rotors.csv", 1, observables={"cosine": cosine}):
        simulation.step(1)
        integrator.setTemperature(310.0)
        with pytest.raises(ValueError, match="use a new AverageReporter with another file"):
            simulation.step(1)
    assert read(tmp_path / "rotors.csv")[1]["chord"] == pytest.approx(COUNT * KT / 3.0, rel=1e-4)


def planar():
    """Return four atoms in a plane, held by all their distances."""
    x = 0.1 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return x, list(itertools.combinations(range(4), 2))


def test_what_is_known_of_rigid_molecules_does_not_depend_on_the_precision_of_positions():
    """Positions that a run begins with may not obey the constraints yet."""
    _, system, positions = rb.rigid_water(1)
    exact = np.array(positions._value)
    rough = exact + np.random.default_rng(3).normal(0.0, 0.005, exact.shape)
    held = constraints(system)[0]
    found = [Chords(find_bodies(system, x), held, x).mean(exact, KT) for x in (exact, rough)]
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    x, pairs = planar()
    lengths = [np.linalg.norm(x[i] - x[j]) for i, j in pairs]
    with pytest.raises(ValueError, match="nearly planar"):
        cluster(lengths, [12.0] * 4, pairs, x + np.random.default_rng(4).normal(0.0, 0.001, x.shape))
