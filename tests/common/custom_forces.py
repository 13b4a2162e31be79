"""Custom bonds, angles and torsions along a chain of particles, with expressions of every function of OpenMM."""

import numpy as np
import openmm

from starts import system_of

N = 9
#: The kinds of terms, their numbers of particles, and the variables in their energies.
KINDS = {"Bond": (2, "r"), "Angle": (3, "theta"), "Torsion": (4, "theta")}
#: Energies of a variable v, of k and a of each term, and of parameters p and q of the Context.
ENERGIES = (
    *("k*(v-a)^2", "p*k*(v-a)^4 - q*v", "k*sqrt(1+v)", "k*exp(-v/p)", "log(k+v*v)", "k*sin(v*p)", "k*cos(3*v-a)"),
    *("k*sec(0.3*v)", "csc(1+0.2*v)*k", "k*tan(0.3*v)", "k*cot(1+0.2*v)", "asin(v/9)^3", "acos(v/9)*p", "atan(k*v)"),
    *("atan2(v,a)*k", "sinh(v)", "k*cosh(v-a)", "tanh(v*p)", "k*erf(v)", "erfc(q*v)*p", "step(v-a)*k*v^3"),
    *("delta(v-a)+v*k", "min(k*v,a)", "max(k*v*v,a*v)", "k*abs(v-a)^3", "floor(4*v)*v", "ceil(3*v)*v*k"),
    *("select(step(v-a),k*v^2,p*v)", "k*(2+v)^-3", "(2+v)^2.5", "(2+v)^q", "p^v", "(v/4)^70", "k*(2+v)^a+(2+v)^(-12)"),
    *("u*(u-1)*4*k; u = (a/w)^6; w = a*(0.5*(1-p)^q + ((2+v)/a)^6)^(1/6)", "k*(1+0*v)"),
)


def force_of(kind, energy, first=0, rng=None, n=N):
    """Return a custom force with an energy on the chain of n particles from `first` on."""
    rng = rng or np.random.default_rng(3)
    width, variable = KINDS[kind]
    force = getattr(openmm, f"Custom{kind}Force")(energy.replace("v", variable) if energy in ENERGIES else energy)
    for name in "ka":
        getattr(force, f"addPer{kind}Parameter")(name)
    for name, value in (("p", 0.8), ("q", 1.7)):
        force.addGlobalParameter(name, value)
    for i in range(first, first + n - width + 1):
        getattr(force, f"add{kind}")(*range(i, i + width), rng.uniform((1.0, 0.3), (5.0, 1.5)).tolist())
    return force


def chain(*forces, n=N):
    """Return a System of particles of 12 amu with forces."""
    system = system_of(n * [12.0])
    for force in forces:
        system.addForce(force)
    return system
