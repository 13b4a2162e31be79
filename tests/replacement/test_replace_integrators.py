"""Integrators of the package instead of OpenMM's: which, with which arguments, and what remains afterwards."""

import contextlib
import copy
import pickle
import threading

import numpy as np
import openmm
import pytest
from openmm import LangevinIntegrator as ImportedBefore
from openmm import app, unit

import openmm_exactrb as rb
from peptides import FORCE_FIELD, PEPTIDE, in_box
from places import CPU, REFERENCE
from starts import simulation_of

LANGEVIN = openmm.LangevinMiddleIntegrator, openmm.LangevinIntegrator
CLASSES = (*LANGEVIN, openmm.VerletIntegrator)
K, PS, FS = unit.kelvin, unit.picosecond, unit.femtosecond
HELD = {"made": [openmm.LangevinMiddleIntegrator]}  # as a library keeps a class, out of reach of names


class Scripts(openmm.LangevinMiddleIntegrator):
    """As a script derives its own integrator, before or within the statement."""

    def __init__(self, kelvin, note):
        self.note = note
        super().__init__(kelvin * K, 1 / PS, 2 * FS)

    def step(self, steps):
        super().step(2 * steps)

    def hotter(self):
        self.setTemperature(self.getTemperature() + 10 * K)


def default(made=openmm.VerletIntegrator):
    return made(1 * FS)


def by_star():
    names = {}
    exec("from openmm import *", names)
    return names["LangevinIntegrator"](300 * K, 1 / PS, 2 * FS)


WAYS = {
    "module": lambda: openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, 2 * FS),
    "openmm.openmm": lambda: openmm.openmm.LangevinMiddleIntegrator(300, 1, 0.002),
    "star": by_star,
    "imported before": lambda: ImportedBefore(300, 1.0, 2 * FS),
    "kept in a container": lambda: HELD["made"][0](300, 1.0, 2 * FS),
    "default of an argument": default,
    "in nanoseconds": lambda: openmm.VerletIntegrator(1e-6 * unit.nanosecond),
    "subclass": lambda: Scripts(300, "from before"),
}


def silent(**options):
    return rb.replace_integrators(report=None, **options)


def in_water(integrator, platform=REFERENCE):
    topology, system, x = rb.rigid_water(8)
    simulation = simulation_of(topology, system, integrator, x, platform=platform)
    simulation.context.setVelocitiesToTemperature(300, 1)
    return simulation


@pytest.mark.parametrize("make", WAYS.values(), ids=WAYS)
def test_each_way_to_create_an_integrator_creates_ours_of_the_same_arguments(make):
    openmms = make()
    with silent() as replaced:
        ours = make()
        assert isinstance(ours, rb.ExactRigidBodyIntegrator)
        assert replaced.integrators.total() == 1
    for kind in CLASSES:
        assert isinstance(ours, kind) == isinstance(openmms, kind)
    assert isinstance(ours, rb.ExactRigidBodyLangevinIntegrator) == isinstance(openmms, LANGEVIN)
    for name in ("StepSize", "Temperature", "Friction"):
        if hasattr(openmms, f"get{name}"):
            assert getattr(ours, f"get{name}")() == getattr(openmms, f"get{name}")()
    assert ours.forceEvaluationsPerStep == 1
    assert not isinstance(make(), rb.ExactRigidBodyIntegrator)


def test_arguments_have_names_too():
    with silent():
        for integrator in (
            openmm.LangevinMiddleIntegrator(frictionCoeff=2 / PS, stepSize=2 * FS, temperature=310 * K),
            openmm.LangevinIntegrator(310, 2, stepSize=0.002),
        ):
            found = integrator.getTemperature(), integrator.getFriction(), integrator.getStepSize()
            assert found == (310 * K, 2 / PS, 2 * FS)


def openmm_as_it_is():
    owners = (*CLASSES, openmm.Context, app.Simulation, app.ForceField, app.AmberPrmtopFile, app.CharmmPsfFile)
    return [dict(vars(owner)) for owner in owners]


@pytest.mark.parametrize("options", [{}, {"interval": 0.004, "same_time": True, "heavy_hydrogens": True}])
@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt, SystemExit])
def test_nothing_of_openmm_is_changed_afterwards(options, error):
    before = openmm_as_it_is()
    with contextlib.suppress(error or ()), silent(**options):
        assert openmm_as_it_is() != before
        if error:
            raise error
    assert openmm_as_it_is() == before


def test_an_integrator_moves_as_ours_of_the_default_scheme_does():
    ends = []
    with silent():
        for kind in (openmm.LangevinMiddleIntegrator, rb.ExactRigidBodyLangevinIntegrator):
            integrator = kind(300 * K, 1 / PS, 2 * FS)
            integrator.setRandomNumberSeed(7)
            simulation = in_water(integrator)
            simulation.step(25)
            ends.append(simulation.context.getState(positions=True).getPositions(asNumpy=True)._value)
    np.testing.assert_array_equal(*ends)


@pytest.mark.library
@pytest.mark.parametrize("kind", CLASSES)
def test_a_step_is_a_force_evaluation_as_measured(kind):
    with silent() as replaced:
        integrator = kind(*(300 * K, 1 / PS)[: 2 * (kind in LANGEVIN)], 2 * FS)
        simulation = in_water(integrator)
        simulation.step(200)
        assert replaced.steps == replaced.forceEvaluations == simulation.currentStep == 200
        assert replaced.gain == pytest.approx(1.0, rel=1e-12)
    assert 200 <= integrator.timings.evaluations <= 220  # with the energies of checks


COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda integrator: pickle.loads(pickle.dumps(integrator)),
    "XML": lambda integrator: openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(integrator)),
    "clone": openmm.XmlSerializer.clone,
}


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("way", ["module", "imported before", "default of an argument", "subclass"])
def test_copies_are_of_the_same_class_and_settings(way, copied, inside):
    with silent(interval=3 * FS):
        original = WAYS[way]()
        original.setRandomNumberSeed(5)
        duplicate = copied(original) if inside else None
    duplicate = duplicate or copied(original)
    assert type(duplicate) is type(original)
    assert duplicate.getSettings() == original.getSettings()
    assert duplicate.getStepSize() == 3 * FS
    assert vars(duplicate).get("note") == vars(original).get("note")


def test_a_subclass_of_a_script_keeps_its_methods():
    with silent() as replaced:
        integrator = Scripts(290, "mine")
        integrator.hotter()
        simulation = in_water(integrator)
        simulation.step(6)
        assert (integrator.note, integrator.getTemperature(), type(integrator).__name__) == ("mine", 300 * K, "Scripts")
        assert replaced.steps == simulation.currentStep >= 6


def test_threads_create_ours_and_are_counted():
    def run():
        in_water(openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, 2 * FS)).step(10)

    with silent() as replaced:
        threads = [threading.Thread(target=run) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert (replaced.integrators.total(), replaced.steps) == (6, 60)


def test_one_statement_at_a_time():
    with silent(), pytest.raises(RuntimeError, match="already being replaced"), silent():
        pass
    with silent():
        pass


def test_what_is_not_replaced_is_named():
    told = []
    xml = openmm.XmlSerializer.serialize(openmm.LangevinMiddleIntegrator(300, 1, 0.002))
    _, system, _ = rb.rigid_water(1)
    with rb.replace_integrators(report=told.append) as replaced:
        compound = openmm.CompoundIntegrator()
        compound.addIntegrator(openmm.VerletIntegrator(0.001))
        compound.addIntegrator(openmm.BrownianIntegrator(300, 1, 0.001))
        for integrator in (
            openmm.NoseHooverIntegrator(0.001),
            openmm.NoseHooverIntegrator(0.001),
            openmm.MTSIntegrator(0.001, [(0, 1)]),
            openmm.XmlSerializer.deserialize(xml),
            openmm.VerletIntegrator(0.0),
            rb.ExactRigidBodyIntegrator(0.001),
            compound,
        ):
            openmm.Context(system, integrator, REFERENCE)
    names = ["NoseHooverIntegrator", "MTSIntegrator of openmm.mtsintegrator", "LangevinMiddleIntegrator"]
    names += ["VerletIntegrator", "BrownianIntegrator"]
    assert replaced.others == dict(zip(names, [2, 1, 1, 1, 1], strict=True))
    assert replaced.integrators == {"VerletIntegrator": 1}
    assert "not replaced: NoseHooverIntegrator (2 Contexts)" in told


def test_modeller_prepares_systems_with_openmm():
    pdb = app.PDBFile(str(PEPTIDE))
    with silent(interval=8 * FS) as replaced:
        modeller = app.Modeller(pdb.topology, pdb.positions)
        modeller.delete([atom for atom in modeller.topology.atoms() if atom.element is app.element.hydrogen])
        modeller.addHydrogens(FORCE_FIELD, platform=REFERENCE)
    assert modeller.topology.getNumAtoms() == pdb.topology.getNumAtoms()
    assert not replaced.integrators
    assert not replaced.others


# -- intervals --------------------------------------------------------------------------------------------------------


def test_an_interval_is_the_step_of_all_integrators_and_the_first_line_says_how_long_the_run_becomes():
    told = []
    with rb.replace_integrators(4 * FS, report=told.append) as replaced:
        integrator = openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, 1 * FS)
        simulation = in_water(integrator)
        simulation.step(20)
        assert integrator.getStepSize() == 4 * FS
        assert simulation.context.getTime()._value == pytest.approx(0.08, rel=1e-12)
        integrator.setStepSize(2 * FS)
        simulation.step(10)
        assert integrator.getStepSize() == 4 * FS
    assert "a step is 4 fs with one force evaluation, and in the script 1 fs" in told[0]
    assert "n steps of the script stay n steps, and have 4 times the simulated time" in told[0]
    assert "setStepSize(2 fs) has no effect" in told[1]
    assert "30 force evaluations" in told[2]
    assert replaced.openmmForceEvaluations == pytest.approx(80 + 20)
    integrator.setStepSize(1 * FS)
    assert integrator.getStepSize() == 1 * FS


@pytest.mark.library
def test_steps_of_a_compound_are_counted():
    _, system, x = rb.rigid_water(8)
    with silent(interval=4 * FS) as replaced:
        compound = openmm.CompoundIntegrator()
        compound.addIntegrator(openmm.LangevinMiddleIntegrator(300, 1, 0.002))
        compound.addIntegrator(openmm.LangevinMiddleIntegrator(400, 1, 0.001))
        context = openmm.Context(system, compound, REFERENCE)
        context.setPositions(x)
        for k in (0, 1, 0):
            compound.setCurrentIntegrator(k)
            compound.step(5)
    assert context.getTime()._value == pytest.approx(0.06)
    assert (replaced.steps, replaced.openmmForceEvaluations) == (15, pytest.approx(10 * 2 + 5 * 4))


def test_light_hydrogens_are_refused_at_long_intervals():
    topology, system, x = in_box()
    with silent(interval=8 * FS):
        with pytest.raises(ValueError, match=r"an interval of 8 fs needs heavy hydrogens, but .* use heavy_hydrogens"):
            simulation_of(topology, system, openmm.LangevinMiddleIntegrator(300, 1, 0.002), x, platform=CPU)
        rb.heavy_hydrogens(system, topology)
        simulation = simulation_of(topology, system, openmm.LangevinMiddleIntegrator(300, 1, 0.002), x, platform=CPU)
        simulation.minimizeEnergy(maxIterations=50)
        simulation.step(20)
    with silent(interval=6 * FS):
        topology, system, x = rb.rigid_water(8)
        simulation_of(topology, system, openmm.LangevinMiddleIntegrator(300, 1, 0.002), x, platform=REFERENCE)


def test_hydrogens_of_systems_of_createsystem_are_heavy_in_water_too():
    pdb = app.PDBFile(str(PEPTIDE))
    prmtop = app.AmberPrmtopFile(str(PEPTIDE.parents[2] / "tests" / "data" / "two_waters.prmtop"))
    with silent(heavy_hydrogens=True):
        systems = {
            pdb.topology: FORCE_FIELD.createSystem(pdb.topology, hydrogenMass=1.5),
            prmtop.topology: prmtop.createSystem(),
        }
    for topology, system in systems.items():
        total = sum(system.getParticleMass(i)._value for i in range(system.getNumParticles()))
        assert total == pytest.approx(sum(atom.element.mass._value for atom in topology.atoms()), rel=1e-3)
        masses = {system.getParticleMass(atom.index)._value for atom in topology.atoms() if atom.element.symbol == "H"}
        assert masses == {3.0}
    light = prmtop.createSystem()
    assert light.getParticleMass(1)._value == pytest.approx(1.008, abs=1e-3)


@pytest.mark.parametrize(
    "name",
    ["AmberPrmtopFile", "CharmmPsfFile", "DesmondDMSFile", "ForceField", "GromacsTopFile", "TinkerFiles"],
)
def test_each_class_of_openmm_that_creates_systems_makes_hydrogens_heavy(name):
    before = getattr(app, name).createSystem
    with silent(heavy_hydrogens=True):
        assert getattr(app, name).createSystem is not before
    assert getattr(app, name).createSystem is before
    with silent():
        assert getattr(app, name).createSystem is before


def test_systems_without_hydrogens_stay_as_they_are():
    topology = app.Topology()
    residue = topology.addResidue("CL", topology.addChain())
    topology.addAtom("CL", app.element.chlorine, residue)
    with silent(heavy_hydrogens=True):
        assert FORCE_FIELD.createSystem(topology).getNumParticles() == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"interval": 0.0}, "interval must be positive"),
        ({"interval": -1 * FS}, "at least 0"),
        ({"interval": 300 * K}, "interval"),
        ({"same_time": True}, "same_time needs an interval"),
        ({"same_time": 1, "interval": 0.004}, "same_time must be True or False"),
        ({"heavy_hydrogens": "yes"}, "heavy_hydrogens must be True or False"),
    ],
)
def test_invalid_arguments_are_refused_before_anything_is_changed(options, message):
    before = openmm_as_it_is()
    with pytest.raises(ValueError, match=message), silent(**options):
        pass
    assert openmm_as_it_is() == before
