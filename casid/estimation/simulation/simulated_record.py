"""What a simulation-error criterion computes of one record at a point."""

from __future__ import annotations

from dataclasses import dataclass

from casid.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Outputs, residuals and sensitivities of one experiment at one point."""

    y: Array  # (N, ny)
    residual: Array  # (N, ny), zero where a sample is not used, over the noise's relative size
    jacobian: Array  # (N, ny, n), d yhat / d variables, likewise
    x: Array  # (N, nx)
