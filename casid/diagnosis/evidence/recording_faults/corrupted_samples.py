"""Samples that a sensor or logger corrupted, left out before anything is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.sampling import stretches_of
from casid.diagnosis.evidence.recording_faults.plateaus import Plateaus, find_plateaus
from casid.diagnosis.evidence.recording_faults.spikes import (
    Spikes,
    find_spikes,
    spread_of_differences,
    starts_apart,
)
from casid.diagnosis.evidence.recording_faults.stuck_sensors import Standstills, find_standstills
from casid.diagnosis.thresholds import OUTLIERS
from casid.estimation.holdout import Split, restarts, simulate_apart, whole_simulation
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class CorruptedSamples:
    """Samples that were left out, and why."""

    spikes: tuple[Spikes, ...] = ()
    plateaus: tuple[Plateaus, ...] = ()
    standstills: tuple[Standstills, ...] = ()
    first: int = 0  # first samples, from before the inputs had acted
    behind_gaps: int = 0  # samples that show what an input did where it was not recorded

    @property
    def count(self) -> int:
        """Samples left out."""
        left_out = [s.count for s in self.spikes] + [p.count for p in self.plateaus]
        left_out += [s.count for s in self.standstills]
        return sum(left_out) + self.first + self.behind_gaps


@dataclass(frozen=True, slots=True, eq=False)
class _Simulated:
    """One channel of every record, fitted ones to their end and then those apart."""

    measured: list[Array]
    simulated: list[Array]
    used: list[Array]
    inputs: list[Array]  # (N, nu), those recorded, each from the sample on that may show it
    anew: list[Array]  # samples at which the simulation starts anew
    times: list[Array]  # (N,) [s]
    sizes: list[Array]  # (N,) of the noise, relative
    behind: list[Array]  # (N,) bool, in or shortly behind a gap of an input that was filled

    @property
    def residuals(self) -> list[Array]:
        """Residuals of the recorded samples, joined over gaps, as white noise may be."""
        return [
            ((y - s) / size)[u]
            for y, s, size, u in zip(
                self.measured, self.simulated, self.sizes, self.used, strict=True
            )
        ]

    @property
    def simulated_used(self) -> list[Array]:
        """Simulated values at the samples that are left, in the units of `residuals`."""
        parts = zip(self.simulated, self.sizes, self.used, strict=True)
        return [(s / size)[u] for s, size, u in parts]

    @property
    def inputs_used(self) -> list[Array]:
        """The inputs at those samples."""
        return [d[u] for d, u in zip(self.inputs, self.used, strict=True)]

    @property
    def behind_used(self) -> list[Array]:
        """Which of those samples are in or shortly behind a gap of an input."""
        return [near[u] for near, u in zip(self.behind, self.used, strict=True)]

    @property
    def restarts_among_used(self) -> list[Array]:
        """The samples, of those that there are, at which the simulation starts anew."""
        return [
            np.array([int(u[:k].sum()) for k in starts if u[:k].any() and u[k:].any()], dtype=int)
            for u, starts in zip(self.used, self.anew, strict=True)
        ]

    def in_records(self, masks: Sequence[Array]) -> list[Array]:
        """Masks of those samples as masks (N,) of the records."""
        out = [np.zeros(len(u), dtype=bool) for u in self.used]
        for whole, u, mask in zip(out, self.used, masks, strict=True):
            whole[u] = mask
        return out

    def left_out(self, split: Split, channel: str, masks: Sequence[Array]) -> Split:
        """The split without those samples, which are used no more here either."""
        for used, mask in zip(self.used, masks, strict=True):
            used &= ~mask
        return _masked(split, channel, masks)


def without_corrupted(
    fit: Fit, split: Split, alpha: float, *, without: Sequence[str] = ()
) -> tuple[CorruptedSamples, Split]:
    """Mark clipped samples, standing sensors and spikes of outputs as missing, held-out ones too.

    `without` are kinds that are not looked for.
    """
    first, behind_gaps = 0, 0
    spikes: list[Spikes] = []
    plateaus: list[Plateaus] = []
    standstills: list[Standstills] = []
    for i, channel in enumerate(fit.criterion.outputs):
        at = _channel(fit, split, i)
        if "saturation" not in without:
            cut = find_plateaus(
                channel, at.measured, at.simulated, at.used, OUTLIERS.test_share * alpha
            )
            if cut is not None:
                plateaus.append(cut)
                split = at.left_out(split, channel, cut.masks)
        if "outliers" not in without:
            still = find_standstills(
                channel, at.measured, at.simulated, at.used, OUTLIERS.test_share * alpha
            )
            if still is not None:
                standstills.append(still)
                split = at.left_out(split, channel, still.masks)
            early = at.in_records([_early(r, OUTLIERS.test_share * alpha) for r in at.residuals])
            if any(mask.any() for mask in early):
                first += sum(int(mask.sum()) for mask in early)
                split = at.left_out(split, channel, early)
            found, split, shown = _spikes(channel, at, split, OUTLIERS.test_share * alpha)
            behind_gaps += shown
            if found is not None:
                masks = tuple(at.in_records(found.masks))
                measured = tuple(y[m] for y, m in zip(at.measured, masks, strict=True))
                found = replace(found, masks=masks, measured=measured)
                spikes.append(found)
                split = _masked(split, channel, found.masks)
    corrupted = tuple(spikes), tuple(plateaus), tuple(standstills)
    return CorruptedSamples(*corrupted, first, behind_gaps), split


def _spikes(
    channel: str, at: _Simulated, split: Split, alpha: float
) -> tuple[Spikes | None, Split, int]:
    """The spikes of a channel; the split without samples that stand out behind gaps of the inputs.

    What fills a gap is not what acted there. A sample that shows it stands out as a spike does, and
    says nothing of the sensor: it is left out, and counted, and the others are tested without it.
    """
    count = 0
    while True:
        found = find_spikes(
            channel,
            at.residuals,
            alpha,
            inputs=at.inputs_used,
            anew=at.restarts_among_used,
            simulated=at.simulated_used,
            behind=at.behind_used,
        )
        if found is None:
            return None, split, count
        masks = zip(at.in_records(found.masks), at.behind, strict=True)
        behind = [mask & near for mask, near in masks]
        shown = sum(int(mask.sum()) for mask in behind)
        if not shown:
            return found, split, count
        count += shown
        split = at.left_out(split, channel, behind)


def confirmed(
    spikes: Spikes, fit: Fit, split: Split, onsets: Sequence[float] = ()
) -> Spikes | None:
    """The spikes of which another model leaves the larger part; None where there are none.

    Fast misfit, after a step of an input, may stand out like a spike until its cause is known: what
    is left of it then is compared with what it was, and with the noise that is left. The sample
    beside a step stands out as well: left out, it no longer says on which side of it the step is.
    Those that are left beside others that are none are tested anew: a few large ones make a tail of
    which the largest samples of mere noise are then the end.

    Parameters
    ----------
    onsets : instants at which an effect of that model sets in [s], on the fitted records' clock.
    """
    at = _channel(fit, split, fit.criterion.outputs.index(spikes.channel))
    left, residuals = [], []
    for e, mask in enumerate(spikes.masks):
        residual = np.where(at.used[e], at.measured[e], np.nan) - at.simulated[e]
        residual[mask] = spikes.measured[e] - at.simulated[e][mask]
        height = above_neighbours(residual, mask)
        noise = spread_of_differences(residual[np.isfinite(residual)])
        kept = (height > OUTLIERS.left * spikes.heights[e]) & (height > spikes.limit * noise)
        at_onset = at_onsets(at.times[e], onsets if e < len(split.whole) else ())
        kept &= ~at_onset[mask]
        left.append(kept)
        residual[mask] = np.where(kept, residual[mask], np.nan)
        residual[at_onset] = np.nan
        residuals.append(residual[np.isfinite(residual)])
    count = int(sum(kept.sum() for kept in left))
    if not count or (count < spikes.count and is_tail(spikes, residuals)):
        return None
    masks = [mask.copy() for mask in spikes.masks]
    for mask, kept in zip(masks, left, strict=True):
        mask[mask] = kept
    heights = tuple(h[kept] for h, kept in zip(spikes.heights, left, strict=True))
    height = np.concatenate(heights)
    return replace(
        spikes,
        masks=tuple(masks),
        heights=heights,
        measured=tuple(y[kept] for y, kept in zip(spikes.measured, left, strict=True)),
        count=count,
        share=spikes.share * count / spikes.count,
        size=float(np.median(height)),
        energy=float(np.sum(height**2)),
    )


def is_tail(spikes: Spikes, residuals: Sequence[Array]) -> bool:
    """True if residuals of another model have no spikes at the level at which these were found."""
    return find_spikes(spikes.channel, residuals, spikes.level) is None


def at_onsets(times: Array, onsets: Sequence[float]) -> Array:
    """Samples (N,) that are a sample or less from an onset."""
    near = np.zeros(len(times), dtype=bool)
    for onset in onsets:
        near |= np.abs(times - onset) <= np.median(np.diff(times))
    return near


def above_neighbours(residual: Array, mask: Array) -> Array:
    """How far samples (M,) lie from the mean of their neighbours, of those that there are."""
    wide = np.concatenate([[np.nan], residual, [np.nan]])
    k = np.flatnonzero(mask)
    near = np.stack([wide[k], wide[k + 2]])
    there = np.isfinite(near)
    mean = np.sum(np.where(there, near, 0.0), axis=0) / np.maximum(there.sum(axis=0), 1)
    return np.asarray(np.abs(residual[k] - mean))


def _early(residual: Array, alpha: float) -> Array:
    """A first sample (N,) from before the inputs had acted."""
    mask = np.zeros(len(residual), dtype=bool)
    mask[:1] = len(residual) > 2 and starts_apart(residual, alpha)
    return mask


def _channel(fit: Fit, split: Split, i: int) -> _Simulated:
    runs = [whole_simulation(fit, split, e) for e in range(len(split.whole))]
    runs += [simulate_apart(fit, experiment) for experiment in split.apart]
    model = fit.criterion.model
    entries = model.inputs.values()
    recorded = [k for k, entry in enumerate(entries) if entry.kind != "generated"]
    later = act_a_sample_later(model, fit.criterion.outputs[i])[recorded]
    return _Simulated(
        [d.y[:, i] for d, _, _ in runs],
        [y[:, i] for _, y, _ in runs],
        [d.used[:, i].copy() for d, _, _ in runs],
        [_shown(d.u[:, recorded], later) for d, _, _ in runs],
        restarts(fit, split),
        [d.t for d, _, _ in runs],
        [d.relative_sizes[:, i] for d, _, _ in runs],
        [_behind_gaps(d) for d, _, _ in runs],
    )


def _behind_gaps(d: Signals) -> Array:
    """Samples (N,) in a gap of an input that was filled, or few enough behind it to show it.

    The intervals of an input with a slower clock of its own are no gaps.
    """
    near = np.zeros(len(d.t), dtype=bool)
    for mask in d.filled.values():
        usual = np.median(np.diff(np.flatnonzero(~mask))) if np.sum(~mask) > 1 else len(mask)
        for first, stop in zip(*stretches_of(mask), strict=True):
            if stop - first + 1 > usual:
                near[first : stop + OUTLIERS.after_steps] = True
    return near


def act_a_sample_later(model: Model, channel: str) -> Array:
    """Which inputs (nu,) no sample of a channel shows that was taken as they stepped.

    A held input acts from its sample on: an output that it moves through states alone shows a step
    at the next sample. What steps with a spike of that sample follows the sensor, as a controller
    does that takes the spike for motion.
    """
    e = model.explicit()
    row = e.h[list(e.outputs).index(channel)]
    is_held = [model.inputs[name].hold == "zoh" for name in e.inputs]
    direct = [bool(ca.depends_on(row, e.u[k])) for k in range(len(e.inputs))]
    return np.asarray(np.array(is_held, dtype=bool) & ~np.array(direct, dtype=bool))


def _shown(u: Array, later: Array) -> Array:
    """Inputs (N, nu), those that act later moved to the sample that shows them first."""
    out = u.copy()
    out[1:, later] = u[:-1, later]
    return out


def _masked(split: Split, channel: str, masks: Sequence[Array]) -> Split:
    n = len(split.whole)
    return split.mask(channel, masks[:n], masks[n:])
