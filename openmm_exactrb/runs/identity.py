"""What must be the same for a run to be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple
from typing import Any
from xml.etree import ElementTree

import openmm
from openmm import unit

from openmm_exactrb import kernels
from openmm_exactrb.baths.momenta import CanonicalMomenta
from openmm_exactrb.baths.thermostatted import ThermostattedIntegrator
from openmm_exactrb.device.gather import without as without_sums
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.runs.text import hash_of, text_of_function
from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.version import version

# What an integrator of all forces says: 32 bits.
_EVERY_GROUP = -1


def identity_of(simulation: Any) -> dict[str, str]:
    """Return what decides the bits of a run, by name.

    Parameters
    ----------
    simulation : openmm.app.Simulation
        At its start, where bodies are named by hand: this fixes their shape, before a checkpoint is loaded.
    """
    integrator = simulation.integrator
    identity = {
        "openmm": openmm.__version__,
        "openmm-exactrb": version("not installed"),
        "kernels": "compiled" if kernels.available() else "numpy",  # they round differently
        "platform": simulation.context.getPlatform().getName(),
        "System": text_of_system(without_sums(simulation.system)),
        "integrator": _settings(integrator),
    }
    if draws := [reporter.settings() for reporter in simulation.reporters if isinstance(reporter, CanonicalMomenta)]:
        identity["CanonicalMomenta"] = "; ".join(draws)
    if isinstance(integrator, ExactRigidBodyIntegrator):
        identity["engine"] = integrator.getEngine()
    if isinstance(integrator, ExactRigidBodyIntegrator) and integrator.hasNamedBodies():
        bodies, _ = integrator.bodyState()
        shapes = b"".join(kind.particles.tobytes() + kind.sites.tobytes() for kind in bodies.kinds)
        identity["bodies"] = f"{len(bodies)}, {hash_of(shapes)}"
    return identity


def text_of_system(system: openmm.System) -> str:
    """Return what tells a System apart; of a force that cannot be serialised only that it is there."""
    try:
        content = openmm.XmlSerializer.serialize(system)
    except Exception as error:  # a PythonForce raises whatever pickle does with its function
        content, unseen = _serialised_parts(system)
        if not unseen:
            raise error
        return f"{system.getNumParticles()} particles, {hash_of(content.encode())}, and {unseen} not compared"
    return f"{system.getNumParticles()} particles, {hash_of(content.encode())}"


def _serialised_parts(system: openmm.System) -> tuple[str, str]:
    """Return masses, constraints and forces as text, and the kinds of forces that cannot be serialised."""
    number, constraints = range(system.getNumParticles()), range(system.getNumConstraints())
    parts = [str([system.getParticleMass(i)._value for i in number])]
    parts += [str([system.getConstraintParameters(i) for i in constraints]), str(system.getDefaultPeriodicBoxVectors())]
    unseen = []
    for force in system.getForces():
        try:
            parts.append(openmm.XmlSerializer.serialize(force))
        except Exception:
            unseen.append(type(force).__name__)
    return "\n".join(parts), ", ".join(unseen)


def _settings(integrator: Any) -> str:
    text = type(integrator).__name__
    if not text.startswith("Variable"):  # whose steps change the size of steps
        text += f", step {integrator.getStepSize().value_in_unit(unit.picosecond)!r} ps"
    if (groups := integrator.getIntegrationForceGroups()) != _EVERY_GROUP:
        text += f", force groups {groups & 0xFFFFFFFF:#b}"
    if isinstance(integrator, ExactRigidBodyIntegrator):
        scheme = integrator.getScheme()
        text += f", {scheme.name}, {integrator.getRotor()}"
        if CATALOGUE.get(scheme.name) != scheme:  # of one's own, or with the bath within it
            text += f", {hash_of(repr(astuple(scheme)).encode())}"
        text += "".join(f", {name} by {text_of_function(function)}" for name, function in _own_parts(integrator))
        if (nesting := integrator.getNesting()) is None:
            text += ", nothing nested"
        elif nesting.certain:  # else System and step decide
            inner = nesting.scheme.name if nesting.scheme else "the usual scheme"
            text += f", {nesting.fast} forces nested by {nesting.steps or 'enough'} steps of {inner}"
    else:
        text += f", {hash_of(_settings_of_openmm(integrator))}"
    if isinstance(integrator, ThermostattedIntegrator):
        text += "".join(f", {name} {value}" for name, value in integrator.getBathSettings().items())
    return text


def _own_parts(integrator: ExactRigidBodyIntegrator) -> Iterator[tuple[str, Any]]:
    """Yield what makes a user's own rotor and letters, each by its name."""
    settings = integrator.getSettings()
    if isinstance(rotor := settings["arguments"]["rotor"], Rotor):
        yield rotor.name, rotor.factory
    yield from sorted(settings["letters"].items())


def _settings_of_openmm(integrator: openmm.Integrator) -> bytes:
    """Return what an integrator of OpenMM is, without the numbers that its steps change."""
    tree = ElementTree.fromstring(openmm.XmlSerializer.serialize(integrator))
    tree.attrib.pop("stepSize", None)
    computed = {computation.get("computationVariable") for computation in tree.iter("Computation")}
    for variables in tree.iter("GlobalVariables"):
        variables[:] = [variable for variable in variables if variable.get("name") not in computed]
    for variables in tree.iter("PerDofVariables"):
        variables.clear()
    return ElementTree.tostring(tree)
