"""Linear models: transfer functions, difference equations, their constraints and loops."""
