"""What the letters of a step do, without OpenMM."""
