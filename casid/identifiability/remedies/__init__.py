"""Sensors, experiments and known values that make all parameters identifiable."""
