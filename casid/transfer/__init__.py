"""Rational transfer functions and matrices of them, as values that are computed with exactly."""
