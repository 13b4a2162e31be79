"""``Context.setState`` for Contexts with an integrator of this package, without the package's library."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import openmm

from openmm_exactrb.context.variables import OTHER_STORAGE, PREFIX

# The data of an integrator in the XML of a State.
_DATA = re.compile(r"<IntegratorParameters[^>]*/>|<IntegratorParameters.*?</IntegratorParameters>", re.DOTALL)
_OTHER_SETTINGS = (
    "the State was saved with another scheme, thermostat or engine of openmm_exactrb, and this integrator cannot read "
    "its data: load the other data of the State with openmm_exactrb.loadState, or create the integrator with the "
    "settings of the run that saved the State"
)


def load(kind: type[Any], original: Callable[..., None], context: Any, state: openmm.State) -> None:
    """Set a State, also of another kind of integrator, if it or the integrator of the Context is one of a class.

    A CustomIntegrator cannot read the data of most other integrators, and OpenMM's NoseHooverIntegrator and
    MTSIntegrator cannot read those of this package: OpenMM raises errors such as "Unknown property 'version'". These
    data are ignored, as OpenMM's LangevinMiddleIntegrator ignores them. `original` is the method of OpenMM.
    """
    ours = isinstance(context.getIntegrator(), kind)
    has_data = isinstance(state, openmm.State) and state.getDataTypes() & openmm.State.IntegratorParameters
    text = openmm.XmlSerializer.serialize(state) if has_data else ""
    if ours and f"<Numbers {PREFIX}" in text:
        raise openmm.OpenMMException(OTHER_STORAGE.format("with", "without"))
    try:
        original(context, state)
    except openmm.OpenMMException as error:
        if not has_data:
            raise
        if ours and PREFIX in text:
            raise openmm.OpenMMException(_OTHER_SETTINGS) from error
        if not ours and PREFIX not in text:
            raise
        original(context, openmm.XmlSerializer.deserialize(_DATA.sub("", text)))
