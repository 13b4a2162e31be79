"""One sentence for each misuse, and nothing is left behind that the mended script stumbles over."""

import os
import subprocess
import sys

import dask
import numpy as np
import openmm
import pytest
from boxes import FEMTOSECONDS, quietly, water
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb import ensemble


def one_sentence(message, call, error=ValueError):
    with pytest.raises(error, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bodies", [[0, 1, 2], "abc", 5, [["a", "b"]], [[0.5, 1.5]], np.arange(3)])
def test_bodies_are_lists_of_particles(bodies):
    one_sentence(
        r"^bodies must be lists .* \[\[0, 1, 2\],",
        lambda: rb.ExactRigidBodyIntegrator(0.002, bodies=bodies),
    )


@pytest.mark.parametrize(
    "arguments",
    [(300 * unit.kelvin, 1 / unit.picosecond, 0.004 * unit.picoseconds), (300, 1, 0.004), (300 * unit.kelvin,)],
)
def test_the_arguments_of_a_thermostat_are_distinguished(arguments):
    one_sentence(
        "use ExactRigidBodyLangevinIntegrator for these",
        lambda: rb.ExactRigidBodyIntegrator(*arguments),
    )


def test_reinitialize_that_forgets_positions_says_so():
    simulation = water(minimise=0)
    quietly(simulation.step, 1)
    simulation.context.reinitialize()
    one_sentence("no positions", lambda: simulation.step(1))


# -- reporters and runs -----------------------------------------------------------------------------------------


def test_an_interval_is_a_whole_number_of_steps(tmp_path):
    run = rb.Run(tmp_path / "run")
    for interval in (0, -1, 2.5, "10"):
        one_sentence(
            "interval must be a whole number", lambda i=interval: run.add_reporter(app.DCDReporter, "a.dcd", i)
        )
        one_sentence(
            "reportInterval must be a whole number", lambda i=interval: rb.EnergyReporter(tmp_path / "e.csv", i)
        )
    one_sentence("must be a path or an open text file, not 2.5", lambda: rb.EnergyReporter(2.5, 10))
    assert not list(tmp_path.iterdir())


def test_a_run_advances_to_a_number_and_a_simulation(tmp_path):
    run = rb.Run(tmp_path / "run")
    for until in ("100", 10.5, -1, None):
        one_sentence("whole number of at least 0", lambda u=until: run.advance(water(minimise=0), u))
    one_sentence("takes an openmm.app.Simulation, not Context", lambda: run.advance(water(minimise=0).context, 10))
    assert not list(tmp_path.iterdir())


def test_energies_of_another_integrator_are_refused_and_nothing_is_left(tmp_path):
    verlet = water(openmm.VerletIntegrator(2 * FEMTOSECONDS), minimise=0)
    alone = rb.EnergyReporter(tmp_path / "alone.csv", 1)
    verlet.reporters.append(alone)
    message = "use openmm.app.StateDataReporter"
    one_sentence(message, lambda: verlet.step(1))
    verlet.reporters.clear()
    alone.close()
    run = rb.Run(tmp_path / "run")
    run.add_reporter(rb.EnergyReporter, "energies.csv", 1)
    one_sentence(message, lambda: run.advance(verlet, 2))
    assert not list((tmp_path / "run").iterdir())
    run = rb.Run(tmp_path / "run")
    run.add_reporter(rb.EnergyReporter, "energies.csv", 1)
    quietly(run.advance, water(), 2)
    assert len((tmp_path / "run" / "energies.csv").read_text(encoding="utf-8").splitlines()) == 4


def test_a_reporter_that_cannot_append_is_refused_before_anything_is_written(tmp_path):
    run = rb.Run(tmp_path / "run")
    one_sentence("PDBReporter .* has no argument append=", lambda: run.add_reporter(app.PDBReporter, "a.pdb", 1))
    assert not list(tmp_path.iterdir())
    run.add_reporter(app.XTCReporter, "a.xtc", 1)
    quietly(run.advance, water(), 2)


def test_a_run_refused_for_broken_molecules_can_be_mended(tmp_path):
    simulation = water()
    good = simulation.context.getState(positions=True).getPositions(asNumpy=True)
    simulation.context.setPositions(good + np.eye(*good.shape) * 0.1 * unit.nanometer)
    for x in (None, good):
        run = rb.Run(tmp_path)
        run.add_reporter(app.DCDReporter, "a.dcd", 1)
        if x is None:
            one_sentence("from its shape", lambda r=run: r.advance(simulation, 2))
        else:
            simulation.context.setPositions(x)
            run.advance(simulation, 2)
    assert (tmp_path / "checkpoint").exists()


def test_errors_name_keywords_to_a_script_and_options_to_a_command_line(tmp_path):
    for _ in range(2):
        run = rb.Run(tmp_path / "out", overwrite=True)
        quietly(run.advance, water(), 1)
    one_sentence("resume=True or .*overwrite=True or", lambda: rb.Run(tmp_path / "out"), FileExistsError)
    command = (
        "import argparse, openmm_exactrb as rb; parser = argparse.ArgumentParser(); "
        "rb.Run.add_options(parser); rb.Run.from_options(parser.parse_args())"
    )
    done = subprocess.run(
        [sys.executable, "-c", command, "--out", tmp_path / "out"], capture_output=True, text=True, check=False
    )
    assert "--resume" in done.stderr
    assert "--overwrite" in done.stderr
    (tmp_path / "out" / "checkpoint").write_text("nothing")
    one_sentence("damaged.* overwrite", lambda: rb.Run(tmp_path / "out", resume=True))


# -- ensembles and tuning ---------------------------------------------------------------------------------------


def test_a_worker_killed_while_it_starts_is_reported(tmp_path):
    killer = tmp_path / "killer.py"
    killer.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    jobs = [ensemble.Job(os.path.basename, p="a/b")]
    with dask.config.set({"distributed.worker.preload": [str(killer)]}):
        one_sentence(
            "a worker process exited at startup",
            lambda: list(ensemble.as_completed(jobs, tmp_path / "out", workers=1, progress=False)),
            RuntimeError,
        )


def test_tuning_shows_progress_unless_asked_not_to(capfd):
    _, system, positions = rb.dipole_fluid(4, trap=0.5)
    few = {"schemes": ["V2"], "temperature": 30, "duration": 0.1, "levels": 3, "platform": "Reference"}
    rb.tune(system, positions, **few)
    told = capfd.readouterr()
    assert len(told.err.splitlines()) >= 3
    assert told.out == ""
    rb.tune(system, positions, report=None, **few)
    assert capfd.readouterr().err == ""
