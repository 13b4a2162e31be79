"""Importing the package is cheap, and everybody imports the same files."""

import pkgutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import openmm_exactrb
from openmm_exactrb import ensemble, runs, thermostats, tuning


def test_what_is_slow_to_import_waits():
    script = "import sys, openmm.app, openmm_exactrb; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in run.stdout.split()}
    assert loaded.isdisjoint({"scipy", "numba", "matplotlib", "tqdm", "dask", "distributed"})


def test_tests_and_their_child_processes_run_the_files_of_this_checkout(tmp_path):
    ours = Path(__file__).parents[2] / "openmm_exactrb" / "__init__.py"
    script = "import openmm_exactrb; print(openmm_exactrb.__file__)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert Path(openmm_exactrb.__file__) == Path(run.stdout.strip()) == ours


@pytest.mark.parametrize("package", [openmm_exactrb, ensemble, runs, thermostats, tuning])
def test_no_public_name_is_that_of_a_module_which_an_import_would_put_in_its_place(package):
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    for name in modules.intersection(package.__all__):
        assert isinstance(getattr(package, name), ModuleType)
