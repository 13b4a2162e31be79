"""Advice for exact sampling: which proposals of hybrid Monte Carlo move a system on at the least cost."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.baths import ExactRigidBodyHybridIntegrator
from openmm_exactrb.checks import positive, whole
from openmm_exactrb.context.units import stripped
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.tuning.movers import own_scheme, schemes_of
from openmm_exactrb.tuning.scales import scales_of
from openmm_exactrb.tuning.start import Start, start_of
from openmm_exactrb.tuning.thermal import thermalised

#: Schemes that are tried unless others are named.
PROPOSERS = ("V2", "S2_2", "W2_4")

# The time a force evaluation that is tried first, in units of the system's time scale; the ratio of two tries, and how
# many there are at most.
_COARSE, _RATIO, _TRIES = 0.4, 2.0**0.5, 10
_SETTLING = 0.2  # of the proposals, before those that are counted


@dataclass(frozen=True)
class Proposal:
    """A setting of hybrid Monte Carlo, and what was measured of it.

    Attributes
    ----------
    method : str
        The name of a scheme.
    step : float
        Time of a proposal in ps.
    acceptance : float
        The part of the proposals that was taken.
    seconds : float
        Wall time of a proposal.
    progress : float
        Time in ps that a proposal is worth; see `progress`.
    temperature, friction : float
        In K and 1/ps.
    bodies : list of lists of int, optional
        For the integrator.
    scheme : Scheme, optional
        That of the method, where it is not of the catalogue.
    groups : int
        Bits of the force groups that act.
    """

    method: str
    step: float
    acceptance: float
    seconds: float
    progress: float
    temperature: float
    friction: float
    bodies: list[list[int]] | None = None
    scheme: Scheme | None = None
    groups: int = -1

    @property
    def cost(self) -> float:
        """Wall time in s for a ps of progress; infinite where nothing is accepted."""
        return self.seconds / self.progress if self.progress > 0.0 else math.inf

    def integrator(self) -> ExactRigidBodyHybridIntegrator:
        """Return a new integrator with this setting."""
        integrator = ExactRigidBodyHybridIntegrator(
            self.temperature, self.friction, self.step, scheme=self.scheme or self.method, bodies=self.bodies
        )
        integrator.setIntegrationForceGroups(self.groups)
        return integrator

    def __str__(self) -> str:
        return (
            f"{self.method} with proposals of {1e3 * self.step:.4g} fs: {self.acceptance:.2f} are taken, "
            f"{self.cost:.3g} s for a ps of progress ({86.4 / self.cost:.3g} ns per day)"
        )


def progress(step: float, acceptance: float, friction: float) -> float:
    """Return the time that a proposal is worth: in which Langevin dynamics diffuses as far as the proposals do.

    A refusal costs twice: the state stays, and it turns back to where it came from. Along the direction of its motion
    a free body makes a walk, whose step is `step` where a proposal is taken; friction leaves a = exp(-friction step) of
    the momentum from one to the next, and a refusal changes its sign. With refusals that know nothing of each other
    the sum over all correlations of this walk is friction step² (p/2 + p² a/(1 - a (2p - 1))), p the acceptance.

    Parameters
    ----------
    step : float
        Time of a proposal in ps.
    acceptance : float
        From 0 to 1.
    friction : float
        In 1/ps, above zero.

    Returns
    -------
    float
        In ps; about ``step`` where all are taken and the friction is small.
    """
    a = math.exp(-friction * step)
    walk = 0.5 * acceptance + acceptance**2 * a / (1.0 - a * (2.0 * acceptance - 1.0))
    return friction * step**2 * walk


def tune_proposals(
    system: openmm.System | app.Simulation,
    start: Any = None,
    *,
    temperature: float | unit.Quantity,
    friction: float | unit.Quantity,
    schemes: str | Scheme | Sequence[str | Scheme] = PROPOSERS,
    proposals: int = 200,
    velocities: Any = None,
    platform: str | openmm.Platform | None = None,
    properties: Mapping[str, str] | None = None,
    bodies: Sequence[Sequence[int]] | None = None,
    seed: int = 1,
    report: Callable[[str], None] | None = None,
) -> list[Proposal]:
    """Measure what hybrid Monte Carlo takes of its proposals, and what a picosecond of progress costs.

    For each scheme proposals of one step are made, from about the largest stable time a force evaluation on and each
    time sqrt(2) shorter, until the cost rises twice running. The acceptance is counted: with 200 proposals it is known
    to 0.03. Progress is that of a free body (`tuning.proposals.progress`), which stands for slow, diffusive motion; of
    a variable of your own the autocorrelation of a run with the best settings tells more.

    Parameters
    ----------
    system, start, velocities, platform, properties, bodies
        As in `tune`. Without velocities the momenta are drawn and mixed with the positions in short runs.
    temperature : float or Quantity
        In K if it has no unit.
    friction : float or Quantity
        In 1/ps if it has no unit; above zero, since without friction nothing makes the walk end.
    schemes : sequence of str or Scheme, optional
        Symmetric ones without a processor.
    proposals : int, optional
        For each setting.
    seed : int, optional
        Of the noise and the momenta.
    report : callable, optional
        Gets a line for each setting.

    Returns
    -------
    list of Proposal
        All settings that were tried, the cheapest first.

    Raises
    ------
    ValueError
        As `tune` and `ExactRigidBodyHybridIntegrator`, and if a number is not above zero.

    Examples
    --------
    >>> import openmm_exactrb as rb
    >>> _, water, positions = rb.rigid_water(8)
    >>> best, *others = rb.tune_proposals(
    ...     water, positions, temperature=300.0, friction=5.0, schemes=["S2_2"], proposals=20, platform="Reference"
    ... )
    >>> best.method
    'S2_2'
    >>> integrator = best.integrator()
    """
    kelvin = positive(stripped(temperature, unit.kelvin), "temperature", "K")
    rate = positive(stripped(friction, unit.picosecond**-1), "friction", "/ps")
    number = whole(proposals, "proposals")
    chosen = schemes_of(schemes)
    begin, _ = start_of(system, start, velocities, platform, properties, bodies)
    if not begin.velocities.any():
        begin = thermalised(begin, kelvin, seed, minimise=True)
    tell = report or (lambda line: None)
    scale = scales_of(begin).time
    found = [
        tried
        for scheme in chosen
        for tried in _until_dearer(_measured(begin, scheme, kelvin, rate, number, seed, tell), scale)
    ]
    return sorted(found, key=lambda proposal: proposal.cost)


def _until_dearer(measure: Callable[[float], Proposal], scale: float) -> Iterator[Proposal]:
    """Yield settings from a large time a force evaluation to small ones, until the cost rises twice running."""
    last, rises = math.inf, 0
    for k in range(_TRIES):
        tried = measure(_COARSE * scale * _RATIO**-k)
        yield tried
        rises = rises + 1 if tried.cost > last else 0
        last = tried.cost
        if rises == 2:
            return


def _measured(
    start: Start,
    scheme: Scheme,
    temperature: float,
    friction: float,
    number: int,
    seed: int,
    tell: Callable[[str], None],
) -> Callable[[float], Proposal]:
    """Return what measures proposals of a scheme at a time a force evaluation."""

    def measure(interval: float) -> Proposal:
        step = scheme.stages * interval
        integrator = ExactRigidBodyHybridIntegrator(temperature, friction, step, scheme=scheme, bodies=start.bodies)
        integrator.setRandomNumberSeed(seed)
        context = start.context(integrator)
        integrator.step(max(1, round(_SETTLING * number)))
        integrator.resetTally()
        begun = time.perf_counter()
        integrator.step(number)
        context.getState(positions=True)  # waits for platforms that work in the background
        seconds = (time.perf_counter() - begun) / number
        rate = integrator.acceptanceRate()
        worth = progress(step, rate, friction)
        found = Proposal(
            scheme.name,
            step,
            rate,
            seconds,
            worth,
            temperature,
            friction,
            copy.deepcopy(start.bodies),
            own_scheme(scheme),
            start.groups,
        )
        tell(str(found))
        return found

    return measure
