"""What functions that make Systems refuse."""

from functools import partial

import numpy as np
from openmm import app, unit
from test_ellipsoids import X, Z, pair

import openmm_exactrb as rb
from openmm_exactrb.potentials import GayBerne
from openmm_exactrb.systems.fluids import rigid_sites
from peptides import peptide
from refusals import assert_refused, refused, with_options


def without_elements():
    topology, system, _ = peptide()
    bare = app.Topology()
    residue = bare.addResidue("ACE", bare.addChain())
    atoms = [bare.addAtom(atom.name, None, residue) for atom in topology.atoms()]
    for first, second in topology.bonds():
        bare.addBond(atoms[first.index], atoms[second.index])
    rb.heavy_hydrogens(system, bare)


@refused(
    *with_options(
        rb.dipole_fluid,
        {"n": 2},
        [
            ({"n": 0}, "n must be a whole number of at least 1, not 0"),
            ({"n": 2.5}, "n must be a whole number"),
            ({"spacing": -1.0}, "spacing must be a positive number of nm"),
            ({"sigma": float("nan")}, "sigma must be a positive number of nm"),
            ({"epsilon": 0.0}, "epsilon must be a positive number of kJ/mol"),
            ({"mass": -1.0}, "mass must be a positive number of amu"),
            ({"perturbation": -0.1}, "perturbation must be a number of at least 0"),
            ({"trap": float("inf")}, "trap must be a number of at least 0"),
            ({"dipole": (0.0, 0.0, 0.0)}, "non-zero vector"),
            ({"dipole": (1.0, 0.0)}, "three finite numbers"),
            ({"dipole": 1.0}, "three finite numbers"),
            ({"dipole": 3.0 * unit.kelvin}, "three finite numbers"),
            ({"dipole": (1.0, 0.0, 0.0) * unit.nanometer}, "is not a dipole moment"),
            ({"inertia": (1.0, 1.0, 3.0)}, "at most the sum of the other two"),
            ({"inertia": (1.0, 1.0, 0.0)}, "three positive moments"),
            ({"inertia": (1.0, 1.0)}, "three positive moments"),
            ({"density": 0.8}, "density needs a periodic box: add boundary="),
            ({"boundary": rb.ReactionField(), "density": -1.0}, "density must be a positive number"),
            ({"boundary": rb.ReactionField(), "trap": 0.5}, "not to a periodic liquid: omit trap="),
            ({"boundary": rb.ReactionField(cutoff=10.0)}, "at most half the shortest edge of the box"),
            ({"boundary": "periodic"}, "boundary must be one of"),
        ],
    ),
    *with_options(
        rb.ellipsoids,
        {},
        [
            ({"n": 0}, "n must be a whole number"),
            ({"kappa": -1.0}, "kappa must be a positive number"),
            ({"kappa_prime": 0.0}, "kappa_prime must be a positive number"),
            ({"mass": float("nan")}, "mass must be a positive number of amu"),
            ({"sigma": 1.0 * unit.kelvin}, "sigma must be a positive number of nm"),
            ({"epsilon": -1.0}, "epsilon must be a positive number of kJ/mol"),
            ({"density": 0.0}, "density must be a positive number"),
            ({"density": 0.7, "cutoff": 3.0}, "do not fit on a lattice"),
            ({"n": 100}, "at most half the edge of the box, .* use more ellipsoids"),
            ({"cutoff": -1.0}, "cutoff must be a positive number of nm"),
            ({"switch": 4.5}, "must be below the cutoff"),
            ({"seed": 1.5}, "the seed must be a whole number of at least 0"),
            ({"seed": None}, "the seed must be a whole number of at least 0"),
        ],
    ),
    *with_options(
        rb.rigid_water,
        {},
        [
            ({"n": 2, "model": "tip2p"}, "choose one of tip3p, spce"),
            ({"n": 0}, "n must be a whole number of at least 1"),
        ],
    ),
    *with_options(
        rb.exclude_within,
        {"system": rb.rigid_water(8)[1]},
        [
            ({"bodies": bodies}, sentence)
            for bodies, sentence in [
                ([[0, 1], [1, 2]], "particle 1 is named twice, in bodies 0 and 1"),
                ([[0, 99]], "the particles of body 0 must be numbers from 0 to 23, not 99"),
                ("all", "bodies must be lists of particle indices"),
            ]
        ],
    ),
    *(
        (partial(rigid_sites, 1.0, [1.0, thin, 1.0 + part * thin]), "nearly linear")
        for thin in (1e-7, 1e-9, 1e-10, 1e-12, 1e-14)
        for part in (0.0, 0.5, 1.0)
    ),
    *(
        (partial(GayBerne(3.0, 5.0, 1.0, 1.0, 4.0, 3.6).energy_and_forces, pair(Z, Z, X), np.array(box)), sentence)
        for box, sentence in [
            ([[9.0, 0, 0], [1.0, 9.0, 0], [0, 0, 9.0]], "rectangular"),
            (7.0 * np.eye(3), "at most half the shortest edge of the box"),
        ]
    ),
    (without_elements, "no atom of the Topology has the element hydrogen: set the elements"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
