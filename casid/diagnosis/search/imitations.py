"""Effects that imitate the small misfit which others leave, and are no causes beside them.

A line of the residual at a resonance of the model is what an error of its stiffness or damping
leaves, which shifts and stretches the motion there; a third law of friction in one place repairs
the shape of two others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.thresholds import PEAKS, ROUNDS
from casid.model.effects.effect import Effect

FRICTIONS = (
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "quadratic_damping",
    "cubic_damping",
)
"""Kinds that are laws of friction or damping."""


def is_further_friction(effect: Effect, adopted: Sequence[Candidate]) -> bool:
    """True of a law of friction in a place where `ROUNDS.frictions` of them were adopted."""
    if effect.kind not in FRICTIONS:
        return False
    there = [c for c in adopted if c.effect.kind in FRICTIONS and c.effect.where == effect.where]
    return len(there) >= ROUNDS.frictions


def is_at_resonance(at: Weighted, frequency: float) -> bool:
    """True if a force of this frequency [Hz] acts near a resonance of the linearised model.

    Near: its gain to some output is at least `PEAKS.resonance` of the largest, in squares.
    """
    for d, r in zip(at.criterion.data, at.full.responses, strict=True):
        omega = 2 * np.pi * frequency * d.Ts
        for balance in at.model.balances:
            for gain2 in r.gain2[:, :, r.sources.index(balance)].T:
                top = int(np.argmax(gain2))
                # One that is largest at the lowest frequencies has no resonance, but a cut-off.
                is_peak = PEAKS.resonance * gain2[top] > gain2[0]
                near = float(np.interp(omega, r.omega, gain2)) >= PEAKS.resonance * gain2[top]
                if is_peak and near:
                    return True
    return False
