"""All figures and tables of the paper, and docs/paper.md, which compares the paper's claims with our numbers."""

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
#: What each picture shows, for those who cannot see it.
ALTERNATIVES = {
    "figure01": "Digits of the orientation over cost, and relative cost over the step size, for methods of order 6, 8, 10",
    "figure02": "Time of a call and error of one step of h = 5 for 100 random momenta, by method",
    "figure03": "The triangle of possible moments of inertia, with every 25th point of the grid",
    **{
        f"figure{number:02d}": f"Digits over the triangle of inertias at h = {h} for {', '.join(methods)}"
        for number, (h, methods) in triangle.FIGURES.items()
    },
    "figure12": "Energy error of heavy tops over torque evaluations for ε = 1e-6, a panel for each kinetic energy and rotor",
    "figure13": "Energy error of heavy tops over torque evaluations for ε = 1e-3, a panel for each kinetic energy and rotor",
    "figure14": "Axis and energy error of the satellite with McLachlan-Reich at two steps: errors are visible",
    "figure15": "Axis and energy error of the satellite with the exact rotor and SRKN6_14a at two steps",
    "figure16": "Energy error of 100 dipoles at rest over force evaluations, by scheme and rotor",
    "figure17": "Mean energy error of 125 dipoles over force evaluations, a panel for each energy",
    "figure18": "Largest energy error of two Nyström schemes over force evaluations, a panel for each energy",
}
INTRODUCTION = """\
# The paper, reproduced

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, *The exact computation of the free rigid body motion and its use in
splitting methods*, SIAM J. Sci. Comput. 30, 2084 (2008), doi:10.1137/070704393.

This page compares every claim of the paper about its tables and figures with numbers of this package. `make paper`
computes the numbers and writes the page, from the scripts in `benchmarks/paper` (`make paper ARGS=--stored` writes it
from the stored data in `docs/paper/data`). A verdict is computed from criteria, which are printed with every claim:

- a claim **agrees** if all criteria are met: in every draw of random starts, or by the mean over the draws within two
  standard errors;
- it **agrees in part** if some criteria are met, or if they are met in some of the draws;
- it is **exceeded** if no criterion is met because our errors are smaller;
- it **does not agree** if no criterion is met in any draw;
- it **cannot be decided** if the paper does not state what would have to be known, or if our numbers do not allow it.

The paper's words rarely contain a number. Numbers in criteria, such as "within a factor of 3", are therefore ours.
Criteria that are stricter than the paper's words are named as such and do not decide. Sentences of our own, under
"Beyond the paper", are judged in the same way and counted separately. Costs are processor times on one core and
meaningful as ratios only. No ratio that a verdict depends on compares compiled code with numpy.

"""
ERRATA = """\
## Errata

Formulas of the preprint that had to be corrected or rewritten. Each was checked numerically, by a reference of 50 digits
or by the slope of the energy error.

| place | printed | correct | evidence |
| --- | --- | --- | --- |
| (52), S4_6 | b2 = 0.143851773179818 | b2 = -0.143851773179818 | order 2 as printed, 4.00 as corrected |
| (54), SRKN6_14a | a4 = 0.314241403071477 | a4 = 0.314241403071447 | two digits exchanged; other published tables agree with the correction |
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
  satellite), use `V2_C17` if output is rare, since its corrector costs 32 evaluations per output, or `V2_gradient_C17`
  if a force gradient is available; otherwise `SABA_4` at loose and `ABA_10_6_4` at tight tolerances.
- If the potential is as large as the kinetic energy (T0 = ε, dipoles, every liquid), these schemes have no advantage.
  [Which integrator, scheme and step](which.md) has recommendations for molecules.
- With McLachlan-Reich instead of the exact flow, every scheme falls to order 2, except for compositions of Verlet steps
  (`Y4_3`, `Y6_7`, `KL8_17`), which have large error constants.
"""


def page(results):
    """Return docs/paper.md."""
    judged = [(script.TITLE, claim) for script, _, data in results for claim in script.claims(data)]
    parts = [INTRODUCTION + claims.summary(judged), ERRATA + WHEN]
    for script, pictures, data in results:
        parts.append(f"## {script.TITLE}\n")
        parts.append(f"{(script.__doc__ or '').split(chr(10) * 2, 1)[1].strip()}\n")
        for own in (False, True):
            found = [claims.entry(claim) for claim in script.claims(data) if claim.ours is own]
            parts += ["\nBeyond the paper:\n"] * bool(own and found) + found
        parts += ["", script.table(data), ""]
        parts += [f"![{ALTERNATIVES[name]}](paper/{name}.png)\n" for name in pictures]
    return "\n".join(parts).rstrip() + "\n"


def main():
    parser = argparse.ArgumentParser(description=textwrap.shorten(__doc__, 100))
    parser.add_argument("--quick", action="store_true", help="small versions, into out/paper/quick")
    parser.add_argument("--stored", action="store_true", help="judge and draw the data of the last run again")
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
