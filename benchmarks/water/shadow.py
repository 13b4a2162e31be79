"""Predictions from the shadow energies of splittings for rigid water: temperatures and potential energy.

A symmetric splitting conserves an energy that differs from the true energy. For an oscillator of frequency w, this
shadow energy is that of `openmm_exactrb.schemes.shadow`, which determines <p²> and <q²> at the ends of steps. Here, the
spectra of the linear momenta of water and of its angular momenta about each axis of the molecule define a set of
oscillators that share one temperature. The thermostat sets their mean kinetic temperature at the point in the step
where it acts. The results are T_rot - T_tr and the error of the potential energy, for each scheme and each time between
force evaluations. The prediction neglects resonances of long steps with fast motion, which cause heating, and friction,
which moves the temperature of each mode towards that of the thermostat.

A liquid is not a set of oscillators. To second order, its potential energy has an additional error, which
`Anharmonicity` predicts from two short runs at other temperatures.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import R, context_of
from openmm_exactrb.schemes import Scheme, shadow, splitting
from openmm_exactrb.steps.substeps import HEAT_EXCHANGE

TEMPERATURE, APART = 298.15, 15.0  # K; how far two runs are from it
STEP, WINDOW = 0.006, 400  # ps; steps of a window of the spectrum
PREDICTED = "T_rot - T_tr", "dU oscillators", "dU more", "error", "rotation beyond stability"
RECORD = Record(RECORDS / "shadow.csv", ("model", "masses", "scheme", "fs"), PREDICTED)


def started(model: str, heavy: bool, integrator: rb.ExactRigidBodyLangevinIntegrator) -> openmm.Context:
    """Return 216 minimised molecules at the thermostat's temperature, with hydrogens of 3 amu if they are heavy."""
    topology, system, positions = rb.rigid_water(
        216, model=model, nonbondedMethod=app.PME, nonbondedCutoff=0.85, ewaldErrorTolerance=1e-4
    )
    if heavy:
        rb.heavy_hydrogens(system, topology, 3.0)
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, positions, properties={})
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    integrator.setVelocitiesToTemperature(integrator.getTemperature(), 1)
    return context


def momenta(model: str, picoseconds: float, heavy: bool = False):
    """Return linear and angular momenta, (steps, 3, n), of the molecules, each over the root of its mass or moment."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, 5.0, 0.004, scheme="S2_2")
    _context = started(model, heavy, integrator)
    integrator.step(2500)
    integrator.setFriction(0.0)
    integrator.setStepSize(STEP)
    linear, angular = [], []
    for _ in range(round(picoseconds / STEP)):
        integrator.step(1)
        bodies, state = integrator.bodyState()
        linear.append(state.P / np.sqrt(bodies.mass))
        angular.append(state.m / np.sqrt(bodies.principal_moments))
    return np.array(linear), np.array(angular)


def spectrum(series) -> np.ndarray:
    """Return the power of a series (steps, 3, n) over frequencies, as parts of one."""
    windows = series[: len(series) // WINDOW * WINDOW].reshape(-1, WINDOW, *series.shape[1:])
    tapered = windows * np.hanning(WINDOW)[:, None, None]
    power = (np.abs(np.fft.rfft(tapered, axis=1)) ** 2).mean(axis=(0, 2, 3))[1:]
    return power / power.sum()


def at_thermostat(scheme: Scheme) -> Scheme:
    """Return the scheme whose steps end with the thermostat: the same where half of it stands at either end."""
    substeps = [substep for substep, _ in scheme.sequence]
    after = substeps.index(HEAT_EXCHANGE) + 1 if HEAT_EXCHANGE in substeps else 0
    return replace(scheme, sequence=scheme.sequence[after:] + scheme.sequence[:after])


def shadows(scheme: Scheme, h: float, frequencies) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return K, Q and whether the step is stable, for each frequency.

    What is beyond stability is taken like the fastest motion that is not.
    """
    kept: list[tuple[float, float]] = []
    stable = []
    for w in frequencies:
        try:
            kept.append(shadow(scheme, w * h))
            stable.append(True)
        except ValueError:
            kept.append(kept[-1])
            stable.append(False)
    kinetic, potential = np.transpose(kept)
    return kinetic, potential, np.array(stable)


def predicted(scheme: Scheme, interval: float, frequencies, translational, rotational) -> tuple[float, float, float]:
    """Return T_rot - T_tr in K, the error of U in kJ/mol per molecule, and the part of rotation beyond stability.

    Both are those at the end of a step.
    """
    h, both = scheme.forces * interval, translational + rotational
    kinetic, potential, stable = shadows(scheme, h, frequencies)
    kinetic_at_thermostat, _, _ = shadows(at_thermostat(scheme), h, frequencies)
    shared = 2.0 * TEMPERATURE / float((both / kinetic_at_thermostat).sum())
    return (
        shared * float(((rotational - translational) / kinetic).sum()),
        1.5 * R * (shared * float((both / potential).sum()) - 2.0 * TEMPERATURE),
        float(rotational[~stable].sum()),
    )


@dataclass(frozen=True)
class Anharmonicity:
    """What makes a liquid other than oscillators, to second order in the step.

    Next to the heat exchange a splitting keeps H + h² (a v·V''v + b f·M⁻¹f), where K = 1 + 2a (w h)² and
    Q = 1 + 2b (w h)². The thermostat sets <p²> on the whole, and motion shares what is kept. So the density of
    positions is that of V but for a factor, with which the mean of V is off by
    h² <f·M⁻¹f> ((c - 1) a - (a + b) s) more than that of oscillators, wherever in the last drift it is read. For
    oscillators c is 1 and s is 0.

    Attributes
    ----------
    squares : float
        Mean of f·M⁻¹f and of the same of torques, in kJ/mol/ps² per molecule.
    capacity : float
        c, the configurational heat capacity over that of as many oscillators.
    stiffening, error : float
        s = d ln(<f·M⁻¹f>/kT) / d ln T at constant volume, and its error.
    """

    squares: float
    capacity: float
    stiffening: float
    error: float

    @classmethod
    def measured(cls, model: str, picoseconds: float, heavy: bool = False) -> Anharmonicity:
        """Return that of 216 molecules, from runs of this length with a step of 1 fs."""
        temperatures = TEMPERATURE + np.array([-APART, APART])
        runs = [squares_and_energies(model, kelvin, picoseconds, heavy) for kelvin in temperatures]
        (low, high), (cold, hot) = ([run[k] for run in runs] for k in (0, 1))
        blocks = [np.log([part.mean() for part in np.array_split(some, 10)]) for some in (low, high)]
        error = np.sqrt(sum(block.var(ddof=1) / len(block) for block in blocks))
        ratio = np.log(high.mean() / low.mean())
        per_log = 1.0 / np.log(temperatures[1] / temperatures[0])
        return cls(
            float(0.5 * (low.mean() + high.mean())),
            float((hot.mean() - cold.mean()) / (3.0 * R * 2.0 * APART)),
            float(ratio * per_log - 1.0),
            float(error * per_log),
        )

    def energy(self, scheme: Scheme, interval: float) -> tuple[float, float]:
        """Return the error of U in kJ/mol per molecule beyond that of oscillators, and its own error."""
        h, angle = scheme.forces * interval, 1e-2
        a, b = (0.5 * (part - 1.0) / angle**2 for part in shadow(at_thermostat(scheme), angle))
        unit_energy = h * h * self.squares
        mean = unit_energy * ((self.capacity - 1.0) * a - (a + b) * self.stiffening)
        return mean, abs(unit_energy * (a + b) * self.error)


def squares_and_energies(model: str, kelvin: float, picoseconds: float, heavy: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return samples of f·M⁻¹f, torques among f, and of the potential energy, both per molecule."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(kelvin, 5.0, 0.001)
    context = started(model, heavy, integrator)
    integrator.step(8000)
    squares, energies = [], []
    for _ in range(round(10.0 * picoseconds)):
        integrator.step(100)
        state = context.getState(forces=True, energy=True)
        bodies, motion = integrator.bodyState()
        force, torque = bodies.forces(motion, state.getForces(asNumpy=True)._value)
        squares.append(
            ((force**2).sum(axis=0) / bodies.mass + (torque**2 / bodies.principal_moments).sum(axis=0)).mean()
        )
        energies.append(state.getPotentialEnergy()._value / len(bodies))
    return np.array(squares), np.array(energies)


def main() -> None:
    parser = argparse.ArgumentParser(description="Temperatures and energy of water from shadow energies.")
    parser.add_argument("--model", default="spce", help="%(default)s")
    parser.add_argument("--length", type=float, default=24.0, metavar="PS", help="%(default)s")
    parser.add_argument(
        "--schemes",
        nargs="+",
        default=["V2", "S2_2", "SBAB_2", "SABA_2", "S2_3", "W2_3", "W2_3m", "W2_4g", "BAOAB", "BAOA"],
    )
    parser.add_argument("--intervals", nargs="+", type=float, default=[2, 4, 6], metavar="FS", help="a force")
    parser.add_argument("--heavy", action="store_true", help="hydrogens of 3 amu")
    args = parser.parse_args()
    liquid = Anharmonicity.measured(args.model, args.length, args.heavy)
    print(f"c {liquid.capacity:.2f}, s {liquid.stiffening:.2f} +- {liquid.error:.2f}, {liquid.squares:.0f} kJ/mol/ps²")
    linear, angular = momenta(args.model, args.length, args.heavy)
    frequencies = 2.0 * np.pi * np.fft.rfftfreq(WINDOW, STEP)[1:]
    parts = spectrum(linear), spectrum(angular)
    for name, part in zip(("translation", "rotation"), parts, strict=True):
        print(f"{name}: root mean square frequency {np.sqrt((part * frequencies**2).sum()):.0f}/ps")
    for name in args.schemes:
        for interval in args.intervals:
            difference, energy, lost = predicted(splitting(name), 0.001 * interval, frequencies, *parts)
            found = (difference, energy, *liquid.energy(splitting(name), 0.001 * interval), lost)
            row = {"model": args.model, "masses": "heavy" if args.heavy else "plain", "scheme": name, "fs": interval}
            RECORD.add(row | {key: f"{value:.4f}" for key, value in zip(PREDICTED, found, strict=True)})


if __name__ == "__main__":
    main()
