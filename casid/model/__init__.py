"""A system: states, inputs, outputs and parameters with units, and the catalogue of effects."""
