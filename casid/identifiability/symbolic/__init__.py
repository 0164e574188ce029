"""Lie derivatives and the observability matrix as formulas to read."""
