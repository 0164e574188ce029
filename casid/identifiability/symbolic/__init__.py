"""Lie derivatives and the observability matrix, symbolically."""
