"""Steps on the device: the sequence of a scheme as one program of OpenMM's CustomIntegrator."""
