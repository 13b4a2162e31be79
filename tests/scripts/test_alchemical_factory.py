"""Alchemical Systems of openmmtools: kernels of the native engine have their bonded forces, as the host has them."""

import warnings

import openmm
import pytest

import openmm_exactrb as rb
from peptides import in_box
from places import CPU
from starts import context_of, positions_of

pytestmark = [pytest.mark.library, pytest.mark.filterwarnings("ignore")]
reason = "pip install 'openmm-exactrb[validation]'"
alchemy = pytest.importorskip("openmmtools.alchemy", reason=reason)

PARAMETERS = {"lambda_electrostatics": 0.6, "lambda_sterics": 0.8, "lambda_bonds": 0.9, "lambda_torsions": 0.7}


@pytest.mark.parametrize("treatment", ["exact", "direct-space", "coulomb"])
@pytest.mark.parametrize("bonded", [False, True])
def test_engines_agree(treatment, bonded):
    _, system, x = in_box()
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    nonbonded.setNonbondedMethod(openmm.NonbondedForce.PME)
    factory = alchemy.AbsoluteAlchemicalFactory(consistent_exceptions=False, alchemical_pme_treatment=treatment)
    parts = {f"alchemical_{kind}": bonded for kind in ("bonds", "angles", "torsions")}
    region = alchemy.AlchemicalRegion(alchemical_atoms=range(22), annihilate_sterics=True, **parts)
    alchemical = factory.create_alchemical_system(system, region)
    ends = []
    for engine in ("host", "auto"):
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, 0.006, "W2_3m", engine=engine)
        context = context_of(alchemical, integrator, x, platform=CPU, properties={"Threads": "1"})
        integrator.setVelocitiesToTemperature(300.0, 2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rb.StepSizeWarning)
            for name, value in PARAMETERS.items():
                if name in context.getParameters():
                    context.setParameter(name, value)
                integrator.step(1)
        assert integrator.getEngine() == ("host" if engine == "host" else "native")
        assert integrator.timings.fast_evaluations > 0
        ends.append(positions_of(context))
    assert abs(ends[1] - ends[0]).max() < 1e-12
