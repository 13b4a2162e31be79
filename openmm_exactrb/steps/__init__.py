"""What a step is made of: substeps, their sequence, the moves that engines perform, and what substeps are bound to."""
