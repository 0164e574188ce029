"""Solvers of the fits that a diagnosis makes from next to their minimum."""

from __future__ import annotations

from dataclasses import replace

from casid.diagnosis.thresholds import REFITS
from casid.estimation.nlp.solver import Solver

NEAR = Solver(
    max_iterations=25,
    options={"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-7, "ipopt.tol": 1e-6},
)
"""For fits that start next to their minimum: a large barrier would only lead away from it."""

COMPARED = replace(NEAR, enough=REFITS.enough)
"""The same for candidates that are compared: what a further step would gain decides nothing."""

EXACT = Solver(
    max_iterations=100, options={**NEAR.options, "ipopt.mu_init": 1e-6, "ipopt.tol": 1e-8}
)
"""The same for fits that are reported."""
