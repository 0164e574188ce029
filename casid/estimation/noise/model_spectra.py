"""What the residual's spectra depend on: the model itself passes its noise on to the outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.estimation.noise.missing_samples import FILLED_FROM, unbroken
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response, linearised_at, may_vary, noise_response
from casid.estimation.noise.source_spectra import Lines, SourceSpectra, lines_of
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError

PARAMETER_STEP = 1e-4
"""Relative change of a parameter over which responses are differentiated."""


class ModelSpectra:
    """Residuals and their spectra over z: the variables of a criterion, then those of the noise.

    Parameters
    ----------
    criterion : in one segment a record.
    sources : the spectra of given responses.
    signals : of each record in the place of its own, None for those (`completed`).
    """

    def __init__(
        self,
        criterion: SimulationError,
        sources: SourceSpectra,
        signals: Sequence[Signals | None],
    ) -> None:
        self.criterion, self.sources, self.signals = criterion, sources, signals
        self.lower = np.array([v.lower for v in criterion.variables])
        self.upper = np.array([v.upper for v in criterion.variables])

    def lines(self, z: Array, e: int) -> Lines | None:
        """The transforms of residual and its slopes, side by side; None where they overflow."""
        d = self.criterion.data[e]
        simulated = self.criterion.simulated(z[: len(self.lower)], e, signals=self.signals[e])
        stack = np.concatenate([simulated.residual[:, :, None], -simulated.jacobian], axis=2)
        if self.signals[e] is None:
            stack = stack[unbroken(d.used) or slice(None)]
        return lines_of(stack) if np.all(np.isfinite(stack)) else None

    def spectra(self, z: Array, e: int, omega: Array) -> tuple[Array, dict[int, Array]]:
        """S (F, ny, ny) at `omega`, and its derivative for each place of z that it depends on."""
        n, Ts = len(self.lower), self.criterion.data[e].Ts
        r = self._response(z[:n], e, omega)
        S, shapes = self.sources.at(z[n:], r, Ts)
        states, tangents = self._states(z[:n], e)
        slopes = {n + k: slope for k, slope in shapes.items()}
        for k, v in enumerate(self.criterion.variables):
            if v.source not in self.criterion.model.parameters:
                continue
            h = PARAMETER_STEP * max(abs(float(z[k])), v.scale)
            h = -h if z[k] + h > v.upper else h
            moved = z[:n].copy()
            moved[k] += h
            at = None if states is None else states + h * tangents[:, :, k]
            there = self._response(moved, e, omega, states=at, is_beside=True)
            slope = self.sources.change(z[n:], r, there, Ts) / h
            if np.any(slope):
                slopes[k] = slope
        return S, slopes

    def _response(
        self,
        x: Array,
        e: int,
        omega: Array,
        *,
        states: Array | None = None,
        is_beside: bool = False,
    ) -> Response:
        of = self.criterion
        return noise_response(of, x, e, omega=omega, states=states, is_beside=is_beside)

    def _states(self, x: Array, e: int) -> tuple[Array | None, Array]:
        """States (points, nx) where the record is linearised, and their slopes (points, nx, n).

        The states are None where they do not count, or tangents would not do.
        """
        nothing = np.zeros((0, 0, len(x)))
        if not may_vary(self.criterion):
            return None, nothing
        with np.errstate(all="ignore"):
            found = self.criterion.state_tangents(x, e)
        if found is None or not np.all(np.isfinite(found[1])):
            return None, nothing
        pick = linearised_at(self.criterion.data[e].N)
        return found[0][pick], found[1][pick]


def completed(
    criterion: SimulationError, x: Array, noise: NoiseModel
) -> list[Signals | None] | None:
    """The records with a draw of what they miss at `x`, None of one that misses nothing in between.

    None where a record cannot be completed so.
    """
    rng = np.random.default_rng(0)
    out: list[Signals | None] = []
    for e, d in enumerate(criterion.data):
        if unbroken(d.used) is not None:  # of a late input the first samples are left out
            out.append(None)
            continue
        if d.used.mean() < FILLED_FROM:
            return None
        at = criterion.simulated(x, e)
        drawn = noise.filled(at.residual, e, rng) * d.relative_sizes
        y = np.where(d.used, d.y, at.y + drawn)
        out.append(replace(d, y=y, used=np.ones_like(d.used)))
    return out
