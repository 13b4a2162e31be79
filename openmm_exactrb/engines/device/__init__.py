"""The device engine: programs of fused kernels, carried out by an integrator of OpenMM that knows no physics."""
