"""Mathematics that needs numpy only: elliptic functions, compensated sums, quaternions."""
