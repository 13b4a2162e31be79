"""Splitting schemes for H = T + V: a step is a word of drifts and kicks, and one catalogue names them."""

from openmm_exactrb.schemes.catalogue import CATALOGUE, FORCE_GRADIENT, scheme
from openmm_exactrb.schemes.generated import composition, corrected, saba, sbab
from openmm_exactrb.schemes.scheme import Scheme, symmetric
from openmm_exactrb.schemes.stability import stability_limit

__all__ = [
    "CATALOGUE",
    "FORCE_GRADIENT",
    "Scheme",
    "composition",
    "corrected",
    "saba",
    "sbab",
    "scheme",
    "stability_limit",
    "symmetric",
]
