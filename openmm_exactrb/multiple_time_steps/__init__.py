"""Multiple time steps: fast forces that are integrated with inner steps within the drifts of a scheme."""
