"""Parameters by OpenMM's C interface are those that its Python functions return."""

import numpy as np
import openmm
import pytest
from openmm import unit

from bonded_terms import FORMS, system_of
from openmm_exactrb.multiple_time_steps.bonded import Bonded
from openmm_exactrb.openmm_access import parameters
from peptides import peptide
from starts import force_of


def flat(values):
    """Return the numbers of a term, with those of its tuple or array."""
    return [number for value in values for number in np.ravel(getattr(value, "_value", value))]


@pytest.mark.parametrize("make", FORMS)
def test_terms_are_those_of_the_force(make):
    force = make()
    what = "Torsion" if hasattr(force, "getNumTorsions") else "Angle" if hasattr(force, "getNumAngles") else "Bond"
    count, get = getattr(force, f"getNum{what}s")(), getattr(force, f"get{what}Parameters")
    whole, numbers = parameters.terms(force)
    np.testing.assert_array_equal(np.hstack([whole, numbers]), [flat(get(i)) for i in range(count)])
    some = np.arange(count) % 3 == 0
    thinned = Bonded(force, whole, numbers).chosen(some).made()
    np.testing.assert_array_equal(np.hstack(parameters.terms(thinned)), np.hstack([whole, numbers])[some])
    before, after = (openmm.XmlSerializer.serialize(system_of(of)) for of in (force, Bonded.of(force).made()))
    assert after == before


def test_exceptions_constraints_and_masses_are_those_of_the_system():
    _, system, _ = peptide()
    nonbonded = force_of(system)
    exceptions = map(nonbonded.getExceptionParameters, range(nonbonded.getNumExceptions()))
    np.testing.assert_array_equal(np.hstack(parameters.exceptions(nonbonded)), [flat(values) for values in exceptions])
    constraints = map(system.getConstraintParameters, range(system.getNumConstraints()))
    found = np.column_stack(parameters.constraints(system))
    np.testing.assert_array_equal(found, [flat(values) for values in constraints])
    masses = [system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles())]
    np.testing.assert_array_equal(parameters.masses(system), masses)


def test_a_system_without_any_has_empty_arrays():
    assert [part.shape for part in parameters.constraints(openmm.System())] == [(0, 2), (0,)]
    assert parameters.masses(openmm.System()).shape == (0,)
    assert [part.shape for part in parameters.terms(openmm.CMAPTorsionForce())] == [(0, 9), (0, 0)]
