"""Nonlinear programs, compiled once or solved once, and their solvers."""
