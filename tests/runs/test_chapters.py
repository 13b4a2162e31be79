"""Scripts that advance more than once, two processes in one folder, and what is refused before anything is lost."""

import functools

import numpy as np
import openmm
import pytest
from openmm import app
from small_droplets import droplet, make, same_bytes

import openmm_exactrb as rb
from openmm_exactrb.runs import checkpoint
from openmm_exactrb.runs.identity import identity_of


def warm(folder, until, resume=False, temperature=300.0):
    """Equilibrate for 20 steps, set another temperature, and produce with a file of its own."""
    run, simulation = rb.Run(folder, resume=resume), of_langevin()
    run.add_reporter(rb.EnergyReporter, "warm.csv", 5)
    run.advance(simulation, 20)
    simulation.integrator.setTemperature(temperature)
    run.add_reporter(rb.EnergyReporter, "produced.csv", 5)
    run.advance(simulation, until)


def of_langevin():
    topology, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    integrator = rb.ExactRigidBodyLangevinIntegrator(30.0, 1.0, 0.005)
    integrator.setRandomNumberSeed(3)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    return simulation


def test_a_script_with_two_stretches_goes_on_in_the_second_one(tmp_path):
    warm(tmp_path / "whole", 60)
    warm(tmp_path / "parts", 33)
    warm(tmp_path / "parts", 60, resume=True)
    for name in ("warm.csv", "produced.csv"):
        assert (tmp_path / "parts" / name).read_text() == (tmp_path / "whole" / name).read_text()
    steps = np.loadtxt(tmp_path / "parts" / "produced.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(20, 61, 5))


def test_a_script_killed_between_two_stretches_goes_on(tmp_path):
    run = rb.Run(tmp_path / "parts")
    run.add_reporter(rb.EnergyReporter, "warm.csv", 5)
    run.advance(of_langevin(), 20)
    warm(tmp_path / "whole", 60)
    warm(tmp_path / "parts", 60, resume=True)
    for name in ("warm.csv", "produced.csv"):
        assert (tmp_path / "parts" / name).read_text() == (tmp_path / "whole" / name).read_text()


def test_the_second_stretch_with_other_settings_is_refused(tmp_path):
    warm(tmp_path, 33)
    with pytest.raises(ValueError, match=r"another run: integrator is .*300.* in it, but .*900.* now"):
        warm(tmp_path, 60, resume=True, temperature=900.0)


def test_the_first_stretch_cannot_become_longer_when_it_is_over(tmp_path):
    warm(tmp_path, 33)
    run = rb.Run(tmp_path, resume=True)
    run.add_reporter(rb.EnergyReporter, "warm.csv", 5)
    with pytest.raises(ValueError, match=r"is of step 33, but the run had other settings there .* to step 50"):
        run.advance(of_langevin(), 50)


def test_one_run_is_of_one_system(tmp_path):
    run = make(tmp_path)
    run.advance(droplet(), 10)
    with pytest.raises(ValueError, match="another run: System is 20 particles"):
        run.advance(droplet(n=5), 20)


def complain(steps):
    raise RuntimeError("no")


@pytest.mark.parametrize("again", ["the same run", "one that goes on"])
def test_a_finished_run_is_not_deleted_by_one_that_fails_at_once(tmp_path, again):
    run, simulation = make(tmp_path), droplet()
    run.advance(simulation, 33)
    before = {file.name: file.stat().st_size for file in tmp_path.iterdir()}
    if again == "one that goes on":
        run, simulation = make(tmp_path, resume=True), droplet()
    with pytest.raises(RuntimeError):
        run.advance(simulation, 60, complain)
    assert {file.name: file.stat().st_size for file in tmp_path.iterdir()} == before


def test_what_another_process_did_meanwhile_is_seen(half):
    late, fresh = make(half, resume=True), rb.Run(half.parent / "new")
    make(half, resume=True).advance(droplet(), 60)
    late.advance(droplet(), 40)  # which is behind
    same_bytes(half, half.parent / "whole")
    make(half.parent / "new").advance(droplet(), 7)
    with pytest.raises(FileExistsError, match="of an earlier run"):
        fresh.advance(droplet(), 60)


def test_a_run_that_another_process_took_over_is_refused(half):
    run, simulation = make(half, resume=True), droplet()
    run.advance(simulation, 40)
    make(half, resume=True).advance(droplet(), 50)
    with pytest.raises(ValueError, match=r"another process went on with the run in .* resume=True"):
        run.advance(simulation, 60)


def test_a_run_that_is_overwritten_leaves_no_file_of_the_old_one(half):
    run = rb.Run(half, overwrite=True)
    run.add_reporter(rb.EnergyReporter, "other.csv", 5)
    run.advance(droplet(), 10)
    assert {file.name for file in half.iterdir()} == {"checkpoint", "topology.pdb", "other.csv"}


def test_a_first_checkpoint_that_could_not_be_written_is_tried_again(tmp_path, monkeypatch):
    run, simulation = make(tmp_path), droplet()
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", lambda *arguments: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(OSError, match="No space left"):
            run.advance(simulation, 10)
    run.advance(simulation, 10)
    assert len((tmp_path / "energies.csv").read_text().splitlines()) == 3


@pytest.mark.parametrize(
    ("name", "reporter", "message"),
    [
        ("energies.csv", rb.EnergyReporter, "a reporter for energies.csv already"),
        ("checkpoint", rb.EnergyReporter, "checkpoint is a file of the run itself"),
        ("topology.pdb", rb.EnergyReporter, "topology.pdb is a file of the run itself"),
        ("other.dcd", "DCD", "give what makes the reporter, such as openmm.app.DCDReporter, not 'DCD'"),
    ],
)
def test_a_reporter_that_would_spoil_a_file_is_refused(tmp_path, name, reporter, message):
    run = make(tmp_path)
    with pytest.raises(ValueError, match=message):
        run.add_reporter(reporter, name, 5)


def table_of(**columns):
    return functools.partial(app.StateDataReporter, step=True, **columns)


def test_other_columns_are_another_run(tmp_path):
    for columns in ({"potentialEnergy": True}, {"potentialEnergy": True}, {"temperature": True}):
        run = rb.Run(tmp_path, resume=True)
        run.add_reporter(table_of(**columns), "log.csv", 5)
        if "temperature" in columns:
            with pytest.raises(ValueError, match=r"file log.csv is .*potentialEnergy=True.*temperature=True"):
                run.advance(droplet(), 20)
        else:
            run.advance(droplet(), 10)


def numbers(last):
    x = np.zeros(2000)
    x[1500] = last
    return x


@pytest.mark.parametrize(
    ("settings", "others"),
    [
        ({"x": numbers(1.0)}, {"x": numbers(2.0)}),
        ({"x": [1.0, 0.1]}, {"x": [1.0, 0.1 + 1e-12]}),
        ({"call": numbers}, {"call": complain}),
    ],
)
def test_settings_are_compared_to_the_last_digit(tmp_path, settings, others):
    make(tmp_path, settings=settings).advance(droplet(), 10)
    make(tmp_path, settings=settings, resume=True).advance(droplet(), 12)
    with pytest.raises(ValueError, match="another run: setting"):
        make(tmp_path, settings=others, resume=True).advance(droplet(), 20)


def test_settings_that_are_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="settings must be a mapping"):
        rb.Run(tmp_path, settings=5)


def test_a_file_with_the_name_of_a_setting_hides_nothing(tmp_path):
    for n in (4, 5):
        run = rb.Run(tmp_path, resume=True)
        run.add_reporter(rb.EnergyReporter, "System", 5)
        if n == 4:
            run.advance(droplet(n=n), 10)
        else:
            with pytest.raises(ValueError, match="another run: System is 20 particles"):
                run.advance(droplet(n=n), 20)


def letters(factor):
    if factor == 1.0:
        return lambda parts, names: {name: (lambda state, tau: state) for name in names}
    return lambda parts, names: {name: (lambda state, tau: state._replace(P=0.5 * state.P)) for name in names}


def test_own_letters_and_rotors_of_one_name_are_told_apart():
    def texts(**options):
        word = (("B", 0.5), ("A", 0.5), ("F", 1.0), ("A", 0.5), ("B", 0.5))
        simulation = droplet()
        integrator = rb.ExactRigidBodyIntegrator(0.005, scheme=rb.schemes.Scheme("mine", 2, word), engine="host")
        integrator.addLetter("F", letters(options.get("factor", 1.0)))
        context = openmm.Context(simulation.system, integrator, openmm.Platform.getPlatform("Reference"))
        context.setPositions(simulation.context.getState(positions=True).getPositions())
        found = app.Simulation.__new__(app.Simulation)
        found.integrator, found.system, found.context, found.reporters = integrator, simulation.system, context, []
        return identity_of(found)["integrator"]

    assert texts() == texts()
    assert texts() != texts(factor=0.5)


def test_a_force_that_cannot_be_serialised_does_not_keep_a_run_from_it(tmp_path):
    def at_rest(state):
        return 0.0, np.zeros((state.getPositions(asNumpy=True).shape[0], 3))

    for trap, until in ((0.5, 10), (0.5, 20), (0.6, 30)):
        topology, system, positions = rb.dipole_fluid(4, seed=1, trap=trap)
        system.addForce(openmm.PythonForce(lambda state: at_rest(state)))
        simulation = app.Simulation(
            topology, system, rb.ExactRigidBodyIntegrator(0.005), openmm.Platform.getPlatform("Reference")
        )
        simulation.context.setPositions(positions)
        run = make(tmp_path, resume=True)
        if until < 30:
            run.advance(simulation, until)
        else:
            with pytest.raises(ValueError, match=r"System is .* and PythonForce not compared in it"):
                run.advance(simulation, until)
