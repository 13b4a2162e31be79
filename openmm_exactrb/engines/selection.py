"""The choice of the engine that performs the steps of an integrator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.engines.catalogue import ENGINES, in_order, named
from openmm_exactrb.engines.engine import Engine, Settings
from openmm_exactrb.library.library import adopt

#: The value of `engine` that selects the first engine that supports the Context and is recommended for it.
AUTO = "auto"


class Selection:
    """The engine of an integrator.

    With "auto", the choice depends on the Context, unless the run continues from a checkpoint, whose engine is kept if
    possible. Before a Context exists, the integrator has the variables of the host engine. A ValueError is raised if
    the engine is unknown, or if a requested engine does not support a setting.

    Attributes
    ----------
    asked : str
        The name of an engine, or "auto".
    engine : Engine
        The chosen engine, which is provisional until a Context exists.
    note : str
        A sentence that states the reason for the choice.
    marks : tuple of float
        Possible values of the first variable of the integrator if it contains no state, or a state of this engine.
    """

    def __init__(self, asked: str, settings: Settings) -> None:
        asked = named(asked)
        if asked != AUTO and asked not in ENGINES:
            raise ValueError(f"the engine {asked!r} is unknown: choose one of {', '.join((*ENGINES, AUTO))}")
        self.asked = asked
        _check(settings)
        asked_for = in_order() if asked == AUTO else [ENGINES[asked]]
        self._candidates, self._reasons = _serving(asked_for, lambda engine: engine.unsupported(settings))
        self._choose(self._candidates[-1], (*self._reasons, f'engine="{asked}" was asked for')[0], settings)

    @property
    def open(self) -> bool:
        """Whether there are several candidates, so that the Context determines the engine."""
        return len(self._candidates) > 1

    def declare(self, integrator: openmm.CustomIntegrator, settings: Settings) -> None:
        """Make a new integrator one of the library, if there is one, and give it its variables."""
        adopt(integrator)
        self.engine.declare(integrator, settings)

    def settle(self, context: Any, integrator: openmm.CustomIntegrator, settings: Settings) -> None:
        """Choose the engine for a Context and settings; raise ValueError if no engine supports them."""
        _check(settings)
        writer, before = self._writer(integrator, settings), self.engine
        serving, reasons = _serving(self._candidates, lambda engine: engine.unsupported_in(context, settings))
        if not self.open:
            return
        if writer in serving:  # a continued run keeps its engine if possible
            self._choose(writer, f"the run began with engine={writer.name!r}", settings)
        else:
            self._advised(context, settings, serving, [*self._reasons, *reasons])
        if self.engine is not before:
            before.release(integrator)

    def _advised(self, context: Any, settings: Settings, serving: Sequence[Engine], reasons: list[str]) -> None:
        """Choose the first engine that is advised for a Context; `reasons` state why engines do not support it."""
        for engine in serving:
            pays, why = engine.advice(context, settings)
            if pays:
                self._choose(engine, reasons[0] if reasons and engine is serving[-1] else why, settings)
                return
            reasons.append(why)

    def _choose(self, engine: Engine, note: str, settings: Settings) -> None:
        self.engine, self.note, self.marks = engine, note, (variables.NOTHING, *engine.marks(settings))

    def _writer(self, integrator: openmm.CustomIntegrator, settings: Settings) -> Engine | None:
        """Return the engine that wrote the state in an integrator's variables, or None if they contain no state.

        A ValueError is raised if the state was written by another kind of integrator, or by an engine that was not
        requested.
        """
        mark = integrator.getGlobalVariable(0)
        if mark == variables.NOTHING:
            return None
        for engine in (self.engine, *self._candidates):
            if mark in engine.marks(settings):
                return engine
        for engine in ENGINES.values():
            if mark in engine.marks(settings):
                if self.asked == AUTO:  # only the shown state can be continued
                    variables.mark(integrator, variables.NOTHING)
                    return None
                raise ValueError(variables.OTHER_ENGINE.format(engine.name))
        raise ValueError(variables.OTHER_FORMAT)


def _check(settings: Settings) -> None:
    """Raise ValueError if the flow of a substep or thermostat would depend on the engine."""
    if why := settings.unperformed:
        raise ValueError(why)


def _serving(engines: Sequence[Engine], unsupported: Callable[[Engine], str | None]) -> tuple[list[Engine], list[str]]:
    """Return the supported engines, and why others are not supported; raise ValueError if none are supported."""
    answers = [(engine, unsupported(engine)) for engine in engines]
    serving, reasons = [engine for engine, why in answers if not why], [why for _, why in answers if why]
    if not serving:
        raise ValueError(f"{reasons[0]}: use engine={in_order()[-1].name!r} instead")
    return serving, reasons
