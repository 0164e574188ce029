"""Constrained grey-box identification with CasADi."""
