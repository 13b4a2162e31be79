"""Averages without the error of the step size: the data that a run reports, and the corrections computed from them."""

from openmm_exactrb.averages.correction import Average, PressureOffset, corrected, pressure_offset
from openmm_exactrb.averages.reporter import AverageReporter

__all__ = ["Average", "AverageReporter", "PressureOffset", "corrected", "pressure_offset"]
