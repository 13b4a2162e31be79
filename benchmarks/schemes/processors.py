"""Processors: changes of coordinates that greatly reduce the energy error of a scheme with few force evaluations.

A kernel K and a processor P form the method P K P^-1. Since n steps are P K^n P^-1, P is applied only once per run or
output. The processor removes all of the kernel's error that a change of coordinates can remove. The remaining error
determines which kernel is better:

- A third of the error of Verlet remains. For an oscillator, the processor removes the oscillation x²/8 of the energy,
  with x = w h. The error x²/24 of the frequency remains, and affects the energy when oscillators exchange energy.
- No error of the order h² remains for the step of Takahashi and Imada, which has one force-gradient kick. The method is
  of order 4.

G. Rowlands, J. Comput. Phys. 97, 235 (1991), found that a processor makes the step of Takahashi and Imada a method of
order 4; see M. A. López-Marcos, J. M. Sanz-Serna and R. D. Skeel, SIAM J. Sci. Comput. 18, 223 (1997),
doi:10.1137/S1064827595288085. Here P is a sequence of drifts and kicks whose sums are zero. Its coefficients satisfy
the order conditions in the free Lie algebra of drifts and kicks, and minimise the energy oscillation of oscillators up
to x = `--reach`.

    python benchmarks/schemes/processors.py TI2 --kicks 5 --minutes 2
    python benchmarks/schemes/processors.py V2_drift --kicks 4 --minutes 1
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numba import njit
from scipy.optimize import least_squares

import openmm_exactrb as rb
from openmm_exactrb.schemes.scheme import processed
from openmm_exactrb.schemes.stability import oscillated
from openmm_exactrb.steps.substeps import DRIFT, GradientKick

DEGREES = 6  # series in two letters that do not commute, drifts and kicks, up to words of five of them
SIZE = 2**DEGREES - 1
TAIL = 4  # the swing of the fastest oscillators counts less: few of a liquid's are there


# -- the free algebra: coefficients of words of drifts and kicks, in a row by their length --------------------------


@njit(cache=True)
def product(x, y):
    """Return the product of two series."""
    result = np.zeros(SIZE)
    for degree in range(DEGREES):
        for left in range(degree + 1):
            n = 2 ** (degree - left)
            for i in range(2**left):
                factor = x[2**left - 1 + i]
                if factor != 0.0:
                    for j in range(n):
                        result[2**degree - 1 + i * n + j] += factor * y[n - 1 + j]
    return result


@njit(cache=True)
def exponential(x):
    """Return exp(x) of a series without a constant."""
    result, term = np.zeros(SIZE), np.zeros(SIZE)
    result[0] = term[0] = 1.0
    for k in range(1, DEGREES):
        term = product(term, x) / k
        result = result + term
    return result


@njit(cache=True)
def logarithm(x):
    """Return log(x) of a series whose constant is one."""
    small, result, term = x.copy(), np.zeros(SIZE), np.zeros(SIZE)
    small[0], term[0] = 0.0, 1.0
    for k in range(1, DEGREES):
        term = product(term, small)
        result = result - (-1.0) ** k / k * term
    return result


@njit(cache=True)
def inverse(x):
    """Return 1/x of a product of exponentials: the words backwards, with signs."""
    result = np.zeros(SIZE)
    for degree in range(DEGREES):
        for i in range(2**degree):
            backwards = 0
            for bit in range(degree):
                backwards |= ((i >> bit) & 1) << (degree - 1 - bit)
            result[2**degree - 1 + backwards] = (-1.0) ** degree * x[2**degree - 1 + i]
    return result


def commutator(x, y):
    """Return [x, y]."""
    return product(x, y) - product(y, x)


A, B = np.eye(SIZE)[1], np.eye(SIZE)[2]
AB = commutator(A, B)
AAB, BAB = commutator(A, AB), commutator(B, AB)
AAAB, BAAB, BBAB = commutator(A, AAB), commutator(B, AAB), commutator(B, BAB)
# By degree. [B, [B, [B, A]]] is zero, since the kinetic energy is quadratic in the momenta: the last ones do not count.
BASES = {
    1: ([A, B], 2),
    2: ([AB], 1),
    3: ([AAB, BAB], 2),
    4: ([AAAB, BAAB, BBAB], 2),
    5: ([*(commutator(x, y) for x, y in ((A, AAAB), (B, AAAB), (AB, AAB), (B, BAAB), (A, BBAB), (B, BBAB)))], 4),
}


def coordinates(series, degree):
    """Return the coordinates of the terms of a degree of a Lie series, of those that count."""
    base, count = BASES[degree]
    terms = slice(2**degree - 1, 2 ** (degree + 1) - 1)
    return np.linalg.lstsq(np.array([row[terms] for row in base]).T, series[terms], rcond=None)[0][:count]


def series_of(sequence):
    """Return the product of the exponentials of a sequence's substeps, for h = 1."""
    result = np.eye(SIZE)[0]
    for substep, part in sequence:
        strength = substep.strength if isinstance(substep, GradientKick) else 0.0
        flow = part * A if substep == DRIFT else part * B + 0.5 * strength * part**3 * BAB
        result = product(result, exponential(flow))
    return result


def modified(scheme):
    """Return the Lie series of h times the vector field that a scheme with its processor solves, for h = 1."""
    change = series_of(scheme.processor)
    return logarithm(product(product(change, series_of(scheme.sequence)), inverse(change)))


# -- oscillators ---------------------------------------------------------------------------------------------------


def matrices(sequence, x):
    """Return the matrices (len(x), 2, 2) of a sequence for oscillators with x = w h."""
    return np.moveaxis(np.array(oscillated(sequence, x)), 2, 0)


def swing(scheme, x):
    """Return by how much the kept energy is no circle: (2, len(x)); and the relative error of the frequency."""
    change = matrices(scheme.processor, x)
    whole = np.linalg.inv(change) @ matrices(scheme.sequence, x) @ change
    angle = np.arccos(np.clip(0.5 * (whole[:, 0, 0] + whole[:, 1, 1]), -1.0, 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        form = 0.5 * np.array([-whole[:, 1, 0] - whole[:, 0, 1], whole[:, 0, 0] - whole[:, 1, 1]]) / np.sin(angle)
    return form, angle / x - 1.0


# -- a processor ---------------------------------------------------------------------------------------------------


def member(kernel, free):
    """Return a kernel with the processor of free coefficients, those of drifts before those of kicks."""
    half = len(free) // 2
    return processed(kernel, kernel.name, order=kernel.order, a=free[:half], b=free[half:], reference="")


def conditions(scheme, order):
    """Return what is zero where a scheme has an order, and the leading terms of the error."""
    field = modified(scheme)
    return np.concatenate([coordinates(field, k) for k in range(2, order + 1)]), coordinates(field, order + 1)


def found(kernel, order, kicks, reach, seconds, seed):
    """Return pairs of an objective and free coefficients, best first, of descents from random points."""
    x = reach * np.linspace(0.1, 1.0, 10)
    weight = np.exp(-((x / (0.75 * reach)) ** TAIL))

    def objective(free):
        scheme = member(kernel, free)
        zero, leading = conditions(scheme, order)
        return np.concatenate([30.0 * zero, leading, (3.0 * weight * swing(scheme, x)[0]).ravel(), 3e-5 * free])

    rng, results, end = np.random.default_rng(seed), [], time.monotonic() + seconds
    while time.monotonic() < end:
        descent = least_squares(objective, rng.normal(0.0, 0.35, 2 * kicks - 2), max_nfev=300)
        results.append((float(descent.cost), polished(kernel, order, descent.x)))
    return sorted(results, key=lambda result: result[0])


def polished(kernel, order, free, steps=6, e=1e-6):
    """Return the nearest point at which the conditions of the order hold to roundoff, by Newton's method."""

    def zero(free):
        return conditions(member(kernel, free), order)[0]

    for _ in range(steps):
        slopes = np.array([(zero(free + shift) - zero(free - shift)) / (2.0 * e) for shift in e * np.eye(len(free))]).T
        free = free - np.linalg.pinv(slopes) @ zero(free)
    return free


def main() -> None:
    parser = argparse.ArgumentParser(description="Find processors of a kernel.")
    parser.add_argument("kernel", choices=rb.SCHEMES)
    parser.add_argument("--order", type=int, default=None, help="to reach; 4 for TI2, else the kernel's unless given")
    parser.add_argument("--kicks", type=int, default=5)
    parser.add_argument("--reach", type=float, default=0.9, help="largest w h whose swing counts")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    kernel = rb.SCHEMES[args.kernel]
    order = args.order or (4 if kernel.name == "TI2" else kernel.order)
    for value, free in found(kernel, order, args.kicks, args.reach, 60.0 * args.minutes, args.seed)[:3]:
        scheme = member(kernel, free)
        left = np.abs(conditions(scheme, order)[0]).max()
        print(f"{value:.4e}  largest {np.abs(free).max():.2f}  conditions {left:.1e}")
        print("   a", [float(c) for c in free[: args.kicks - 1]])
        print("   b", [float(c) for c in free[args.kicks - 1 :]])


if __name__ == "__main__":
    main()
