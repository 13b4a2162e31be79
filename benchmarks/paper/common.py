"""Functions shared by the figures of the paper: parallel jobs that can be resumed, pictures, and free bodies.

Every script of this folder defines `NAME`, `TITLE`, `PICTURES`, `compute(quick) -> data`, `draw(data)`, `table(data)`
and `claims(data)`, and passes itself to `main`. `PICTURES` contains a text alternative for each picture. The full
version stores its data and pictures in docs/paper, the quick version in out/paper/quick/paper. Finished jobs are stored
in out/paper/pieces, from which an interrupted run continues.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import os
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import matplotlib as mpl
import numpy as np
from dask.system import CPU_COUNT
from PIL import Image
from tqdm import tqdm

from benchmarks.paper import claims

mpl.use("Agg")
import matplotlib.pyplot as plt

PIECES = Path("out/paper/pieces")
FOLDERS = {False: Path("docs/paper"), True: Path("out/paper/quick/paper")}
# Colours that colour-blind readers can tell apart (Okabe and Ito).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
MARKERS = "osD^vPX*"
DPI = 110


def in_pieces(name, function, pieces):
    """Return function(**piece) for all pieces, in order; those computed before are read from disk.

    Parameters
    ----------
    name : str
    function : callable
        At the top level of a module; returns an array or a dict of arrays and numbers that JSON can hold.
    pieces : sequence of dict
        Keyword arguments, which JSON can hold.
    """
    folder = PIECES / name
    folder.mkdir(parents=True, exist_ok=True)
    results = {}

    def file_of(piece):
        return folder / (hashlib.sha256(json.dumps(piece, sort_keys=True).encode()).hexdigest()[:20] + ".json")

    todo = []
    for k, piece in enumerate(pieces):
        if file_of(piece).exists():
            results[k] = json.loads(file_of(piece).read_text(encoding="utf-8"))["result"]
        else:
            todo.append(k)
    with ProcessPoolExecutor(CPU_COUNT, initializer=_one_thread) as pool:
        running = {pool.submit(function, **pieces[k]): k for k in todo}
        for done in tqdm(as_completed(running), total=len(todo), desc=name, disable=not todo):
            k = running[done]
            text = json.dumps({"piece": pieces[k], "result": _plain(done.result())})
            partial = file_of(pieces[k]).with_suffix(".part")
            partial.write_text(text, encoding="utf-8")
            partial.replace(file_of(pieces[k]))
            results[k] = json.loads(text)["result"]
    return [results[k] for k in range(len(pieces))]


def _one_thread():
    os.environ["OPENMM_CPU_THREADS"] = "1"


def _plain(value):
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def main(script):
    """Run one script from the command line."""
    parser = argparse.ArgumentParser(description=script.TITLE)
    parser.add_argument("--quick", action="store_true", help="a small version, for a look and for tests")
    run(script, parser.parse_args().quick)


def run(script, quick, own=False, stored=False, **options):
    """Compute, keep the data, draw, and print the table and the claims of one script; return its data.

    The full version goes to docs/paper; the quick one, and one with a user's own options, to out/paper/quick/paper. With
    `stored` the data of the last run are drawn and judged again, and nothing is computed.
    """
    folder = FOLDERS[quick or own]
    (folder / "data").mkdir(parents=True, exist_ok=True)
    kept = folder / "data" / f"{script.NAME}.json"
    if stored:
        data = json.loads(kept.read_text(encoding="utf-8"))
    else:
        data = _plain(script.compute(quick, **options))
        kept.write_text(json.dumps(data, separators=(",", ":")) + "\n")
    for name, figure in script.draw(data):
        save(figure, folder / f"{name}.png")
    print(script.table(data))
    for claim in script.claims(data):
        print(claims.entry(claim))
    return data


def save(figure, file):
    """Write a figure as a PNG of 128 colours, which is a third of the size, and close it."""
    full = io.BytesIO()
    figure.savefig(full, dpi=DPI)
    plt.close(figure)
    Image.open(full).convert("RGB").quantize(128).save(file, optimize=True)


def markdown(header, rows):
    """Return a table in markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def least_seconds(calls, rounds=9):
    """Return the least processor time of each call in seconds; they take turns, so that a busy machine is fair.

    Parameters
    ----------
    calls : dict of callable
    rounds : int
    """
    found = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.process_time()
            call()
            found[name].append(time.process_time() - start)
    return {name: min(times) for name, times in found.items()}


# -- free bodies --------------------------------------------------------------------------------------------------


def random_bodies(rng, n, physical=True):
    """Return n inertias I1 < I2 < I3 = 1, (3, n), and unit momenta in the first octant, (3, n).

    A physical body has I1 + I2 >= I3. The paper does not say whether its random inertias are those of such bodies.
    """
    moments = np.sort(rng.random((2, 4 * n)), axis=0)
    if physical:
        moments = moments[:, moments.sum(axis=0) > 1.0]
    moments = moments[:, :n]
    m = np.abs(rng.standard_normal((3, n)))
    return np.vstack([moments, np.ones(n)]), m / np.linalg.norm(m, axis=0)


def unit_attitudes(n):
    """Return n attitudes (1, 0, 0, 0), (4, n)."""
    q = np.zeros((4, n))
    q[0] = 1.0
    return q


def matrix(q):
    """Return rotation matrices (3, 3, n) of quaternions (4, n) in their own precision, not assuming norm one."""
    w, x, y, z = q / np.sqrt((q * q).sum(axis=0))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def attitude_errors(q, reference):
    """Return the largest difference of the rotation matrices of each body, (n,), in float64."""
    difference = np.abs(matrix(q.astype(np.longdouble)) - matrix(reference))
    return difference.max(axis=(0, 1)).astype(np.float64)
