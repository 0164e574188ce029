"""Runge-Kutta steps with their sensitivities along all samples, interpreted or as machine code."""
