"""Jobs: a key for each, the same one in every process."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import cloudpickle
import numpy as np
import openmm
import pytest
from job_functions import SHORT, Multiple, energies, square
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb import ensemble
from openmm_exactrb.ensemble import Job, workers
from openmm_exactrb.ensemble.jobs import versions


def keys(*values):
    return {Job(square, x=value).key for value in values}


def test_keys_tell_jobs_apart_and_nothing_else():
    system = rb.dipole_fluid(2)[1]
    values = [1, 2, 1.5, "1", None, [1, 2], {"a": 1}, np.arange(3), np.arange(3.0), np.arange(6).reshape(2, 3)]
    values += [Path("a"), 1 * unit.femtosecond, 1 * unit.picosecond, rb.SCHEMES["V2"], rb.SCHEMES["S6_10"], square]
    values += [system, rb.dipole_fluid(3)[1], app.PME, app.NoCutoff, {"mapping": []}, True]
    assert len(keys(*values)) == len(values)
    assert len(keys((1, 2), [1, 2], np.array([1, 2]).tolist(), [np.int64(1), np.int32(2)])) == 1
    assert len(keys({"a": 1, "b": 2}, {"b": 2, "a": 1})) == 1
    assert len(keys(system, openmm.XmlSerializer.clone(system))) == 1
    assert len(keys(0.1, np.float64(0.1))) == 1
    assert Job(square, x=1) != 1


def test_results_of_another_version_are_not_taken(monkeypatch):
    here = Job(square, x=1)
    for place, other in enumerate(["0.0", "7.7"]):
        changed = versions()
        changed[place] = other
        with monkeypatch.context() as patch:
            patch.setattr("openmm_exactrb.ensemble.jobs.versions", lambda there=changed: there)
            assert Job(square, x=1) != here


def test_a_key_is_the_same_in_another_process(tmp_path):
    script = "from job_functions import *; from openmm_exactrb.ensemble import Job\n"
    script += "print(Job(energies, **SHORT, scheme=rb.SCHEMES['V2'], box=rb.dipole_fluid(2)[1]).key)"
    command = [sys.executable, "-c", script]
    there = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": "7"},
    )
    here = Job(energies, **SHORT, scheme=rb.SCHEMES["V2"], box=rb.dipole_fluid(2)[1])
    assert there.stdout.strip() == here.key


def done(job):
    """Return the fields of the result that a worker returns."""
    return workers.perform(cloudpickle.dumps(job), versions())


def changed_system():
    system = rb.dipole_fluid(2)[1]
    return system, lambda: system.setParticleMass(0, 7.0)


def changed_integrator():
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.01)
    return integrator, lambda: integrator.setFriction(5.0)


def changed_list():
    nested = {"a": [1, {"b": [2.0]}]}
    return nested, lambda: nested["a"][1]["b"].append(3.0)


def changed_array():
    array = np.arange(3.0)
    return array, lambda: array.__setitem__(0, 9.0)


def changed_quantity():
    quantity = np.arange(3.0) * unit.nanometer
    return quantity, lambda: quantity._value.__setitem__(0, 9.0)


@pytest.mark.parametrize(
    "make",
    [changed_array, changed_list, changed_quantity, changed_system, changed_integrator],
    ids=lambda f: f.__name__,
)
def test_what_is_changed_later_does_not_change_a_job(make):
    value, change = make()
    made = [Job(square, x=value), *ensemble.sweep(square, {"x": [value]}), *ensemble.sweep(square, {}, x=value)]
    change()
    assert len({job.key for job in made}) == 1
    for job in made:
        assert Job(square, x=job.arguments["x"]) == job  # that is what a worker gets
        assert Job(square, x=value) != job


def test_what_is_changed_in_a_job_does_not_reach_the_worker():
    job = Job(square, x=np.arange(3.0))
    job.arguments["x"][0] = 9.0
    assert done(job)["value"] == [0.0, 1.0, 4.0]


def test_arrays_in_files_are_arrays(tmp_path):
    np.save(tmp_path / "x.npy", np.arange(3.0))
    assert len(keys(np.arange(3.0), np.load(tmp_path / "x.npy", mmap_mode="r"))) == 1


def test_the_key_knows_what_is_in_a_file(tmp_path):
    file = tmp_path / "atoms.xyz"
    nothing, folder = keys(file), keys(tmp_path)
    file.write_text("one")
    text, one = keys(str(file)), keys(file)
    file.write_text("another")
    another = keys(file)
    assert len(nothing | one | another) == 3
    assert text == keys(str(file))
    assert folder == keys(tmp_path)
    file.write_text("one")
    assert keys(file) == one


def test_classes_of_one_name_in_two_modules_are_two():
    one, two = (dataclasses.make_dataclass("Box", ["edge"]) for _ in range(2))
    one.__module__, two.__module__ = "cubes", "parcels"
    assert len(keys(one(1.0), one(1.0), two(1.0))) == 2


def test_a_function_in_a_class_has_a_name():
    assert repr(Job(Multiple.twice, x=1)) == "Job(job_functions.Multiple.twice, x=1)"
