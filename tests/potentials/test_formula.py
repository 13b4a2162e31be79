"""OpenMM's formulas and the compiled kernel are the same potential."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from force_laws import assert_lawful, evaluated, positions_of
from soft_dipoles import FIELD, arrows, assert_same, fluid
from starts import context_of

OPEN = {}
KERNELS = ("bonds", "compiled")
# A box of 64 or more dipoles is wide enough for donors and acceptors.
WIDE = {"boundary": rb.ReactionField(cutoff=1.5, switch=1.0, dielectric=7.0), "density": 0.4}


@pytest.mark.parametrize(("n", "options"), [(1, OPEN), (2, OPEN), (27, OPEN), (27, FIELD)])
def test_both_kernels_agree(n, options):
    assert_same(*(evaluated(fluid(n, kernel=kernel, **options)[0]) for kernel in KERNELS))


def test_both_kernels_agree_for_a_body_of_its_own():
    own = {"inertia": (1.0, 1.5, 2.0), "dipole": (0.3, -0.8, 0.5), "mass": 3.0, "sigma": 0.9, "epsilon": 1.7}
    assert_same(*(evaluated(fluid(27, kernel=kernel, **own)[0]) for kernel in KERNELS))


@pytest.mark.parametrize(("options", "wca"), [(OPEN, False), (FIELD, True)], ids=["open", "periodic and wca"])
def test_both_kernels_agree_for_the_stockmayer_fluid(options, wca):
    own = options | {"attraction": 0.8, "wca": wca, "sigma": 1.2 if wca else 0.9, "epsilon": 1.7}
    assert_same(*(evaluated(fluid(27, kernel=kernel, **own)[0]) for kernel in KERNELS))


@pytest.mark.parametrize(("wca", "attraction"), [(False, 2.7), (True, 2.7), (False, 0.0), (True, 0.0), (True, -1.0)])
def test_both_kernels_follow_the_parameters_of_the_context(wca, attraction):
    results = []
    for kernel in KERNELS:
        context, _ = fluid(9, kernel=kernel, attraction=0.5, wca=wca)
        context.setParameter("soft_attraction", attraction)
        context.setParameter("soft_repulsion", 1.3)
        context.setParameter("dipole_coupling", 2.1)
        results.append(evaluated(context))
    assert_same(*results)


def test_both_kernels_agree_in_a_box_whose_edges_are_changed():
    results = []
    for kernel in KERNELS:
        around = rb.ReactionField(cutoff=1.7, switch=1.0, dielectric=7.0)
        context, _ = fluid(27, kernel=kernel, boundary=around, density=0.5, sphere_cutoff=1.7)
        edges = np.array([3.6, 3.7, 3.9])
        context.setPeriodicBoxVectors(*np.diag(edges))
        if kernel == "bonds":
            for axis, edge in zip("xyz", edges, strict=True):
                context.setParameter(f"box_{axis}", edge)
        results.append(evaluated(context))
    assert_same(*results)


# -- donors and acceptors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("own", [{}, {"attraction": 0.8}, {"attraction": 0.8, "wca": True}], ids=["soft", "lj", "wca"])
def test_donors_and_acceptors_agree_with_the_compiled_kernel(own):
    own = WIDE | {"sigma": 1.1, "epsilon": 1.7, "dipole": (0.3, -0.8, 0.5)} | own
    contexts = [fluid(64, kernel=kernel, **own)[0] for kernel in ("openmm", "compiled")]
    assert isinstance(contexts[0].getSystem().getForce(0), openmm.CustomHbondForce)
    assert_same(*map(evaluated, contexts), 1e-12)


def test_donors_and_acceptors_follow_the_box_and_the_parameters_of_the_context():
    results = []
    for kernel in ("openmm", "compiled"):
        context, _ = fluid(64, kernel=kernel, attraction=0.5, sphere_cutoff=2.5, **WIDE)
        context.setPeriodicBoxVectors(*np.diag([5.3, 5.4, 5.6]))
        for name, value in (("soft_attraction", 2.7), ("soft_repulsion", 1.3), ("dipole_coupling", 2.1)):
            context.setParameter(name, value)
        results.append(evaluated(context))
    assert_same(*results, 1e-12)


def test_donors_and_acceptors_are_lawful(rng):
    x, box = arrows(8, rng)[0], 5.6  # of random lengths, which OpenMM does not know
    around = {"boundary": rb.ReactionField(cutoff=1.6, switch=1.0), "box": 3 * [box]}
    pairs = np.arange(16).reshape(8, 2).tolist()
    assert_lawful(rb.soft_dipole_force(pairs, strength=1.5, length=0.5, kernel="openmm", **around), x, 3 * [box])


def test_without_a_cutoff_openmm_takes_bonds():
    assert isinstance(fluid(2, kernel="openmm")[0].getSystem().getForce(0), openmm.CustomCompoundBondForce)


def test_a_cutoff_whose_tips_have_other_nearest_images_is_refused():
    for cutoff, fits in ((1.49, True), (1.51, False), (None, False)):
        asked = {"strength": 1.0, "length": 0.5, "box": (5.0, 6.0, 7.0), "kernel": "openmm"}
        asked["boundary"] = rb.ReactionField(cutoff=cutoff)
        if fits:
            rb.soft_dipole_force([(0, 1)], **asked)
        else:
            with pytest.raises(
                ValueError, match=r"below half the shortest edge of the box, 2.5 nm, but .* or kernel='bonds'"
            ):
                rb.soft_dipole_force([(0, 1)], **asked)


@pytest.mark.parametrize(
    ("kernel", "boundary"),
    [("openmm", WIDE["boundary"]), ("bonds", rb.ReactionField()), ("openmm", rb.Ewald(tolerance=1e-3))],
)
def test_a_barostat_is_refused_where_the_formula_needs_its_box(kernel, boundary):
    _, system, positions = rb.dipole_fluid(64, density=0.4, boundary=boundary, kernel=kernel)
    system.addForce(openmm.MonteCarloBarostat(1.0, 100.0))
    integrator = rb.ExactRigidBodyIntegrator(0.004)
    _context = context_of(system, integrator, positions)
    with pytest.raises(ValueError, match=r"a barostat changes the box, .* with kernel='compiled'"):
        integrator.step(1)


def test_the_trajectory_is_the_same_to_roundoff_growth():
    ends = []
    for kernel in KERNELS:
        context, integrator = fluid(27, kernel=kernel, trap=0.5)
        integrator.setVelocitiesToTemperature(12.0, 1)
        integrator.step(20)
        ends.append(positions_of(context))
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-11)
