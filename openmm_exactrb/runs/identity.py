"""What must be the same for a run to be resumed."""

from __future__ import annotations

import hashlib
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
    integrator, system = simulation.integrator, without_sums(simulation.system)
    identity = {
        "openmm": openmm.__version__,
        "openmm-exactrb": version("not installed"),
        "kernels": "compiled" if kernels.available() else "numpy",  # they round differently
        "platform": simulation.context.getPlatform().getName(),
        "System": f"{system.getNumParticles()} particles, {_hash(openmm.XmlSerializer.serialize(system).encode())}",
        "integrator": _settings(integrator),
    }
    if draws := [reporter.settings() for reporter in simulation.reporters if isinstance(reporter, CanonicalMomenta)]:
        identity["CanonicalMomenta"] = "; ".join(draws)
    if isinstance(integrator, ExactRigidBodyIntegrator):
        identity["engine"] = integrator.getEngine()
    if isinstance(integrator, ExactRigidBodyIntegrator) and integrator.hasNamedBodies():
        bodies, _ = integrator.bodyState()
        shapes = b"".join(kind.particles.tobytes() + kind.sites.tobytes() for kind in bodies.kinds)
        identity["bodies"] = f"{len(bodies)}, {_hash(shapes)}"
    return identity


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
            text += f", {_hash(repr(astuple(scheme)).encode())}"
        if (nesting := integrator.getNesting()) is None:
            text += ", nothing nested"
        elif nesting.certain:  # else System and step decide
            inner = nesting.scheme.name if nesting.scheme else "the usual scheme"
            text += f", {nesting.fast} forces nested by {nesting.steps or 'enough'} steps of {inner}"
    else:
        text += f", {_hash(_settings_of_openmm(integrator))}"
    if isinstance(integrator, ThermostattedIntegrator):
        text += "".join(f", {name} {value}" for name, value in integrator.getBathSettings().items())
    return text


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


def _hash(content: bytes) -> str:
    return f"hash {hashlib.sha256(content).hexdigest()[:16]}"
