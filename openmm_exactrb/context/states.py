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
    """Let integrators of a class load States of integrators of other packages, and those load States of this package.

    A CustomIntegrator cannot read the data of most other integrators, and OpenMM's NoseHooverIntegrator and
    MTSIntegrator cannot read those of this package: OpenMM raises errors such as "Unknown property 'version'". These
    data are ignored, as OpenMM's LangevinMiddleIntegrator ignores them. The method of all Contexts is replaced, because
    it is usually called before the integrator has found its Context.
    """
    method = openmm.Context.setState

    @functools.wraps(method)
    def load(context: Any, state: openmm.State) -> None:
        try:
            method(context, state)
        except openmm.OpenMMException as error:
            if not isinstance(state, openmm.State) or not state.getDataTypes() & openmm.State.IntegratorParameters:
                raise
            text = openmm.XmlSerializer.serialize(state)
            reads, wrote = isinstance(context.getIntegrator(), kind), PREFIX in text
            if reads and wrote:
                raise openmm.OpenMMException(_OTHER_SETTINGS) from error
            if not reads and not wrote:
                raise
            method(context, openmm.XmlSerializer.deserialize(_DATA.sub("", text)))

    openmm.Context.setState = load
