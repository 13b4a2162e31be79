"""Operations in double precision of a force evaluation on a GPU, and the share of its time on a card for consumers.

The kernels are compiled as C++ with types that count (`counted/`), in mixed precision. Additions, multiplications,
comparisons and conversions from and to double precision or 64 bits count as one instruction each, although a
compiler fuses many of them, a quotient and a root as ten, and a logarithm or a sine as forty. The integrator is BAOA
with a force evaluation every 8 fs. A GeForce RTX 5090 performs 104.8e12 operations a second in single precision,
which counts a fused multiplication and addition as two, and a 64th of these in double precision. OpenMM's benchmarks
(openmm.org, 8.2, single precision, 4 fs) name 2258 ns/day for DHFR and 1060 ns/day for ApoA1, and the time of water
is that of ApoA1 per atom.

    python benchmarks/device/operations.py

The kernels of proteins are those of a Context on OpenCL. DHFR is that of openmmtools. "launches" counts those of this
package for a force evaluation within a call.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.provenance import commit
from benchmarks.common.records import RECORDS, Record
from benchmarks.device.on_gpu import protein
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.native.program import Launch
from openmm_exactrb.engines.native.rigid import _constants
from openmm_exactrb.library import compilation
from openmm_exactrb.steps.moves import Op

INSTRUCTIONS = 104.8e12 / 2 / 64  # in double precision, a second
SECONDS = {"dhfr": 86400.0 / (2258.0 / 4e-6), "water": 86400.0 / (1060.0 / 4e-6) / 92224 * 300_000}
RECORD = Record(
    RECORDS / "device_operations.csv",
    ("system", "part"),
    ("operations", "number", "operations in all", "percent of a force", "launches", "commit"),
)
COUNTED = Path(__file__).parent / "counted"
KT, FS = 2.494, 8.0
#: The kinds of bonded terms, by the constants of the kernel that contain their numbers.
TERMS = {"BONDS": "bond", "ANGLES": "angle", "TORSIONS": "torsion", "PAIRS": "pair", "IMPROPERS": "improper"}


def counts(name, *arguments, text=""):
    """Return the operations of the parts of kernels that a program in `counted` writes."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "constants.h").write_text(compilation.definitions(), encoding="utf-8")
        folders = [f"-I{path}" for path in (COUNTED, folder, compilation.PACKAGE)]
        command = [compilation.compiler(), "-std=c++17", "-O1", "-w", *folders, str(COUNTED / f"{name}.cpp")]
        subprocess.run([*command, "-o", f"{folder}/count"], check=True)
        done = subprocess.run(
            [f"{folder}/count", *map(str, arguments)], input=text, capture_output=True, text=True, check=True
        )
    return {part: float(number) for part, number in (line.split(",") for line in done.stdout.splitlines())}


def of_water():
    """Return the operations of a water with hydrogens of 3 amu in a segment of BAOA."""
    topology, system, positions = rb.rigid_water(1)
    rb.heavy_hydrogens(system, topology, 3.0, water=True)
    kind = find_bodies(system, positions).kinds[0]
    constants = np.array(next(_constants(kind)))
    h = 1e-3 * FS
    numbers = [h, 0.5 * h, h, *4 * (-0.04, 0.28), 0.0]
    state = np.ones(3), np.sqrt(KT) * constants[8] * np.ones(3), np.full(4, 0.5), np.sqrt(KT) * constants[9:12]
    given = constants, kind.sites.ravel(), *state, np.linspace(-500.0, 700.0, 9), np.array(numbers)
    return counts("bodies", text="\n".join(" ".join(map(repr, [len(a), *a.tolist()])) for a in given))


def of_protein(name, platform):
    """Return the numbers of the parts in a force evaluation of a protein, its waters and its launches."""
    _, system, positions = protein(name)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 1e-3 * FS, "BAOA", engine="native", fast="bonded")
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform), {"Precision": "mixed"})
    context.setPositions(getattr(positions, "_value", positions))
    integrator.step(0)
    assembly = integrator._propagator._assembly  # noqa: SLF001
    found, waters = Counter(), 0
    step = [o for name in ("body", "between") for o in assembly.program.sequences[name] if isinstance(o, Launch)]
    for part in assembly.parts:
        if not hasattr(part, "blocks"):
            waters += part.n
            continue
        defined = dict(part.source.defines)
        lanes = defined["RAYS"] * len(part.blocks.starts)
        for launch in (launch for launch in step if launch.source == part.source):
            first, count = launch.arguments[launch.arguments.index("factors") + 1 :][:2]
            ops = [move.op for move in assembly.table._moves[first : first + count]]  # noqa: SLF001
            kicks = ops.count(Op.FAST_KICK) + ops.count(Op.KICK)
            found["thread of a constraint"] += lanes * ops.count(Op.DRIFT)
            found["heat exchange of an atom"] += part.n * ops.count(Op.EXCHANGE)
            found["kick of an atom"] += part.n * kicks
            if kicks:
                found["position"] += defined["PLACES_IN_ALL"]
                found.update({term: defined[constant] for constant, term in TERMS.items()})
    return found, waters, len(step)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="OpenCL", help="of the kernels that are counted")
    parser.add_argument("--proteins", nargs="*", default=["villin", "dhfr"])
    options = parser.parse_args()
    water, inner = of_water(), counts("flexible", 1e-3 * FS / 4)
    add("water", "segment of a water", water["segment"], 100_000, 1)
    for name in options.proteins:
        found, waters, launches = of_protein(name, options.platform)
        add(name, "segment of a water", water["segment"], waters, launches)
        for part, number in found.items():
            if number:
                add(name, part, inner[part], number, launches)


def add(system, part, operations, number, launches):
    """Add a row; the share is that of a force evaluation of the system, if its time was published."""
    share = operations * number / INSTRUCTIONS / SECONDS[system] if system in SECONDS else np.nan
    values = system, part, operations, number, round(operations * number), f"{100.0 * share:.2f}", launches, commit()
    RECORD.add(dict(zip(RECORD.columns, values, strict=True)))


if __name__ == "__main__":
    main()
