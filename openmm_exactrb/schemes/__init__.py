"""Splitting schemes for H = T + V: a step is a word of drifts and kicks, and one catalogue names them."""

from openmm_exactrb.schemes.bathed import WITH_BATH
from openmm_exactrb.schemes.catalogue import CATALOGUE, scheme, scheme_for_bath
from openmm_exactrb.schemes.generated import composition, corrected, saba, sbab
from openmm_exactrb.schemes.gradients import force_gradient
from openmm_exactrb.schemes.scheme import Scheme, symmetric
from openmm_exactrb.schemes.stability import Shadow, shadow, stability_limit

__all__ = [
    "CATALOGUE",
    "WITH_BATH",
    "Scheme",
    "Shadow",
    "composition",
    "corrected",
    "force_gradient",
    "saba",
    "sbab",
    "scheme",
    "scheme_for_bath",
    "shadow",
    "stability_limit",
    "symmetric",
]
