"""Several unknown inputs behind several sensors: y = M u + e, with M known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import TINY
from casid.errors import IdentifiabilityError, ModelError
from casid.unknown_inputs.limits.linear_signals import LinearSignals

_RANK = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class InputMeasurement:
    """Sensors that measure known combinations of unknown inputs, Linder (2017), (4.4).

    Parameters
    ----------
    sensors : ny signals of the system.
    inputs : nu unknown inputs.
    gain : M (ny, nu), known; rows in sensor units per input unit.
    """

    sensors: Sequence[str]
    inputs: Sequence[str]
    gain: ArrayLike

    def recover(self, system: LinearSignals) -> tuple[LinearSignals, Mapping[str, str]]:
        """The system with the signals pinv(M) y, and input -> the name of its signal.

        Raises
        ------
        ModelError
            If M has another shape.
        IdentifiabilityError
            If M has not full column rank; the message names the inputs that cannot be recovered
            and the combination of them that no sensor detects (Assumption 4.1).
        """
        M = np.asarray(self.gain, dtype=float)
        if M.shape != (len(self.sensors), len(self.inputs)):
            raise ModelError(
                f"gain has shape {M.shape} for {len(self.sensors)} sensors and "
                f"{len(self.inputs)} inputs; give one row for each sensor, one column for each "
                "input"
            )
        size = np.linalg.norm(M, axis=0)
        scaled = M / np.where(size > 0, size, 1.0)
        _, s, vt = np.linalg.svd(scaled)
        rank = int(np.sum(s > _RANK * max(s.max(initial=0.0), TINY)))
        if rank < M.shape[1]:
            null = vt[rank:] / np.where(size > 0, size, 1.0)
            lost = [n for n, c in zip(self.inputs, null.T, strict=True) if np.any(abs(c) > 1e-9)]
            direction = null[0] / np.max(np.abs(null[0]))
            moves = ", ".join(
                f"{n} by {c:.4g}"
                for n, c in zip(self.inputs, direction, strict=True)
                if abs(c) > 1e-9
            )
            raise IdentifiabilityError(
                f"the sensors {', '.join(self.sensors)} have rank {rank} for the "
                f"{len(self.inputs)} inputs {', '.join(self.inputs)}: {', '.join(lost)} cannot be "
                f"recovered, since no sensor detects a change of {moves}. Add a sensor that does, "
                "or neglect one of these inputs"
            )
        inverse = np.linalg.pinv(M)
        names = {n: f"{n} recovered" for n in self.inputs}
        rows = {
            names[n]: {y: float(c) for y, c in zip(self.sensors, row, strict=True)}
            for n, row in zip(self.inputs, inverse, strict=True)
        }
        return system.with_signals(rows), names
