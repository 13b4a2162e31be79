"""Text in an integrator, which OpenMM copies and writes to XML together with the integrator.

Of all text in a CustomIntegrator, only the expression of the kinetic energy can be changed after a Context was created.
The text is therefore stored in this expression, as a definition that the expression does not use.
"""

from __future__ import annotations

from urllib.parse import quote, unquote

import openmm

# The kinetic energy of every CustomIntegrator, unless another expression is set, and the name of the definition.
_KINETIC_ENERGY, _NAME = "m*v*v/2", "exactrb_settings"
_START = f"{_KINETIC_ENERGY}; {_NAME}="


def write(integrator: openmm.CustomIntegrator, text: str) -> None:
    """Store a text in an integrator, percent-encoded so that OpenMM parses it as one name."""
    encoded = quote(text, safe=":[]{}").replace("-", "%2D")
    openmm.CustomIntegrator.setKineticEnergyExpression(integrator, _START + encoded)


def read(integrator: openmm.CustomIntegrator) -> str | None:
    """Return the text stored in an integrator, or None."""
    start, name, encoded = integrator.getKineticEnergyExpression().partition(_START)
    return unquote(encoded) if name and not start else None
