"""A Langevin thermostat as per-DOF statements: friction and noise that are the same for all copies of a body.

OpenMM's own random numbers differ from particle to particle. So every component of every copy has a generator, which
began where that of the other copies of the body did: then nothing has to be sent from one particle to the others. It
is the sum of four generators by B. A. Wichmann and I. D. Hill, Comput. Stat. Data Anal. 51, 1614 (2006),
doi:10.1016/j.csda.2006.05.019, of period 2^121; its products are below 2^47, so float64 has them exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.custom_program import names
from openmm_exactrb.engines.custom_program.program import AXES, INVERSE_INERTIA, Program
from openmm_exactrb.engines.custom_program.rows import Table

#: Multipliers and moduli: r <- multiplier r mod modulus, and the sum of r/modulus without its whole part is uniform.
GENERATORS = ((11600, 2147483579), (47003, 2147483543), (23000, 2147483423), (33000, 2147483123))


def streams(n_bodies: int, seed: int, drawn: int = 0) -> NDArray[np.float64]:
    """Return the states of the generators of all bodies when each has drawn so many numbers, (4, n_bodies, 3)."""
    rng = np.random.default_rng(seed)
    begin = [rng.integers(1, modulus, (n_bodies, 3)) for _, modulus in GENERATORS]
    factors = [pow(multiplier, drawn, modulus) for multiplier, modulus in GENERATORS]
    states = [r * k % modulus for r, k, (_, modulus) in zip(begin, factors, GENERATORS, strict=True)]
    return np.array(states, dtype=np.float64)


def draws(table: Table, sites: bool) -> int:
    """Return how many numbers each generator draws in a step."""
    return 2 * table.heat_exchanges(sites)


def exchange(program: Program, part: str) -> None:
    """Write the exact Ornstein-Uhlenbeck flow of the momenta over the time in a column of the rows.

    As `openmm_exactrb.thermostats.langevin.ornstein_uhlenbeck`, but for the random numbers, which are drawn once in
    every row, however many turns it has. The variables a, g, n, p and y change.
    """
    program.times("n", ((part, "begins"),) * 3)
    program.let("p", program.begins)
    program.let("a", _uniform(program))
    program.let("y", _uniform(program))
    program.let("g", "sqrt(-2*log(1-a))")
    program.let("y", f"{2.0 * np.pi!r}*y")
    program.let("a", "exp(-n*_x(thermostat))")
    program.let("P", "P*a+g*cos(y)*sqrt(_z(thermostat)*(1-a*a)/_y(inverse))")
    program.let("a", "exp(-n*_y(thermostat))")
    program.let("L", f"L*a+g*sin(y)*{AXES}*sqrt(_z(thermostat)*(1-a*a)/max({INVERSE_INERTIA},1e-300))")


def _uniform(program: Program) -> str:
    """Write the next state of the generators where p is 1, and return the expression of a number on [0, 1)."""
    for name, (multiplier, modulus) in zip(names.STREAMS, GENERATORS, strict=True):
        program.let(name, f"{name}+p*({multiplier}*{name}-{modulus}*floor({multiplier}*{name}/{modulus})-{name})")
    total = "+".join(f"{name}/{modulus}" for name, (_, modulus) in zip(names.STREAMS, GENERATORS, strict=True))
    return f"total-floor(total);total={total}"
