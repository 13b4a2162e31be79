"""Splitting schemes for H = T + V, whose steps are sequences of substeps, and the lookup of schemes by name."""

from openmm_exactrb.schemes.catalogue import CATALOGUE, scheme, scheme_for_thermostat, splitting
from openmm_exactrb.schemes.generated import composition, corrected, saba, sbab
from openmm_exactrb.schemes.gradients import force_gradient
from openmm_exactrb.schemes.scheme import Scheme, symmetric
from openmm_exactrb.schemes.stability import Shadow, shadow, stability_limit
from openmm_exactrb.schemes.thermostatted import WITH_THERMOSTAT
from openmm_exactrb.steps.sequence import spelled

__all__ = [
    "CATALOGUE",
    "WITH_THERMOSTAT",
    "Scheme",
    "Shadow",
    "composition",
    "corrected",
    "force_gradient",
    "saba",
    "sbab",
    "scheme",
    "scheme_for_thermostat",
    "shadow",
    "spelled",
    "splitting",
    "stability_limit",
    "symmetric",
]
