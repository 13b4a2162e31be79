"""The identity of a run: all values that must be the same when it is resumed."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import openmm
from openmm import unit

from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.momenta import CanonicalMomenta
from openmm_exactrb.support.stable_text import digest, stable_text
from openmm_exactrb.support.version import version

_LONGEST = 100  # largest number of characters of a value in a message


def identity_of(simulation: Any) -> dict[str, str]:
    """Return all values that determine a run bit for bit.

    As a side effect, the shapes of the bodies in ``bodies=`` are determined from the current positions.
    """
    integrator = simulation.integrator
    identity = {
        "openmm": openmm.__version__,
        "openmm-exactrb": version(),
        "platform": simulation.context.getPlatform().getName(),
        "System": _text_of_system(simulation.system),
        "integrator": type(integrator).__name__,
    }
    if draws := [reporter.settings() for reporter in simulation.reporters if isinstance(reporter, CanonicalMomenta)]:
        identity["CanonicalMomenta"] = "; ".join(draws)
    own = isinstance(integrator, ExactRigidBodyIntegrator)
    settings = _settings(integrator) if own else _settings_of_openmm(integrator)
    return identity | {f"integrator {name}": text for name, text in settings.items()}


def _text_of_system(system: openmm.System) -> str:
    try:
        content = openmm.XmlSerializer.serialize(system)
    except Exception as error:  # serialising a PythonForce may raise any error of pickle
        raise ValueError(
            f"OpenMM cannot serialise the System of this run ({error}): replace the force that cannot be serialised"
        ) from error
    return f"{system.getNumParticles()} particles, hash {digest(content.encode())}"


def setting_text(value: Any, name: str) -> str:
    """Return a setting as text; a long text is replaced by its name or beginning, and a hash.

    A TypeError, with the name of the setting, is raised if the value has no text that is equal in every process.
    """
    try:
        text = stable_text(value)
    except TypeError as error:
        raise TypeError(f"{name} {error}") from None
    if len(text) <= _LONGEST:
        return text
    return f"{getattr(value, 'name', text[:_LONGEST] + '...')}, hash {digest(text.encode())}"


def _settings(integrator: ExactRigidBodyIntegrator) -> dict[str, str]:
    given = {name: value for group in integrator.getSettings().values() for name, value in group.items()}
    given.pop("checkDivergence")  # does not affect the trajectory
    settings = {name: setting_text(value, f"the integrator's {name}") for name, value in given.items()}
    settings["engine"] = integrator.getEngine()
    if integrator.getNamedBodies() is not None:
        bodies, _ = integrator.bodyState()
        settings["shapes"] = digest(b"".join(kind.sites.tobytes() for kind in bodies.kinds))
    return settings


def _settings_of_openmm(integrator: openmm.Integrator) -> dict[str, str]:
    """Return the settings of an OpenMM integrator, except those that its steps change."""
    tree = ElementTree.fromstring(openmm.XmlSerializer.serialize(integrator))
    tree.attrib.pop("stepSize", None)
    computed = {computation.get("computationVariable") for computation in tree.iter("Computation")}
    for variables in tree.iter("GlobalVariables"):
        variables[:] = [variable for variable in variables if variable.get("name") not in computed]
    for variables in tree.iter("PerDofVariables"):
        variables.clear()
    settings = {"settings": digest(ElementTree.tostring(tree))}
    if not type(integrator).__name__.startswith("Variable"):  # their steps change the step size
        settings["stepSize"] = repr(integrator.getStepSize().value_in_unit(unit.picosecond))
    return settings
