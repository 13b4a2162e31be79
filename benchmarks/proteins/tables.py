"""Tables of peptide.py, rigid_domains.py and inner_energies.py."""

from __future__ import annotations

from benchmarks.common.markdown import distinct, rows, table, with_error
from benchmarks.proteins.inner_energies import deviations, inner_of
from openmm_exactrb.schemes import splitting as look_up

_PEPTIDE = {
    "Verlet": "`VerletIntegrator`",
    "MTSIntegrator": "`MTSIntegrator`",
    " nested with 1-4": ', `fast="bonded"`',
    " nested": ", `fast=(1,)`",
}


#: Inner steps of a drift that are in the table: S2_2, and the defaults.
_SHOWN = ("S2_2:2", "b=0.198:2", "S2_4:2")
# The drifts of bodies with inner steps, as fractions of a step.
_DRIFTS = {"BAOA": (0.5, 0.5), "W2_3m": (0.135, 0.365, 0.365, 0.135)}


def peptide_errors() -> str:
    """Return the energy errors of a peptide in a droplet within 0.5 ps and over 10 ps, by evaluations per ps."""
    found = rows("peptide")
    rates, body = sorted({int(row["nonbonded_a_ps"]) for row in found}), []
    errors = {
        (row["method"], int(row["nonbonded_a_ps"])): (row["energy_std_half_ps"], row["energy_std_run"]) for row in found
    }
    for (method,) in distinct(found, "method"):
        scheme, space, inner = method.partition(" ")
        inner, comma, inverse = inner.partition(",")
        label = _PEPTIDE.get(method) or f"`{scheme}`" + (_PEPTIDE[space + inner] if inner else "") + comma + inverse
        body.append((label, *(_both(*errors[method, rate]) for rate in rates)))
    return table(("", *(f"{rate} per ps" for rate in rates)), body)


def _both(*errors: str) -> str:
    numbers = [float(error) for error in errors]
    return "diverges" if max(numbers) > 1e3 else ", ".join(f"{number:.2g}" for number in numbers)


def rigid_domains() -> str:
    """Return the energy errors and drifts of a chain with rigid domains, by the time between two force evaluations."""
    found, body = rows("rigid_domains"), []
    kinds = distinct(found, "bodies", "scheme")
    for (fs,) in distinct(found, "interval_fs"):
        of = {(row["bodies"], row["scheme"]): row for row in found if row["interval_fs"] == fs}
        pairs = ((of[kind]["rms_kJ_per_mol"], of[kind]["drift_kJ_per_mol_ps"]) for kind in kinds)
        body.append((fs, *(", ".join(filter(None, pair)) for pair in pairs)))
    return table(("fs", *(f"`{bodies}`, {scheme}" for bodies, scheme in kinds)), body)


def inner_steps() -> str:
    """Return by how many percent mean energies differ from those with many inner steps."""
    body = []
    for (solute, _, integrator, _, friction), inner, runs, changes in deviations(rows("inner_energies")):
        name, steps = inner.split(":")
        if friction == "0.0" or len(runs) < 2 or inner not in _SHOWN:
            continue
        splitting = inner_of(name)
        evaluations = splitting.stages * sum(max(1, round(int(steps) * part)) for part in _DRIFTS[integrator])
        label = f"`S2_2` with {name.replace('=', ' = ')}" if "=" in name else f"`{name}`"
        cells = (with_error(*changes[kind], 2) for kind in ("bonds", "angles", "torsions"))
        length = f"{len(runs)} x {float(runs[0]['picoseconds']):g} ps"
        cost = f"{evaluations / look_up(integrator).forces:.2g}"
        body.append((f"{solute}, `{integrator}`", label, cost, length, *cells))
    return table(
        ("", "inner scheme", "bonded evaluations per force", "", "bonds (%)", "angles (%)", "torsions (%)"), body
    )
