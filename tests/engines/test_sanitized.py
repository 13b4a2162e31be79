"""The library, compiled with sanitizers: no kernel reads or writes beyond an array, or divides an integer by zero.

`make library-check` runs this test.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from openmm_exactrb.library import compilation

pytestmark = pytest.mark.library

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
# Arrays of a variable length are an extension that Microsoft's compiler does not have. The type of a class of OpenMM's
# devices is unknown in this process.
FLAGS = (
    "-O0 -g1 -Werror=vla -D_GLIBCXX_ASSERTIONS -fsanitize=address,undefined -fno-sanitize=vptr -fno-sanitize-recover"
)


def preloaded():
    """Return the libraries that a process loads first: the sanitizer, and that of C++; skip the test without them."""
    try:
        commands = [[compilation.compiler(), f"-print-file-name={name}"] for name in ("libasan.so", "libstdc++.so.6")]
        told = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for command in commands]
    except (compilation.CompilationError, subprocess.CalledProcessError):
        told = [""]
    paths = [path.strip() for path in told]
    return paths if all(map(os.path.isabs, paths)) else pytest.skip("needs g++ with its sanitizers")


@pytest.mark.validate
@pytest.mark.skipif(sys.platform != "linux", reason="the sanitizer is loaded first on Linux alone")
def test_no_kernel_leaves_its_arrays(tmp_path):
    first, path = ":".join(preloaded()), tmp_path / "library.so"
    compilation.build(path, *FLAGS.split())
    folders = os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "common", HERE)))
    environment = {"PYTHONPATH": folders, "LD_PRELOAD": first, "ASAN_OPTIONS": "detect_leaks=0"}
    command = [sys.executable, str(HERE / "sanitized.py"), str(path)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "moved all\n"), done.stderr[:5000]
