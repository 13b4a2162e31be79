"""Makes steps on OpenCL and says on standard error where they begin and end: kinds and schemes, by turns."""

import sys
from pathlib import Path

import openmm

import openmm_exactrb as rb

sys.path.insert(0, str(Path(__file__).parents[2]))
for kind, scheme in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
    if kind == "nested":
        from peptides import in_box

        _, system, positions = in_box()
        fast = (rb.separate_bonded(system),)
        integrator = rb.ExactRigidBodyIntegrator(0.002, scheme, fast=fast, innerSteps=6, engine="device")
    else:
        _, system, positions = rb.rigid_water(4)
        if kind == "langevin":
            system.addForce(openmm.CMMotionRemover())
            integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, scheme, engine="device")
        else:
            integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine="device")
    platform = openmm.Platform.getPlatform("OpenCL")
    context = openmm.Context(system, integrator, platform, {"Precision": "mixed"})
    context.setPositions(positions)
    for steps in (3, 5, 15):
        integrator.step(steps)
        print(f"steps {steps}", file=sys.stderr, flush=True)
