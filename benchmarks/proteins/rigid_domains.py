"""Rigid domains of a protein: radius of gyration, energy error compared with OpenMM's recipe, and gain by exclusions.

The model is that of examples/rigid_domains.py: hnRNPA1* in CALVADOS 2, one chain without a periodic box. The recipe
createRigidBodies of OpenMM's cookbook assigns the mass of a body to four of its particles, with constraints between
them, and turns the other particles into virtual sites. The name `concentrated` refers to this recipe. VerletIntegrator,
which it uses, has a constraint tolerance of 1e-8.

    python benchmarks/proteins/rigid_domains.py gyration --ns 100  # records/rigid_domains_gyration.csv, continued
    python benchmarks/proteins/rigid_domains.py energies           # records/rigid_domains.csv
    python benchmarks/proteins/rigid_domains.py cost               # records/rigid_domains_cost.csv
    python benchmarks/proteins/rigid_domains.py rotation           # of a lone molecule as a whole: printed

Times are processor times on the CPU platform with one thread, as medians of rounds in which the candidates alternate.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import runpy
from types import SimpleNamespace

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.clocks import in_turns
from benchmarks.common.provenance import OF_RUN, PROVENANCE, of_run, provenance
from benchmarks.common.records import RECORDS, ROOT, read, write
from benchmarks.common.starts import R

MODEL = SimpleNamespace(**runpy.run_path(str(ROOT / "examples" / "rigid_domains.py")))
CPU = openmm.Platform.getPlatform("CPU")
GYRATION, ENERGIES, COST = (RECORDS / f"rigid_domains{part}.csv" for part in ("_gyration", "", "_cost"))
STEP, SAMPLE, FRICTION = 0.03, 9.0, 0.1  # ps, ps, 1/ps
WARM, BLOCKS = 2000.0, 10  # ps that are left out, and blocks of the rest
INTERVALS, DURATION, EVERY = (10, 20, 30, 50, 80, 110), 30.0, 0.1  # fs, ps, ps


def model(exclude: bool = True) -> openmm.System:
    system = MODEL.calvados2(MODEL.SEQUENCE, MODEL.TEMPERATURE, MODEL.IONIC)
    if exclude:
        rb.exclude_within(system, MODEL.DOMAINS)
    return system


def context_of(system, integrator, x):
    context = openmm.Context(system, integrator, CPU, {"Threads": "1"})
    context.setPositions(x)
    return context


def positions(context):
    return context.getState(positions=True).getPositions(asNumpy=True)._value


def langevin(friction):
    return rb.ExactRigidBodyLangevinIntegrator(MODEL.TEMPERATURE, friction, STEP, bodies=MODEL.DOMAINS)


def gyration(duration: float) -> None:
    """Continue the record of the radius of gyration to a duration in ps, with a State beside it."""
    system, integrator = model(), langevin(FRICTION)
    charges = system.getForce(2)  # of the same energy, but for pairs of neutral beads, which need not be computed
    charged = [k for k in range(system.getNumParticles()) if charges.getParticleParameters(k)[0]]
    charges.addInteractionGroup(charged, charged)
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, MODEL.start())
    state, rows = ROOT / "out" / "benchmarks" / "rigid_domains.xml", [list(row.values()) for row in read(GYRATION)]
    if rows and state.exists():
        context.setState(openmm.XmlSerializer.deserialize(state.read_text()))
    else:
        rows = []
        integrator.minimizeEnergy(10.0, 100)
        integrator.setVelocitiesToTemperature(MODEL.TEMPERATURE, 1)
    while context.getTime()._value < duration - 0.5 * SAMPLE:
        integrator.step(round(SAMPLE / STEP))
        rows.append([f"{context.getTime()._value:.0f}", f"{MODEL.radius_of_gyration(system, positions(context)):.4f}"])
        if len(rows) % 20 == 0:
            state.parent.mkdir(parents=True, exist_ok=True)
            whole = context.getState(positions=True, velocities=True, integratorParameters=True)
            state.write_text(openmm.XmlSerializer.serialize(whole))
            write(GYRATION, ("time_ps", "radius_of_gyration_nm"), rows)
    report()


def report(blocks: int = 5) -> None:
    """Print the mean of the record, with the standard error of a few long blocks: the chain moves slowly."""
    table = np.array([[float(value) for value in row.values()] for row in read(GYRATION)])
    kept = table[table[:, 0] > WARM, 1]
    means = [block.mean() for block in np.array_split(kept, blocks)]
    error, root = np.std(means, ddof=1) / blocks**0.5, (kept**2).mean() ** 0.5
    print(f"{table[-1, 0] / 1e3:.1f} ns: root of the mean square {root:.2f} nm, error {error:.2f}")


def concentrated(system, x, bodies):
    """Return a copy of a System in which four particles of each body have its mass, and hold the others."""
    system, masses = copy.deepcopy(system), np.array([system.getParticleMass(k)._value for k in range(len(x))])
    for body in map(np.array, bodies):
        arms = x[body] - masses[body] @ x[body] / masses[body].sum()
        distance = np.linalg.norm(arms, axis=1)
        rank = np.argsort(np.abs(distance - np.sqrt((distance**2).mean())), kind="stable")
        for four in map(list, itertools.combinations(rank, 4)):
            rows = np.vstack([arms[four].T, np.ones(4)])
            weights = np.linalg.solve(rows, [0.0, 0.0, 0.0, masses[body].sum()])
            if (weights > 0.0).all():
                break
        real = body[four]
        for k, weight in zip(real, weights, strict=True):
            system.setParticleMass(int(k), weight)
        for i, j in itertools.combinations(map(int, real), 2):
            system.addConstraint(i, j, float(np.linalg.norm(x[i] - x[j])))
        first = x[real[1:3]] - x[real[0]]
        axes = np.vstack([first, np.cross(*first)])
        for k in np.setdiff1d(body, real):
            system.setParticleMass(int(k), 0.0)
            site = openmm.OutOfPlaneSite(*map(int, real[:3]), *np.linalg.solve(axes.T, x[k] - x[real[0]]))
            system.setVirtualSite(int(k), site)
    bonds = next(force for force in system.getForces() if isinstance(force, openmm.HarmonicBondForce))
    owner = {k: number for number, body in enumerate(bodies) for k in body}
    for k in range(bonds.getNumBonds()):
        i, j, length, _ = bonds.getBondParameters(k)
        if owner.get(i, -1) == owner.get(j, -2):
            bonds.setBondParameters(k, i, j, length, 0.0)
    return system


def moments(masses, x):
    arms = x - masses @ x / masses.sum()
    return np.linalg.eigvalsh(np.einsum("s,sij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in arms]))


def relaxed(system):
    """Return positions after 200 ps with a high friction."""
    integrator = langevin(5.0)
    context = context_of(system, integrator, MODEL.start())
    integrator.setRandomNumberSeed(2)
    integrator.minimizeEnergy(10.0, 100)
    integrator.setVelocitiesToTemperature(MODEL.TEMPERATURE, 2)
    integrator.step(round(200.0 / STEP))
    return positions(context)


def energies() -> None:
    system = model()
    x = relaxed(system)
    recipe = concentrated(system, x, MODEL.DOMAINS)
    for number, body in enumerate(map(list, MODEL.DOMAINS)):
        own, theirs = (np.array([s.getParticleMass(k)._value for k in body]) for s in (system, recipe))
        shares = moments(theirs, x[body]) / moments(own, x[body])
        print(
            f"domain {number + 1}: moments of the recipe are {', '.join(f'{s:.2f}' for s in shares)} of the exact ones"
        )
    rows = []
    for interval in INTERVALS:
        for name, scheme in (("createRigidBodies", "Verlet"), ("bodies=", "W2_1"), ("bodies=", "W4_4")):
            ours = scheme != "Verlet"
            if ours:
                integrator = rb.ExactRigidBodyIntegrator(
                    forceInterval=1e-3 * interval, scheme=scheme, bodies=MODEL.DOMAINS
                )
            else:
                integrator = openmm.VerletIntegrator(1e-3 * interval)
                integrator.setConstraintTolerance(1e-8)
            context = context_of(system if ours else recipe, integrator, x)
            (integrator if ours else context).setVelocitiesToTemperature(MODEL.TEMPERATURE, 7)
            try:
                numbers = [f"{number:.3f}" for number in conserved(context, integrator, ours)]
            except (rb.IntegrationError, openmm.OpenMMException):
                numbers = ["diverges", ""]
            rows.append([interval, name, scheme, *numbers, *of_run(context).values()])
            print(*rows[-1], flush=True)
    write(ENERGIES, ("interval_fs", "bodies", "scheme", "rms_kJ_per_mol", "drift_kJ_per_mol_ps", *OF_RUN), rows)


def conserved(context, integrator, ours):
    """Return the spread of the total energy about its line (kJ/mol), and the slope (kJ/mol/ps)."""
    step = integrator.getStepSize()._value
    every, found = max(1, round(EVERY / step)), []
    for _ in range(round(DURATION / (every * step))):
        integrator.step(every)
        state = context.getState(energy=True)
        kinetic = (
            sum(integrator.kineticEnergies(), 0 * openmm.unit.kilojoule_per_mole) if ours else state.getKineticEnergy()
        )
        found.append((state.getPotentialEnergy() + kinetic)._value)
    time = every * step * np.arange(len(found))
    line = np.polyfit(time, found, 1)
    return float(np.std(found - np.polyval(line, time))), float(line[0])


def cost(rounds: int = 7, steps: int = 100) -> None:
    rows = []
    x = relaxed(model())
    runs, kept, langevins = {}, [], {}
    for exclude in (False, True):
        system = model(exclude)
        for name in ("bodies=", "createRigidBodies", "flexible"):
            bodies = name == "bodies="
            integrator = langevin(1.0) if bodies else openmm.LangevinMiddleIntegrator(MODEL.TEMPERATURE, 1.0, STEP)
            if name == "flexible" and exclude:
                continue
            context = context_of(concentrated(system, x, MODEL.DOMAINS) if name[0] == "c" else system, integrator, x)
            (integrator if bodies else context).setVelocitiesToTemperature(MODEL.TEMPERATURE, 1)
            integrator.step(20)
            kept.append(context)
            if bodies:
                langevins[exclude] = integrator
            runs[name, exclude] = lambda integrator=integrator: integrator.step(steps)
    for (name, exclude), taken in in_turns(runs, rounds).items():
        step = 1e3 * np.median(taken) / steps
        engine = langevins[exclude].getEngine() if name == "bodies=" else "openmm"
        rows.append([name, "excluded" if exclude else "computed", f"{step:.2f}", engine, *provenance().values()])
        print(*rows[-1], flush=True)
    write(COST, ("bodies", "pairs_within", "step_ms", "engine", *PROVENANCE), rows)


def rotation(seeds=(1, 2, 3), duration: float = 1500.0) -> None:
    """Print the temperature of the rotation as a whole of a lone molecule: residues 1 to 120, of one rigid domain."""
    system = MODEL.calvados2(MODEL.SEQUENCE[:120], MODEL.TEMPERATURE, MODEL.IONIC)
    bodies = MODEL.DOMAINS[:1]
    rb.exclude_within(system, bodies)
    masses = np.array([system.getParticleMass(k)._value for k in range(120)])
    kinds = {
        "Nose-Hoover": lambda: rb.ExactRigidBodyNoseHooverIntegrator(
            MODEL.TEMPERATURE, 2.0, STEP, bodies=bodies, together=True
        ),
        "Langevin": lambda: rb.ExactRigidBodyLangevinIntegrator(MODEL.TEMPERATURE, 0.5, STEP, bodies=bodies),
    }
    for (name, make), seed in itertools.product(kinds.items(), seeds):
        integrator = make()
        context = context_of(system, integrator, MODEL.start()[:120])
        integrator.minimizeEnergy(10.0, 100)
        integrator.setRandomNumberSeed(seed)
        integrator.setVelocitiesToTemperature(MODEL.TEMPERATURE, seed)
        found = []
        for _ in range(round(duration / (10 * STEP))):
            integrator.step(10)
            found.append(whole_rotation(masses, context))
        means = [block.mean() for block in np.array_split(found[len(found) // 5 :], BLOCKS)]
        spread = np.std(means, ddof=1) / BLOCKS**0.5
        print(f"{name}, seed {seed}: {np.mean(means):.0f} K, standard error {spread:.0f} K", flush=True)


def whole_rotation(masses, context):
    """Return the temperature (K) of a molecule's rotation as a whole, about its centre of mass."""
    state = context.getState(positions=True, velocities=True)
    x, v = state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
    arms, rates = x - masses @ x / masses.sum(), v - masses @ v / masses.sum()
    L = np.einsum("s,si->i", masses, np.cross(arms, rates))
    tensor = np.einsum("s,sij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in arms])
    return float(L @ np.linalg.solve(tensor, L)) / (3.0 * R)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gyration", "energies", "cost", "rotation"))
    parser.add_argument("--ns", type=float, default=100.0, metavar="NS", help="of the run for gyration (%(default)s)")
    args = parser.parse_args()
    if args.what == "gyration":
        gyration(1e3 * args.ns)
    else:
        {"energies": energies, "cost": cost, "rotation": rotation}[args.what]()


if __name__ == "__main__":
    main()
