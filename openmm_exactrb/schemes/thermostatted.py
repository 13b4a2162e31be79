"""Schemes that contain a thermostat, and functions that add a thermostat to other schemes."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.sequence import Sequence, palindromic, repeated, second_moments, spelled
from openmm_exactrb.steps.substeps import DRIFT, HEAT_EXCHANGE, KICK, Drift, HeatExchange, Substep
from openmm_exactrb.support.descriptions import changed

_PARTICLES = "B. Leimkuhler and C. Matthews, J. Chem. Phys. 138, 174102 (2013), doi:10.1063/1.4802990, for particles"
_MIDDLE = "Z. Zhang et al., J. Phys. Chem. A 123, 6056 (2019), doi:10.1021/acs.jpca.9b02771, for particles"
_CANONICAL = "openmm-exactrb, for equipartition and the density of rigid water at 4 to 6 fs per force evaluation"


def reading_point(kicks: Iterable[tuple[float, float]]) -> float:
    """Return the time after the thermostat at which positions are read, as a fraction of the step.

    A step from one heat exchange to the next maps (q, p) of an oscillator of frequency w to (.. + (1 - B h² w²) h p, ..
    - (1 - D h² w²) h w² q) up to h³, with B and D of `sequence.second_moments`. Next to the thermostat, w² <q²> / <p²>
    is therefore 1 - (B - D) h² w². A drift over y h, which leaves momenta unchanged, adds y² h² w², so that with y² = B
    - D positions are canonical up to h⁴, as momenta are.
    """
    single, double = second_moments(sorted(kicks, key=operator.itemgetter(1)))
    return math.sqrt(single - double)


def _three_kicks(outer: float) -> Sequence:
    """Return a sequence of three kicks, with a thermostat between two drifts; a step ends where positions are read.

    `outer` is the drift on each side of the thermostat. The weight of the middle kick is such that the step touches the
    stability bound at half a period of an oscillator, and does not cross it.
    """
    inner, middle = 0.5 - outer, (1.0 - 4.0 * outer) / (2.0 - 6.0 * outer)
    kick = 0.5 * (1.0 - middle)
    read = reading_point([(kick, outer), (middle, 0.5), (kick, 1.0 - outer)])
    kicks = (KICK, kick), (DRIFT, inner), (KICK, middle), (DRIFT, inner), (KICK, kick)
    return (DRIFT, outer - read), *kicks, (DRIFT, outer), (HEAT_EXCHANGE, 1.0), (DRIFT, read)


#: Splittings with a thermostat within them, by name. Those of Leimkuhler and Matthews need one force evaluation per
#: step, as does BAOA, the splitting of OpenMM's LangevinMiddleIntegrator. With an outer drift of 0.135, momenta of
#: W2_3m next to the thermostat are canonical within 0.5 % up to 160/ps at 6 fs per force evaluation. Positions at the
#: end of a step, at `reading_point` after the thermostat, are canonical to fourth order:
#: tests/schemes/test_thermostatted.py.
WITH_THERMOSTAT: Mapping[str, Scheme] = MappingProxyType(
    {
        scheme.name: scheme
        for scheme in (
            Scheme("BAOAB", 2, spelled("B A O A B"), reference=_PARTICLES),
            Scheme("ABOBA", 2, spelled("A B O B A"), reference=_PARTICLES),
            Scheme("BAOA", 2, spelled("B A O A"), reference=_MIDDLE),
            Scheme("W2_3m", 2, _three_kicks(0.135), reference=_CANONICAL),
        )
    }
)


def with_thermostat(scheme: Scheme) -> Scheme:
    """Return a scheme with half a heat exchange at each end of a step, unless the step already contains one."""
    return _numbered(scheme, scheme.sequence if scheme.has(HEAT_EXCHANGE) else _between_halves(scheme.sequence))


def canonical_momenta(sequence: Sequence) -> Sequence:
    """Return a sequence at whose end the momenta of bodies with inner steps are those after the heat exchange.

    A drift between the last heat exchange and the end of a step preserves momenta, except for bodies with inner steps.
    During the time t of the drift, fast forces act on these bodies without the slow forces that balance them, which
    adds -t² <f_fast M^-1 f_slow> to twice the mean kinetic energy. These bodies therefore perform the drift at the
    start of the next step.
    """
    if len(sequence) < 2 or not isinstance(sequence[-2][0], HeatExchange) or sequence[-1][0] != DRIFT:
        return sequence
    *rows, (_, late) = sequence
    first, part = rows[0]
    if first == DRIFT:
        return (Drift("inner"), part + late), (Drift("others"), part), *rows[1:], (Drift("others"), late)
    return (Drift("inner"), late), *rows, (Drift("others"), late)


def with_proposals(scheme: Scheme, proposal: Substep) -> Scheme:
    """Return a scheme whose step is a proposal between two halves of a heat exchange."""
    return _numbered(scheme, _between_halves(((proposal, 1.0),)))


def _between_halves(sequence: Sequence) -> Sequence:
    return (HEAT_EXCHANGE, 0.5), *sequence, (HEAT_EXCHANGE, 0.5)


def _numbered(scheme: Scheme, sequence: Sequence) -> Scheme:
    """Return a scheme with this sequence and with numbered heat exchanges, so that each receives different noise."""
    numbers = itertools.count()
    rows = ((changed(s, number=next(numbers)) if isinstance(s, HeatExchange) else s, part) for s, part in sequence)
    return replace(scheme, sequence=tuple(rows))


def proposal(scheme: Scheme, steps: int) -> Scheme:
    """Return a scheme whose step consists of a number of steps of another scheme.

    The Metropolis test requires a scheme that is symmetric in time and contains no thermostat; otherwise a ValueError
    is raised.
    """
    if scheme.has(HEAT_EXCHANGE):
        raise ValueError(
            f"scheme {scheme.name} contains a thermostat, but proposals must not contain one: choose a scheme such "
            "as S2_2"
        )
    require_symmetric(scheme)
    rows = repeated(scheme.sequence, steps)
    return replace(scheme, sequence=tuple((substep, part / steps) for substep, part in rows))


def require_symmetric(scheme: Scheme | None, role: str = "scheme") -> None:
    """Raise ValueError if the scheme of proposals, or of their inner steps, is not symmetric in time."""
    if scheme is not None and not palindromic(scheme.sequence):
        raise ValueError(
            f"the {role} {scheme.name} is not symmetric in time, but proposals must be symmetric: choose a scheme such "
            "as S2_2"
        )
