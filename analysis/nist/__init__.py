"""NIST StRD nonlinear regression: certified parameters and standard errors of 27 sets."""
