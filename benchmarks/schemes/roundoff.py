"""The growth of roundoff errors where they exceed the error of the scheme: Brouwer's law.

1. Heavy tops, up to 1e6 steps: with compensated sums (high + low), and with every drift and kick rounded to float64.
2. An isolated droplet of 27 soft dipoles in OpenMM on the Reference platform, 1e5 steps: the same two variants, and
   OpenMM's VerletIntegrator with SETTLE from the same starts, with as many force evaluations per unit of time.

The results of each start are stored in out/benchmarks/roundoff/, from which an interrupted run continues. Root mean
squares over the starts are written to records/roundoff.csv, in which rows of variants without results stay, and to
docs/pictures/roundoff.png. Rounded states, and tops, are not those of an engine but of the loop in Python, "host".
--quick runs a hundredth of the steps and uses a separate folder.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.pictures import plt
from benchmarks.common.provenance import OF_RUN, commit, of_run, of_runs
from benchmarks.common.records import OUT, RECORDS, picture_of, read, write
from benchmarks.common.starts import R, context_of, masses_of, positions_and_velocities
from benchmarks.paper import problems
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.steps.sequence import repeated, run
from openmm_exactrb.steps.substeps import Substep

# Schemes and steps whose own energy error is small enough to see roundoff beside it; --truncation measures it.
TOP_SCHEME, TOP_STEP = rb.SCHEMES["SRKN6_11b"], 0.02
DIPOLE_SCHEME, DIPOLE_STEP = rb.SCHEMES["SRKN6_14a"], 0.0025
KT, TRAP = 0.1, 0.1  # kJ/mol and kJ/mol/nm²
QUANTITIES = ("energy", "direction", "momentum")  # of the angular and the linear momentum


def recorded_steps(last):
    """Return numbers of steps, six a decade."""
    return np.unique(np.round(np.geomspace(10, last, 6 * round(np.log10(last / 10)) + 1)).astype(int))


# -- tops -----------------------------------------------------------------------------------------------------------


def top_of(start):
    """Return the problem and the state (q, m) of 32 tops."""
    return problems.HeavyTop.random(np.random.default_rng([7, start]), epsilon=0.1, T0=1.0, n=32)


def rounding(flow):
    """Return a flow that drops the low parts of what it changes."""

    def rounded(state, tau):
        after = flow(state, tau)
        return State(*(new if new is old else exactly(new[0]) for new, old in zip(after, state, strict=True)))

    return rounded


def rounded_tops(problem):
    """Return advance(state, h, n) in which every flow ends in float64."""
    flows = {substep: rounding(flow) for substep, flow in problems.flows(problem, TOP_SCHEME).items()}

    def advance(state, h, n):
        nowhere = np.zeros((2, 3, 0))
        end = run(repeated(TOP_SCHEME.sequence, n), flows, State(nowhere, nowhere, *map(exactly, state)), h)
        return end.rounded.q, end.rounded.m

    return advance


def energy_and_momentum(problem, state):
    """Return the energies of tops and their momenta along the field, in long double from all that the state holds."""
    q, m = (x.astype(np.longdouble).sum(axis=0) if x.ndim == 3 else x.astype(np.longdouble) for x in state)
    w, v = q[:1], q[1:]
    t = 2.0 * np.cross(problem.direction, v, axis=0)
    u = problem.direction + (w * t + np.cross(t, v, axis=0)) / (q * q).sum(axis=0)  # conj(q) u q
    return 0.5 * (m * m / problem.inertia).sum(axis=0) + problem.epsilon * u[2], (m * u).sum(axis=0)


def tops(start, variant, last, h=TOP_STEP):
    """Return energy errors of 32 tops, (32, records), and errors of the momentum along the field."""
    problem, state = top_of(start)
    if variant == "sums":

        def advance(state, h, n):
            return problems.integrate(problem, state, h, n, TOP_SCHEME)
    else:
        advance = rounded_tops(problem)

    size = np.linalg.norm(state[1], axis=0)
    if variant == "sums":
        state = tuple(map(exactly, state))
    observe = partial(energy_and_momentum, problem)
    energy, along, before = *observe(state), 0
    records = {"energy": [], "direction": []}
    for step in recorded_steps(last):
        state, before = advance(state, h, step - before), step
        now = observe(state)
        records["energy"].append(now[0] / energy - 1.0)
        records["direction"].append((now[1] - along) / size)
    found = {name: np.array(rows, dtype=np.float64).T for name, rows in records.items()}
    return found | {"origin": np.array(["host", "", openmm.__version__, commit()])}


# -- dipoles --------------------------------------------------------------------------------------------------------


@cache
def dipoles_of(start, n=27, kernel="auto"):
    """Return the system of n dipoles, and the positions and velocities of a droplet that rests as a whole."""
    topology, system, positions = rb.dipole_fluid(n, seed=start, kernel=kernel)
    system.addForce(springs([atom.index for atom in topology.atoms() if atom.name == "C"]))
    integrator = rb.ExactRigidBodyIntegrator(0.001, "SRKN4_6b")
    context = context_of(system, integrator, positions, "Reference")
    openmm.LocalEnergyMinimizer.minimize(context, 1e-3)
    integrator.setVelocitiesToTemperature(KT / R, start)
    state, masses = context.getState(positions=True, velocities=True), masses_of(system)
    v = state.getVelocities(asNumpy=True)._value
    v -= masses @ v / masses.sum()
    return system, state.getPositions(), v


def springs(centres):
    """Return a harmonic trap about the centre of mass, which moves with it: a weak spring between all pairs.

    Without it the droplet evaporates, and far from the origin positions and momenta are rounded more and more.
    """
    force = openmm.HarmonicBondForce()
    for i, j in itertools.combinations(centres, 2):
        force.addBond(i, j, 0.0, TRAP / len(centres))
    return force


@dataclass(frozen=True)
class Rounded(Substep):
    """Another substep, behind which the low parts of the sums that it changes are dropped."""

    substep: Substep

    @property
    def moves(self):
        """Whether the other one may change positions."""
        return self.substep.moves

    @property
    def kicks(self):
        """Whether the other one kicks."""
        return self.substep.kicks

    def bind(self, environment):
        """Return the flow of the other one, rounded."""
        return rounding(self.substep.bind(environment))


def rounded(scheme):
    """Return a scheme that drops the low parts of its sums after every substep."""
    return replace(scheme, sequence=tuple((Rounded(substep), part) for substep, part in scheme.sequence))


def in_long_double(context, integrator):
    """Return energy, momenta (N, 3) and angular momentum of dipoles, in long double from all that the state holds."""
    bodies, full = integrator.fullState()
    system, (kind,), parameters = context.getSystem(), bodies.kinds, context.getParameters()
    R, P, q, m = (x.astype(np.longdouble).sum(axis=0) for x in full)
    Q = attitude(q)
    first = kind.particles[0]
    sites = dict(zip(first, kind.sites[0].astype(np.longdouble), strict=True))
    centre, tip = (virtual_site(system.getVirtualSite(int(first[-1]) + k), sites) for k in (1, 2))
    places = R + np.einsum("ijn,j->in", Q, centre)
    arrows = np.einsum("ijn,j->in", Q, tip - centre)
    i, j = np.triu_indices(len(bodies), 1)
    r = places[:, i] - places[:, j]
    u, v, inverse = arrows[:, i], arrows[:, j], 1.0 / (r * r).sum(axis=0)
    dipolar = (u * v).sum(axis=0) - 3.0 * (u * r).sum(axis=0) * (v * r).sum(axis=0) * inverse
    dipolar *= parameters["dipole_coupling"] * inverse * np.sqrt(inverse)
    spring = 0.5 * TRAP / len(bodies) / inverse
    potential = (parameters["soft_repulsion"] * inverse**6 + dipolar + spring).sum()
    kinetic = 0.5 * ((P * P / bodies.mass).sum() + (m * m / bodies.inertia.T).sum())
    spin = np.cross(R, P, axis=0).sum(axis=1) + np.einsum("ijn,jn->i", Q, m)
    return kinetic + potential, P.T, spin


def norm(x):
    """Return norms along the last axis, in the precision of x."""
    return np.sqrt((x * x).sum(axis=-1))


def attitude(q):
    """Return rotation matrices (3, 3, N) of quaternions of any norm and precision."""
    w, v = q[:1] / np.sqrt((q * q).sum(axis=0)), q[1:] / np.sqrt((q * q).sum(axis=0))
    unit_vectors = np.eye(3)[:, :, None] * np.ones_like(w)
    t = [2.0 * np.cross(v, e, axis=0) for e in unit_vectors]
    columns = [e + w * s + np.cross(v, s, axis=0) for e, s in zip(unit_vectors, t, strict=True)]
    return np.stack(columns, axis=1)


def virtual_site(site, places):
    """Return the place of an OutOfPlaneSite, by its definition."""
    x1, x2, x3 = (places[site.getParticle(k)] for k in range(3))
    to_second, to_third = x2 - x1, x3 - x1
    cross = np.cross(to_second, to_third)
    return x1 + site.getWeight12() * to_second + site.getWeight13() * to_third + site.getWeightCross() * cross


def dipoles(start, variant, last, h=DIPOLE_STEP):
    """Return the records of one droplet, (1, records)."""
    settle = variant == "settle"
    integrator = (
        openmm.VerletIntegrator(h * DIPOLE_SCHEME.stages)
        if settle
        else rb.ExactRigidBodyIntegrator(h, scheme=rounded(DIPOLE_SCHEME) if variant == "rounded" else DIPOLE_SCHEME)
    )
    system, positions, velocities = dipoles_of(start)
    context = context_of(system, integrator, (positions, velocities), "Reference")
    masses = masses_of(system)

    def observe():
        if not settle:
            return in_long_double(context, integrator)
        state = context.getState(positions=True, velocities=True, energy=True)
        x, v = positions_and_velocities(state)
        p = masses[:, None] * v
        return state.getKineticEnergy()._value + state.getPotentialEnergy()._value, p, np.cross(x, p).sum(axis=0)

    (energy, momentum, spin), before = observe(), 0
    records = {name: [] for name in QUANTITIES}
    for step in recorded_steps(last):
        integrator.step(int(step - before))
        now, before = observe(), step
        records["energy"].append(now[0] / energy - 1.0)
        records["momentum"].append(norm((now[1] - momentum).sum(axis=0)) / norm(momentum).sum())
        records["direction"].append(norm(np.cross(now[2], spin)) / (norm(now[2]) * norm(spin)))
    found = {name: np.array(rows, dtype=np.float64)[None] for name, rows in records.items()}
    return found | {"origin": np.array([*of_run(context).values()])}


# -- all of it ------------------------------------------------------------------------------------------------------

SYSTEMS = {"top": (tops, ("sums", "rounded"), 1_000_000), "dipoles": (dipoles, ("sums", "rounded", "settle"), 100_000)}


def compute(folder, chosen, variants, starts, fraction):
    folder.mkdir(parents=True, exist_ok=True)
    for name, (function, known, last) in SYSTEMS.items():
        for start in range(starts if name == "dipoles" else 1):
            for variant in known:
                file = folder / f"{name}_{variant}_{start}.npz"
                if name in chosen and variant in variants and not file.exists():
                    np.savez(file, **function(start, variant, last // fraction))
                    print(file, flush=True)


def curves(folder):
    """Yield system, variant, quantity, number of starts, root mean squares over them, and where they come from."""
    for name, (_, known, _) in SYSTEMS.items():
        for variant in known:
            files = [np.load(file) for file in sorted(folder.glob(f"{name}_{variant}_*.npz"))]
            origin = of_runs(dict(zip(OF_RUN, map(str, file["origin"]), strict=True)) for file in files)
            for quantity in QUANTITIES:
                if files and quantity in files[0].files:
                    rows = np.concatenate([file[quantity] for file in files])
                    yield name, variant, quantity, len(rows), np.sqrt((rows**2).mean(axis=0)), origin


def exponent(steps, errors, first):
    """Return the slope of log(error) over log(steps), from step `first` on."""
    late = steps >= first
    return np.polyfit(np.log(steps[late]), np.log(errors[late]), 1)[0]


def truncation():
    """Print the energy error of the schemes at larger steps, and extrapolated by its order to the steps taken here."""
    for name, function, scheme, taken, sizes in (
        ("top", tops, TOP_SCHEME, TOP_STEP, (0.4, 0.2)),
        ("dipoles", dipoles, DIPOLE_SCHEME, DIPOLE_STEP, (0.02, 0.01)),
    ):
        for h in sizes:
            worst = max(np.abs(function(start, "sums", 1000, h)["energy"]).max() for start in range(2))
            print(f"{name}: h = {h:g}: {worst:.1e}; at {taken:g}: {worst * (taken / h) ** scheme.order:.1e}")


VARIANTS = ("sums", "rounded", "settle")
STYLES = {
    "sums": ("#0072B2", "o", "this package: state in double-doubles"),
    "rounded": ("#D55E00", "s", "the same, state rounded at every stage"),
}


def record(folder, fraction, table):
    """Write the root mean squares, and print where they end and how they grow."""
    known = {(row["system"], row["variant"], row["quantity"]): [] for row in read(table)}
    for row in read(table):
        known[row["system"], row["variant"], row["quantity"]].append(row)
    for name, variant, quantity, starts, errors, origin in curves(folder):
        last = SYSTEMS[name][2] // fraction
        steps = recorded_steps(last)
        of_curve = {"system": name, "variant": variant, "quantity": quantity, "starts": starts} | origin
        known[name, variant, quantity] = [
            of_curve | {"step": n, "rms": f"{e:.4e}"} for n, e in zip(steps, errors, strict=True)
        ]
        slope = exponent(steps, np.maximum(errors, 1e-20), last / 1000)
        print(f"{name:8} {variant:8} {quantity:10} {starts:4} starts  end {errors[-1]:.1e}  exponent {slope:.2f}")
    write(table, ("system", "variant", "quantity", "starts", "step", "rms", *OF_RUN), itertools.chain(*known.values()))


def draw(table, picture):
    """Draw how roundoff lets the energy of the dipoles drift, from the table."""
    rows = [row for row in read(table) if (row["system"], row["quantity"]) == ("dipoles", "energy")]
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for variant, (colour, marker, label) in STYLES.items():
        steps, errors = np.array([(row["step"], row["rms"]) for row in rows if row["variant"] == variant], float).T
        axes.loglog(steps, errors, color=colour, marker=marker, markersize=4, label=label)
    guide = steps[[0, -1]]
    axes.loglog(guide, 1e-17 * np.sqrt(guide / guide[0]), color="#999999", linestyle="--", label="square root of n")
    axes.set(
        title="27 dipoles: roundoff in the energy", xlabel="number of steps n", ylabel="relative energy error (rms)"
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    figure.savefig(picture, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=VARIANTS)
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--draw", action="store_true", help="only draw the table that is there")
    parser.add_argument("--truncation", action="store_true", help="only measure the error of the scheme")
    parser.add_argument("--record", type=Path, default=RECORDS / "roundoff.csv", metavar="CSV", help="%(default)s")
    options = parser.parse_args()
    fraction = 100 if options.quick else 1
    folder = OUT / ("roundoff_quick" if options.quick else "roundoff")
    if options.truncation:
        truncation()
        return
    if not options.draw:
        compute(folder, options.systems, options.variants, options.starts, fraction)
    table = folder / "roundoff.csv" if options.quick else options.record
    if not options.draw:
        record(folder, fraction, table)
    draw(table, picture_of(table))


if __name__ == "__main__":
    main()
