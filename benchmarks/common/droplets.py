"""Compiled simulation of droplets of rigid water, at about 20 us per force evaluation for 32 molecules.

The potential is that of the System of `openmm_exactrb.rigid_water` without a cutoff, and the drift is the exact rotor
of the package. Sequences of substeps are performed as in the integrator, but in float64 without compensated summation.
The speed is needed for searches.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import openmm
from numba import njit

import openmm_exactrb as rb
from benchmarks.common.starts import R, context_of
from benchmarks.paper.compiled import jacobi_flow
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick

COULOMB = 138.93545764438198  # kJ/mol nm e^-2, 1/(4 pi epsilon0) as OpenMM has it
_FAST = {"reassoc", "contract", "arcp", "nsz"}
# The rule of `jacobi_flow` with which its integral of the third kind is exact.
_CARLSON = (np.empty(0), np.empty(0))


class Model(NamedTuple):
    """What the molecules of a droplet are.

    Attributes
    ----------
    sites : (k, 3) array
        In the principal axes, nm; the site of Lennard-Jones is the first.
    charges : (k,) array
        Times sqrt(COULOMB), sqrt(kJ/mol nm).
    sigma, epsilon : float
    mass : float
    inertia : (3,) array
        Ascending.
    """

    sites: np.ndarray
    charges: np.ndarray
    sigma: float
    epsilon: float
    mass: float
    inertia: np.ndarray


@cache
def prepared(n: int, name: str) -> tuple[Model, openmm.System, rb.ExactRigidBodyIntegrator, openmm.Context]:
    """Return the model, and a droplet on a lattice in OpenMM whose energy is minimised."""
    _, system, positions = rb.rigid_water(n, model=name)
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme="V2")
    context = context_of(system, integrator, positions, "Reference")
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    bodies, state = integrator.bodyState()
    integrator.setBodyState(state)  # positions of exactly this shape
    (nonbonded,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    k = system.getNumParticles() // n
    parameters = [[p._value for p in nonbonded.getParticleParameters(i)] for i in range(k)]
    charge, sigma, epsilon = np.array(parameters).T
    if epsilon[1:].any():
        raise ValueError(f"{name} has Lennard-Jones beyond the first site")
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    sites = (x[:k] - state.R[:, 0]) @ matrix(state.q)[:, :, 0]
    model = Model(sites, math.sqrt(COULOMB) * charge, sigma[0], epsilon[0], bodies.mass[0], bodies.inertia[0])
    return model, system, integrator, context


@njit(error_model="numpy", fastmath=_FAST, cache=True)
def forces(R, q, sites, charges, sigma, epsilon, force, torque, x, f):
    """Write forces and body-frame torques; return the potential energy. x and f are (k, 3, n) work space."""
    k, n = sites.shape[0], R.shape[1]
    for i in range(n):
        w, a, b, c = q[0, i], q[1, i], q[2, i], q[3, i]
        for s in range(k):
            s0, s1, s2 = sites[s, 0], sites[s, 1], sites[s, 2]
            x[s, 0, i] = R[0, i] + (1 - 2 * (b * b + c * c)) * s0 + 2 * (a * b - w * c) * s1 + 2 * (a * c + w * b) * s2
            x[s, 1, i] = R[1, i] + 2 * (a * b + w * c) * s0 + (1 - 2 * (a * a + c * c)) * s1 + 2 * (b * c - w * a) * s2
            x[s, 2, i] = R[2, i] + 2 * (a * c - w * b) * s0 + 2 * (b * c + w * a) * s1 + (1 - 2 * (a * a + b * b)) * s2
            f[s, 0, i] = f[s, 1, i] = f[s, 2, i] = 0.0
    energy = 0.0
    for s in range(k):
        for t in range(k):
            qq = charges[s] * charges[t]
            lj = epsilon if s == 0 and t == 0 else 0.0
            if qq == 0.0 and lj == 0.0:
                continue
            for i in range(n):
                x0, x1, x2 = x[s, 0, i], x[s, 1, i], x[s, 2, i]
                f0 = f1 = f2 = e = 0.0
                for j in range(i + 1, n):
                    d0, d1, d2 = x0 - x[t, 0, j], x1 - x[t, 1, j], x2 - x[t, 2, j]
                    inverse = 1.0 / (d0 * d0 + d1 * d1 + d2 * d2)
                    coulomb = qq * math.sqrt(inverse)
                    ratio = sigma * sigma * inverse
                    six = ratio * ratio * ratio
                    e += coulomb + 4.0 * lj * (six * six - six)
                    g = (coulomb + 24.0 * lj * (2.0 * six * six - six)) * inverse
                    g0, g1, g2 = g * d0, g * d1, g * d2
                    f0, f1, f2 = f0 + g0, f1 + g1, f2 + g2
                    f[t, 0, j] -= g0
                    f[t, 1, j] -= g1
                    f[t, 2, j] -= g2
                energy += e
                f[s, 0, i] += f0
                f[s, 1, i] += f1
                f[s, 2, i] += f2
    for i in range(n):
        w, a, b, c = q[0, i], q[1, i], q[2, i], q[3, i]
        F0 = F1 = F2 = N0 = N1 = N2 = 0.0
        for s in range(k):
            s0, s1, s2 = sites[s, 0], sites[s, 1], sites[s, 2]
            g0, g1, g2 = f[s, 0, i], f[s, 1, i], f[s, 2, i]
            F0, F1, F2 = F0 + g0, F1 + g1, F2 + g2
            h0 = (1 - 2 * (b * b + c * c)) * g0 + 2 * (a * b + w * c) * g1 + 2 * (a * c - w * b) * g2
            h1 = 2 * (a * b - w * c) * g0 + (1 - 2 * (a * a + c * c)) * g1 + 2 * (b * c + w * a) * g2
            h2 = 2 * (a * c + w * b) * g0 + 2 * (b * c - w * a) * g1 + (1 - 2 * (a * a + b * b)) * g2
            N0, N1, N2 = N0 + (s1 * h2 - s2 * h1), N1 + (s2 * h0 - s0 * h2), N2 + (s0 * h1 - s1 * h0)
        force[0, i], force[1, i], force[2, i] = F0, F1, F2
        torque[0, i], torque[1, i], torque[2, i] = N0, N1, N2
    return energy


@njit(error_model="numpy", cache=True)
def _carry_out(R, P, q, m, known, sequence, h, body, molecule, work):
    """Carry out a sequence in place; `known` says whether the forces in `work` are those of the places."""
    kinds, parts, gradients = sequence
    sites, charges, sigma, epsilon, mass, inertia = molecule
    force, torque, force1, torque1, R1, q1, x, f = work
    for place in range(len(kinds)):
        tau = parts[place] * h
        if kinds[place] == 0:
            R += P * (tau / mass)
            q[0], m[0] = jacobi_flow(body, False, _CARLSON, q[0], m[0], tau)
            known = False
            continue
        if not known:
            forces(R, q[0], sites, charges, sigma, epsilon, force, torque, x, f)
            known = True
        if kinds[place] == 1:
            P += force * tau
            m[0] += torque * tau
            continue
        e = gradients[place] * tau * tau
        for i in range(R.shape[1]):
            v0 = e * torque[0, i] / inertia[0]
            v1 = e * torque[1, i] / inertia[1]
            v2 = e * torque[2, i] / inertia[2]
            angle = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            c, s = math.cos(0.5 * angle), 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
            a0, a1, a2, a3 = q[0, 0, i], q[0, 1, i], q[0, 2, i], q[0, 3, i]
            b1, b2, b3 = s * v0, s * v1, s * v2
            q1[0, 0, i] = a0 * c - a1 * b1 - a2 * b2 - a3 * b3
            q1[0, 1, i] = a0 * b1 + a1 * c + a2 * b3 - a3 * b2
            q1[0, 2, i] = a0 * b2 - a1 * b3 + a2 * c + a3 * b1
            q1[0, 3, i] = a0 * b3 + a1 * b2 - a2 * b1 + a3 * c
            for row in range(3):
                R1[row, i] = R[row, i] + e * force[row, i] / mass
        forces(R1, q1[0], sites, charges, sigma, epsilon, force1, torque1, x, f)
        for i in range(R.shape[1]):  # torques about the places themselves
            w, a, b, c = q1[0, 0, i], q1[0, 1, i], q1[0, 2, i], q1[0, 3, i]
            s0, s1, s2 = torque1[0, i], torque1[1, i], torque1[2, i]
            t0 = (1 - 2 * (b * b + c * c)) * s0 + 2 * (a * b - w * c) * s1 + 2 * (a * c + w * b) * s2
            t1 = 2 * (a * b + w * c) * s0 + (1 - 2 * (a * a + c * c)) * s1 + 2 * (b * c - w * a) * s2
            t2 = 2 * (a * c - w * b) * s0 + 2 * (b * c + w * a) * s1 + (1 - 2 * (a * a + b * b)) * s2
            d0, d1, d2 = R1[0, i] - R[0, i], R1[1, i] - R[1, i], R1[2, i] - R[2, i]
            f0, f1, f2 = force1[0, i], force1[1, i], force1[2, i]
            t0 += d1 * f2 - d2 * f1
            t1 += d2 * f0 - d0 * f2
            t2 += d0 * f1 - d1 * f0
            w, a, b, c = q[0, 0, i], q[0, 1, i], q[0, 2, i], q[0, 3, i]
            s0 = (1 - 2 * (b * b + c * c)) * t0 + 2 * (a * b + w * c) * t1 + 2 * (a * c - w * b) * t2
            s1 = 2 * (a * b - w * c) * t0 + (1 - 2 * (a * a + c * c)) * t1 + 2 * (b * c + w * a) * t2
            s2 = 2 * (a * c + w * b) * t0 + 2 * (b * c - w * a) * t1 + (1 - 2 * (a * a + b * b)) * t2
            m[0, 0, i] += tau * s0
            m[0, 1, i] += tau * s1
            m[0, 2, i] += tau * s2
        P += force1 * tau
    return known


@njit(error_model="numpy", cache=True)
def _energy(R, P, q, m, molecule, work):
    """Return the total energy, and leave the forces of the places in `work`."""
    sites, charges, sigma, epsilon, mass, inertia = molecule
    force, torque, _, _, _, _, x, f = work
    energy = forces(R, q[0], sites, charges, sigma, epsilon, force, torque, x, f)
    for i in range(R.shape[1]):
        for row in range(3):
            energy += 0.5 * P[row, i] ** 2 / mass + 0.5 * m[0, row, i] ** 2 / inertia[row]
    return energy


@njit(error_model="numpy", cache=True)
def _run(R, P, q, m, molecule, body, sequences, h, every, samples):
    """Return the total energies before and after `samples` times `every` steps, nan from where the run blows up.

    The state is in the coordinates of the steps; `leave` makes of it that of the problem, for each look.
    """
    enter, step, leave = sequences
    k, n = molecule[0].shape[0], R.shape[1]
    work = (
        *(np.empty((3, n)), np.empty((3, n)), np.empty((3, n)), np.empty((3, n))),
        *(np.empty((3, n)), np.empty((1, 4, n)), np.empty((k, 3, n)), np.empty((k, 3, n))),
    )
    energies = np.full(samples + 1, np.nan)
    processed = len(leave[0]) > 0
    known = _carry_out(R, P, q, m, False, enter, h, body, molecule, work)
    for sample in range(samples + 1):
        for _ in range(every if sample else 0):
            known = _carry_out(R, P, q, m, known, step, h, body, molecule, work)
        if processed:
            R2, P2, q2, m2 = R.copy(), P.copy(), q.copy(), m.copy()
            _carry_out(R2, P2, q2, m2, known, leave, h, body, molecule, work)
            energy = _energy(R2, P2, q2, m2, molecule, work)
            known = False
        else:
            energy = _energy(R, P, q, m, molecule, work)
            known = True
        if not abs(energy - (energies[0] if sample else energy)) < n:
            break
        energies[sample] = energy
    _carry_out(R, P, q, m, known, leave, h, body, molecule, work)
    return energies


def table(sequence):
    """Return substeps as numbers, parts, and strengths of gradients of a sequence."""
    kinds = [0 if substep == DRIFT else 1 if substep == KICK else 2 for substep, _ in sequence]
    strengths = [substep.strength if isinstance(substep, GradientKick) else 0.0 for substep, _ in sequence]
    numbers = [part for _, part in sequence], strengths
    return np.array(kinds, dtype=np.int64), *(np.array(row, dtype=float) for row in numbers)


def run(model, state, scheme, h, duration, interval=0.02):
    """Return the energies of a run in kJ/mol per molecule, some `interval` apart, and the state at its end."""
    R, P, q, m = (np.ascontiguousarray(a).copy() for a in state)
    q, m = q[None], m[None]
    every = max(1, round(interval / h))
    samples = max(1, round(duration / (every * h)))
    body = np.repeat(model.inertia[:, None], R.shape[1], axis=1)
    sequences = table(scheme.processor), table(scheme.sequence), table(scheme.postprocessor)
    energies = _run(R, P, q, m, (*model,), body, sequences, h, every, samples)
    return energies / R.shape[1], BodyState(R, P, q[0], m[0])


@cache
def start(n: int, name: str, seed: int, temperature: float = 300.0, picoseconds: int = 60) -> BodyState:
    """Return a canonical start: momenta are drawn anew every picosecond, at steps of 2 fs."""
    model, _, integrator, _ = prepared(n, name)
    bodies, state = integrator.bodyState()
    rng = np.random.default_rng([seed, n])
    for _ in range(picoseconds):
        state = bodies.canonical_momenta(state, R * temperature, rng, at_rest=True)
        _, state = run(model, state, rb.SCHEMES["V2"], 0.002, 1.0, 0.5)
    return bodies.canonical_momenta(state, R * temperature, rng, at_rest=True)
