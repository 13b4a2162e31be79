"""A flow that is overridden together with its moves is the same on both engines."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import starts
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.moves import Move, Op
from openmm_exactrb.steps.substeps import KICK, Drift, Kick
from openmm_exactrb.thermostats import Langevin, StochasticRescaling
from overriding import Halved, moved, scheme_of
from places import platform_for

pytestmark = pytest.mark.library


class HalfKick(Halved):
    def kernel_moves(self, part):
        return super().kernel_moves(0.5 * part)


class SlowDrift(Drift):
    def bind(self, environment):
        drift = super().bind(environment)
        return lambda state, tau: drift(state, 0.7 * tau)

    def kernel_moves(self, part):
        return super().kernel_moves(0.7 * part)


class OneMethod(Kick):
    """A kick whose moves alone were written anew, with the same flow, which the class names."""

    bind = Kick.bind

    def kernel_moves(self, part):
        return (Move(Op.KICK, 0.25 * part, groups=-1), Move(Op.KICK, 0.75 * part, groups=-1))


class Stronger(Langevin):
    """Twice the friction, by both methods."""

    def _doubled(self):
        return Langevin(self.temperature, 2.0 * self.friction)

    def bind(self, environment):
        return self._doubled().bind(environment)

    def kernel_exchange(self, tau, freedom):
        return self._doubled().kernel_exchange(tau, freedom)


class Shared(Langevin):
    """Twice the friction, by what both methods read."""

    @property
    def frictions(self):
        return 2.0 * self.friction, 2.0 * self.friction


class Faster(StochasticRescaling):
    """Half the relaxation time."""

    def _faster(self):
        return StochasticRescaling(self.temperature, 0.5 * self.relaxationTime)

    def bind(self, environment):
        return self._faster().bind(environment)

    def kernel_exchange(self, tau, freedom):
        return self._faster().kernel_exchange(tau, freedom)


BOTH = {
    "kick": (scheme_of(HalfKick()), None),
    "drift": (Scheme("mine", 2, ((KICK, 0.5), (SlowDrift(), 1.0), (KICK, 0.5))), None),
    "moves": (scheme_of(OneMethod()), None),
    "friction": ("S2_2", Stronger(300.0, 10.0)),
    "shared": ("S2_2", Shared(300.0, 10.0)),
    "rescaling": ("S2_2", Faster(300.0, 0.02)),
}


@pytest.mark.opencl
@pytest.mark.parametrize("name", BOTH)
def test_a_flow_that_is_overridden_with_its_moves_is_the_same_on_both_engines(name):
    scheme, thermostat = BOTH[name]
    found = []
    for engine in ("host", "native"):
        integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine=engine, thermostat=thermostat)
        integrator.setRandomNumberSeed(3)
        found.append(moved(integrator, engine, 20, "native")[1])
    for host, device in zip(*found, strict=True):
        np.testing.assert_allclose(device, host, rtol=0.0, atol=1e-10)


@pytest.mark.opencl
def test_drifts_of_ones_own_have_no_inner_steps_that_openmm_evaluates():
    """Their moves would be those of the package."""
    system = starts.system_of([12.0, 16.0, 12.0])
    bonds = openmm.CustomBondForce("k*(r-0.12)^4")
    bonds.addGlobalParameter("k", 1e7)
    bonds.addBond(0, 1, [])
    bonds.setUsesPeriodicBoundaryConditions(True)
    bonds.setForceGroup(1)
    system.addForce(bonds)
    slow = openmm.CustomBondForce("100*(r-0.2)^2")
    slow.addBond(1, 2, [])
    system.addForce(slow)
    scheme = BOTH["drift"][0]
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine="native", fast=(1,), innerSteps=4)
    context = openmm.Context(system, integrator, *platform_for("native"))
    context.setPositions([[0, 0, 0], [0.12, 0, 0], [0.32, 0, 0]])
    with pytest.raises(ValueError, match=r"no kernel for .* which the drifts .*SlowDrift.* of mine need"):
        integrator.step(1)
