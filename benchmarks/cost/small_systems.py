"""The processor time of small systems compared with OpenMM's integrators, on one thread.

Rigid water is compared with VerletIntegrator and LangevinMiddleIntegrator by the time per force evaluation, and a call
of step(1) with a step of a call of 100. Peptides in vacuum have steps of 2 fs. Peptides in water have hydrogens of 3
amu and a force evaluation every 8 fs, for which LangevinMiddleIntegrator needs constraints of all bonds. The time of
the first step of water, without that of imports, is measured in new processes with an empty home folder and a compiled
library. On two threads, the wall time of the native engine is compared with that of the host engine. The last rows are
for alanine dipeptide in water as an alchemical solute of openmmtools (the extra `openmmtools`), half discharged.

Each row is the median and the quartiles of nine pairs of runs that alternate, except on two threads on one core. Rows
are written to records/small_systems.csv; rows that are there are not measured again.

    python benchmarks/cost/small_systems.py --pdb villin.pdb
    python benchmarks/cost/small_systems.py --only water --engine host --record out/host.csv
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.clocks import QUARTILES, in_turns, on_one_core, quartiles, timed
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE, helix, solvated
from benchmarks.common.provenance import PROVENANCE, provenance
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import context_of
from openmm_exactrb.library.library import CACHE, library

RUN = "system", "platform", "run", "beside"
FOUND = "unit", *QUARTILES, "engine", *PROVENANCE
PAIRS = 9
SECONDS = 0.2  # of processor time that a run takes at least
KELVIN, FRICTION = 300.0, 5.0
PLATFORMS = "Reference", "CPU"
HALF_DISCHARGED = {"lambda_sterics": 1.0, "lambda_electrostatics": 0.5}
WATERS, IN_BATH, BY_CALL = (1, 8, 27, 64, 216, 895), (8, 27, 64, 216), (1, 8, 27, 64)
#: Residues of helices of 123 and 403 atoms, and water around alanine dipeptide.
RESIDUES, AROUND = (12, 40), 212
MANY = 10_000  # molecules of water for two threads
FIRST = """
import time
import openmm_exactrb as rb, openmm
from openmm import app
begin = time.process_time()
_, system, positions = rb.rigid_water(216, nonbondedMethod=app.PME, nonbondedCutoff=0.9)
integrator = rb.ExactRigidBodyIntegrator(0.002, engine={engine!r})
context = openmm.Context(system, integrator, openmm.Platform.getPlatform({platform!r}))
context.setPositions(positions)
context.setVelocitiesToTemperature(300.0, 1)
integrator.step(1)
print(time.process_time() - begin, integrator.getEngine())
"""


class Start(NamedTuple):
    """A System, positions, and parameters of the Context."""

    system: openmm.System
    positions: Any
    parameters: Mapping[str, float] = MappingProxyType({})

    def moving(self, integrator: openmm.Integrator, platform: str, threads: int = 1) -> openmm.Context:
        """Return a Context after some steps of an integrator."""
        properties = {"CPU": {"Threads": f"{threads}"}, "OpenCL": {"Precision": "mixed"}}.get(platform, {})
        context = context_of(self.system, integrator, self.positions, platform, properties)
        for name, value in self.parameters.items():
            context.setParameter(name, value)
        context.applyConstraints(1e-8)
        context.setVelocitiesToTemperature(KELVIN, 1)
        integrator.step(10)
        return context


# -- systems ---------------------------------------------------------------------------------------------------------


@cache
def water(n: int) -> Start:
    """Return rigid TIP3P: one molecule in vacuum, boxes with a cutoff, or with PME from 216 molecules on."""
    method = app.NoCutoff if n == 1 else app.PME if n >= 216 else app.CutoffPeriodic
    cutoff = min(0.9, 0.48 * 0.3104 * n ** (1 / 3))
    _, system, positions = rb.rigid_water(n, nonbondedMethod=method, nonbondedCutoff=cutoff)
    return relaxed(system, positions)


def relaxed(system: openmm.System, positions: Any) -> Start:
    """Return a start near the minimum."""
    context = context_of(system, openmm.VerletIntegrator(0.001), positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 200)
    return Start(system, context.getState(positions=True).getPositions(asNumpy=True))


@cache
def in_vacuum(residues: int) -> Start:
    """Return a helix in vacuum with constrained bonds to hydrogen."""
    topology, places = helix(residues)
    modeller, force_field = app.Modeller(topology, places * unit.nanometer), app.ForceField(*FORCE_FIELD)
    modeller.addHydrogens(force_field, platform=openmm.Platform.getPlatform("CPU"))
    return relaxed(force_field.createSystem(modeller.topology, constraints=app.HBonds), modeller.positions)


@cache
def molecules_of(pdb: Path) -> tuple[app.Topology, Any]:
    """Return the solute of a PDB file in water, with few molecules if the file has none."""
    topology, positions = solvated(pdb, numAdded=AROUND)
    system = app.ForceField(*FORCE_FIELD).createSystem(topology, nonbondedMethod=app.PME, nonbondedCutoff=0.9)
    return topology, relaxed(system, positions).positions


def in_water(pdb: Path, constraints: Any) -> Start:
    """Return a solute in water with PME and heavy hydrogens."""
    topology, positions = molecules_of(pdb)
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.9 * unit.nanometer, "constraints": constraints}
    system = app.ForceField(*FORCE_FIELD).createSystem(topology, **options)
    rb.heavy_hydrogens(system, topology)
    return Start(system, positions)


def alchemical(constraints: Any) -> Start:
    """Return alanine dipeptide in water, with charges half switched off and exact PME."""
    from openmmtools import alchemy

    start, atoms = in_water(PEPTIDE, constraints), app.PDBFile(str(PEPTIDE)).topology.getNumAtoms()
    factory = alchemy.AbsoluteAlchemicalFactory(alchemical_pme_treatment="exact")
    region = alchemy.AlchemicalRegion(alchemical_atoms=range(atoms))
    return Start(factory.create_alchemical_system(start.system, region), start.positions, HALF_DISCHARGED)


# -- measurements ----------------------------------------------------------------------------------------------------


def langevin(step: float) -> openmm.Integrator:
    return openmm.LangevinMiddleIntegrator(KELVIN, FRICTION, step)


def bath(step: float, scheme: str, engine: str) -> openmm.Integrator:
    return rb.ExactRigidBodyLangevinIntegrator(KELVIN, FRICTION, step, scheme, engine=engine)


def constant(step: float, scheme: str | None, engine: str) -> openmm.Integrator:
    return rb.ExactRigidBodyIntegrator(step, scheme, engine=engine)


def calls(integrator: openmm.Integrator, steps: int = 10) -> int:
    """Return a number of steps that takes `SECONDS`."""
    while (spent := timed(partial(integrator.step, steps))) < 0.25 * SECONDS:
        steps *= 2
    return max(steps, round(steps * SECONDS / spent))


def by_force(our_context: openmm.Context, their_context: openmm.Context) -> dict[str, Any]:
    """Return how many times the processor time of theirs, which evaluates forces once a step, ours takes per force."""
    ours, theirs = our_context.getIntegrator(), their_context.getIntegrator()
    mine, other = calls(ours), calls(theirs)
    ours.timings.reset()
    times = in_turns({"ours": partial(ours.step, mine), "theirs": partial(theirs.step, other)}, PAIRS)
    forces = ours.timings.evaluations / PAIRS
    ratios = np.array(times["ours"]) / forces / (np.array(times["theirs"]) / other)
    return {"unit": "ratio", "engine": ours.getEngine(), **quartiles(ratios)}


def by_call(context: openmm.Context) -> dict[str, Any]:
    """Return how many microseconds a call of step(1) takes beyond a step in a call of 100."""
    integrator = context.getIntegrator()
    repeats = max(1, calls(integrator) // 100)

    def steps(n: int) -> None:
        for _ in range(repeats * 100 // n):
            integrator.step(n)

    times = in_turns({n: partial(steps, n) for n in (1, 100)}, PAIRS)
    differences = (np.array(times[1]) - times[100]) / (repeats * 100)
    return {"unit": "us", "engine": integrator.getEngine(), **quartiles(1e6 * differences)}


def by_engine(native_context: openmm.Context, host_context: openmm.Context) -> dict[str, Any]:
    """Return how many times the wall time of the same steps with the host engine the native engine takes."""
    native, host = native_context.getIntegrator(), host_context.getIntegrator()
    steps = calls(native, 2)
    times = in_turns({each: partial(each.step, steps) for each in (native, host)}, PAIRS, time.perf_counter)
    ratios = np.array(times[native]) / times[host]
    return {"unit": "ratio", "engine": native.getEngine(), **quartiles(ratios)}


def first_steps(engine: str, platform: str) -> dict[str, Any]:
    """Return the seconds of the first step in new processes."""
    folder, spent, used = library().path.parent, [], ""
    for _ in range(PAIRS):
        with tempfile.TemporaryDirectory() as home:
            own = {"HOME": home, "XDG_CACHE_HOME": home, CACHE: str(folder), "OPENMM_CPU_THREADS": "1"}
            command = [sys.executable, "-c", FIRST.format(engine=engine, platform=platform)]
            run = subprocess.run(command, env=os.environ | own, capture_output=True, text=True, check=True)
        seconds, used = run.stdout.split()
        spent.append(float(seconds))
    return {"unit": "s", "engine": used, **quartiles(spent)}


class Measurement(NamedTuple):
    """A row of the record: `measured` returns the columns of a result."""

    system: str
    platform: str
    run: str
    beside: str
    measured: Any


def of_water(engine: str) -> Iterator[Measurement]:
    """Yield the measurements of rigid water at 2 fs a force."""
    for platform in PLATFORMS:
        for n in WATERS:
            name = f"{n} TIP3P"
            for scheme, step in (("W2_1", 0.002), ("S2_2", 0.004)):
                ours, theirs = partial(constant, step, scheme, engine), partial(openmm.VerletIntegrator, 0.002)
                yield beside(name, platform, f"{scheme}, 2 fs a force", partial(water, n), ours, theirs)
            if n in IN_BATH:
                ours, theirs = partial(bath, 0.002, "BAOA", engine), partial(langevin, 0.002)
                yield beside(name, platform, "BAOA, 2 fs", partial(water, n), ours, theirs)
            if n in BY_CALL:
                ours = partial(constant, 0.002, "W2_1", engine)
                yield Measurement(
                    *(name, platform, "W2_1, a call of step(1)", "a step in a call of 100"),
                    lambda n=n, platform=platform, ours=ours: by_call(water(n).moving(ours(), platform)),
                )
        first = partial(first_steps, engine, platform)
        yield Measurement("216 TIP3P", platform, "the first step in an empty home", "nothing", first)


def of_peptides(engine: str) -> Iterator[Measurement]:
    """Yield the measurements of peptides in vacuum at 2 fs."""
    for residues in RESIDUES:
        start, name = partial(in_vacuum, residues), f"{10 * residues + 3} atoms in vacuum"
        for platform in PLATFORMS:
            for what, ours in (
                ("the default, 2 fs", partial(constant, 0.002, None, engine)),
                ("BAOA, 2 fs", partial(bath, 0.002, "BAOA", engine)),
            ):
                yield beside(name, platform, what, start, ours, partial(langevin, 0.002))


def of_solutes(engine: str, pdbs: list[Path]) -> Iterator[Measurement]:
    """Yield the measurements of solutes in water with a force evaluation every 8 fs."""
    for pdb in pdbs:
        yield from at_eight_fs(f"{pdb.stem} in water", "CPU", engine, partial(in_water, pdb))


def of_alchemy(engine: str) -> Iterator[Measurement]:
    """Yield the measurements of an alchemical solute in water with a force evaluation every 8 fs."""
    for platform in ("CPU", "OpenCL"):
        yield from at_eight_fs(f"alchemical {PEPTIDE.stem} in water", platform, engine, alchemical)


def at_eight_fs(name: str, platform: str, engine: str, start: Any) -> Iterator[Measurement]:
    """Yield the measurements of a start, which takes constraints."""
    for scheme, step in (("W2_3m", 0.024), ("BAOA", 0.008)):
        ours, theirs = partial(bath, step, scheme, engine), partial(langevin, 0.008)
        starts = partial(start, app.HBonds), ours, theirs, partial(start, app.AllBonds)
        yield beside(name, platform, f"{scheme}, 8 fs a force", *starts)


def on_two_threads(engine: str, pdbs: list[Path]) -> Iterator[Measurement]:
    """Yield the measurements of the host engine beside another engine on two threads."""
    rows = [(f"{MANY} TIP3P", "W2_1, 2 fs a force", partial(water, MANY), partial(constant, 0.002, "W2_1"))]
    for pdb in pdbs:
        start = partial(in_water, pdb, app.HBonds)
        rows.append((f"{pdb.stem} in water", "W2_3m, 8 fs a force", start, partial(bath, 0.024, "W2_3m")))
    for name, run, start, ours in rows:

        def measured(start: Any = start, ours: Any = ours) -> dict[str, Any]:
            return by_engine(*(start().moving(ours(each), "CPU", 2) for each in (engine, "host")))

        yield Measurement(name, "CPU", f"{run}, two threads", "the host engine, by wall time", measured)


def beside(system: str, platform: str, run: str, start: Any, ours: Any, theirs: Any, other: Any = None) -> Measurement:
    """Return the measurement of an integrator of ours beside one of OpenMM's, which may have another start."""

    def measured() -> dict[str, Any]:
        return by_force(start().moving(ours(), platform), (other or start)().moving(theirs(), platform))

    name = theirs.func.__name__ if theirs.func is not langevin else "LangevinMiddleIntegrator"
    return Measurement(system, platform, run, name + (", AllBonds" if other else ""), measured)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--only", choices=("water", "peptides", "solutes", "alchemy", "threads"), help="some of the rows")
    add("--pdb", type=Path, help="a solvated protein, beside alanine dipeptide")
    add("--engine", default="native", help="of our integrators (%(default)s)")
    add("--record", type=Path, default=RECORDS / "small_systems.csv")
    args = parser.parse_args()
    pdbs = [args.pdb] if args.pdb else []
    record = Record(args.record, RUN, FOUND)
    measurements = {
        "threads": on_two_threads(args.engine, pdbs),  # before the process stays on one core
        "water": of_water(args.engine),
        "peptides": of_peptides(args.engine),
        "solutes": of_solutes(args.engine, [PEPTIDE, *pdbs]),
        "alchemy": of_alchemy(args.engine),
    }
    for what, some in measurements.items():
        if what != "threads":
            on_one_core()
        for each in some if args.only in (None, what) else ():
            row = dict(zip(RUN, each[:4], strict=True))
            if row in record:
                continue
            record.add({**row, **provenance(), **each.measured()})


if __name__ == "__main__":
    main()
