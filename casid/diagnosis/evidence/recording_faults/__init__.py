"""Samples that a sensor or logger got wrong, and inputs between and outside their samples."""
