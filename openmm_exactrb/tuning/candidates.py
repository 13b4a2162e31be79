"""The integrators that are compared: schemes, with and without nested bonded forces, and OpenMM's Verlet integrator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.schemes import scheme as look_up

#: Schemes that are tried by default: each is the cheapest at some accuracy on some system. Schemes for small potentials
#: and compositions of Verlet steps are not among them; others are always cheaper.
CANDIDATES = (
    "V2",
    "W2_1",
    "S2_2",
    "S2_4",
    "W2_4",
    "W2_5",
    "W4_4",
    "W4_5",
    "W4_6",
    "SRKN4_6b",
    "SRKN6_11b",
    "SRKN6_14a",
)

#: Schemes that are tried with nested bonded forces by default.
NESTED_CANDIDATES = ("W2_1", "S2_2", "S2_3", "W2_4", "W2_5", "W4_4", "W4_5", "SRKN4_6b", "ABA_8_6_4")

#: Name of the baseline: OpenMM's leapfrog with constraints.
VERLET = "VerletIntegrator"

#: End of the name of a scheme with nested bonded forces.
NESTED = " nested"


@dataclass(frozen=True)
class Method:
    """A scheme, plain or with the bonded forces nested in its drifts, or without a scheme the baseline `VERLET`."""

    scheme: Scheme | None = None
    nested: bool = False

    @property
    def name(self) -> str:
        """The name in tables and results."""
        return VERLET if self.scheme is None else self.scheme.name + NESTED * self.nested

    @property
    def order(self) -> int:
        """Order in the step size."""
        return 2 if self.scheme is None else self.scheme.order

    @property
    def stages(self) -> int:
        """Force evaluations per step, not counting those of nested forces."""
        return 1 if self.scheme is None else self.scheme.forces

    @property
    def own_scheme(self) -> Scheme | None:
        """The scheme if it is the user's own, that is, if its name does not say which one it is."""
        return None if self.scheme is None or _by_name(self.scheme.name) == self.scheme else self.scheme


def schemes_named(names: str | Scheme | Sequence[str | Scheme]) -> list[Scheme]:
    """Return the schemes that a user names, without repetitions; ValueError for unknown or ambiguous names."""
    schemes = [look_up(name) for name in ([names] if isinstance(names, (str, Scheme)) else names)]
    if not schemes:
        raise ValueError(f"schemes is empty: name some of {', '.join(CATALOGUE)}")
    known: dict[str, Scheme] = {}
    for scheme in schemes:
        name = scheme.name
        if name.endswith(NESTED) or name == VERLET or known.setdefault(name, _by_name(name) or scheme) != scheme:
            raise ValueError(f"a scheme of your own has the name {name!r} of another method: choose another name")
    return list(known.values())


def _by_name(name: str) -> Scheme | None:
    try:
        return look_up(name)
    except ValueError:
        return None
