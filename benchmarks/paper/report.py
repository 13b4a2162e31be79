"""All figures and tables of the paper, and pages that compare the paper's claims with our numbers.

docs/paper.md contains all verdicts, and docs/paper has a page for each table or figure.
"""

import argparse
import textwrap

from benchmarks.paper import claims, common, figure01, figure16, figure17, figure18, satellite, table1, tops, triangle

SCRIPTS = (table1, figure01, triangle, tops, satellite, figure16, figure17, figure18)
INTRODUCTION = """\
# The paper, reproduced

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, *The exact computation of the free rigid body motion and its use in
splitting methods*, SIAM J. Sci. Comput. 30, 2084 (2008), doi:10.1137/070704393.

"""
RULES = """\
## How a verdict is reached

`make paper` runs the scripts in `benchmarks/paper`, which compute the numbers and write these pages. `make paper
ARGS=--stored` writes the pages from the stored data in `docs/paper/data`. A verdict follows from criteria, which are
printed with every claim:

- a claim **agrees** if all criteria are met, either in every draw of random starts or, to within two standard errors,
  by the mean over the draws;
- it **agrees in part** if some criteria are met, or if criteria are met in some of the draws;
- it is **exceeded** if no criterion is met because our errors are smaller;
- it **does not agree** if no criterion is met in any draw;
- it **cannot be decided** if the paper does not state the required information, or if our numbers do not allow a
  decision.

The claims of the paper rarely contain a number, so the numbers in the criteria, such as "within a factor of 3", are
our choice. Criteria that are stricter than the claim are marked and do not affect the verdict. Our own statements,
under "Beyond the paper", are judged in the same way and counted separately. Costs are processor times on one core and
are meaningful only as ratios. No verdict depends on a ratio of times between compiled code and NumPy code.

"""
ERRATA = """\
## Errata

The following formulas of the preprint had to be corrected or rewritten. Each correction was checked numerically, with a
reference of 50 digits or by the slope of the energy error.

| place | printed | correct | evidence |
| --- | --- | --- | --- |
| (52), S4_6 | b2 = 0.143851773179818 | b2 = -0.143851773179818 | order 2 as printed, 4.00 as corrected |
| (54), SRKN6_14a | a4 = 0.314241403071477 | a4 = 0.314241403071447 | two digits are exchanged; other published tables agree with the correction |
| (5), (6), (14) | signs of λ, ξ2 and Π | λ has the sign of the component with dn (m1 in case (a), m3 in case (b)), also within the angle; n = (I3 - I2)/(I2 a1²) in case (a) and (I2 - I1)/(I2 a3²) in case (b); Π(φ + Nπ) = Π(φ) + 2N Π of a quarter period; the phase from atan2(sn, cn), not asin | errors of order 1 |
| (38), choice (a) | one formula | valid in case (a) only. In case (b), with μs = sign(m3) μ, n = -I3 (I2 - I1)/(I1 (I3 - I2)) and R = sqrt(1 - n): ψ = (t - t0)/I3 + (2T I3 - 1)/(I3 λ (1 - μ²)) (ΔΠ(n) - μs Δ[atan(R tan φ)/R]), atan continued by π per half turn | errors of order 1 in case (b) |
| choice (c) | one formula | case (a): n = -a3² I3/(I1 a1²) and the factor (I3 - I1)/(I1 I3 λ); case (b): the same factor with the n of choice (a), case (b) | errors of order 1 in case (b) |
| heavy top | torque (u2, -u1, 0) | ε (u2, -u1, 0) | the energy is not conserved |
| (12); section 2.4, case (b) | Y(t0) = PᵀQP; v = m/norm(m) | for a general Q0, Q = Q0 P0ᵀ Y P; v = ṁ/norm(ṁ) | the orientation is wrong |
| solution on the separatrix | m1 and m3 have one sign | their signs are independent | wrong for half of the initial values |
| section 2.2, frame | v = ṁ/norm(ṁ) | singular as ṁ goes to 0 | nan at a stationary rotation, and a loss of digits near it |
| (33), (37) | divisions by m1 and by 1 + m3 - m2² | removable singularities | needs a branch, or half angles |
| (39), Gauss's rule | "very effective" | for short steps only | largest error over 20 000 random bodies with 5 points: 1e-9 at h omega = 0.1, 1e-1 at 1 |
| 1 - k² | computed from k | from the invariants, without cancellation | all digits are lost near the separatrix |

"""
WHEN = """\
## Consequences for the choice of a scheme

- If the potential is small compared with the kinetic energy and varies slowly within a step (a perturbed free body, a
  satellite), use `SABA_4`, or `ABA_10_6_4` at tight tolerances. If output is rare, use `V2_C17` instead, whose
  corrector costs 32 force evaluations per output. If a force gradient is also available, use `V2_gradient_C17`.
- If the potential is as large as the kinetic energy (tops with T0 = ε, dipoles, liquids), these schemes have no
  advantage over schemes for any potential ([recommendations for molecules](which.md)).
- With the McLachlan-Reich rotor instead of the exact rotor, every scheme has order 2, except for compositions of Verlet
  steps (`Y4_3`, `Y6_7`, `KL8_17`), which have large error constants.
"""


def contents():
    """Return the table of contents of the sidebar."""
    pages = "\n".join(f"{common.FOLDERS[False].name}/{script.NAME}" for script in SCRIPTS)
    return f"```{{toctree}}\n:hidden:\n\n{pages}\n```\n"


def overview(results):
    """Return docs/paper.md: all verdicts, each with a link to its page, and the errata."""
    folder = common.FOLDERS[False].name
    judged = [
        (f"[{script.TITLE.split(':')[0]}]({folder}/{script.NAME}.md)", claim)
        for script, data in results
        for claim in script.claims(data)
    ]
    return "".join((INTRODUCTION, claims.summary(judged), "\n", ERRATA, WHEN, "\n", RULES, contents()))


def page(script, data):
    """Return the page of a script: what it compares, its pictures, the claims, and the numbers as a table."""
    introduction = (script.__doc__ or "").split("\n\n", 1)[1].strip()
    how = f"[How a verdict is reached](../{common.FOLDERS[False].name}.md#how-a-verdict-is-reached)."
    parts = [f"# {script.TITLE}", introduction, *pictures(script), f"## Claims of the paper\n\n{how}"]
    for own in (False, True):
        found = [claims.entry(claim) for claim in script.claims(data) if claim.ours is own]
        parts += ["## Beyond the paper"] * bool(own and found) + ["\n".join(found)] * bool(found)
    return "\n\n".join([*parts, "## Numbers", script.table(data)]) + "\n"


def pictures(script):
    """Yield the pictures of a script with their alternative texts; those of its `SHEET` as a table."""
    shown = {name: f"![{words}]({name}.png)" for name, words in script.PICTURES.items()}
    columns = getattr(script, "SHEET", {})
    yield from (picture for name, picture in shown.items() if not any(name in column for column in columns.values()))
    if columns:
        rows = zip(*columns.values(), strict=True)
        yield common.markdown(list(columns), [[shown[name] for name in row] for row in rows])


def main():
    parser = argparse.ArgumentParser(description=textwrap.shorten(__doc__, 100))
    parser.add_argument("--quick", action="store_true", help="small versions, into out/paper/quick")
    parser.add_argument("--stored", action="store_true", help="judge and draw the data of the last run again")
    args = parser.parse_args()
    folder, results = common.FOLDERS[args.quick], []
    for script in SCRIPTS:
        print(f"\n{script.TITLE}", flush=True)
        data = common.run(script, args.quick, stored=args.stored)
        (folder / f"{script.NAME}.md").write_text(page(script, data), encoding="utf-8")
        results.append((script, data))
    folder.with_suffix(".md").write_text(overview(results), encoding="utf-8")


if __name__ == "__main__":
    main()
