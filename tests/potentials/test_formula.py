"""OpenMM's formulas and the compiled kernel are the same potential."""

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from force_laws import assert_lawful, evaluated
from openmm_exactrb.openmm_access.platforms import DEVICES
from places import REFERENCE, device_platform
from products import in_pairs, spread_over
from soft_dipoles import FIELD, arrows, assert_same, fluid
from starts import context_of, positions_of

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


# -- other boxes ------------------------------------------------------------------------------------------------------

SHORT = {"density": 0.4, "boundary": rb.ReactionField(cutoff=1.3), "sphere_cutoff": 1.5, "perturbation": 0.1}
PRECISIONS = [
    pytest.param(("Reference", {}, 1e-12), id="Reference"),
    pytest.param(("CPU", {}, 1e-12), id="CPU"),
    pytest.param(("OpenCL", {"Precision": "double"}, 1e-12), marks=pytest.mark.opencl, id="OpenCL double"),
    pytest.param(("OpenCL", {"Precision": "single"}, 2e-5), marks=pytest.mark.opencl, id="OpenCL single"),
]


def shaken(kernel, platform="Reference", properties=None, integrator=None, n=32):
    """Return the Context of a dilute fluid, its positions (n, 5, 3) and the edge of its box."""
    _, system, positions = rb.dipole_fluid(n, attraction=1.0, kernel=kernel, **SHORT)
    integrator = integrator or openmm.VerletIntegrator(0.001)
    place = device_platform([platform]) if platform in DEVICES else openmm.Platform.getPlatform(platform)
    context = openmm.Context(system, integrator, place, properties or {})
    return context, positions._value.reshape(n, -1, 3), (n / 0.4) ** (1.0 / 3.0)


def in_box(context, x, box, images=2):
    """Return energy and forces in another box, with molecules at the same places relative to its edges.

    Molecules are in up to this many images.
    """
    rng = np.random.default_rng(3)
    edge = context.getSystem().getDefaultPeriodicBoxVectors()[0][0]._value
    moved = x.mean(axis=1, keepdims=True) @ (box / edge - np.eye(3))
    moved += rng.integers(-images, images + 1, (len(x), 1, 3)) @ box
    context.setPeriodicBoxVectors(*box)
    context.setPositions((x + moved).reshape(-1, 3))
    return evaluated(context)


@pytest.fixture(scope="module", params=PRECISIONS)
def everywhere(request):
    """Return the Context of bonds on a platform, that of the compiled kernel, positions, edge and a tolerance."""
    platform, properties, tolerance = request.param
    (bonds, x, edge), (compiled, _, _) = shaken("bonds", platform, properties), shaken("compiled")
    return bonds, compiled, x, edge, tolerance


def test_bonds_follow_the_box_of_any_context(everywhere):
    """Nobody tells the force of the box, so that every integrator, barostat, State and minimiser is served."""
    bonds, compiled, x, edge, tolerance = everywhere
    edges = [
        (1.0, 1.0, 1.0),
        (0.98, 1.0, 1.3),
        (0.9, 0.8, 0.7),
        (1.0 / 1.4, 2.09, 1.0),
        (1.13, 1.14, 1.15),
        (1.0, 2.0, 1.5),
    ]
    edges += np.random.default_rng(4).uniform(0.75, 2.09, (6, 3)).tolist()
    for factors in edges:
        box, images = edge * np.diag(factors), 2 * (tolerance < 1e-6)  # of which single precision loses digits
        found, expected = (in_box(context, x, box, images) for context in (bonds, compiled))
        assert found[0] == pytest.approx(expected[0], rel=tolerance, abs=tolerance)
        np.testing.assert_allclose(found[1], expected[1], rtol=0.0, atol=max(1e-8, tolerance * abs(expected[1]).max()))


def test_where_bonds_do_not_know_the_box_their_energy_is_no_number(everywhere):
    bonds, compiled, x, edge, tolerance = everywhere
    wrong = [
        (0.5, 0.5, 0.5),
        (1 / 3, 1 / 3, 1 / 3),
        (0.61, 1.0, 1.0),
        (1.0, 0.3, 1.0),
        (2.11, 1.0, 1.0),
        (3.0, 3.0, 3.0),
    ]
    wrong += [(0.641, 1.0, 1.0), (0.6, 0.7, 2.2), (4.0, 0.25, 1.0), (10.0, 10.0, 10.0)]  # the first is too small a box
    assert all(np.isnan(in_box(bonds, x, edge * np.diag(factors))[0]) for factors in wrong)
    known = {name: bonds.getParameter(name) for name in ("box_x", "box_y", "box_z")}
    for name in known:
        bonds.setParameter(name, 3.0 * edge)
    found, expected = (in_box(context, x, 3.0 * edge * np.eye(3), 0) for context in (bonds, compiled))
    for name, value in known.items():
        bonds.setParameter(name, value)
    assert found[0] == pytest.approx(expected[0], rel=tolerance, abs=tolerance)


@pytest.fixture(scope="module")
def of_bonds():
    return shaken("bonds", integrator=rb.ExactRigidBodyLangevinIntegrator(100.0, 1.0, 0.002))


@pytest.mark.parametrize("tilt", [1e-3, 0.02, 0.3, -0.5])
@pytest.mark.parametrize("place", [(1, 0), (2, 0), (2, 1)])
def test_bonds_refuse_a_triclinic_box(tilt, place, of_bonds):
    context, x, edge = of_bonds
    box = edge * np.eye(3)
    box[place] = tilt * edge
    energy, _ = in_box(context, x, box)
    assert np.isnan(energy)
    with pytest.raises(ValueError, match="need a rectangular box: set orthogonal box vectors"):
        context.getIntegrator().step(1)


@spread_over(
    {
        "kernel, scale, message": [
            ("bonds", 3.0, r"edges from 0.62 to 2.1 times .* not 3 times: set these parameters"),
            ("bonds", 0.6, r"edges of at least 3 nm, not 2.78\d* nm: use a larger box"),
            ("openmm", 0.9, r"edges of at least 4.6 nm, not 4.17\d* nm: use a larger box, or .* shorter cutoffs"),
        ],
        "ours": [True, False],
    }
)
def test_a_box_in_which_a_formula_is_wrong_is_refused(kernel, scale, message, ours, tmp_path):
    """By our integrators at the next step, and with one of OpenMM's by the reporter of averages."""
    kind = rb.ExactRigidBodyLangevinIntegrator if ours else openmm.LangevinMiddleIntegrator
    integrator = kind(100.0, 1.0, 0.002)
    topology, system, positions = rb.dipole_fluid(40, attraction=1.0, kernel=kernel, **SHORT)
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(positions)
    simulation.step(ours)
    simulation.context.setPeriodicBoxVectors(*(scale * 100.0 ** (1.0 / 3.0) * np.eye(3)))
    simulation.reporters += [] if ours else [rb.AverageReporter(tmp_path / "averages.csv", 1)]
    with pytest.raises(ValueError, match=message):
        simulation.step(1)


def test_a_box_that_is_too_small_for_rods_is_refused():
    _, system, positions = rb.dipole_fluid(64, density=0.4, boundary=rb.Ewald(tolerance=1e-3), kernel="openmm")
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = context_of(system, integrator, positions)
    shortest = context.getParameter("shortest_edge")
    for edge, fits in ((shortest, True), (0.999 * shortest, False)):
        context.setPeriodicBoxVectors(*(edge * np.eye(3)))
        if fits:
            integrator.step(0)
        else:
            with pytest.raises(ValueError, match="need a box with edges of at least"):
                integrator.step(0)


@in_pairs({"frequency": [1, 3], "scheme": ["BAOAB", "W2_3m"], "engine": ["host", "native"]})
def test_a_barostat_ends_a_run_where_the_box_becomes_too_small(frequency, scheme, engine):
    """OpenMM accepts trials whose energy is nan."""
    _, system, positions = rb.dipole_fluid(8, attraction=1.0, kernel="bonds", **SHORT | {"density": 0.2})
    barostat = openmm.MonteCarloBarostat(3000.0, 100.0, frequency)
    barostat.setRandomNumberSeed(5)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyLangevinIntegrator(100.0, 5.0, 0.002, scheme, engine=engine)
    context = context_of(system, integrator, positions)
    context.setVelocitiesToTemperature(100.0, 1)
    with pytest.raises(ValueError, match="need a box with edges of at least 3 nm, not 2"):
        integrator.step(5000)
    edge = context.getState().getPeriodicBoxVectors()[0][0]._value
    assert 3.0 <= edge < 4.0
    assert np.isfinite(integrator.totalEnergy()._value)
    integrator.step(0)


def test_a_barostat_moves_bonds_as_it_moves_the_compiled_kernel():
    boxes = []
    for kernel in KERNELS:
        _, system, positions = rb.dipole_fluid(40, attraction=1.0, kernel=kernel, **SHORT)
        barostat = openmm.MonteCarloBarostat(60.0, 100.0, 1)
        barostat.setRandomNumberSeed(5)
        system.addForce(barostat)
        integrator = rb.ExactRigidBodyLangevinIntegrator(100.0, 5.0, 0.004)
        integrator.setRandomNumberSeed(2)
        context = context_of(system, integrator, positions)
        context.setVelocitiesToTemperature(100.0, 1)
        volumes = []
        for _ in range(20):
            integrator.step(1)
            volumes.append(context.getState().getPeriodicBoxVolume()._value)
        boxes.append(volumes)
    assert len(set(boxes[0])) > 5
    np.testing.assert_allclose(*boxes, rtol=1e-12)


def test_the_trajectory_is_the_same_to_roundoff_growth():
    ends = []
    for kernel in KERNELS:
        context, integrator = fluid(27, kernel=kernel, trap=0.5)
        integrator.setVelocitiesToTemperature(12.0, 1)
        integrator.step(20)
        ends.append(positions_of(context))
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-11)
