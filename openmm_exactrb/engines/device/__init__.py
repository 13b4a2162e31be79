"""The device engine: programs of fused kernels, executed by an integrator of OpenMM that contains no physics."""
