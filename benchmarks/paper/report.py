"""All figures and tables of the paper, and docs/paper.md, which puts the paper's claims beside our numbers."""

import argparse
import textwrap

import common
import dipoles
import figure01
import figure17
import satellite
import table1
import tops
import triangle

SECTIONS = (
    (table1, ("figure02",)),
    (figure01, ("figure01",)),
    (triangle, tuple(f"figure{k:02d}" for k in range(4, 12))),
    (tops, ("figure12", "figure13")),
    (satellite, ("figure14", "figure15")),
    (dipoles, ("figure16", "figure18")),
    (figure17, ("figure17",)),
)
INTRODUCTION = """\
# The paper, reproduced

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, *The exact computation of the free rigid body motion and its use in
splitting methods*, SIAM J. Sci. Comput. 30, 2084 (2008), doi:10.1137/070704393.

This page is written by `make paper`, from the data in `docs/paper/data`: for every table and figure the paper's claim,
our numbers, and whether they agree. Numbers are measured by the scripts in `benchmarks/paper`; the verdict is computed
from them. Times are of one run on two cores and mean something as ratios only. Where the paper compares with Matlab's
ode45 at its tolerance, our reference is a Taylor series in double-double arithmetic.

Formulas of the paper that had to be corrected to obtain what follows: the sign of b2 in S4_6 (52), two swapped digits of
a4 in SRKN6_14a (54), the torque of the heavy top (a factor ε), and the second family of orbits in (38) and in choice (c).
"""
WHEN = """\
## Which scheme, when

- The potential is small beside the kinetic energy, and changes slowly in the time of a step (a perturbed free body, a
  satellite): `V2_C17` if outputs are rare, since its corrector costs 64 evaluations an output; with a force gradient at
  hand `V2_gradient_C17`; else `SABA_4` at loose and `ABA_10_6_4` at tight tolerances.
- The potential is as large as the kinetic energy (T0 = ε; dipoles; every liquid): those schemes lose what they were
  made for. `SRKN4_6b` serves from loose to middle tolerances, `SRKN6_14a` or `S6_10` at tight ones.
- Large steps, a few evaluations in the shortest period (rigid water at 2 to 4 fs): the minimal-error schemes of low
  order, `S2_2`, `S2_3`, `W2_5`; see `rb.tune`, which measures it on your system.
- McLachlan-Reich in place of the exact flow brings every scheme down to order 2, but for compositions of Verlet steps
  (`Y4_3`, `Y6_7`, `KL8_17`), which pay with large error constants.
"""


def page(results):
    """Return docs/paper.md."""
    parts = [INTRODUCTION, summary(results), WHEN]
    for script, pictures, data in results:
        parts.append(f"## {script.TITLE}\n")
        parts.append(f"{(script.__doc__ or '').split(chr(10) * 2, 1)[1].strip()}\n")
        parts += [
            f"- *{claim.sentence}* Ours: {claim.numbers} {common.verdict(claim)}" for claim in script.claims(data)
        ]
        parts += ["", script.table(data), ""]
        parts += [f"![{name}](paper/{name}.png)\n" for name in pictures]
    return "\n".join(parts).rstrip() + "\n"


def summary(results):
    """Count the claims that hold and list those that do not."""
    claims = [(script, claim) for script, _, data in results for claim in script.claims(data)]
    agreeing = sum(claim.agrees is True for _, claim in claims)
    lines = [f"Of {len(claims)} claims, {agreeing} agree with our numbers."]
    for word, value in (("do not agree", False), ("cannot be decided", None)):
        found = [f"- {claim.sentence} ({script.TITLE})" for script, claim in claims if claim.agrees is value]
        if found:
            lines += [f"\nThese {word}:\n", *found]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=textwrap.shorten(__doc__, 100))
    parser.add_argument("--quick", action="store_true", help="small versions, into out/paper/quick")
    quick = parser.parse_args().quick
    results = []
    for script, pictures in SECTIONS:
        print(f"\n{script.TITLE}", flush=True)
        results.append((script, pictures, common.run(script, quick)))
    place = common.FOLDERS[True] / "paper.md" if quick else common.FOLDERS[False].with_suffix(".md")
    place.write_text(page(results))


if __name__ == "__main__":
    main()
