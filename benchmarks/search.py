"""Search for splittings of rigid water at large steps, judged on long runs.

A family is a word such as BACAB, whose letters are drifts (A), kicks (B) and force-gradient kicks (C). Its palindromes
leave some coefficients free. Three stages, each through `openmm_exactrb.ensemble`, so that a call goes on where the
last one stopped:

1. `linear`, in no time: a step makes of an oscillator of frequency w one with the Hamiltonian (alpha p² + beta q²) w/2.
   What alpha and beta differ by over the frequencies of water is the energy error of small vibrations: their ratio
   swings within a period, their product is slow, and wanders as oscillators exchange energy. The best points of a
   family are where the next stage begins.
2. `improve`: Nelder and Mead on the standard deviation of the energy of droplets of four water models in windows of
   10 ps, in units of Verlet's, over training starts.
3. `judge`: 30 ps from starts that nothing else has seen, of other sizes.

    python search.py --rates 500 1000 --families BACAB BABABAB --starts 2 --budget 120 --folder out/search
"""

from __future__ import annotations

import argparse
import itertools
import time
from functools import cache

import numpy as np
from scipy.optimize import minimize

import droplets
import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes import scheme as look_up

MODELS = ("tip3p", "spce", "tip4pew", "tip5p")
TRAINING, TEST = {"n": 24, "seeds": (11,)}, {"n": 48, "seeds": (101, 102, 103, 104, 105, 106)}
FAMILIES = (
    # without force gradients, 3 to 8 forces a step
    *("BABABAB", "BABABABAB", "ABABABABA", "BABABABABAB", "ABABABABABA", "BABABABABABAB", "ABABABABABABA"),
    *("BABABABABABABAB", "ABABABABABABABA", "BABABABABABABABAB"),
    # with them
    *("BACAB", "ACABACA", "ABACABA", "BACACAB", "BABACABAB", "BACABACAB", "ACABABACA", "ABACACABA", "ABABACABABA"),
    *("BABACACABAB", "BABABACABABAB"),
)
LOST = 50.0  # the objective of what is unstable


# -- a family: which numbers make a scheme -------------------------------------------------------------------------


def slots(family, kinds):
    """Return the places of the left half of a palindrome, its middle included, that have one of these letters."""
    half = family[: (len(family) + 1) // 2]
    return [i for i, letter in enumerate(half) if letter in kinds]


def dimension(family):
    """Return how many numbers a family leaves free."""
    return len(slots(family, "A")) - 1 + len(slots(family, "BC")) - 1 + len(slots(family, "C"))


def member(family, free, name="candidate", order=2):
    """Return the scheme of free coefficients: of drifts, of kicks, and displacements e of the gradients over h².

    The coefficient that closes the sum of drifts, and that of kicks, is the one nearest to the middle.
    """
    free, parts = list(free), dict.fromkeys(range(len(family)), 0.0)
    middle = len(family) // 2
    for kinds in ("A", "BC"):
        places = slots(family, kinds)
        weights = {i: 1.0 if i == middle else 2.0 for i in places}
        for i in places[:-1]:
            parts[i] = free.pop(0)
        last = places[-1]
        parts[last] = (1.0 - sum(weights[i] * parts[i] for i in places[:-1])) / weights[last]
    word, strengths = [], {}
    for i, letter in enumerate(family):
        i = min(i, len(family) - 1 - i)
        if letter == "C":
            letter = f"C{i}"
        word.append((letter, parts[i]))
    for i in slots(family, "C"):
        strengths[f"C{i}"] = free.pop(0) / parts[i] ** 2
    return Scheme(name, order, tuple(word), gradients=tuple(strengths.items()))


def free_of(family, scheme):
    """Return the free coefficients of a scheme of a family."""
    strengths, parts = dict(scheme.gradients), [part for _, part in scheme.word]
    letters = [letter for letter, _ in scheme.word]
    kicks = [parts[i] for kinds in ("A", "BC") for i in slots(family, kinds)[:-1]]
    return [*kicks, *(strengths.get(letters[i], 0.0) * parts[i] ** 2 for i in slots(family, "C"))]


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
    qq, qp, pq, pp = (np.full_like(x, c) for c in (1.0, 0.0, 0.0, 1.0))
    strengths = dict(scheme.gradients)
    for letter, part in scheme.word:
        tau = part * x
        if letter == "A":
            qq, qp = qq + tau * pq, qp + tau * pp
        else:
            tau = tau * (1.0 - strengths.get(letter, 0.0) * tau * tau)
            pq, pp = pq - tau * qq, pp - tau * qp
    with np.errstate(invalid="ignore", divide="ignore"):
        angle, ratio = np.arccos(0.5 * (qq + pp)), np.sqrt(-qp / pq)
    return ratio * angle / x, angle / (ratio * x)


def linear(scheme, rate, weights=None):
    """Return the energy error that vibrations of water leave, in kJ/mol a molecule and root of their number.

    Six degrees of freedom share what is conserved: an alpha and a beta that are the same for all are no error.
    """
    w, density = spectrum() if weights is None else weights
    alpha, beta = oscillator(scheme, w * scheme.forces / rate)
    if not np.isfinite(alpha[density > 1e-7]).all():
        return np.inf
    known = density > 1e-7
    g, coefficients = density[known] / density[known].sum(), np.stack([alpha[known], beta[known]])
    mean = (g * coefficients).sum() / 2.0
    return droplets.GAS_CONSTANT * 300.0 * np.sqrt(3.0 * (g * (coefficients - mean) ** 2).sum())


def linear_optima(family, rate, tries=40, seed=0):
    """Return the best points of a family for oscillators, best first, of which no two are close.

    From a row of Verlet steps, disturbed, at four times as many forces a ps, down to the rate that is asked for.
    """
    rng, found = np.random.default_rng([seed, *family.encode()]), []
    even, gradients, weights = np.array(free_of(family, _even(family))), len(slots(family, "C")), spectrum()

    def objective(free, rate):
        scheme = member(family, free)
        error, size = linear(scheme, rate, weights), sum(abs(part) for _, part in scheme.word)
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
    """Return the member that is a row of equal Verlet steps, as nearly as its letters allow."""
    sums = {kinds: sum(family.count(letter) for letter in kinds) - (family[0] in kinds) for kinds in ("A", "BC")}
    parts = [1.0 / sums["A" if letter == "A" else "BC"] for letter in family]
    parts[0] = parts[-1] = 0.5 * parts[0]
    names = [f"C{min(i, len(family) - 1 - i)}" if letter == "C" else letter for i, letter in enumerate(family)]
    gradients = [(f"C{i}", 0.2 / sums["A"] ** 2 / parts[i] ** 2) for i in slots(family, "C")]
    return Scheme("even", 2, tuple(zip(names, parts, strict=True)), gradients=tuple(gradients))


# -- stage 2: droplets ---------------------------------------------------------------------------------------------


def spread(energies, interval, window):
    """Return the root of the mean variance within windows of a length in ps; infinite where a run has blown up."""
    if not np.isfinite(energies).all():
        return np.inf
    pieces = max(1, round(len(energies) * interval / window))
    return float(np.sqrt(np.mean([part.var() for part in np.array_split(energies, pieces)])))


def error(scheme, rate, n, model, seed, window, duration):
    """Return the standard deviation of the energy of a droplet in kJ/mol a molecule."""
    kind, *_ = droplets.prepared(n, model)
    h = scheme.forces / rate
    energies, _ = droplets.run(kind, droplets.start(n, model, seed), scheme, h, duration)
    return spread(energies, max(1, round(0.02 / h)) * h, window)


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


class _Spent(Exception):
    """The time for a search is over."""


def improve(family, rate, first, budget, n, seeds, models, window=10.0, duration=10.0):
    """Improve a member of a family by Nelder and Mead on droplets; a recipe.

    Returns
    -------
    dict
        "free", the coefficients; "objective", the mean logarithm of the error over Verlet's; "trace" of both.
    """
    trace, begun, starts = [], time.perf_counter(), list(itertools.product(models, seeds))

    def objective(free):
        scheme, total = member(family, free), 0.0
        if sum(abs(part) for _, part in scheme.word) > 6.0 or not np.isfinite(linear(scheme, rate)):
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
            raise _Spent
        return value

    simplex = np.array([first] + [np.array(first) + 0.015 * row for row in np.eye(len(first))])
    try:
        minimize(objective, first, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-5})
    except _Spent:
        pass
    value, free = min(trace, default=(LOST, list(first)))
    return {"free": free, "objective": value, "trace": trace}


# -- stage 3: starts that nothing has seen -------------------------------------------------------------------------


def judge(family, free, rate, model, seed, n, duration=30.0):
    """Return the errors in windows of 2, 10 and 30 ps of a member, or of a named scheme (free is None); a recipe."""
    scheme = look_up(family) if free is None else member(family, free)
    kind, *_ = droplets.prepared(n, model)
    h = scheme.forces / rate
    interval = max(1, round(0.02 / h)) * h
    energies, _ = droplets.run(kind, droplets.start(n, model, seed), scheme, h, duration)
    return {str(window): spread(energies, interval, window) for window in (2.0, 10.0, duration)}


def judged(candidates, rate, folder, models=MODELS, n=TEST["n"], seeds=TEST["seeds"], workers=1, duration=30.0):
    """Print how far below Verlet candidates, pairs of a family and its free coefficients, are on the test starts."""
    axes = {"seed": seeds, "model": models}
    wanted = [("V2", None), *candidates]
    recipes = {
        (family, str(free)): rb.ensemble.sweep(
            judge, axes, family=family, free=free, rate=rate, n=n, duration=duration
        )
        for family, free in wanted
    }
    outcomes = rb.ensemble.run(list(itertools.chain(*recipes.values())), folder, workers=workers, progress=False)
    results = {outcome.recipe.key: outcome.result for outcome in outcomes}

    def over_models(key, window):
        rows = [[results[r.key][window] for r in recipes[key] if r.arguments["model"] == model] for model in models]
        return np.sqrt(np.mean(np.square(rows), axis=1))

    for family, free in wanted:
        key = family, str(free)
        windows = {window: over_models(key, window) for window in ("2.0", "10.0", str(duration))}
        below = over_models(("V2", "None"), str(duration)) / windows[str(duration)]
        rows = " ".join(f"{w}: " + " ".join(f"{e:.2e}" for e in errors) for w, errors in windows.items())
        print(f"{rate} {family} {free}\n   below Verlet {np.round(below, 2)}; error in windows of {rows}", flush=True)


def searched(families, rates, starts, budget, folder, workers):
    """Carry out stages 1 and 2 and return their outcomes, best first."""
    recipes = []
    for rate, family in itertools.product(rates, families):
        for first in linear_optima(family, rate)[:starts]:
            recipes.append(
                rb.ensemble.Recipe(
                    improve, family=family, rate=rate, first=first, budget=budget, models=list(MODELS), **TRAINING
                )
            )
    done = []
    for outcome in rb.ensemble.as_completed(recipes, folder, workers=workers):
        print(outcome.error or (outcome.recipe.arguments["family"], outcome.recipe.arguments["rate"]), flush=True)
        if outcome.error is None:
            print(f"   {outcome.result['objective']:.3f} {outcome.result['free']}", flush=True)
            done.append(outcome)
    return sorted(done, key=lambda outcome: outcome.result["objective"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", nargs="+", type=int, default=[250, 500, 1000, 2000], help="forces a ps")
    parser.add_argument("--families", nargs="+", default=list(FAMILIES))
    parser.add_argument("--starts", type=int, default=2, help="points of the first stage that the second one improves")
    parser.add_argument("--budget", type=float, default=120.0, help="seconds for each of them")
    parser.add_argument("--best", type=int, default=4, help="how many of a rate are judged")
    parser.add_argument("--folder", default="out/search", help="where results are kept")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    done = searched(args.families, args.rates, args.starts, args.budget, args.folder, args.workers)
    for rate in args.rates:
        best = [o for o in done if o.recipe.arguments["rate"] == rate][: args.best]
        judged(
            [(o.recipe.arguments["family"], o.result["free"]) for o in best], rate, args.folder, workers=args.workers
        )


if __name__ == "__main__":
    main()
