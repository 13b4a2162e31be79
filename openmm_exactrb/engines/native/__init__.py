"""The native engine: programs of fused kernels, executed by an OpenMM integrator that contains no physics."""
