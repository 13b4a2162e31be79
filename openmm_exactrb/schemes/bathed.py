"""Splittings with a heat bath within them: what integrators with a bath take beside the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import BATH, DRIFT, KICK, Word, spelled

_PARTICLES = "B. Leimkuhler and C. Matthews, J. Chem. Phys. 138, 174102 (2013), doi:10.1063/1.4802990, for particles"
_MIDDLE = "Z. Zhang et al., J. Phys. Chem. A 123, 6056 (2019), doi:10.1021/acs.jpca.9b02771, for particles"
_CANONICAL = "openmm-exactrb, for equipartition and the density of rigid water at 4 to 6 fs per force evaluation"


def _three_kicks(outer: float) -> Word:
    """Return three kicks about a drift with a bath in its middle; a step ends between the bath and the first kick.

    Of the drifts `outer` is the one on each side of the bath. Of the kicks the middle one has the part with which the
    step touches the bound of stability at half a period of an oscillator, and does not cross it.
    """
    inner, middle = 0.5 - outer, (1.0 - 4.0 * outer) / (2.0 - 6.0 * outer)
    kick = 0.5 * (1.0 - middle)
    bath = (DRIFT, outer), (BATH, 1.0), (DRIFT, outer)
    return (KICK, kick), (DRIFT, inner), (KICK, middle), (DRIFT, inner), (KICK, kick), *bath


#: Splittings with a bath within them, by name. Those of Leimkuhler and Matthews need one force per step, as does BAOA,
#: the word of OpenMM's LangevinMiddleIntegrator. With an outer drift of 0.135 the momenta of W2_3m next to the bath are
#: canonical within half a percent up to 160/ps at 6 fs per force: tests/schemes/test_bathed.py.
WITH_BATH: Mapping[str, Scheme] = MappingProxyType(
    {
        scheme.name: scheme
        for scheme in (
            Scheme("BAOAB", 2, spelled("B A O A B"), reference=_PARTICLES),
            Scheme("ABOBA", 2, spelled("A B O B A"), reference=_PARTICLES),
            Scheme("BAOA", 2, spelled("B A O A"), reference=_MIDDLE),
            Scheme("W2_3m", 2, _three_kicks(0.135), reference=_CANONICAL),
        )
    }
)
