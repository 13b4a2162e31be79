"""What potentials and boundaries refuse."""

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.potentials import SoftDipoles, dipole_rod_forces
from refusals import assert_refused, for_each, refused, with_options
from soft_dipoles import FIELD, PARAMETERS, fluid
from starts import context_of, positions_of

PERIODIC = [rb.ReactionField, rb.Ewald]
DIPOLES = {"arrows": [(0, 1), (2, 3)], "strength": 1.0, "length": 0.5}
RODS = {"rods": [(0, 1), (2, 3)], "centres": [4, 5], "particles": 6, "strength": 1.0, "length": 0.1}
RODS |= {"box": 3 * [5.0], "boundary": rb.Ewald(tolerance=1e-3)}
SPHERES = {"n": 64, "attraction": 1.0, "dipole": (0.0, 0.0, 1.0), "inertia": (0.3, 0.3, 0.3), "perturbation": 0.08}
SPHERES |= {"seed": 3, "boundary": rb.ReactionField(dielectric=1.0)}

# Numbers of arrows that are none are memory that a compiled kernel would read, and write forces to.


def energy_after(change, n, **options):
    context, _ = fluid(n, **{"kernel": "compiled"} | options)
    change(context)
    context.getState(energy=True)


def without_a_position():
    boundary = rb.Ewald(method="mesh", cutoff=1.5, tolerance=1e-3)
    context, integrator = fluid(64, "S2_2", boundary=boundary, density=0.5)
    x = positions_of(context)
    x[7, 1] = np.nan
    context.setPositions(x)
    integrator.step(1)


def beside_a_barostat(boundary):
    _, system, positions = rb.dipole_fluid(64, density=0.4, boundary=boundary, kernel="openmm")
    system.addForce(openmm.MonteCarloBarostat(1.0, 100.0))
    integrator = rb.ExactRigidBodyIntegrator(0.004)
    _context = context_of(system, integrator, positions)
    integrator.step(1)


@refused(
    *(
        row
        for kind in PERIODIC
        for row in with_options(
            kind,
            {},
            [
                ({"cutoff": 0.0}, "cutoff must be a positive number of nm"),
                ({"cutoff": np.nan}, "cutoff must be a positive number of nm"),
                ({"cutoff": "1 nm"}, "cutoff must be a positive number of nm"),
                ({"switch": -0.1}, "switch must be a number of at least 0"),
                ({"cutoff": 1.0, "switch": 1.0}, "switch must be below the cutoff of 1 nm, not 1 nm"),
                ({"dielectric": 0.5}, "dielectric must be at least 1"),
                ({"dielectric": np.nan}, "dielectric must be a finite number"),
            ],
        )
    ),
    *(
        row
        for kind in PERIODIC
        for row in with_options(
            lambda kind=kind, **options: kind(**options).truncation((3.0, 4.0, 5.0)),
            {},
            [
                ({"cutoff": 1.6}, "at most half the shortest edge of the box, 1.5 nm"),
                ({"switch": 1.5}, "switch must be below the cutoff of 1.5 nm"),
            ],
        )
    ),
    *for_each(lambda tolerance: rb.Ewald(tolerance=tolerance), "tolerance must be", (0.0, 0.1, np.nan, "fine")),
    *with_options(
        lambda **options: rb.Ewald(**options).getParameters(1000, (10.0, 10.0, 10.0)),
        {},
        [
            ({"method": "fast"}, "the method 'fast' is unknown"),
            ({"method": "direct", "order": 8}, "the direct sum has no mesh"),
            ({"order": 7}, "order must be an even number"),
            ({"mesh": 41}, "a mesh of 41 points along an edge has a slow Fourier transform: use 45"),
            ({"mesh": (40, 40)}, "one number of points or three"),
            ({"mesh": 8}, "at least order"),
            ({"cutoff": 6.0}, "cutoff must be at most half the shortest edge"),
            ({"mesh": 20, "cutoff": 2.0, "tolerance": 1e-6}, "above the tolerance"),
            ({"method": "mesh", "tolerance": 1e-13}, "a mesh needs a tolerance of at least"),
        ],
    ),
    *with_options(
        rb.soft_dipole_force,
        DIPOLES,
        [
            ({"strength": np.nan}, "strength must be a finite number"),
            ({"length": 0.0}, "length must be a positive number of nm"),
            ({"sigma": -1.0}, "sigma must be a positive number of nm"),
            ({"epsilon": -1.0}, "epsilon must be a number of at least 0"),
            ({"attraction": np.nan}, "attraction must be a finite number"),
            ({"wca": True}, "wca=True needs an energy with a minimum: set attraction and epsilon to positive"),
            ({"wca": True, "attraction": 1.0, "epsilon": 0.0}, "set attraction and epsilon to positive"),
            ({"kernel": "fortran"}, "the kernel 'fortran' is unknown"),
            ({"boundary": "ewald"}, "boundary must be one of"),
            ({"boundary": rb.Ewald}, "boundary must be one of"),
            ({"boundary": rb.ReactionField()}, "needs a periodic box"),
            ({"boundary": rb.Ewald()}, "needs a periodic box"),
            ({"box": (2.0, 2.0, 2.0)}, "box= needs a periodic boundary"),
            ({"box": (2.0, 2.0), "boundary": rb.ReactionField()}, "three positive edges"),
            ({"box": 2.0, "boundary": rb.ReactionField()}, "three positive edges"),
            ({"box": (2.0, 2.0, 2.0) * unit.nanometer, "boundary": rb.ReactionField()}, "without a unit"),
            ({"box": (2.0, 2.0, 0.0), "boundary": rb.ReactionField()}, "each edge of the box"),
        ],
    ),
    *(
        row
        for kernel in ("compiled", "openmm")
        for row in with_options(
            rb.soft_dipole_force,
            DIPOLES | {"kernel": kernel},
            [
                ({"arrows": arrows}, sentence)
                for arrows, sentence in [
                    ([(0, 1, 2), (3, 4, 5)], r"a pair of particles.* not \(0, 1, 2\)"),
                    ([(0,), (1,)], "a pair of particles"),
                    ([(0, 1), (-1, 3)], "a pair of particles"),
                    ([(0, 1), (0, 3)], "particle 0 occurs twice in the arrows"),
                    ([(0, 0)], "particle 0 occurs twice in the arrows"),
                    ([0, 1], "arrows must be lists of particle indices"),
                    ([(0.0, 1.0)], "arrows must be lists of particle indices"),
                    ([], "at least one arrow"),
                ]
            ],
        )
    ),
    *with_options(
        rb.dipole_fluid,
        {"n": 27, "boundary": rb.Ewald()},
        [
            ({"kernel": "bonds"}, "only the compiled kernel computes an Ewald sum"),
            ({"kernel": "fortran"}, "the kernel 'fortran' is unknown"),
            ({"boundary": rb.Ewald(switch=0.0)}, "start the switch at a larger distance"),
            ({"boundary": rb.Ewald(switch=0.02)}, "waves, more than 1e\\+06"),
        ],
    ),
    (
        lambda: SoftDipoles(None, (1.0, 1.0, 1.0)).energy_and_forces(np.zeros((2, 3)), PARAMETERS),
        "needs a periodic box",
    ),
    *with_options(
        dipole_rod_forces,
        RODS,
        [
            (
                {"boundary": rb.Ewald(tolerance=9e-5)},
                r"must be at least 0.0001, not 9e-05: .* kernel='compiled'",
            ),
            ({"boundary": rb.Ewald(dielectric=4.0)}, "an infinite dielectric"),
            ({"boundary": rb.ReactionField()}, "need boundary=Ewald"),
            (
                {"boundary": rb.Ewald(cutoff=2.0), "length": 0.6},
                "must be below half the shortest edge of the box, 2.5 nm: use a larger box, a shorter cutoff",
            ),
            ({"boundary": rb.Ewald(cutoff=2.6)}, "at most half the shortest edge of the box"),
            ({"length": 0.0}, "length must be a positive"),
            ({"strength": np.nan}, "strength must be a finite number"),
            ({"wca": True}, "wca=True needs an energy with a minimum: set attraction and epsilon to positive"),
            ({"rods": [(0, 1, 2)]}, r"each rod must be a pair of particles \(plus, minus\)"),
            ({"rods": []}, "at least one rod"),
            ({"particles": 3}, "particles must be"),
            ({"centres": [4]}, "the length must be 2, not 1"),
        ],
    ),
    *with_options(
        rb.dipole_fluid,
        SPHERES,
        [
            (
                {"sphere_cutoff": 5.0},
                "sphere_cutoff must be at most half the shortest edge of the box, .* a larger box",
            ),
            ({"sphere_cutoff": 0.0}, "sphere_cutoff must be a positive number of nm"),
            ({"sphere_cutoff": 2.0, "sphere_switch": 2.0}, "sphere_switch must be below the sphere_cutoff of 2 nm"),
            ({"wca": True, "shifted": True}, "wca=True already shifts the energy .* omit shifted"),
            ({"wca": True, "long_range_correction": True}, "without wca: omit long_range_correction="),
            ({"wca": True, "sphere_cutoff": 1.2}, "before the minimum of their energy at 1.12246 nm"),
            ({"boundary": rb.Open(), "sphere_cutoff": 2.0}, "need a periodic box"),
            ({"boundary": rb.Open(), "long_range_correction": True}, "needs a periodic box and spheres"),
        ],
    ),
    *(
        (lambda change=change, fluid=fluid: energy_after(change, **fluid), sentence, Exception)
        for change, fluid, sentence in [
            (
                lambda context: context.setPeriodicBoxVectors(*np.diag([3.5, 3.6, 3.9])),
                {"n": 27} | FIELD,
                r"sphere_cutoff must be at most half the shortest edge .* a barostat may shrink",
            ),
            (
                lambda context: context.setPeriodicBoxVectors([4.0, 0, 0], [0.5, 4.0, 0], [0, 0, 4.0]),
                {"n": 27} | FIELD,
                "rectangular",
            ),
            (
                lambda context: context.setParameter("soft_repulsion", 0.0),
                {"n": 9, "attraction": 1.0, "wca": True},
                "soft_repulsion must be positive",
            ),
            (
                lambda context: context.setPeriodicBoxVectors(*np.diag([7.2, 10.0, 10.0])),
                {"n": 64, "boundary": rb.Ewald(order=16, tolerance=1e-2), "density": 0.05},
                r"the box, 7.2 nm, is too short .* do not fit into 15 points",
            ),
        ]
    ),
    (without_a_position, "the position of particle 7 is not finite: set finite positions"),
    *for_each(
        beside_a_barostat,
        r"a barostat changes the box, .* with kernel='compiled'",
        [rb.ReactionField(cutoff=1.5, switch=1.0, dielectric=7.0), rb.Ewald(tolerance=1e-3)],
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
