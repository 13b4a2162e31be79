"""What the letters of a word do to bodies, without OpenMM: the state, its flows, and the loop over a word."""
