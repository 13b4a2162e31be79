"""Print the catalogue of schemes as a table."""

import openmm_exactrb as rb
from openmm_exactrb.schemes import stability_limit

print(f"{'name':<12}{'orders':>10}{'forces a step':>15}{'starts with':>13}{'kind':>10}{'stable step a force':>21}")
for name, scheme in rb.SCHEMES.items():
    orders = ", ".join(map(str, scheme.generalised or (scheme.order,)))
    stable = stability_limit(scheme, 1e-3) / scheme.stages
    print(f"{name:<12}{orders:>10}{scheme.stages:>15}{scheme.first:>13}{scheme.kind:>10}{stable:>21.2f}")
