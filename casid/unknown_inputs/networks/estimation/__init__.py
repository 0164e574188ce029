"""Estimation of one module of a network of known structure."""
