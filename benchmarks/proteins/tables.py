"""Tables of peptide.py."""

from __future__ import annotations

from benchmarks.common.markdown import distinct, rows, table

_PEPTIDE = {
    "Verlet": "`VerletIntegrator`",
    "MTSIntegrator": "`MTSIntegrator`",
    " nested with 1-4": ', `fast="bonded"`',
    " nested": ", `fast=(1,)`",
}


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
