"""Outputs whose noise grows with what they read: every sample in units of the noise there.

Taken as noise of one size, that of large readings passes for outliers and changes, and what small
readings show of a cause, which may be nearly all, counts for nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment, NoiseSizes
from casid.estimation.holdout import Split, simulate_apart, whole_simulation
from casid.estimation.simulation.input_noise.growing_noise import (
    Readings,
    growing_level,
    size_of_readings,
)
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals


def with_noise_sizes(
    fit: Fit, split: Split, known: Collection[str] = ()
) -> tuple[Split, tuple[str, ...]]:
    """The records with sizes of the noise of outputs in which it is seen to grow, and which.

    The sizes follow the simulation, of what is held out as well; the test takes what is fitted.

    Parameters
    ----------
    known : outputs of which the noise is stated, or has sizes already; they stay as they are.
    """
    runs = [whole_simulation(fit, split, e)[:2] for e in range(len(split.whole))]
    apart = [simulate_apart(fit, e)[:2] for e in split.apart]
    found: dict[str, list[NoiseSizes]] = {}
    for i, name in enumerate(fit.criterion.outputs):
        if name not in known:
            fitted = [d.used[:, i] & ~held for (d, _), held in zip(runs, split.held, strict=True)]
            sizes = _sizes_of(i, [*runs, *apart], fitted)
            if sizes is not None:
                found[name] = sizes

    def sized(experiments: Sequence[Experiment], first: int = 0) -> list[Experiment]:
        """The experiments with the sizes of noise found, from experiment `first` on."""
        return [
            replace(e, noise_sizes={**e.noise_sizes, **{n: s[k] for n, s in found.items()}})
            for k, e in enumerate(experiments, first)
        ]

    if not found:
        return split, ()
    n = len(runs)
    cut = replace(
        split, fitted=sized(split.fitted), whole=sized(split.whole), apart=sized(split.apart, n)
    )
    return cut, tuple(found)


def fitted_in_sizes(
    fit: Fit, split: Split, stated: Collection[str], again: Callable[[Split, Fit], Fit]
) -> tuple[Split, Fit, tuple[str, ...]]:
    """The records with sizes of their noise, the fit by these, and the outputs of which it grows.

    As given where noise is not seen to grow, or no longer once the fit counts by its sizes.

    Parameters
    ----------
    stated : outputs of which the problem states the noise.
    again : fits such records from near a fit.
    """
    known = {*stated, *(name for e in split.fitted for name in e.noise_sizes)}
    sized, found = split, fit
    names: tuple[str, ...] = ()
    for _ in range(2):  # by the sizes of the fit as given, then by those of the fit that follows
        sized, names = with_noise_sizes(found, sized, known)
        if not names:
            return split, fit, ()
        found = again(sized, found)
    return sized, found, names


def sized_noise_text(names: Sequence[str]) -> str:
    """What follows for errors of outputs whose noise grows."""
    return (
        f"the noise of {', '.join(names)} grows with the reading: each sample counts by the size "
        "of the noise there"
    )


def _sizes_of(
    i: int, runs: Sequence[tuple[Signals, Array]], fitted: Sequence[Array]
) -> list[NoiseSizes] | None:
    """Sizes of the noise of output i in every record; None where it does not grow.

    Parameters
    ----------
    fitted : (N,) samples of the first records that are there and fitted.
    """
    readings = []
    for (d, y), part in zip(runs, fitted, strict=False):
        part = part & np.isfinite(y[:, i])
        readings.append(Readings(d.t[part], y[part, i], d.y[part, i] - y[part, i]))
    level = growing_level(readings)
    if level is None:
        return None
    every = [np.hypot(level, size_of_readings(d.y[:, i], y[:, i], d.used[:, i])) for d, y in runs]
    counted = np.concatenate([s[part] for s, part in zip(every, fitted, strict=False)])
    norm = max(float(np.sqrt(np.mean(counted**2))), TINY)
    return [
        NoiseSizes(d.t, sizes / norm, per_reading=1 / norm, at_zero=level / norm)
        for (d, _), sizes in zip(runs, every, strict=True)
    ]
