"""Rigid-body dynamics for OpenMM with exact free rotation and high-order symplectic splittings."""

from openmm_exactrb import ensemble
from openmm_exactrb.averages import AverageReporter, corrected, pressure_offset
from openmm_exactrb.errors import IntegrationError, NonFiniteError, NotConvergedWarning, ShapeWarning, StepSizeWarning
from openmm_exactrb.integrators.hybrid import ExactRigidBodyHybridIntegrator
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.integrators.momenta import CanonicalMomenta
from openmm_exactrb.integrators.nose_hoover import ExactRigidBodyNoseHooverIntegrator
from openmm_exactrb.integrators.rescaling import ExactRigidBodyRescalingIntegrator
from openmm_exactrb.integrators.states import loadState
from openmm_exactrb.multiple_time_steps.bonded import separate_bonded
from openmm_exactrb.potentials import Ewald, Open, ReactionField, dipole_strength, soft_dipole_force
from openmm_exactrb.potentials.dielectric import dielectric_constant
from openmm_exactrb.replacement import replace_integrators
from openmm_exactrb.reporters import EnergyReporter, MomentReporter
from openmm_exactrb.rotors import ROTORS, free_rotor
from openmm_exactrb.runs import Run
from openmm_exactrb.schemes import CATALOGUE as SCHEMES
from openmm_exactrb.support.files import written_whole
from openmm_exactrb.support.version import version
from openmm_exactrb.systems import dipole_fluid, ellipsoids, exclude_within, heavy_hydrogens, rigid_water
from openmm_exactrb.tuning import tune

__version__ = version("0+unknown")

__all__ = [
    "ROTORS",
    "SCHEMES",
    "AverageReporter",
    "CanonicalMomenta",
    "EnergyReporter",
    "Ewald",
    "ExactRigidBodyHybridIntegrator",
    "ExactRigidBodyIntegrator",
    "ExactRigidBodyLangevinIntegrator",
    "ExactRigidBodyNoseHooverIntegrator",
    "ExactRigidBodyRescalingIntegrator",
    "IntegrationError",
    "MomentReporter",
    "NonFiniteError",
    "NotConvergedWarning",
    "Open",
    "ReactionField",
    "Run",
    "ShapeWarning",
    "StepSizeWarning",
    "corrected",
    "dielectric_constant",
    "dipole_fluid",
    "dipole_strength",
    "ellipsoids",
    "ensemble",
    "exclude_within",
    "free_rotor",
    "heavy_hydrogens",
    "loadState",
    "pressure_offset",
    "replace_integrators",
    "rigid_water",
    "separate_bonded",
    "soft_dipole_force",
    "tune",
    "written_whole",
]
