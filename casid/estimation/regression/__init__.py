"""Nonlinear regression of one measured response, with bounds and constraints."""
