"""Least squares and instrumental variables by cross moments of the data."""
