"""``Context.setState`` for Contexts with an integrator of this package, without the package's library."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import openmm

from openmm_exactrb.context.variables import OTHER_FORMAT, OTHER_STORAGE, PREFIX

# The data of an integrator in the XML of a State.
_DATA = re.compile(r"<IntegratorParameters[^>]*/>|<IntegratorParameters.*?</IntegratorParameters>", re.DOTALL)
# The numbers and the vectors of this package in this XML, by their names.
_NUMBER, _VECTOR = re.compile(rf'\b({PREFIX}\w+)="'), re.compile(rf"<({PREFIX}\w+)>.*?</\1>", re.DOTALL)


def load(kind: type[Any], original: Callable[..., None], context: Any, state: openmm.State) -> None:
    """Set a State, also of another kind of integrator, if it or the integrator of the Context is one of a class.

    A CustomIntegrator cannot read the data of most other integrators, and OpenMM's NoseHooverIntegrator and
    MTSIntegrator cannot read those of this package: OpenMM raises errors such as "Unknown property 'version'". These
    data are ignored, as OpenMM's LangevinMiddleIntegrator ignores them. `original` is the method of OpenMM.
    """
    ours = isinstance(context.getIntegrator(), kind)
    has_data = isinstance(state, openmm.State) and state.getDataTypes() & openmm.State.IntegratorParameters
    text = openmm.XmlSerializer.serialize(state) if has_data else ""
    of_ours = PREFIX in text
    if ours and of_ours:
        state = _readable(state, text, context.getIntegrator())
    try:
        original(context, state)
    except openmm.OpenMMException:
        if not has_data or ours == of_ours:
            raise
        original(context, openmm.XmlSerializer.deserialize(_DATA.sub("", text)))


def _readable(state: openmm.State, text: str, integrator: openmm.CustomIntegrator) -> openmm.State:
    """Return a State, given with its XML, without vectors that an integrator lacks, such as those of another scheme.

    OpenMMException is raised if the integrator lacks a number, or if the State was saved with the library.
    """
    if f"<Numbers {PREFIX}" in text:
        raise openmm.OpenMMException(OTHER_STORAGE.format("with", "without"))
    numbers = map(integrator.getGlobalVariableName, range(integrator.getNumGlobalVariables()))
    if not {*_NUMBER.findall(text)} <= {*numbers}:
        raise openmm.OpenMMException(OTHER_FORMAT)
    vectors = {*map(integrator.getPerDofVariableName, range(integrator.getNumPerDofVariables()))}
    shorter = _VECTOR.sub(lambda found: found[0] if found[1] in vectors else "", text)
    return state if shorter == text else openmm.XmlSerializer.deserialize(shorter)
