"""Tables of the coefficients of schemes with their sources, and the lookup of schemes by name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from types import MappingProxyType

from openmm_exactrb.schemes.generated import composition, corrected, saba, sbab
from openmm_exactrb.schemes.gradients import (
    FORCE_GRADIENT,
    MAGNIFICATION,
    TAKAHASHI_IMADA,
    TAKAHASHI_IMADA_PAIR,
    force_gradient,
)
from openmm_exactrb.schemes.scheme import Scheme, processed, symmetric
from openmm_exactrb.schemes.thermostatted import WITH_THERMOSTAT
from openmm_exactrb.steps.sequence import Sequence
from openmm_exactrb.steps.substeps import DRIFT, KICK, LastForcesKick
from openmm_exactrb.support.messages import shown

_VERLET = "L. Verlet, Phys. Rev. 159, 98 (1967), doi:10.1103/PhysRev.159.98"
_MCLACHLAN = "R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995), doi:10.1137/0916010"
_HMC = "S. Blanes, F. Casas and J. M. Sanz-Serna, SIAM J. Sci. Comput. 36, A1556 (2014), doi:10.1137/130932740"
# Found by random searches and Nelder-Mead minimisation of the energy error of droplets of rigid water, from initial
# states that no other benchmark uses: benchmarks/schemes/search.py.
_TUNED = "openmm-exactrb, tuned on rigid water at {} fs per force evaluation"
# The scheme with equal shadow energies of fast and slow modes at 4 to 6 fs per force evaluation, among schemes with
# three force evaluations that are stable beyond half a period of an oscillator: benchmarks/water/shadow.py.
_EQUIPARTITION = "openmm-exactrb, for equipartition of rigid water at 4 to 6 fs per force evaluation"
# Least-squares fit of momenta and positions to the canonical distribution, for modes of 40 to 220/ps:
# benchmarks/water/shadow.py.
_CANONICAL = "openmm-exactrb, for the canonical distribution of rigid water at 4 fs per force evaluation"
# Changes of coordinates that remove all of a kernel's error that such a change can remove, for the frequencies of rigid
# water: benchmarks/schemes/processors.py.
_PROCESSOR = "{}; the processor is of openmm-exactrb"
_OMELYAN = (
    "I. P. Omelyan, I. M. Mryglod and R. Folk, Comput. Phys. Commun. 146, 188 (2002), doi:10.1016/S0010-4655(02)00451-4"
)
_BLANES_MOAN = "S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002), doi:10.1016/S0377-0427(01)00492-7"

_YOSHIDA = "H. Yoshida, Phys. Lett. A 150, 262 (1990), doi:10.1016/0375-9601(90)90092-3"
_KAHAN_LI = "W. Kahan and R.-C. Li, Math. Comput. 66, 1089 (1997), doi:10.1090/S0025-5718-97-00873-9"
_PLANETS = "S. Blanes et al., Appl. Numer. Math. 68, 58 (2013), doi:10.1016/j.apnum.2013.01.003"


def _kicks_of_pairs(new: float, last: tuple[float, ...], gradients: tuple[float, ...]) -> Sequence:
    """Return the kicks of an output at one position, by new forces, the last forces and the last force-gradient terms.

    The terms are those of `TAKAHASHI_IMADA_PAIR`, whose displaced forces are magnified with alternating signs.
    """
    differences = tuple(w * (-1.0) ** (k + 1) * MAGNIFICATION for k, w in enumerate(gradients))
    kicks: Sequence = ((KICK, new),) if new else ()
    return *kicks, (LastForcesKick(last, differences), 1.0)


_V2_DRIFT = symmetric("V2_drift", order=2, stages=1, first="drift", reference=_VERLET)

# Map from the inner coordinates to the output, computed from the forces of the last kicks:
# benchmarks/schemes/outputs.py.
_OUTPUT_OF_PAIRS = (
    (DRIFT, -0.25),
    *_kicks_of_pairs(
        0.0,
        (-0.007447901427528911, -0.1181713330577214, 0.0428294257517002, -0.0047240486471881405),
        (-0.6331805086302936, 0.2747037176496458, -0.2059795965560527),
    ),
    (DRIFT, -0.0744),
    *_kicks_of_pairs(
        0.052109225260373156,
        (-0.06566526660321423, 0.08698891577240142, -0.02798798959499058, 0.0023419322920116654),
        (0.5902076811589286, -0.3646383185309654, 0.21747100975141356),
    ),
    (DRIFT, 0.4261),
    *_kicks_of_pairs(
        0.039187035066509016,
        (-0.016146143332472968, 0.027801309240057515, -0.013166933201644533, 0.002051772481707798),
        (0.06903329115113452, 0.06315950119000789, -0.003474179618056593),
    ),
    (DRIFT, -0.1017),
)

_SCHEMES = (
    symmetric("V2", order=2, stages=1, first="kick", reference=_VERLET),
    _V2_DRIFT,
    symmetric("S2_2", order=2, stages=2, first="kick", b=(0.1931833275037836,), reference=_MCLACHLAN),
    symmetric("S2_3", order=2, stages=3, first="kick", a=(0.29619504261126,), b=(0.11888010966548,), reference=_HMC),
    # A scheme between Lobatto's rule of four points and S2_3, which touches the stability bound at half a period
    # without crossing it. The temperatures of momenta and of positions are nearly equal for all modes of rigid water.
    symmetric(
        "W2_3", order=2, stages=3, first="kick", a=(0.28764,), b=(0.10371431720489364,), reference=_EQUIPARTITION
    ),
    symmetric(
        "S2_4",
        order=2,
        stages=4,
        first="kick",
        a=(0.1916678,),
        b=(0.071353913450279725904, 0.268548791161230105820),
        reference=_HMC,
    ),
    symmetric("W2_4", order=2, stages=4, first="drift", a=(0.08284, 0.27988), b=(0.21647,), reference=_TUNED.format(4)),
    symmetric(
        "W4_5",
        order=4,
        stages=5,
        kind="nystroem",
        first="kick",
        a=(0.254, -0.0365),
        b=(0.08477656200969587785212352836804759, 0.65654407453874424357010313964426243),
        reference=_TUNED.format(1),
    ),
    # A variant of SRKN4_6b with a smaller error at long steps.
    symmetric(
        "W4_6",
        order=4,
        stages=6,
        kind="nystroem",
        first="kick",
        a=(0.24584, 0.60817),
        b=(0.08367, 0.3914955154373213, -0.036229470113921206),
        reference=_TUNED.format(0.5),
    ),
    symmetric(
        "PEFRL",
        order=4,
        stages=4,
        first="drift",
        a=(0.1786178958448091, -0.06626458266981849),
        b=(0.5 + 0.2123418310626054,),
        reference=_OMELYAN,
    ),
    symmetric(
        "S4_6",
        order=4,
        stages=6,
        first="drift",
        a=(0.07920369643119565, 0.353172906049774, -0.04206508035771952),
        b=(0.209515106613362, -0.143851773179818),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "S6_10",
        order=6,
        stages=10,
        first="drift",
        a=(0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780),
        b=(0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN4_6b",
        order=4,
        stages=6,
        kind="nystroem",
        first="kick",
        a=(0.245298957184271, 0.604872665711080),
        b=(0.0829844064174052, 0.396309801498368, -0.0390563049223486),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN6_11b",
        order=6,
        stages=11,
        kind="nystroem",
        first="kick",
        a=(0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928),
        b=(0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN6_14a",
        order=6,
        stages=14,
        kind="nystroem",
        first="drift",
        a=(
            0.0378593198406116,
            0.102635633102435,
            -0.0258678882665587,
            0.314241403071447,
            -0.130144459517415,
            0.106417700369543,
            -0.00879424312851058,
        ),
        b=(
            0.09171915262446165,
            0.183983170005006,
            -0.05653436583288827,
            0.004914688774712854,
            0.143761127168358,
            0.328567693746804,
        ),
        reference=_BLANES_MOAN,
    ),
    composition("Y4_3", order=4, stages=3, steps=(1.0 / (2.0 - 2.0 ** (1.0 / 3.0)),), reference=_YOSHIDA),
    composition(
        "Y6_7",
        order=6,
        stages=7,
        steps=(0.78451361047755726382, 0.23557321335935813368, -1.17767998417887100695),
        reference=_YOSHIDA,
    ),
    composition(
        "KL8_17",
        order=8,
        stages=17,
        steps=(
            0.13020248308889008087881763,
            0.56116298177510838456196441,
            -0.38947496264484728640807860,
            0.15884190655515560089621075,
            -0.39590389413323757733623154,
            0.18453964097831570709183254,
            0.25837438768632204729397911,
            0.29501172360931029887096624,
        ),
        reference=_KAHAN_LI,
    ),
    *(saba(n) for n in (2, 3, 4)),
    *(sbab(n) for n in (2, 3, 4)),
    symmetric(
        "ABA_8_4",
        order=4,
        stages=5,
        first="drift",
        a=(0.07534696026989288842, 0.51791685468825678230),
        b=(0.19022593937367661925, 0.84652407044352625706),
        reference=_PLANETS,
        generalised=(8, 4),
    ),
    symmetric(
        "ABA_8_6_4",
        order=4,
        stages=7,
        first="drift",
        a=(
            0.0711334264982231177779387300061549964174,
            0.241153427956640098736487795326289649618,
            0.521411761772814789212136078067994229991,
        ),
        b=(
            0.183083687472197221961703757166430291072,
            0.310782859898574869507522291054262796375,
            -0.0265646185119588006972121379164987592663,
        ),
        reference=_PLANETS,
        generalised=(8, 6, 4),
    ),
    symmetric(
        "ABA_10_6_4",
        order=4,
        stages=8,
        first="drift",
        a=(
            0.03809449742241219545697532230863756534060,
            0.1452987161169137492940200726606637497442,
            0.2076276957255412507162056113249882065158,
            0.4359097036515261592231548624010651844006,
        ),
        b=(
            0.09585888083707521061077150377145884776921,
            0.2044461531429987806805077839164344779763,
            0.2170703479789911017143385924306336714532,
        ),
        reference=_PLANETS,
        generalised=(10, 6, 4),
    ),
    corrected(_V2_DRIFT, 8, "V2_C17", (18, 2)),
    *FORCE_GRADIENT,
    # Coefficients near those of the fourth-order scheme of this pattern with the smallest error constant.
    force_gradient("W2_5", "BACACAB", order=2, a=(0.28756,), b=(0.09363,), e=(0.01434,), reference=_TUNED.format(2)),
    # The scheme of this pattern whose shadow energy is nearest to the energy for all modes of rigid water at 4 fs per
    # force evaluation.
    force_gradient("W2_4g", "ABACABA", order=2, a=(0.08209,), b=(0.24119,), e=(0.025308,), reference=_CANONICAL),
    processed(
        _V2_DRIFT,
        "W2_1",
        order=2,
        a=(-0.2918450971448247, 0.133039607048561, 0.5269587335607733),
        b=(0.35848759687146087, -0.5502314684170239, -0.12290886225067651),
        output=(
            (DRIFT, -0.5),
            (LastForcesKick((-0.15193744468101933, 0.14253477174144466, -0.0532982249395243)), 1.0),
            (DRIFT, 1.0),
            (LastForcesKick((0.24569831976847284, -0.2687832970183045, 0.08578587512893061)), 1.0),
            (DRIFT, -0.5),
        ),
        reference=_PROCESSOR.format(_VERLET),
    ),
    processed(
        TAKAHASHI_IMADA_PAIR,
        "W4_4",
        order=4,
        a=(0.02714539223837513, -0.25270300298574777, 0.13444330399888596, -0.20566323079399654),
        b=(-0.10163873472468118, 0.21121696046811567, -0.06378770240239598, -0.11514340878370852),
        output=_OUTPUT_OF_PAIRS,
        output_of_rigid=True,
        reference=_PROCESSOR.format(TAKAHASHI_IMADA.reference),
    ),
    # The kick of h V - (h³/24) f . M^-1 f leaves no other error of the order h².
    corrected(TAKAHASHI_IMADA, 8, "V2_gradient_C17", (18, 4)),
)

#: All schemes by name; `scheme` also returns SABA_n and SBAB_n for every n up to 99.
CATALOGUE: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in _SCHEMES})


def scheme(name: str | Scheme) -> Scheme:
    """Return the scheme with a name, or a `Scheme` unchanged; raise ValueError if the name is unknown."""
    if name in [*WITH_THERMOSTAT]:
        raise ValueError(
            f"scheme {name} contains a thermostat: use it with an integrator that has one, such as "
            "ExactRigidBodyLangevinIntegrator (exactrb run --ensemble nvt or npt)"
        )
    return _found(name, CATALOGUE)


def scheme_for_thermostat(name: str | Scheme) -> Scheme:
    """Return a scheme of `CATALOGUE` or of `WITH_THERMOSTAT`, in the same way as `scheme`."""
    return _found(name, {**WITH_THERMOSTAT, **CATALOGUE})


def splitting(name: str | Scheme) -> Scheme:
    """Return a scheme of `CATALOGUE` or of `WITH_THERMOSTAT` for use with a thermostat.

    A ValueError is raised if the name is unknown, or if the scheme is processed, because a thermostat acts on the true
    state at every step.
    """
    found = scheme_for_thermostat(name)
    if found.processor:
        raise ValueError(
            f"scheme {found.name} runs in inner coordinates, but a thermostat acts on the true state at every step: "
            "choose a scheme without a processor, such as W2_3m"
        )
    return found


def _found(name: str | Scheme, schemes: Mapping[str, Scheme]) -> Scheme:
    """Return a given, listed or generated scheme; raise ValueError with the closest name if the name is unknown."""
    if isinstance(name, Scheme):
        return name
    if not isinstance(name, str):
        raise ValueError(
            f'a scheme must be a name in openmm_exactrb.SCHEMES, such as "W4_4", or a Scheme, not {shown(name)}'
        )
    if name in schemes:
        return schemes[name]
    if generated := re.fullmatch(r"S(ABA|BAB)_([1-9]\d?)", name):
        return (saba if generated[1] == "ABA" else sbab)(int(generated[2]))
    meant = _meant(name, schemes)
    hint = f": did you mean {meant!r}? A" if meant else ": a"
    more = " and openmm_exactrb.schemes.WITH_THERMOSTAT" if len(schemes) > len(CATALOGUE) else ""
    raise ValueError(f"the scheme {name!r} is unknown{hint}ll names are in openmm_exactrb.SCHEMES{more}")


def _meant(name: str, schemes: Mapping[str, Scheme]) -> str | None:
    """Return the name closest to an unknown one: the cheapest scheme of its family, the most similar name, or None."""
    by_capitals = {known.upper(): known for known in schemes}
    family = [known for capitals, known in by_capitals.items() if capitals.startswith(f"{name.upper()}_")]
    if family and name.upper() not in by_capitals:
        return min(family, key=lambda known: schemes[known].forces)
    return next((by_capitals[near] for near in difflib.get_close_matches(name.upper(), by_capitals, 1)), None)
