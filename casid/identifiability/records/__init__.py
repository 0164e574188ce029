"""Practical identifiability: what given records determine under their noise."""
