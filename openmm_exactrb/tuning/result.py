"""The result of tuning: all measurements, and the settings that follow from them."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import openmm

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.support.checks import positive
from openmm_exactrb.tuning.benchmark import NESTED, VERLET
from openmm_exactrb.tuning.measurements import Point, cost_at, stable_curve, stable_points, step_at

# From the palettes of Okabe and Ito, and of Tol, for colour-blind readers; each colour has its own marker.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#332288", "#882255")
_MARKERS = "sD^vpPX*"


class UnreachableError(ValueError):
    """No measured setting reaches the target."""


@dataclass(frozen=True)
class Choice:
    """A scheme and a step."""

    #: Name of a scheme, followed by " nested" if bonded forces are nested, or "VerletIntegrator".
    method: str
    #: Step of the whole scheme in ps.
    step: float
    #: Standard deviation of the total energy in kJ/mol per body to expect over the horizon.
    error: float
    #: Wall time in s per ps.
    cost: float
    #: Whether this setting itself was run; otherwise it is interpolated.
    confirmed: bool
    #: Argument of the integrator.
    bodies: list[list[int]] | None = None
    #: The scheme of the method if it is not in the catalogue.
    scheme: Scheme | None = None
    #: Bits of the force groups that act.
    groups: int = -1
    #: Force evaluations per ps of `Simulation.step` with reports that are no more frequent than every tenth step.
    evaluations: float = math.nan

    def integrator(self) -> openmm.Integrator:
        """Return a new integrator with this scheme and step."""
        if self.method == VERLET:
            integrator = openmm.VerletIntegrator(self.step)
        else:
            integrator = ExactRigidBodyIntegrator(self.step, bodies=self.bodies, **self.options())
        integrator.setIntegrationForceGroups(self.groups)
        return integrator

    def options(self) -> dict[str, Any]:
        """Return the arguments `scheme` and `fast` of an integrator of this package with this setting."""
        nested = self.method.endswith(NESTED)
        return {"scheme": self.scheme or self.method.removesuffix(NESTED), "fast": "bonded" if nested else None}

    def __str__(self) -> str:
        return (
            f"{self.method} with a step of {1e3 * self.step:.4g} fs: error {self.error:.1e} kJ/mol per body, "
            f"{self.evaluations:.4g} force evaluations and {self.cost:.3g} s per ps ({86.4 / self.cost:.3g} ns per day)"
        )


@dataclass(frozen=True)
class Tuning:
    """The measured points of all methods, and the recommended setting."""

    points: tuple[Point, ...]
    #: Wall time of a force evaluation in s by method, with the nested forces of nested schemes at a short step.
    seconds: Mapping[str, float]
    #: Force evaluations per step by method, not counting those of nested forces.
    stages: Mapping[str, int]
    #: The same as `Simulation.step` has them made in the user's System, with its barostats and for what reports show.
    evaluations: Mapping[str, float]
    n_bodies: int
    platform: str
    #: Length of a survey run in ps.
    duration: float
    #: Length in ps of the production runs for which errors are promised.
    horizon: float
    #: Wanted error in kJ/mol per body.
    target: float | None = None
    #: The cheapest setting that meets the target.
    chosen: Choice | None = None
    #: Error due to the noise of the forces, in kJ/mol per body: smaller steps do not lower it.
    floor: float | None = None
    #: Settings of the System that may set it.
    causes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    bodies: list[list[int]] | None = field(default=None, repr=False)
    #: Schemes that are not in the catalogue, by method.
    schemes: Mapping[str, Scheme] = field(default_factory=dict, repr=False)
    #: Bits of the force groups that act.
    groups: int = -1

    def best(self, target: float | None = None, method: str | None = None) -> Choice:
        """Return the cheapest scheme and step for an energy error.

        Parameters
        ----------
        target : float, optional
            Standard deviation of the total energy in kJ/mol per body within the horizon. By default that of `tune`,
            whose setting was confirmed by a run over the horizon; for other targets the setting is interpolated between
            measured ones.
        method : str, optional
            A scheme, or "VerletIntegrator"; by default all schemes.

        Raises
        ------
        UnreachableError
            With the smallest error found.
        ValueError
            If the method was not measured, or the target is not positive or missing.
        """
        target = self.target if target is None else positive(target, "target", "kJ/mol per body")
        if target is None:
            raise ValueError("give best() a target: tune() was called without one")
        if target == self.target and method is None:
            found = [] if self.chosen is None else [self.chosen]
        else:
            found = [choice for name in self._methods(method) if (choice := self._choice(name, target))]
        if not found:
            raise UnreachableError(self._why_unreachable(target, method))
        return min(found, key=lambda choice: choice.cost)

    def largest_stable_step(self, method: str) -> float:
        """Return the largest step in ps of a scheme with an energy error below a tenth of the kinetic energy.

        Steps were tried up to the first unstable one, at most 19 % above the returned one, or up to the one in which
        free bodies turn by a radian between two force evaluations.

        Raises
        ------
        ValueError
            If the method was not measured, or none of its steps was stable.
        """
        (name,) = self._methods(method)
        if math.isnan(step := self._largest_stable(name)):
            raise UnreachableError(f"no step of {name} that was tried is stable")
        return step

    def curve(self, method: str) -> list[Point]:
        """Return the stable points of a method, cheapest first, without those that a longer run contradicted."""
        return stable_curve(self.points, method)

    def _methods(self, method: str | None) -> list[str]:
        """Return one method, which must have been measured, or all schemes."""
        if method is None:
            return [name for name in self.seconds if name != VERLET]
        if method not in self.seconds:
            raise ValueError(f"{method!r} was not measured: choose one of {', '.join(self.seconds)}")
        return [method]

    def _largest_stable(self, method: str) -> float:
        return max((p.step for p in stable_points(self.points, method)), default=math.nan)

    def _choice(self, method: str, target: float) -> Choice | None:
        """Return the cheapest setting of a method with an error, or None."""
        curve = self.curve(method)
        cost = cost_at(curve, target)
        if cost is None:
            return None
        measured = curve[0].error <= target  # already with the largest stable step
        error, step = curve[0].error if measured else target, step_at(curve, cost)
        own, evaluations = self.schemes.get(method), self.evaluations[method] / step
        return Choice(method, step, error, cost, measured, self.bodies, own, self.groups, evaluations)

    def _why_unreachable(self, target: float, method: str | None = None) -> str:
        points = [p for name in self._methods(method) for p in self.curve(name)]
        if not points:
            return "no run was stable: the start is far from equilibrium, or the forces are not those of a potential"
        least, why = min(points, key=lambda p: p.error), "not reached: the smallest found is"
        failed = [p for p in points if p.duration >= self.horizon and p.error > target]
        if least.error <= target and failed:
            least = min(failed, key=lambda p: p.error)
            why = f"not held: the smallest in runs of {self.horizon:.3g} ps was"
        text = (
            f"an error of {target:.3g} kJ/mol per body was {why} {least.error:.2g}, with {least.method} and a step of "
        )
        text = f"{text}{1e3 * least.step:.3g} fs"
        if self.floor is not None:
            return f"{text}. {self._about_floor()}"
        return text + (f". The forces may limit it: {'; '.join(self.causes)}" if self.causes else "")

    def __str__(self) -> str:
        head = (
            f"{self.n_bodies} bodies on {self.platform}. Error: standard deviation of the total energy in kJ/mol per "
            f"body, within {self.horizon:.3g} ps\n"
            f"(extrapolated from {self.duration:.3g} ps). Cost: wall time in s per ps."
        )
        return "\n".join([head, "", self._tables(), "", *(textwrap.fill(line, 120) for line in self._conclusions())])

    def _tables(self) -> str:
        """Return the errors of all methods by the time per force evaluation; nested schemes have their own table."""
        nested = [method for method in self.seconds if method.endswith(NESTED)]
        plain = [method for method in self.seconds if method not in nested]
        return "\n\n".join(self._table(methods) for methods in (plain, nested) if methods)

    def _table(self, methods: list[str]) -> str:
        contradicted, cells = self._contradicted(), {}
        for p in self.points:
            text = "unstable" if math.isinf(p.error) else f"({p.error:.1e})" if p in contradicted else f"{p.error:.1e}"
            cells[float(f"{p.step / self.stages[p.method]:.6g}"), p.method] = text
        intervals = sorted({interval for interval, method in cells if method in methods}, reverse=True)
        rows = [
            ["fs per evaluation", *methods],
            *([f"{1e3 * t:.4g}", *(cells.get((t, method), "") for method in methods)] for t in intervals),
            ["largest step, fs", *(f"{1e3 * self._largest_stable(method):.4g}" for method in methods)],
            ["ms per evaluation", *(f"{1e3 * self.seconds[method]:.3g}" for method in methods)],
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows)

    def _contradicted(self) -> set[Point]:
        """Return the stable points that a longer run contradicts."""
        return {p for name in self.seconds for p in {*stable_points(self.points, name)}.difference(self.curve(name))}

    def _conclusions(self) -> Iterable[str]:
        if self._contradicted():
            yield "In brackets: a longer run of a smaller step had a larger error."
        if self.floor is not None and (self.target is None or self.chosen is not None):
            yield self._about_floor()
        if self.target is not None:
            yield f"target {self.target:.3g}: {self.chosen or self._why_unreachable(self.target)}"
        if self.chosen is not None and VERLET in self.seconds and self.curve(VERLET):
            yield self._comparison(self.chosen)
        yield from (f"note: {note}" for note in self.notes)

    def _about_floor(self) -> str:
        known = "; ".join(self.causes) or "single precision; use the Reference platform or double precision"
        return (
            f"Below {self.floor:.1e} kJ/mol per body smaller steps do not lower the error: the rest comes from the "
            f"forces, not from the scheme ({known}). See the documentation: Why is my energy error not smaller?"
        )

    def _comparison(self, chosen: Choice) -> str:
        """Return a sentence that compares a choice with OpenMM's Verlet integrator."""
        last, about = self.curve(VERLET)[-1], ""
        cost = cost_at(self.curve(VERLET), chosen.error)
        if cost is None:
            cost, about = _extrapolated(last, chosen.error), "about "
        step = 1e3 * self.seconds[VERLET] * self.evaluations[VERLET] / cost
        return f"{VERLET} needs {about}{cost / chosen.cost:.2g} times the cost for the same error ({step:.3g} fs)"

    def draw(self, file: str | os.PathLike[str]) -> None:
        """Draw energy error against cost, with the best schemes in colours and the others in grey.

        Parameters
        ----------
        file : str or path
            Its suffix must be that of a format that matplotlib writes.

        Raises
        ------
        ModuleNotFoundError
            If matplotlib is not installed.
        """
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ModuleNotFoundError:
            raise ModuleNotFoundError("the picture needs matplotlib: python -m pip install matplotlib") from None
        figure = Figure(figsize=(8.5, 5.0), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot(
            xscale="log",
            yscale="log",
            title=f"{self.n_bodies} bodies, {self.platform} platform",
            xlabel="wall time (s per ps)",
            ylabel=f"std of total energy over {self.horizon:.3g} ps (kJ/mol per body)",
        )
        points = [p for name in self._methods(None) for p in self.curve(name)]
        best = {p.method for p in points if not any(q.cost < p.cost and q.error < p.error for q in points)}
        styles = iter(zip(_COLOURS, _MARKERS, strict=True))
        for name in sorted(self.seconds, key=lambda name: name in best):
            line = [p.cost for p in self.curve(name)], [p.error for p in self.curve(name)]
            if name == VERLET:
                axes.plot(*line, "o--", color="black", label=name)
                if line[0] and self.chosen is not None and self.chosen.error < line[1][-1]:
                    last, error = self.curve(VERLET)[-1], self.chosen.error
                    rest = [last.cost, _extrapolated(last, error)], [last.error, error]
                    axes.plot(*rest, ":", color="black", label=f"{name}, extrapolated")
            elif name in best and (style := next(styles, None)):
                axes.plot(*line, color=style[0], marker=style[1], mec="white", label=name)
            else:
                axes.plot(*line, color="0.8", lw=1.0)
        axes.set_ylim(bottom=0.4 * min([*(p.error for p in points), self.target or math.inf], default=1.0))
        if self.target is not None:
            axes.axhline(self.target, color="0.4", lw=0.8, ls="--", label="target")
        if self.floor is not None:
            axes.axhspan(1e-3 * self.floor, self.floor, color="0.85", label="below the floor")
        if self.chosen is not None:
            label = f"chosen: {self.chosen.method}, {1e3 * self.chosen.step:.3g} fs"
            axes.plot(self.chosen.cost, self.chosen.error, "o", ms=14, mfc="none", mec="black", label=label)
        if axes.get_legend_handles_labels()[0]:
            figure.legend(loc="outside right upper", fontsize=9)
        figure.savefig(file, dpi=150)


def _extrapolated(last: Point, error: float) -> float:
    """Return the cost at which Verlet, which is of order 2, has an error beyond its last point."""
    return last.cost * math.sqrt(last.error / error)
