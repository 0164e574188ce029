"""Linear constraints that a model's coefficients obey whatever its parameters are."""
