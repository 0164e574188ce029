"""Forces that act in several balances at once: one source of noise more for each of them.

A crosswind pushes a car and turns it. What it does to the outputs is the sum of what a force in
each of these places does, in the ratios that its spectrum states (`DisturbanceSpectrum.parts`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum, Part
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.varying_steps import Steps


def joined(r: Response, spectra: Mapping[str, DisturbanceSpectrum]) -> Response:
    """The response with one more source for each force that acts in several places."""
    for name, parts in _further(r.sources, spectra):
        assert r.gain is not None
        gain = np.concatenate([r.gain, _together(r.gain, r.sources, parts)], axis=2)
        r = replace(r, sources=(*r.sources, name), gain=gain, gain2=np.abs(gain) ** 2)
    return r


def joined_steps(steps: Steps, spectra: Mapping[str, DisturbanceSpectrum]) -> Steps:
    """Steps of a simulation that is linearised at every sample, with the same sources."""
    for name, parts in _further(steps.sources, spectra):
        b0, b1, d = (
            np.concatenate([m, _together(m, steps.sources, parts)], axis=2)
            for m in (steps.b0, steps.b1, steps.d)
        )
        steps = replace(steps, sources=(*steps.sources, name), b0=b0, b1=b1, d=d)
    return steps


def _further(
    sources: Sequence[str], spectra: Mapping[str, DisturbanceSpectrum]
) -> list[tuple[str, tuple[Part, ...]]]:
    """The forces that act in several places and are no source yet, and where they act."""
    return [(n, s.parts) for n, s in spectra.items() if s.parts and n not in sources]


def _together(gains: Array, sources: Sequence[str], parts: Sequence[Part]) -> Array:
    """(.., rows, 1) by which one force enters in several places, of gains (.., rows, sources)."""
    return np.asarray(sum(p.ratio * gains[..., [sources.index(p.place)]] for p in parts))
