"""Search for splittings of rigid water at large steps, tested in long runs.

A family is a symmetric sequence such as BACAB of drifts (A), kicks (B) and force-gradient kicks (C), in which some
coefficients are free. The search has three stages. Each consists of jobs of `openmm_exactrb.ensemble`, so
that an interrupted command can be resumed:

1. `linear` needs no simulation. A step transforms an oscillator of frequency w into one with the Hamiltonian (alpha p²
   + beta q²) w/2. The variation of alpha and beta over the frequencies of water gives the energy error of small
   vibrations. Their ratio causes oscillations within a period, and their product causes slow fluctuations as
   oscillators exchange energy. The next stage begins at the best points of a family.
2. `screened` and `improve` minimise the standard deviation of the energy of droplets of four water models in windows of
   10 ps, relative to that of Verlet, over training starts. They evaluate the points of the first stage and run
   Nelder-Mead minimisations from the best of them.
3. `judge` runs 30 ps from starts that no other stage uses, with droplets of other sizes. Errors of the schemes of the
   catalogue are written to records/droplet_models.csv.

    python benchmarks/schemes/search.py --rates 500 1000 --families BACAB BABABAB --best 2 --budget 120
    python benchmarks/schemes/search.py --judge W2_4 W2_5 --rates 500 --models tip3p --molecules 64 --starts 3
    python benchmarks/schemes/search.py --judge W2_1 S2_3 --rates 250 --molecules 64 --picoseconds 60
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import math
import time
from functools import cache

import numpy as np
from scipy.optimize import minimize

import openmm_exactrb as rb
from benchmarks.common import droplets
from benchmarks.common.energies import variance
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import R
from openmm_exactrb.schemes import force_gradient
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.schemes.stability import oscillated

MODELS = ("tip3p", "spce", "tip4pew", "tip5p")
TRAINING, TEST = {"n": 24, "seeds": (11,)}, {"n": 32, "seeds": (101, 102, 103, 104, 105, 106)}
FAMILIES = (
    # without force gradients, 3 to 8 forces per step
    *("BABABAB", "BABABABAB", "ABABABABA", "BABABABABAB", "ABABABABABA", "BABABABABABAB", "ABABABABABABA"),
    *("BABABABABABABAB", "ABABABABABABABA", "BABABABABABABABAB"),
    # with them
    *("BACAB", "ACABACA", "ABACABA", "BACACAB", "BABACABAB", "BACABACAB", "ACABABACA", "ABACACABA", "ABABACABABA"),
    *("BABACACABAB", "BABABACABABAB"),
)
LOST = 50.0  # the objective of what is unstable
RECORD = Record(
    RECORDS / "droplet_models.csv",
    ("model", "molecules", "forces_per_ps", "scheme", "ps", "starts"),
    ("std_2_ps", "std_10_ps", "std_all", "of_oscillators"),
)


# -- a family: which numbers make a scheme -------------------------------------------------------------------------


def slots(family, kinds):
    """Return how many places of the left half of a palindrome, its middle included, have one of these letters."""
    return sum(letter in kinds for letter in family[: (len(family) + 1) // 2])


def dimension(family):
    """Return how many numbers a family leaves free: of drifts, of kicks, and displacements of force gradients."""
    return slots(family, "A") - 1 + slots(family, "BC") - 1 + slots(family, "C")


def member(family, free):
    """Return the scheme of the free coefficients of a family: those of drifts, those of kicks, displacements."""
    drifts = slots(family, "A") - 1
    kicks = drifts + slots(family, "BC") - 1
    a, b, e = free[:drifts], free[drifts:kicks], free[kicks:]
    return force_gradient(family, family, order=2, a=a, b=b, e=e)


# -- stage 1: oscillators ------------------------------------------------------------------------------------------


@cache
def spectrum(name="tip3p", n=24, picoseconds=8.0, interval=0.002):
    """Return frequencies in 1/ps, and the part of the kinetic energy that a water model has there, as one density."""
    model, *_ = droplets.prepared(n, name)
    state = droplets.start(n, name, 1)
    rows = []
    for _ in range(round(picoseconds / interval)):
        _, state = droplets.run(model, state, rb.SCHEMES["V2"], interval, 2 * interval, interval)
        rows.append(np.concatenate([state.P / np.sqrt(model.mass), state.m / np.sqrt(model.inertia[:, None])]).ravel())
    table = np.array(rows) * np.hanning(len(rows))[:, None]
    power = (np.abs(np.fft.rfft(table, axis=0)) ** 2).mean(axis=1)
    frequencies = 2.0 * np.pi * np.fft.rfftfreq(len(rows), 2 * interval)
    bins = np.arange(0.0, 260.0, 4.0)
    density = np.histogram(frequencies, np.append(bins, bins[-1] + 4.0), weights=power)[0]
    return bins + 2.0, density / density.sum()


def oscillator(scheme, x):
    """Return alpha and beta of the Hamiltonian that a step x = w h conserves; nan where it is unstable."""
    (qq, qp), (pq, pp) = oscillated(scheme.sequence, x)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle, ratio = np.arccos(0.5 * (qq + pp)), np.sqrt(-qp / pq)
    return ratio * angle / x, angle / (ratio * x)


def linear(scheme, rate, weights=None):
    """Return the energy error that vibrations of water leave, in kJ/mol per molecule and root of their number.

    Six degrees of freedom share what is conserved: an alpha and a beta that are the same for all are no error.
    """
    w, density = spectrum() if weights is None else weights
    alpha, beta = oscillator(scheme, w * scheme.forces / rate)
    if not np.isfinite(alpha[density > 1e-7]).all():
        return np.inf
    known = density > 1e-7
    g, coefficients = density[known] / density[known].sum(), np.stack([alpha[known], beta[known]])
    mean = (g * coefficients).sum() / 2.0
    return R * 300.0 * np.sqrt(3.0 * (g * (coefficients - mean) ** 2).sum())


def linear_optima(family, rate, tries=40, seed=0):
    """Return the best points of a family for oscillators, best first, of which no two are close.

    From a row of Verlet steps, disturbed, at four times as many forces per ps, down to the rate that is asked for.
    """
    rng, found = np.random.default_rng([seed, *family.encode()]), []
    even, gradients, weights = np.array(_even(family)), slots(family, "C"), spectrum()

    def objective(free, rate):
        scheme = member(family, free)
        error, size = linear(scheme, rate, weights), sum(abs(part) for _, part in scheme.sequence)
        # Large coefficients of either sign cost far more with forces that are not linear.
        return np.log(error) + 0.5 * max(size - 3.0, 0.0) ** 2 if np.isfinite(error) else LOST

    for _ in range(tries):
        free = even + rng.choice([0.03, 0.1]) * rng.standard_normal(len(even))
        if gradients:
            free[-gradients:] = rng.uniform(0.0, 0.3, gradients) / family.count("A") ** 2
        for factor in (4.0, 2.0, 1.4, 1.0):
            options = {"maxfev": 80 * len(even), "xatol": 1e-5}
            result = minimize(objective, free, (factor * rate,), method="Nelder-Mead", options=options)
            free = result.x
        if result.fun < LOST and not any(np.abs(free - x).max() < 0.02 for _, x in found):
            found.append((result.fun, free))
    return [x.tolist() for _, x in sorted(found, key=lambda pair: pair[0])]


def _even(family):
    """Return the coefficients of equal Verlet steps, as nearly as the letters of a family allow."""
    inner = {kinds: sum(letter in kinds for letter in family) - (family[0] in kinds) for kinds in ("A", "BC")}
    free = []
    for kinds in ("A", "BC"):
        parts = [1.0 / inner[kinds]] * slots(family, kinds)
        parts[0] *= 0.5 if family[0] in kinds else 1.0
        free += parts[:-1]
    return [*free, *[0.2 / inner["A"] ** 2] * slots(family, "C")]


# -- stage 2: droplets ---------------------------------------------------------------------------------------------


def error(scheme, rate, n, model, seed, window, duration):
    """Return the standard deviation of the energy of a droplet in kJ/mol per molecule."""
    kind, *_ = droplets.prepared(n, model)
    h = scheme.forces / rate
    energies, _ = droplets.run(kind, droplets.start(n, model, seed), scheme, h, duration)
    return math.sqrt(variance(energies, max(1, round(0.02 / h)) * h, window))


@cache
def verlet(rate, n, model, seed, window, duration):
    """Return what `error` is for Verlet."""
    return error(rb.SCHEMES["V2"], rate, n, model, seed, window, duration)


def gains(scheme, rate, n, seeds, models, window, duration):
    """Return for each model and start how many times the error lies below Verlet's."""
    return {
        f"{model} {seed}": verlet(rate, n, model, seed, window, duration)
        / error(scheme, rate, n, model, seed, window, duration)
        for model, seed in itertools.product(models, seeds)
    }


def screened(family, rate, n, seeds, models, factors=(1.0, 1.3, 1.7, 2.4), tries=12, window=10.0, duration=10.0):
    """Try the best points for oscillators, found for somewhat more forces per ps too, on droplets; a job.

    Forces that are not linear often do better with coefficients of a shorter step.

    Returns
    -------
    list
        For each point the mean logarithm of the error over Verlet's and the coefficients, best first.
    """
    found = []
    for factor in factors:
        for free in linear_optima(family, factor * rate, tries)[:2]:
            below = gains(member(family, free), rate, n, seeds, models, window, duration)
            with np.errstate(divide="ignore"):
                found.append([float(min(-np.log(list(below.values())).mean(), LOST)), free])
    return sorted(found)


class _TimeIsUpError(Exception):
    """The time for a search is over."""


def improve(family, rate, first, budget, n, seeds, models, window=10.0, duration=10.0):
    """Improve a member of a family by Nelder and Mead on droplets; a job.

    Returns
    -------
    dict
        "free", the coefficients; "objective", the mean logarithm of the error over Verlet's; "trace" of both.
    """
    trace, begun, starts = [], time.perf_counter(), list(itertools.product(models, seeds))

    def objective(free):
        scheme, total = member(family, free), 0.0
        if sum(abs(part) for _, part in scheme.sequence) > 6.0 or not np.isfinite(linear(scheme, rate)):
            return LOST
        for number, (model, seed) in enumerate(starts, 1):
            ratio = error(scheme, rate, n, model, seed, window, duration)
            total += np.log(ratio / verlet(rate, n, model, seed, window, duration))
            best = min((value for value, _ in trace), default=LOST)
            if not np.isfinite(total) or total / number > best + 2.0:  # no need of the other starts
                break
        value = float(total / number) if np.isfinite(total) else LOST
        trace.append((value, list(map(float, free))))
        if time.perf_counter() - begun > budget:
            raise _TimeIsUpError
        return value

    simplex = np.array([first] + [np.array(first) + 0.015 * row for row in np.eye(len(first))])
    with contextlib.suppress(_TimeIsUpError):
        minimize(objective, first, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-5})
    value, free = min(trace, default=(LOST, list(first)))
    return {"free": free, "objective": value, "trace": trace}


# -- stage 3: starts that nothing has seen -------------------------------------------------------------------------


def judge(family, free, rate, model, seed, n, duration=30.0):
    """Return the errors in windows of 2, 10 and 30 ps of a member, or of a named scheme (free is None); a job."""
    scheme = look_up(family) if free is None else member(family, free)
    kind, *_ = droplets.prepared(n, model)
    h = scheme.forces / rate
    interval = max(1, round(0.02 / h)) * h
    energies, _ = droplets.run(kind, droplets.start(n, model, seed), scheme, h, duration)
    return {str(window): math.sqrt(variance(energies, interval, window)) for window in (2.0, 10.0, duration)}


def judged(candidates, rate, folder, models=MODELS, n=TEST["n"], seeds=TEST["seeds"], workers=1, duration=30.0):
    """Print how far below Verlet candidates, pairs of a family and its free coefficients, are on the test starts."""
    axes = {"seed": seeds, "model": models}
    wanted = [("V2", None), *candidates]
    jobs = {
        (family, str(free)): rb.ensemble.sweep(judge, axes, family=family, free=free, rate=rate, n=n, duration=duration)
        for family, free in wanted
    }
    results = rb.ensemble.run(list(itertools.chain(*jobs.values())), folder, workers=workers, progress=False)
    results = {result.job.key: result.value for result in results}

    def over_models(key, window):
        rows = [[results[r.key][window] for r in jobs[key] if r.arguments["model"] == model] for model in models]
        return np.sqrt(np.mean(np.square(rows), axis=1))

    for family, free in wanted:
        key, scheme = (family, str(free)), look_up(family) if free is None else member(family, free)
        windows = {window: over_models(key, window) for window in ("2.0", "10.0", str(duration))}
        below = over_models(("V2", "None"), str(duration)) / windows[str(duration)]
        rows = " ".join(f"{w}: " + " ".join(f"{e:.2e}" for e in errors) for w, errors in windows.items())
        print(f"{rate} {family} {free}\n   below Verlet {np.round(below, 2)}; error in windows of {rows}")
        alone = np.nan if scheme.processor else linear(scheme, rate) / np.sqrt(n)  # which knows one set of coordinates
        print(f"   of oscillators alone {alone:.2e}", flush=True)
        for model, *errors in zip(models, *windows.values(), strict=True) if free is None else ():
            values = (model, n, rate, family, duration, len(seeds), *(f"{value:.4g}" for value in (*errors, alone)))
            RECORD.add(dict(zip(RECORD.columns, values, strict=True)))


def searched(families, rates, best, budget, folder, workers):
    """Carry out stages 1 and 2 and return pairs of a family and coefficients by rate, best first."""
    chosen = {"models": list(MODELS), **TRAINING}
    jobs = rb.ensemble.sweep(screened, {"rate": rates, "family": families}, **chosen)
    points = {rate: [] for rate in rates}
    for result in rb.ensemble.as_completed(jobs, folder, workers=workers, progress=False):
        family, rate = result.job.arguments["family"], result.job.arguments["rate"]
        print(rate, family, result.error or result.value[:3], flush=True)
        points[rate] += [(value, family, free) for value, free in result.value or [] if value < LOST]
    jobs = [
        rb.ensemble.Job(improve, family=family, rate=rate, first=free, budget=budget, **chosen)
        for rate in rates
        for _, family, free in sorted(points[rate])[:best]
    ]
    improved = {rate: [] for rate in rates}
    for result in rb.ensemble.as_completed(jobs, folder, workers=workers, progress=False) if budget else ():
        family, rate = result.job.arguments["family"], result.job.arguments["rate"]
        print(rate, family, result.error or (result.value["objective"], result.value["free"]), flush=True)
        if result.error is None:
            improved[rate].append((result.value["objective"], family, result.value["free"]))
    return {rate: [(f, free) for _, f, free in sorted(improved[rate] + points[rate])] for rate in rates}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", nargs="+", type=int, default=[250, 500, 1000, 2000], help="forces per ps")
    parser.add_argument("--families", nargs="+", default=list(FAMILIES))
    parser.add_argument("--best", type=int, default=4, help="how many of a rate are improved, and judged")
    parser.add_argument("--budget", type=float, default=120.0, help="seconds to improve each of them; 0 leaves it out")
    parser.add_argument("--folder", default="out/search", help="where results are kept")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--judge", nargs="+", metavar="NAME", help="judge schemes of the catalogue, without any search")
    parser.add_argument("--molecules", type=int, default=TEST["n"], help="of the droplets that judge")
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="water models that judge")
    parser.add_argument("--picoseconds", type=float, default=30.0, help="of the runs that judge")
    parser.add_argument("--starts", type=int, default=len(TEST["seeds"]), help="of each model, that judge")
    args = parser.parse_args()
    seeds = TEST["seeds"][: args.starts]
    if args.judge:
        for rate in args.rates:
            candidates = [(name, None) for name in args.judge if name != "V2"]
            judged(candidates, rate, args.folder, args.models, args.molecules, seeds, args.workers, args.picoseconds)
        return
    found = searched(args.families, args.rates, args.best, args.budget, args.folder, args.workers)
    for rate in args.rates:
        best = found[rate][: args.best]
        judged(best, rate, args.folder, args.models, args.molecules, seeds, args.workers, args.picoseconds)


if __name__ == "__main__":
    main()
