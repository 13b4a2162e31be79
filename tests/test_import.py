"""Importing the package stays cheap: what is slow to import waits until it is needed."""

import subprocess
import sys


def test_what_is_slow_to_import_waits():
    script = "import sys, openmm.app, openmm_exactrb; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in run.stdout.split()}
    assert loaded.isdisjoint({"scipy", "numba", "matplotlib", "tqdm", "dask", "distributed"})
