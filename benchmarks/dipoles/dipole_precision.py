"""Energy error against wall time for 125 soft dipoles: our schemes, V2 with McLachlan-Reich, and LAMMPS.

The benchmark determines the fastest code for a given error. All codes integrate the same droplet from the same start at
rest over T = 5. All three moments of inertia of a sphere are equal, because LAMMPS's fix nve/sphere requires this.
LAMMPS has no pure (σ/r)^12 potential, so its energies are computed with pair_style hybrid/overlay of dipoles and a Mie
potential whose attraction is a constant. Its time is that of plain lj/cut/dipole/cut, which is faster. Times are the
number of evaluations of a run times the seconds of an evaluation, the smallest over several rounds in which the codes
alternate. Raw data are written to out/benchmarks/dipole_precision.json, and the picture to
docs/pictures/dipole_precision.png.
"""

from __future__ import annotations

import time
from functools import partial
from itertools import pairwise

import numpy as np
from openmm import unit

import openmm_exactrb as rb
from benchmarks.common import lammps_peer
from benchmarks.common.clocks import in_turns
from benchmarks.common.pictures import STYLES, plt
from benchmarks.common.records import PICTURES, keep
from benchmarks.common.starts import context_of
from benchmarks.common.stockmayer import arrows
from benchmarks.cost.dipole_cost import lammps_step

N, INERTIA, T = 125, 1.88, 5.0
OURS = ("V2", "S2_2", "SRKN4_6b", "S6_10", "SRKN6_14a", "KL8_17")
EVALUATIONS = [round(20 * 2 ** (k / 2)) for k in range(17)]  # a unit of time
METHODS = [*((scheme, "exact") for scheme in OURS), ("V2", "mclachlan_reich")]


def start():
    return rb.dipole_fluid(N, seed=3, inertia=(INERTIA,) * 3)


def ours(scheme, rotor, evaluations):
    """Return the largest relative energy error and the evaluations of a run."""
    _, system, positions = start()
    stages = rb.SCHEMES[scheme].stages
    steps = max(1, round(T * evaluations / stages))
    integrator = rb.ExactRigidBodyIntegrator(T / steps, scheme=scheme, rotor=rotor)
    _context = context_of(system, integrator, positions, "Reference")

    def energy():
        return integrator.totalEnergy().value_in_unit(unit.kilojoule_per_mole)

    first, largest, every = energy(), 0.0, max(1, steps // 50)
    try:
        for _ in range(steps // every):
            integrator.step(every)
            largest = max(largest, abs(energy() / first - 1.0))
    except rb.IntegrationError:
        largest = float("inf")
    return largest, steps * stages, first


def lammps_error(evaluations, first):
    """Return the largest energy error of LAMMPS, relative to our energy, and its evaluations."""
    _, _, positions = start()
    steps = round(T * evaluations)
    centres, directions = arrows(positions._value, N)
    lmp = lammps_peer.dipoles(
        centres,
        2.0**0.5 * directions,
        """
        pair_style hybrid/overlay lj/cut/dipole/cut 60 mie/cut 60
        pair_coeff * * lj/cut/dipole/cut 0.0 1.0
        pair_coeff * * mie/cut 4.0 1.0 12.0 1.0e-9
        """,
    )
    lmp.commands_string(
        f"""
        set type 1 diameter {(10.0 * INERTIA) ** 0.5!r}
        fix motion all nve/sphere update dipole/dlm
        compute spin all erotate/sphere
        thermo_style custom step pe ke c_spin
        thermo_modify norm no
        timestep {T / steps!r}
        run 0
        """
    )

    def energy():
        spin = lmp.extract_compute("spin", 0, 0)
        return lmp.get_thermo("pe") + lmp.get_thermo("ke") + spin

    begin, largest, every = energy(), 0.0, max(1, steps // 50)
    for _ in range(steps // every):
        lmp.command(f"run {every} post no")
        largest = max(largest, abs(energy() - begin) / abs(first))
    lmp.close()
    return largest, steps


def seconds():
    """Return the seconds of a force evaluation by contender, the least of rounds in turns."""
    runs, evaluations, contexts = {}, {}, []
    for scheme, rotor in METHODS:
        _, system, positions = start()
        integrator = rb.ExactRigidBodyIntegrator(0.001, scheme=scheme, rotor=rotor)
        contexts.append(context_of(system, integrator, positions, "Reference"))
        integrator.step(1)
        name, stages = f"{scheme} + {rotor}", rb.SCHEMES[scheme].stages
        runs[name], evaluations[name] = partial(integrator.step, 200 // stages), 200 // stages * stages
    if lammps_peer.INSTALLED:
        runs["LAMMPS"], evaluations["LAMMPS"] = partial(lammps_step(N), 200), 200
    times = in_turns(runs, 12, time.perf_counter)
    return {name: min(some) / evaluations[name] for name, some in times.items()}


def main():
    cost, lines = seconds(), {}
    for scheme, rotor in METHODS:
        for rate in EVALUATIONS:
            error, evaluations, first = ours(scheme, rotor, rate)
            lines.setdefault(f"{scheme} + {rotor}", []).append((evaluations, error))
    if lammps_peer.INSTALLED:
        lines["LAMMPS"] = [lammps_error(rate, first)[::-1] for rate in EVALUATIONS]
    keep("dipole_precision.json", {"seconds_an_evaluation": cost, "runs": lines})
    report(cost, lines)
    draw(cost, lines)


def time_for(target, points, cost):
    """Return the least seconds for an error, between the measured points of falling error; nan out of range."""
    fine = [(n, e) for n, e in points if 0.0 < e < 0.3]
    for (n0, e0), (n1, e1) in pairwise(fine):
        if e0 >= target >= e1 and e0 > e1:
            part = np.log(e0 / target) / np.log(e0 / e1)
            return cost * n0 * (n1 / n0) ** part
    return np.nan


def report(cost, lines):
    targets = [10.0**-k for k in range(3, 13)]
    print("Seconds for a relative energy error over T = 5 (microseconds an evaluation):")
    print(f"{'':>24}{'us':>8}" + "".join(f"{t:>9.0e}" for t in targets))
    for name, points in lines.items():
        row = [time_for(t, points, cost[name]) for t in targets]
        print(f"{name:>24}{1e6 * cost[name]:>8.0f}" + "".join(f"{s:>9.2f}" for s in row))


def draw(cost, lines):
    figure, axis = plt.subplots(figsize=(7.5, 5.5), layout="constrained")
    for k, (name, points) in enumerate(lines.items()):
        fine = [(cost[name] * n, e) for n, e in points if 0.0 < e < 1.0]
        ours_exact = name.endswith("+ exact")
        label = name.replace(" + mclachlan_reich", " + McLachlan-Reich").replace(" + exact", "")
        axis.loglog(
            *zip(*fine, strict=True),
            color=STYLES[k][0],
            marker=STYLES[k][1],
            ls="-" if ours_exact else "--",
            ms=4,
            label=label,
        )
    axis.set_xlabel("wall time of a run over T = 5 (s)")
    axis.set_ylabel("largest relative error of the energy")
    axis.set_title("125 soft dipoles, open boundaries, two cores (LAMMPS: one)")
    axis.grid(True, alpha=0.3)
    axis.legend(fontsize=9)
    figure.savefig(PICTURES / "dipole_precision.png", dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    main()
