"""The package's library of compiled C++: how it is found or compiled, its integrators, and its functions for arrays."""
