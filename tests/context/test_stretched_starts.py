"""Starts off their constraints: what OpenMM's solver mends runs, and what does not run is refused with its cause."""

import re

import numpy as np
import openmm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.command.main import main
from places import REFERENCE
from products import in_pairs
from starts import context_of, positions_of, simulation_of, system_of, topology_of, velocities_of

SEEDS = st.integers(0, 2**32 - 1)
ENGINES = ["host", "auto"]
#: Masses, positions (nm), the heavy atom of each hydrogen, and further constrained pairs.
MOLECULES = {
    "water": (
        [15.999, 1.008, 1.008],
        [[0.0, 0.0, 0.0], [0.09572, 0.0, 0.0], [-0.023999, 0.092663, 0.0]],
        {1: 0, 2: 0},
        [(1, 2)],
    ),
    "hydroxyl": ([15.999, 1.008], [[0.0, 0.0, 0.0], [0.0945, 0.0, 0.0]], {1: 0}, []),
    "methyl": (
        [12.011, 1.008, 1.008, 1.008],
        [[0.0, 0.0, 0.0], [0.109, 0.0, 0.0], [-0.0363, 0.1027, 0.0], [-0.0363, -0.0514, 0.089]],
        {1: 0, 2: 0, 3: 0},
        [],
    ),
    "methanol": (
        [12.011, 1.008, 1.008, 1.008, 15.999, 1.008],
        [
            *([0.0, 0.0, 0.0], [0.109, 0.0, 0.0], [-0.0363, 0.1027, 0.0], [-0.0363, -0.0514, 0.089]),
            *([-0.0476, -0.0673, -0.1166], [0.0413, -0.087, -0.141]),
        ],
        {1: 0, 2: 0, 3: 0, 5: 4},
        [],
    ),
    "methanol with all bonds": (
        [12.011, 1.008, 1.008, 1.008, 15.999, 1.008],
        [
            *([0.0, 0.0, 0.0], [0.109, 0.0, 0.0], [-0.0363, 0.1027, 0.0], [-0.0363, -0.0514, 0.089]),
            *([-0.0476, -0.0673, -0.1166], [0.0413, -0.087, -0.141]),
        ],
        {1: 0, 2: 0, 3: 0, 5: 4},
        [(0, 4)],
    ),
}


class Start:
    """Three molecules without forces, with random orientations, some of whose bonds to hydrogen are stretched."""

    def __init__(self, name, rng, amounts):
        masses, x, self.bonds, others = MOLECULES[name]
        x, n = np.array(x), len(masses)
        self.held = [(i, j) for i, j in [*self.bonds.items(), *others]]
        turns = [np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(3)]
        molecules = [x @ Q.T + [k, 0.0, 0.0] for k, Q in enumerate(turns)]
        self.shape = np.concatenate(molecules)
        lengths = [(i, j, float(np.linalg.norm(x[i] - x[j]))) for i, j in self.held]
        self.constraints = [(n * k + i, n * k + j, d) for k in range(3) for i, j, d in lengths]
        self.masses = np.array(3 * masses)
        self.x = self.shape.copy()
        for hydrogen, heavy in self.bonds.items():  # of the second molecule
            h, o = n + hydrogen, n + heavy
            bond = self.shape[h] - self.shape[o]
            amount = amounts(rng) / np.linalg.norm(bond)
            self.x[h] = self.shape[o] + (1.0 + amount) * bond

    @property
    def system(self):
        return system_of(self.masses, self.constraints)

    def missed(self, x):
        """Return the largest error of a constrained length, in nm."""
        return max(abs(np.linalg.norm(x[i] - x[j]) - length) for i, j, length in self.constraints)


def slightly(rng):
    return rng.choice([-1.0, 1.0]) * rng.uniform(0.002, 0.05)


def far(rng):
    return rng.choice([rng.uniform(0.08, 0.4), rng.uniform(-0.09, -0.08)])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", MOLECULES)
@settings(max_examples=5, deadline=None)
@given(SEEDS)
def test_bonds_stretched_by_up_to_a_twentieth_of_a_nanometre_are_mended_with_a_warning(name, engine, seed):
    start = Start(name, np.random.default_rng(seed), slightly)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine=engine)
    context = context_of(start.system, integrator, start.x)
    with pytest.warns(rb.ShapeWarning, match=r"were corrected \(bodies affected: [12]\), by up to"):
        integrator.step(0)
    x, n = positions_of(context), len(start.masses) // 3
    assert start.missed(x) < 1e-13
    assert np.linalg.norm(x - start.x, axis=1).max() < 0.06
    mass = start.masses[n : 2 * n]
    np.testing.assert_allclose(mass @ x[n : 2 * n], mass @ start.x[n : 2 * n], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(x[:n], start.x[:n], rtol=0.0, atol=1e-6)  # rounded constraints
    integrator.setVelocitiesToTemperature(300, 1)
    integrator.step(5)
    assert start.missed(positions_of(context)) < 1e-13


@pytest.mark.parametrize("length", [0.131, 0.075])
@pytest.mark.parametrize("name", MOLECULES)
def test_lengths_of_other_force_fields_run_as_in_verlet(name, length, rng):
    """The molecules are the same at the end, up to how far the solver moves their atoms."""
    start = Start(name, rng, lambda rng: 0.0)
    n = len(start.masses) // 3
    for hydrogen, heavy in start.bonds.items():
        bond = start.shape[n + hydrogen] - start.shape[n + heavy]
        start.x[n + hydrogen] = start.shape[n + heavy] + length * bond / np.linalg.norm(bond)
    ends = []
    for integrator in (openmm.VerletIntegrator(0.001), rb.ExactRigidBodyIntegrator(0.001)):
        context = context_of(start.system, integrator, start.x)
        if isinstance(integrator, rb.ExactRigidBodyIntegrator):
            with pytest.warns(rb.ShapeWarning):
                integrator.step(0)
        else:
            context.applyConstraints(1e-8)
        ends.append(positions_of(context))
        assert start.missed(ends[-1]) < 1e-6
    assert np.linalg.norm(ends[0] - ends[1], axis=1).max() < 0.01


@pytest.mark.parametrize("name", MOLECULES)
@settings(max_examples=4, deadline=None)
@given(SEEDS)
def test_bonds_stretched_farther_are_refused_with_the_call_that_mends_them(name, seed):
    start = Start(name, np.random.default_rng(seed), far)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2")
    context = context_of(start.system, integrator, start.x)
    with pytest.raises(
        ValueError, match=r"because bonds are stretched or bent: call context\.applyConstraints\(1e-6\)"
    ):
        integrator.step(1)
    np.testing.assert_array_equal(positions_of(context), start.x)
    context.applyConstraints(1e-6)
    integrator.step(3)
    assert start.missed(positions_of(context)) < 1e-13


@pytest.mark.parametrize("name", MOLECULES)
@settings(max_examples=4, deadline=None)
@given(SEEDS)
def test_atoms_elsewhere_are_refused_as_such(name, seed):
    """Without a periodic box, nothing says in which image an atom belongs."""
    rng = np.random.default_rng(seed)
    start = Start(name, rng, lambda rng: 0.0)
    n = len(start.masses) // 3
    which = n + rng.permutation(n)[: rng.integers(1, n)]
    start.x[which] += rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)] * rng.uniform(1.0, 4.0)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2")
    context = context_of(start.system, integrator, start.x)
    if start.missed(start.x) < 1e-3:  # only atoms without a constraint between them are apart
        integrator.step(1)
        return
    with pytest.raises(ValueError, match="periodic image") as caught:
        integrator.step(1)
    assert "stretched" not in str(caught.value)
    context.setPositions(start.shape)
    integrator.step(1)


@pytest.mark.parametrize("name", MOLECULES)
def test_a_minimisation_mends_what_a_step_refuses(name, rng):
    start = Start(name, rng, far)
    system = start.system
    springs = openmm.CustomExternalForce("10*(x^2+y^2+z^2)")
    for i in range(system.getNumParticles()):
        springs.addParticle(i)
    system.addForce(springs)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2")
    simulation = simulation_of(topology_of(system), system, integrator, start.x)
    simulation.minimizeEnergy(maxIterations=5)
    simulation.step(1)
    assert start.missed(positions_of(simulation.context)) < 1e-13


@in_pairs(
    {
        "name": MOLECULES,
        "how": ["reinitialize", "checkpoint", "State"],
        "scheme": ["S2_2", "W2_1"],
        "engine": ENGINES,
    }
)
def test_other_lengths_of_constraints_hold_from_the_next_call(name, how, scheme, engine, rng):
    """As if the positions had been set, wherever the state comes from."""
    start = Start(name, rng, lambda rng: 0.0)
    system = start.system
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine=engine)
    context = context_of(system, integrator, start.x, kelvin=300.0)
    integrator.step(3)
    x = positions_of(context)
    start.constraints = [(i, j, (1.0 + 0.01 * (k + 1)) * length) for k, (i, j, length) in enumerate(start.constraints)]
    if how == "reinitialize":
        for k, constraint in enumerate(start.constraints):
            system.setConstraintParameters(k, *constraint)
        context.reinitialize(preserveState=True)
    else:
        saved = context
        integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine=engine)
        context = openmm.Context(start.system, integrator, REFERENCE)
        if how == "checkpoint":
            context.loadCheckpoint(saved.createCheckpoint())
        else:
            context.setState(saved.getState(positions=True, velocities=True, integratorParameters=True))
    with pytest.warns(rb.ShapeWarning, match="were corrected"):
        integrator.step(0)
    assert start.missed(positions_of(context)) < 1e-13
    other = context_of(start.system, rb.ExactRigidBodyIntegrator(0.001, scheme), positions_of(context))
    other.setVelocities(velocities_of(context))
    for one in (context, other):
        one.getIntegrator().step(1)
    np.testing.assert_allclose(positions_of(context), positions_of(other), rtol=0.0, atol=1e-12)
    assert np.linalg.norm(positions_of(context) - x, axis=1).max() < 0.02


# -- the command --------------------------------------------------------------------------------------------------


def pdb_of_waters(file, lengths):
    """Write four waters, the first bond of the second one of the given length, where the box has split the third."""
    topology, _, positions = rb.rigid_water(4, seed=3)
    x = np.array(positions._value)
    x[4] = x[3] + lengths / np.linalg.norm(x[4] - x[3]) * (x[4] - x[3])
    x[6:9] += [1.97, 1.0, 1.0] - x[6]
    topology.setPeriodicBoxVectors(2.0 * np.eye(3))
    with file.open("w") as out:
        app.PDBFile.writeFile(topology, np.mod(x, 2.0) * unit.nanometer, out)


@pytest.mark.parametrize("length", [0.075, 0.3])
def test_the_command_mends_a_stretched_start(length, tmp_path, capsys):
    file, out = tmp_path / "four.pdb", tmp_path / "out"
    pdb_of_waters(file, length)
    force_field = "--forcefield", "tip3p.xml", "--cutoff", "0.8"
    assert main(["info", str(file), *force_field]) == 0
    said = capsys.readouterr().out
    assert "everything is supported" in said
    if length < 0.15:
        assert re.search(r"were corrected \(bodies affected: 1\), by up to 0\.0[1-4]", said)
    else:
        assert f"bonds are stretched by up to {length - 0.09572:.2g} nm, which exactrb run corrects" in said
    short = "--step", "1fs", "--scheme", "S2_2", "--duration", "0.005", "--interval", "1fs", "--equilibrate", "0.01"
    options = "--platform", "Reference", "--quiet", "--no-picture", "--out", out
    assert main(["run", str(file), *force_field, *short, *map(str, options)]) == 0
    assert capsys.readouterr().err == ""
