"""All figures and tables of the paper, and docs/paper.md, which puts the paper's claims beside our numbers."""

import argparse
import textwrap

import claims
import common
import figure01
import figure16
import figure17
import figure18
import satellite
import table1
import tops
import triangle

SECTIONS = (
    (table1, ("figure02",)),
    (figure01, ("figure01",)),
    (triangle, tuple(f"figure{k:02d}" for k in range(3, 12))),
    (tops, ("figure12", "figure13")),
    (satellite, ("figure14", "figure15")),
    (figure16, ("figure16",)),
    (figure17, ("figure17",)),
    (figure18, ("figure18",)),
)
INTRODUCTION = """\
# The paper, reproduced

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, *The exact computation of the free rigid body motion and its use in
splitting methods*, SIAM J. Sci. Comput. 30, 2084 (2008), doi:10.1137/070704393.

This page is written by `make paper`, from the data in `docs/paper/data` (`make paper ARGS=--stored` writes it from the
data that are there): for every table and figure the paper's claims, our numbers, and whether they agree. Numbers are measured by the scripts in `benchmarks/paper`. Each claim is followed by
the criteria that it is judged by, and the verdict is computed from them and from nothing else:

- it **agrees** if all its criteria are met, in every draw of random starts where there are several;
- it **agrees in part** if some are met, or are met in some of the draws;
- it **does not agree** if none is met in any draw;
- it **cannot be decided** where the paper does not say what would have to be known.

Criteria with a number, such as "within a factor of 3", are ours: the paper's words leave them open. Sentences of our own,
under "Beyond the paper", are judged in the same way and counted apart. Costs are processor times on one core and mean
something as ratios only. A ratio never compares compiled code with numpy.

Formulas of the paper that had to be corrected to obtain what follows: the sign of b2 in S4_6 (52), two swapped digits of
a4 in SRKN6_14a (54), the torque of the heavy top (a factor ε), and the second family of orbits in (38) and in choice (c).
"""
WHEN = """\
## Which scheme, when

- The potential is small beside the kinetic energy, and changes slowly in the time of a step (a perturbed free body, a
  satellite): `V2_C17` if outputs are rare, since its corrector costs 64 evaluations per output; with a force gradient at
  hand `V2_gradient_C17`; else `SABA_4` at loose and `ABA_10_6_4` at tight tolerances.
- The potential is as large as the kinetic energy (T0 = ε; dipoles; every liquid): those schemes lose what they were
  made for. `SRKN4_6b` serves from loose to middle tolerances, `SRKN6_14a` or `S6_10` at tight ones.
- Large steps, a few evaluations in the shortest period (rigid water): `W2_1` at 4 fs per force, `W4_4` at 2 fs; where
  one looks often, `S2_3` at 4 fs and `W2_5` at 2 fs. `rb.tune` measures it on your system.
- McLachlan-Reich in place of the exact flow brings every scheme down to order 2, but for compositions of Verlet steps
  (`Y4_3`, `Y6_7`, `KL8_17`), which pay with large error constants.
"""


def page(results):
    """Return docs/paper.md."""
    judged = [(script.TITLE, claim) for script, _, data in results for claim in script.claims(data)]
    parts = [INTRODUCTION, claims.summary(judged), WHEN]
    for script, pictures, data in results:
        parts.append(f"## {script.TITLE}\n")
        parts.append(f"{(script.__doc__ or '').split(chr(10) * 2, 1)[1].strip()}\n")
        for own in (False, True):
            found = [claims.entry(claim) for claim in script.claims(data) if claim.ours is own]
            parts += ["\nBeyond the paper:\n"] * bool(own and found) + found
        parts += ["", script.table(data), ""]
        parts += [f"![{name}](paper/{name}.png)\n" for name in pictures]
    return "\n".join(parts).rstrip() + "\n"


def main():
    parser = argparse.ArgumentParser(description=textwrap.shorten(__doc__, 100))
    parser.add_argument("--quick", action="store_true", help="small versions, into out/paper/quick")
    parser.add_argument("--stored", action="store_true", help="judge and draw the data of the last run anew")
    args = parser.parse_args()
    quick = args.quick
    results = []
    for script, pictures in SECTIONS:
        print(f"\n{script.TITLE}", flush=True)
        results.append((script, pictures, common.run(script, quick, stored=args.stored)))
    place = common.FOLDERS[True] / "paper.md" if quick else common.FOLDERS[False].with_suffix(".md")
    place.write_text(page(results), encoding="utf-8")


if __name__ == "__main__":
    main()
