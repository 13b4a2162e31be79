"""Averages without the step-size error: the data that a run reports, and the corrections computed from these data."""

from openmm_exactrb.averages.correction import Average, PressureOffset, corrected, pressure_offset
from openmm_exactrb.averages.reporter import AverageReporter

__all__ = ["Average", "AverageReporter", "PressureOffset", "corrected", "pressure_offset"]
