"""Numbers of error-free transformations; names in capitals are also macros of the kernel texts."""

#: Adding and then subtracting this number rounds numbers between -1 and 1 to multiples of 2^-26.
TO_GRID = 1.5 * 2.0**26
