"""A System whose bonded forces, charges and dispersion of one molecule depend on parameters of the Context."""

import openmm

#: The parameters, with other values than their defaults.
CHANGED = {"lambda_electrostatics": 0.4, "lambda_sterics": 0.7, "lambda_bonded": 0.8}
SOFT_CORE = (
    "lambda_sterics*4*epsilon*x*(x-1); x = (sigma/reff)^6;"
    "reff = sigma*(softcore_alpha*(1-lambda_sterics)^softcore_b + (r/sigma)^softcore_c)^(1/softcore_c)"
)
_BONDED = {
    openmm.HarmonicBondForce: ("Bond", 2, "lambda_bonded*(K/2)*(r-length)^2", ("length", "K")),
    openmm.HarmonicAngleForce: ("Angle", 3, "lambda_bonded*(K/2)*(theta-theta0)^2", ("theta0", "K")),
    openmm.PeriodicTorsionForce: (
        *("Torsion", 4, "lambda_bonded*k*(1+cos(periodicity*theta-phase))"),
        ("periodicity", "phase", "k"),
    ),
}


def alchemical(system, atoms=22, derivatives=()):
    """Return a System like another one, in which the first atoms are alchemical, as openmmtools and OpenMM make them.

    Custom forces return derivatives of the energy with respect to some parameters.
    """
    made = openmm.XmlSerializer.clone(system)
    for number, force in reversed([*enumerate(system.getForces())]):
        if type(force) in _BONDED:
            made.addForce(_custom(force, *_BONDED[type(force)]))
            made.removeForce(number)
    (nonbonded,) = (force for force in made.getForces() if isinstance(force, openmm.NonbondedForce))
    made.addForce(_with_offsets(nonbonded, atoms))
    for force in made.getForces():
        if isinstance(force, (openmm.CustomBondForce, openmm.CustomAngleForce, openmm.CustomTorsionForce)):
            names = [force.getGlobalParameterName(i) for i in range(force.getNumGlobalParameters())]
            for name in set(derivatives) & set(names):
                force.addEnergyParameterDerivative(name)
    return made


def _custom(force, kind, width, energy, names):
    custom = getattr(openmm, f"Custom{kind}Force")(energy)
    custom.addGlobalParameter("lambda_bonded", 1.0)
    for name in names:
        getattr(custom, f"addPer{kind}Parameter")(name)
    for i in range(getattr(force, f"getNum{kind}s")()):
        values = getattr(force, f"get{kind}Parameters")(i)
        numbers = [getattr(value, "_value", value) for value in values[width:]]
        getattr(custom, f"add{kind}")(*values[:width], numbers)
    return custom


def _with_offsets(nonbonded, atoms):
    """Let charges of atoms depend on a parameter, and return a force with their soft-core exceptions."""
    nonbonded.addGlobalParameter("lambda_electrostatics", 1.0)
    for i in range(atoms):
        charge, sigma, epsilon = nonbonded.getParticleParameters(i)
        nonbonded.setParticleParameters(i, 0.0, sigma, epsilon)
        nonbonded.addParticleParameterOffset("lambda_electrostatics", i, charge._value, 0.0, 0.0)
    soft = openmm.CustomBondForce(SOFT_CORE)
    for name, value in (("lambda_sterics", 1.0), ("softcore_alpha", 0.5), ("softcore_b", 1.0), ("softcore_c", 6.0)):
        soft.addGlobalParameter(name, value)
    for name in ("sigma", "epsilon"):
        soft.addPerBondParameter(name)
    for k in range(nonbonded.getNumExceptions()):
        i, j, charges, sigma, epsilon = (
            getattr(value, "_value", value) for value in nonbonded.getExceptionParameters(k)
        )
        if max(i, j) < atoms and (charges or epsilon):
            nonbonded.setExceptionParameters(k, i, j, 0.0, sigma, 0.0)
            nonbonded.addExceptionParameterOffset("lambda_electrostatics", k, charges, 0.0, 0.0)
            soft.addBond(i, j, [sigma, epsilon])
    return soft
