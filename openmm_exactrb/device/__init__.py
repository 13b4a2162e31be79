"""The engine that carries words out on the device: a whole step as one program of OpenMM's CustomIntegrator."""
