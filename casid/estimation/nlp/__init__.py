"""Nonlinear programs with named, scaled variables, and the solvers that solve them."""
