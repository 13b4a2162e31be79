"""Groups of forces that inner steps cannot evaluate."""

import openmm

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.sequence import spelled
from peptides import moving, peptide
from refusals import assert_refused, refused


def all_groups():
    _, system, x = peptide()
    rb.separate_bonded(system)
    moving(system, x, fast=(0, 1))


def group_with_a_kick():
    """It would act twice."""
    system = openmm.System()
    system.addParticle(1.0)
    for group, energy in ((0, "0*y"), (1, "50*x^2")):
        force = openmm.CustomExternalForce(energy)
        force.addParticle(0)
        force.setForceGroup(group)
        system.addForce(force)
    groups = Scheme("groups", 2, spelled("B0 B1 A B1 B0"))
    integrator, _context = moving(system, [[0.1, 0.0, 0.0]], 0.001, groups, fast=(1,), innerSteps=2)
    integrator.step(1)


@refused(
    (all_groups, "fast= names all forces"),
    (group_with_a_kick, "a kick with force group 1 alone, but fast= also names this group"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
