"""Indirect models in transfer functions: the unknown input eliminated with an output."""
