"""Averages without the error of the step size: what a run has to report, and the corrections that follow from it."""

from openmm_exactrb.averages.correction import Average, PressureOffset, corrected, pressure_offset
from openmm_exactrb.averages.reporter import AverageReporter

__all__ = ["Average", "AverageReporter", "PressureOffset", "corrected", "pressure_offset"]
