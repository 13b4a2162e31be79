"""The step-size error of averages, as coefficients of a splitting with a heat exchange.

Next to its heat exchange, a symmetric splitting with steps of size h conserves

    H + h² (alpha v·V''v + beta f·M⁻¹f) + O(h⁴),

and its step ends with drifts over y h in total, possibly with kicks between them, after the exchange. A barostat acts
at another y if a step ends between two drifts after the exchange. `openmm_exactrb.averages` computes the second-order
error of any average from these numbers.

For harmonic motions, the fourth-order error of the potential energy is known too. The coefficient here is that of the
error that remains after the second-order correction in the limit of strong friction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.polynomial import Polynomial

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.stability import oscillated
from openmm_exactrb.steps.sequence import (
    Sequence,
    behind_exchange,
    merged,
    palindromic,
    second_moments,
    up_to_kick,
)
from openmm_exactrb.steps.substeps import Drift, GradientKick, HeatExchange, Kick


class StepErrors(NamedTuple):
    """Coefficients of the step-size error of a splitting, in units of powers of the step."""

    alpha: float  #: coefficient of v·V''v in the conserved energy
    beta: float  #: coefficient of f·M⁻¹f in the conserved energy
    late: float  #: y, the total drift from the heat exchange to the end of a step, in steps
    pushed: float  #: the displacement by kicks between the heat exchange and the end of a step, in h² M⁻¹f
    inner: float  #: y of bodies with inner steps: 0 where `thermostatted.canonical_momenta` defers their drifts
    barostat: float  #: y of a barostat: the total drift from the heat exchange to a move of the barostat
    quartic: float  #: coefficient of h⁴ omega⁴ kT/2 in the corrected potential energy of an oscillator

    @property
    def slope(self) -> float:
        """The factor alpha + y²/2 - c of the slope of an observable along M⁻¹f, which a correction subtracts."""
        return self._slope(self.late)

    @property
    def inner_slope(self) -> float:
        """The factor of the slope for bodies with inner steps."""
        return self._slope(self.inner)

    @property
    def barostat_slope(self) -> float:
        """The factor of the slope where a barostat acts."""
        return self._slope(self.barostat)

    def _slope(self, y: float) -> float:
        return self.alpha + 0.5 * y**2 - self.pushed


def step_errors(scheme: Scheme) -> StepErrors:
    """Return the coefficients of a scheme that contains the heat exchange of its integrator.

    Let b_j be the fractions of the kicks, and c_j their times since the heat exchange in units of the step. Then alpha
    = 1/12 - B/2 and beta = 1/12 - D/2 with B and D of `sequence.second_moments`, and a force-gradient kick of strength
    s adds -s b³/2 to beta. A ValueError is raised unless a step has a single heat exchange, its drifts and kicks are
    palindromic around this exchange, and each kick is by all forces.
    """
    behind, before = _around_exchange(scheme)
    cycle = behind + before
    kicks, gradients, time = [], 0.0, 0.0
    for substep, part in cycle:
        if isinstance(substep, Drift):
            time += part
            continue
        kicks.append((part, time))
        if isinstance(substep, GradientKick):
            gradients -= 0.5 * substep.strength * part**3
    late = math.fsum(part for substep, part in behind if isinstance(substep, Drift))
    single, double = second_moments(kicks)
    pushed = math.fsum(b * (late - c) for b, c in kicks[: sum(not isinstance(s, Drift) for s, _ in behind)])
    inner = 0.0 if behind_exchange(scheme.sequence) else late
    barostat = late + math.fsum(part for _, part in up_to_kick(scheme.sequence))
    alpha, beta = 1.0 / 12.0 - 0.5 * single, 1.0 / 12.0 - 0.5 * double + gradients
    # The second-order correction of an oscillator is an average over frames, in which <q²> has this error.
    error = 2.0 * (alpha - beta) + late**2 - 2.0 * pushed
    change = error * (late**2 - 2.0 * (alpha + 2.0 * beta + pushed))
    return StepErrors(alpha, beta, late, pushed, inner, barostat, _quartic(cycle, behind) - change)


def _quartic(cycle: Sequence, behind: Sequence) -> float:
    """Return the coefficient of x⁴ in omega² <q²>/kT of an oscillator at the ends of steps, with x = h omega.

    Next to the exchange, the matrix ((c, b), (-a, c)) of the cycle conserves a q² + b p², and <p²> is exact. With q in
    units of 1/omega, <q²> is therefore b/a there.
    """
    x = Polynomial([0.0, 1.0])
    (_, b), (a, _) = oscillated(cycle, x)
    (moved, pushed), _ = oscillated(behind, x)
    (_, b1, b2), (_, a1, a2) = ((*series.coef[1::2], 0.0, 0.0)[:3] for series in (b, -a))
    beside = Polynomial([1.0, 0.0, b1 - a1, 0.0, b2 - a2 - a1 * (b1 - a1)])
    return float((beside * moved**2 + pushed**2).deriv(4)(0.0)) / 24.0


def _around_exchange(scheme: Scheme) -> tuple[Sequence, Sequence]:
    """Return the drifts and kicks from the heat exchange to the end of a step, and those before the exchange."""
    rows = scheme.sequence
    if isinstance(rows[0][0], HeatExchange) and isinstance(rows[-1][0], HeatExchange) and len(rows) > 1:
        rows = rows[1:]  # the halves of one exchange
    places = [k for k, (substep, _) in enumerate(rows) if isinstance(substep, HeatExchange)]
    known = all(s in (Drift(), Kick()) or type(s) in (GradientKick, HeatExchange) for s, _ in rows)
    if len(places) == 1 and known and not scheme.processor:
        behind, before = rows[places[0] + 1 :], rows[: places[0]]
        if palindromic(merged(behind + before)):
            return behind, before
    raise ValueError(
        f"averages of scheme {scheme.name} cannot be corrected, because the theory needs a single heat exchange "
        "between drifts and kicks that mirror each other: use a scheme such as W2_3m or BAOA"
    )
