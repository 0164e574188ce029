"""Solvers of the fits that a diagnosis makes from next to their minimum."""

from __future__ import annotations

from dataclasses import replace

from casid.diagnosis.thresholds import REFITS
from casid.estimation.nlp.solver import NEARBY, Solver

NEAR = replace(NEARBY, max_iterations=25, options={**NEARBY.options, "ipopt.tol": 1e-6})
"""To the accuracy that decides."""

COMPARED = replace(NEAR, enough=REFITS.enough)
"""The same for candidates that are compared: what a further step would gain decides nothing."""

EXACT = Solver(
    max_iterations=100, options={**NEAR.options, "ipopt.mu_init": 1e-6, "ipopt.tol": 1e-8}
)
"""The same for fits that are reported."""
