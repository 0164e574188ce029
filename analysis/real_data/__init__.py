"""Measured records: what the diagnosis names, and how much of the error goes away."""
