"""``Context.setState`` for Contexts with an integrator of this package."""

from __future__ import annotations

import functools
import re
from typing import Any

import openmm

from openmm_exactrb.context.variables import PREFIX

# The data of an integrator in the XML of a State.
_DATA = re.compile(r"<IntegratorParameters[^>]*/>|<IntegratorParameters.*?</IntegratorParameters>", re.DOTALL)
_OTHER_SETTINGS = (
    "the State was saved with another scheme, thermostat or engine of openmm_exactrb, and this integrator cannot read "
    "its data: load the other data of the State with openmm_exactrb.loadState, or create the integrator with the "
    "settings of the run that saved the State"
)


def load_by_integrators(kind: type[Any]) -> None:
    """Let Contexts with integrators of a class load States that were saved with integrators of other packages.

    A CustomIntegrator cannot read the data of most other integrators: OpenMM raises errors such as "Unknown property
    'version'". These data are ignored, as OpenMM's LangevinMiddleIntegrator ignores them. The method of all Contexts is
    replaced, because it is usually called before the integrator has found its Context.
    """
    method = openmm.Context.setState

    @functools.wraps(method)
    def load(context: Any, state: openmm.State) -> None:
        try:
            method(context, state)
        except openmm.OpenMMException as error:
            foreign = isinstance(state, openmm.State) and state.getDataTypes() & openmm.State.IntegratorParameters
            if not foreign or not isinstance(context.getIntegrator(), kind):
                raise
            text = openmm.XmlSerializer.serialize(state)
            if PREFIX in text:
                raise openmm.OpenMMException(_OTHER_SETTINGS) from error
            method(context, openmm.XmlSerializer.deserialize(_DATA.sub("", text)))

    openmm.Context.setState = load
