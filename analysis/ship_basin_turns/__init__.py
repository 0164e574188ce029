"""Turns of the nonlinear ship: what the roll model leaves over there, and why."""
