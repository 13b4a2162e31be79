"""Ensembles: the same numbers with any workers, after any death, and wherever they were stopped."""

import importlib
import os
import signal
import subprocess
import sys
import threading
import time

import cloudpickle
import numpy as np
import pytest
from distributed import LocalCluster
from job_functions import SHORT, counted, deadly, energies, flexible, gated, held_up, square, unkeepable

from openmm_exactrb import ensemble
from openmm_exactrb.ensemble import Job, workers
from openmm_exactrb.ensemble.jobs import versions

# On workers that are there, so that it soon begins.
SCRIPT = """
import sys
folder, gate, scheduler, *sys.path[:0] = sys.argv[1:]
from openmm_exactrb import ensemble
from job_functions import gated

jobs = ensemble.sweep(gated, {"x": range(8)}, folder=gate)
for result in ensemble.as_completed(jobs, folder, scheduler=scheduler):
    print(result.cached, result.job.arguments["x"], result.value, flush=True)
"""


@pytest.fixture(scope="module")
def scheduler():
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        yield cluster.scheduler_address


def test_ensembles_run_flexible_molecules(tmp_path):
    """In other processes as in this one, and so that more forces per ps leave less of an error."""
    axes = {"step": [0.004, 0.001]}
    runs = ensemble.sweep(energies, axes, build=flexible, scheme="S2_2", duration=0.2, temperature=300.0, seed=1)
    results = ensemble.run(runs, tmp_path, workers=2, progress=False)
    assert [result.error for result in results] == 2 * [None]
    np.testing.assert_equal(results[0].value, energies(**runs[0].arguments))
    coarse, fine = (np.std(result.value["energies"]) for result in results)
    assert fine < coarse < 3.0


def kill_when_held_up(note, killed):
    while not note.exists() or not note.read_text(encoding="utf-8").endswith("\n"):
        time.sleep(0.05)
    killed.append(int(note.read_text(encoding="utf-8").split()[0]))
    os.kill(killed[0], signal.SIGKILL)


def test_killed_worker_changes_no_result(tmp_path):
    axes = {"scheme": ["V2", "S6_10"], "seed": range(8)}
    notes, killed = tmp_path / "notes", []
    notes.mkdir()
    killer = threading.Thread(target=kill_when_held_up, args=(notes / "3", killed), daemon=True)
    killer.start()
    jobs = ensemble.sweep(held_up, axes, folder=notes, **SHORT)
    results = ensemble.run(jobs, tmp_path / "two", workers=2, progress=False)
    killer.join()
    # The dead worker's run was started again, in another process.
    processes = [int(line) for line in (notes / "3").read_text(encoding="utf-8").split()]
    assert len(processes) == 3  # V2 twice, S6_10 once
    assert processes.count(killed[0]) == 1
    assert [result.error for result in results] == [None] * 16
    here = [energies(**job.arguments) for job in ensemble.sweep(energies, axes, **SHORT)]
    assert [result.value for result in results] == here  # to the last bit


def test_job_that_kills_its_workers_is_given_up(tmp_path):
    jobs = [Job(deadly), Job(square, x=3), Job(square, x=4)]
    dead, *alive = ensemble.run(jobs, tmp_path, workers=1, progress=False)
    assert dead.error.startswith("KilledWorker")
    assert dead.value is None
    assert [result.value for result in alive] == [9, 16]


def test_killed_script_continues_where_it_stopped(tmp_path, scheduler):
    """Three of its eight jobs are over when it is killed, however busy the machine is."""
    kept, gate = tmp_path / "kept", tmp_path / "gate"
    gate.mkdir()
    command = [sys.executable, "-c", SCRIPT, str(kept), str(gate), scheduler, *sys.path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        for _ in range(3):
            process.stdout.readline()
        process.kill()
    finished = {file: file.stat().st_mtime_ns for file in kept.glob("*.json")}
    assert len(finished) == 3
    (gate / "open").touch()
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[0] for line in lines] == ["True"] * 3 + ["False"] * 5
    assert {(int(x), int(value)) for _, x, value in lines} == {(x, x) for x in range(8)}
    assert all(file.stat().st_mtime_ns == then for file, then in finished.items())
    assert len(list(kept.iterdir())) == 8
    assert "8/8" in done.stderr


def test_iterator_may_be_left_and_taken_up(tmp_path, scheduler):
    jobs = ensemble.sweep(square, {"x": range(20)})
    first = ensemble.as_completed(jobs, tmp_path, scheduler=scheduler, progress=False)
    seen = [next(first) for _ in range(4)]
    first.close()
    assert len(list(tmp_path.iterdir())) == 4
    torn = next(iter(tmp_path.iterdir()))
    torn.write_text(torn.read_text(encoding="utf-8")[:-20])  # a file that lost its end is done anew
    results = ensemble.run(jobs, tmp_path, scheduler=scheduler, progress=False)
    assert [result.value for result in results] == [x * x for x in range(20)]
    assert {result.job for result in results if result.cached} < {result.job for result in seen}
    assert sum(result.cached for result in results) == 3
    assert all(result.cached for result in ensemble.run(jobs, tmp_path))  # no scheduler needed


def test_failure_is_reported_and_stops_nothing(tmp_path, scheduler, capfd):
    notes = tmp_path / "notes"
    notes.mkdir()
    close = {**SHORT, "step": 1e200, "duration": 2e200}
    jobs = [Job(counted, folder=notes, name="bad"), Job(energies, **close)]
    jobs += [Job(counted, folder=notes, name="good"), Job(unkeepable)]
    bad, blown_up, good, unkept = ensemble.run(jobs, tmp_path / "kept", scheduler=scheduler)
    assert bad.error == "ArithmeticError: bad cannot be"
    assert "in counted" in bad.traceback
    assert bad.job is jobs[0]
    assert blown_up.error.startswith("NonFiniteError: step ")
    assert unkept.error.startswith("TypeError: a result must be numbers")
    assert good.error is None
    assert good.value["array"] == [0.0, 1.0 / 7.0, 2.0 / 7.0]
    assert good.value["tuple"] == [1, 2.0, None]
    assert np.isnan(good.value["nan"])
    assert "4/4" in capfd.readouterr().err
    assert (notes / "bad").read_text(encoding="utf-8") == "called\n"  # once a call
    again = ensemble.run(jobs, tmp_path / "kept", scheduler=scheduler, progress=False)
    assert [result.cached for result in again] == [False, False, True, False]
    assert again[0].error == bad.error
    assert (notes / "bad").read_text(encoding="utf-8") == "called\ncalled\n"
    assert (notes / "good").read_text(encoding="utf-8") == "called\n"


def test_function_that_workers_cannot_import(tmp_path, scheduler, monkeypatch):
    (tmp_path / "only_here.py").write_text("def one():\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    job = Job(importlib.import_module("only_here").one)
    (result,) = ensemble.run([job], tmp_path / "kept", scheduler=scheduler, progress=False)
    assert "No module named 'only_here'" in result.error


def test_worker_of_another_version_does_not_compute():
    here = versions()
    for other in (["0.0", here[1]], [here[0], "7.7"]):
        assert "but the jobs need" in workers.perform(cloudpickle.dumps(Job(square, x=2)), other)["error"]


def test_equal_jobs_are_executed_once(tmp_path, scheduler):
    notes = tmp_path / "notes"
    notes.mkdir()
    results = ensemble.run(2 * [Job(counted, folder=notes, name="one")], tmp_path, scheduler=scheduler, progress=False)
    assert [result.value["name"] for result in results] == ["one", "one"]
    assert (notes / "one").read_text(encoding="utf-8") == "called\n"
    assert ensemble.run([], tmp_path, progress=False) == []


def test_scheduler_that_goes_away(tmp_path):
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        (tmp_path / "gate").mkdir()
        jobs = ensemble.sweep(gated, {"x": range(9)}, folder=tmp_path / "gate")
        results = ensemble.as_completed(jobs, tmp_path, scheduler=cluster.scheduler_address, progress=False)
        next(results)
    with pytest.raises(ConnectionError, match="the connection to the scheduler was lost"):
        list(results)
    assert list(tmp_path.glob("*.json"))


def test_scheduler_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "TIMEOUT", 0.5)
    with pytest.raises(ConnectionError, match=r"no dask scheduler answers at .tcp://127\.0\.0\.1:1"):
        ensemble.run([Job(square, x=1)], tmp_path, scheduler="tcp://127.0.0.1:1", progress=False)
