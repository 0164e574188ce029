"""What one channel of a record is worth: its range, noise, plateaus, spikes and trend."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casid.arrays import TINY, BoolArray, FloatArray, robust_sd
from casid.data.findings import Finding
from casid.data.held_signals import is_rounded
from casid.data.missing_samples import is_as_placed, some_missing
from casid.data.record import Record
from casid.data.sampling import gaps_of
from casid.model.quantities import count_text
from casid.model.units import difference_from_si, from_si


@dataclass(frozen=True, slots=True)
class ChannelCheck:
    """Numbers of one channel, SI units; None where they cannot be had.

    Attributes
    ----------
    minimum, maximum, mean, rms : float
    missing : int
        Samples marked missing.
    noise : float
        Standard deviation of white noise with the spectral density found in the highest fifth of
        the band; an upper limit where the signal reaches that far. None of a held channel, which
        rests at a level and leaps to the next, as a command does: no sensor's noise shows there.
    step : float
        Quantisation step.
    longest_run : int
        Most equal samples in a row.
    at_extreme : int
        Most equal samples in a row at the minimum or maximum, 1 where there is no plateau.
    spikes : int
        Single samples far off their neighbours.
    drift : float
        Change of the least-squares straight line over the record.
    bandwidth_hz : float
        Highest frequency at which the spectrum is four times above the noise; 0 for none.
    written : str
        Unit in the file, in which text shows the numbers; empty where there is no file.
    """

    name: str
    unit: str
    minimum: float | None
    maximum: float | None
    mean: float | None
    rms: float | None
    missing: int
    noise: float | None = None
    step: float | None = None
    longest_run: int = 1
    at_extreme: int = 1
    spikes: int = 0
    drift: float | None = None
    bandwidth_hz: float | None = None
    written: str = ""

    @property
    def shown_in(self) -> str:
        """The unit in which text shows the numbers."""
        return self.written or self.unit


FEW_LEVELS = 10
"""Different readings, at most, of a channel that may be a command."""
HELD = 3
"""Equal samples in a row, of nine levels in ten at least, of a channel that is held; a heuristic:
readings with noise repeat by chance, on a coarse grid, and not so often."""
GATHERS_SPEED = 2.7
"""Distance after eight samples over that after four beyond which a motion began from rest; between
the 7/3 of what leaves a limit and the 3 of what gathers speed, see `_rests_at_an_end`."""


def stuck_channels(
    record: Record,
    channels: Iterable[str],
    *,
    least: float = 0.0,
    are_measured: bool = True,
    units: Mapping[str, str] | None = None,
) -> tuple[Finding, ...]:
    """What `check` finds of channels that rest, or stand at an extreme as a limit leaves them.

    Parameters
    ----------
    least : share of the record that a channel has to stand there for.
    are_measured : False of commands, which no sensor cuts off: they may rest at a limit.
    units : channel -> unit that its numbers are shown in, where that is not SI.
    """
    found, shown = [], units or {}
    present = [c for c in channels if c in record]
    for numbers, findings in (channel_quality(record, c, shown.get(c, "")) for c in present):
        if numbers.at_extreme >= least * (record.N - numbers.missing):
            found += [
                f for f in findings if f.about == "rest" or (are_measured and f.about == "limit")
            ]
    return tuple(found)


def channel_quality(
    record: Record, name: str, written: str = ""
) -> tuple[ChannelCheck, list[Finding]]:
    """The numbers of one channel, and what is noticed of it, in words with the unit `written`."""
    mask, unit = record.is_missing(name), record.units[name]
    shown = written or unit
    gone = int(mask.sum())
    if mask.all():
        text = "every sample is missing."
        fix = f"Leave it out with record.without({name!r})."
        finding = Finding("warning", name, text, fix)
        return ChannelCheck(name, unit, None, None, None, None, gone), [finding]
    x = record.filled(name)
    kept = x[~mask]
    low, high, mean = float(kept.min()), float(kept.max()), float(kept.mean())
    peak = max(abs(low), abs(high))
    rms = peak * float(np.sqrt(np.mean((kept / peak) ** 2))) if peak else 0.0
    findings: list[Finding] = []
    if gone and not is_as_placed(record, mask):
        findings.append(some_missing(record, name))
    if low == high:
        findings.append(_constant(name, float(from_si(low, shown)), shown))
        at_rest = (0.0, None, record.N, record.N, 0, 0.0, 0.0)
        constant = ChannelCheck(name, unit, low, high, mean, rms, gone, *at_rest, written)
        return constant, findings
    levels = np.unique(kept)
    step, few = quantisation_step(levels), levels.size <= FEW_LEVELS
    own = np.flatnonzero(~mask) if gone > record.N // 2 else np.arange(record.N)  # on its own clock
    run, plateau, equal = _equal_samples(record, name, own, step, few, shown)
    findings += equal
    spikes = np.array([], dtype=np.intp) if few else own[isolated_spikes(x[own], mask[own])]
    if spikes.size:
        findings.append(spiked(name, record.t[spikes]))
    if unit == "rad" and high - low < 6.6:
        findings += _wrapped(record, name)
    drift, trend = _trend(record, name, shown)
    findings += trend
    noise, bandwidth, reaches = _noise_and_band(record, name, own, spikes)
    if _is_held(x[own], step):
        noise = None
    if step is not None and step > (high - low) / 200:
        findings += _quantised(name, shown, kept, step, noise or 0.0)
    if reaches and not few:
        findings.append(_wide_band(name))
    numbers = ChannelCheck(
        name, unit, low, high, mean, rms, gone, noise, step, run, plateau, int(spikes.size), drift,
        bandwidth, written,
    )  # fmt: skip
    return numbers, findings


def _behind(unit: str) -> str:
    """A unit as it stands behind a number: 1 is none."""
    return "" if unit == "1" else f" {unit}"


def _constant(name: str, value: float, unit: str) -> Finding:
    return Finding(
        "warning",
        name,
        f"constant at {value + 0.0:.6g}{_behind(unit)}.",
        "Right for an input that is held throughout, as after a step at its start; a sensor that "
        "shows it is stuck: check it and the mapping, or leave it out.",
        about="rest",
    )


def _equal_samples(
    record: Record, name: str, own: NDArray[np.intp], step: float | None, few: bool, shown: str
) -> tuple[int, int, list[Finding]]:
    """The longest run of equal samples, the longest at an extreme, and what they point to."""
    x, mask, t = record.filled(name)[own], record.is_missing(name)[own], record.t[own]
    run, run_start, plateau, plateau_start, beside = _runs(x, mask)
    jump = _jump_into(x, plateau_start, plateau) if plateau >= 4 else 0.0
    sudden = bool(_begins_suddenly(plateau, beside))
    findings = []
    value = x[plateau_start]
    # At zero no sun shines and no heater heats: the quantity ends there, not the sensor's range.
    is_cut_off = sudden and value != 0.0 and (step is None or jump > 1.5 * step)
    rests = _rests_inside(x, mask, plateau) or _rests_at_an_end(x, plateau_start, plateau)
    if is_cut_off and plateau >= 4 and not few and not rests:
        findings.append(
            Finding(
                "warning",
                name,
                f"{plateau} equal samples at the "
                f"{'maximum' if value == x[~mask].max() else 'minimum'} "
                f"{float(from_si(value, shown)) + 0.0:.6g}{_behind(shown)}, first at "
                f"t = {t[plateau_start]:.6g} s: possibly clipped.",
                "Check the sensor's range; mark the plateau missing or cut it off with a window.",
                about="limit",
            )
        )
    is_new = run_start != plateau_start or not (findings or mask.any())
    if run >= max(20, 0.01 * x.size) and is_new:
        findings.append(
            Finding(
                "note",
                name,
                f"{run} equal samples in a row from t = {t[run_start]:.6g} s.",
                "Right for a held input; for a sensor it is stuck or updated slower than logged.",
            )
        )
    return run, plateau, findings


def _is_held(x: FloatArray, step: float | None) -> bool:
    """True of samples that repeat exactly until the next leap, as held commands do.

    A reading on a grid that is coarser than the noise repeats too, and moves by single steps.
    """
    leaps = np.flatnonzero(np.diff(x))
    lengths = np.diff(np.concatenate(([-1], leaps, [x.size - 1])))
    if not leaps.size or np.mean(lengths >= HELD) < 0.9:
        return False
    return step is None or not is_rounded(x, step)


def _wide_band(name: str) -> Finding:
    return Finding(
        "note",
        name,
        "the spectrum does not fall towards the Nyquist frequency: noise, or a signal that "
        "is aliased.",
        "Check the logger's anti-alias filter; what is called noise here may be signal.",
    )


def _quantised(name: str, shown: str, kept: FloatArray, step: float, noise: float) -> list[Finding]:
    """Readings on a coarse grid; a command has few levels, too, and jumps among them."""
    levels, span = np.unique(kept).size, float(np.ptp(kept))
    rounding = float(difference_from_si(step / np.sqrt(12), shown))
    steps = f"steps of {float(difference_from_si(step, shown)):.4g}{_behind(shown)}"
    many = f"{round(span / step)} of them in the range."
    count = f"with noise of {rounding:.3g}{_behind(shown)} (step/sqrt 12), or log finer."
    if levels > FEW_LEVELS:
        text = f"coarsely quantised: {steps}, {many}"
        return [Finding("warning", name, text, f"Count {count}")] if step >= noise else []
    moves = np.count_nonzero(np.abs(np.diff(kept)) > 0.5 * step)
    if moves < 2 * levels or not is_rounded(kept, step):
        return []
    remedy = f"Right for a command; of a sensor count {count}"
    return [Finding("note", name, f"moves by single {steps}, {many}", remedy)]


def spiked(name: str, times: FloatArray) -> Finding:
    """The finding about isolated spikes of a channel at times [s]."""
    t = ", ".join(f"{when:.6g}" for when in times[:3])
    return Finding(
        "warning",
        name,
        f"{count_text(times.size, 'isolated spike')}, at t = {t} s"
        f"{' ...' if times.size > 3 else ''}.",
        "A diagnosis leaves them out. Before an estimate mark them with "
        f"record.mark_missing({name!r}, mask), or give their cells with --missing.",
    )


def _wrapped(record: Record, name: str) -> list[Finding]:
    wraps = np.flatnonzero(np.abs(np.abs(np.diff(record.filled(name))) - 2 * np.pi) < 0.1)
    if not wraps.size:
        return []
    return [
        Finding(
            "warning",
            name,
            f"the angle wraps round {count_text(int(wraps.size), 'time')}, first at "
            f"t = {record.t[wraps[0]]:.6g} s.",
            f"Unwrap it: record.with_channel({name!r}, numpy.unwrap(record[{name!r}]), 'rad').",
        )
    ]


def _trend(record: Record, name: str, shown: str) -> tuple[float, list[Finding]]:
    """The change of a line over the record, noticed beyond its scatter if no step is nearer."""
    mask = record.is_missing(name)
    kept = record.filled(name)[~mask]
    s = np.linspace(-0.5, 0.5, record.N)[~mask]
    s0 = s - s.mean()
    drift = float(s0 @ kept / (s0 @ s0)) if kept.size > 1 else 0.0
    spread = float(np.std(kept - drift * s))
    if abs(drift) <= 3 * spread or _scatter_about_step(kept) < spread:
        return drift, []
    over = f"{float(difference_from_si(drift, shown)):.4g}{_behind(shown)} over the record"
    if spread <= abs(drift) * np.sqrt(np.finfo(float).eps):  # to rounding
        text = f"a straight line, {over}, as of a ramp, a counter of rows, or a clock."
        remedy = f"Right for a command that is a ramp; else leave it out, --ignore {name!r}."
        return drift, [Finding("note", name, text, remedy)]
    text = f"a trend: {over}, {abs(drift) / max(spread, TINY):.3g} times the scatter about it."
    remedy = "Where it is the sensor's drift, use record.detrend(1) or a bias parameter."
    return drift, [Finding("note", name, text, remedy)]


def _scatter_about_step(x: FloatArray) -> float:
    """Standard deviation about the one step from level to level that is nearest."""
    n, y = np.arange(1, x.size), x - x.mean()
    sums = np.cumsum(y)[:-1]  # as much from the step on, with the other sign
    gain = sums**2 * (1 / n + 1 / (x.size - n))
    return float(np.sqrt(max(np.mean(y**2) - gain.max(initial=0.0) / x.size, 0.0)))


def _runs(x: FloatArray, mask: BoolArray) -> tuple[int, int, int, int, int]:
    """Return length and start of the longest run of equal samples, the same for runs at an
    extreme, and the longer of the two runs beside that."""
    y, starts, lengths, beside = _equal_runs(x, mask)
    longest = int(np.argmax(lengths))
    extreme = (y[starts] == np.nanmin(y)) | (y[starts] == np.nanmax(y))
    at = int(np.argmax(np.where(extreme, lengths, 0)))
    length = int(lengths[longest])
    return length, int(starts[longest]), int(lengths[at]), int(starts[at]), int(beside[at])


def _equal_runs(
    x: FloatArray, mask: BoolArray
) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Samples, NaN where missing, where runs of equal ones start, their lengths, and that of the
    longer of the two beside each."""
    y = np.where(mask, np.nan, x)  # NaN equals nothing: missing samples part the runs
    starts = np.flatnonzero(np.concatenate(([True], y[1:] != y[:-1])))
    lengths = np.diff(np.concatenate((starts, [x.size])))
    around = np.concatenate(([0], lengths, [0]))
    return y, starts, lengths, np.maximum(around[:-2], around[2:])


def _rests_inside(x: FloatArray, mask: BoolArray, plateau: int) -> bool:
    """True of a profile of ramps and rests, of which one is the highest: no limit made it.

    It rests inside its range as suddenly, and half as long. Zero is where quantities end.
    """
    y, starts, lengths, beside = _equal_runs(x, mask)
    level = y[starts]
    inside = (level > np.nanmin(y)) & (level < np.nanmax(y)) & (level != 0.0)
    is_alike = _begins_suddenly(lengths, beside) & (2 * lengths >= plateau)
    return bool(np.any(inside & is_alike))


def _rests_at_an_end(x: FloatArray, start: int, length: int) -> bool:
    """True of a run at either end of a record beside which the motion gathers speed, from rest.

    Eight samples on, a motion that gathers speed evenly is three to four times as far away as
    after four: by (64 + 16 g) / (16 + 8 g), where its first g samples, up to two, were less than a
    step of the readings. What comes out of a limit has its speed: it is (8 - f) / (4 - f) times as
    far, 7/3 at most, with the share f of an interval that the limit held it yet.
    """
    if start == 0:
        beyond = np.abs(x[length:] - x[0])
    elif start + length == x.size:
        beyond = np.abs(x[:start] - x[-1])[::-1]
    else:
        return False
    return beyond.size >= 8 and bool(beyond[7] > GATHERS_SPEED * beyond[3])


def _begins_suddenly(lengths: int | NDArray[np.intp], beside: int | NDArray[np.intp]) -> BoolArray:
    """Whether runs of equal samples follow and precede motion: those beside them are short.

    The top of a rounded parabola is flat too, but the levels below it hold for 0.2 of its width.
    """
    return np.asarray(beside <= np.maximum(1.0, 0.1 * lengths))


def _jump_into(x: FloatArray, start: int, length: int) -> float:
    """Return the larger of the changes at the two ends of a run."""
    ends = [abs(x[start] - x[k]) for k in (start - 1, start + length) if 0 <= k < x.size]
    return float(max(ends, default=0.0))


def quantisation_step(values: FloatArray) -> float | None:
    """Return the step of which all distances between values are multiples, None for none."""
    levels = np.unique(values)
    if levels.size < 3:
        return None
    distances = np.diff(levels)
    scale = float(np.abs(levels).max())
    distances = distances[distances > 1e-9 * scale]  # rounding of the conversion to SI
    if distances.size == 0:
        return None
    step = _even_step(np.sort(distances))
    multiples = distances / step
    small = multiples < 1e3
    off = np.abs(multiples - np.round(multiples))[small]
    # A chance hit needs every distance to fit: with noise the smallest is far below the others.
    if not small.any() or np.median(multiples) > 50 or np.quantile(off, 0.95) > 0.05:
        return None
    return float(np.median(distances[small] / np.round(multiples[small])))


def _even_step(distances: FloatArray) -> float:
    """The step of sorted distances that a print has rounded: from the smallest one on, by all.

    Of 0.0625 with three decimals the smallest distance is 0.062, which eight steps are none of.
    """
    step, total, count = float(distances[0]), 0.0, 0.0
    for distance in distances.tolist():
        if distance > 50 * step:
            break
        total, count = total + distance, count + round(distance / step)
        step = total / count
    return step


def isolated_spikes(x: FloatArray, mask: BoolArray) -> NDArray[np.intp]:
    """Samples of x (N,) far from their neighbours, each alone; none where `mask` is True."""
    if x.size < 8:
        return np.array([], dtype=np.intp)
    padded = np.pad(x, 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5)
    off = np.abs(x - np.median(windows, axis=1))
    bar = max(8 * robust_sd(off), 5 * float(np.quantile(off, 0.98)))
    if bar == 0.0:
        bar = 0.5 * float(x.std())
    left, right = np.roll(off, 1), np.roll(off, -1)
    alone = (left < 0.5 * off) & (right < 0.5 * off)
    alone[[0, -1]] = False  # the ends have no neighbours on one side
    # At a bend a sample continues the line of one side; a spike continues neither.
    before, after = 2 * padded[1:-3] - padded[:-4], 2 * padded[3:-1] - padded[4:]
    alone &= np.minimum(np.abs(x - before), np.abs(x - after)) > 0.5 * off
    return np.flatnonzero((off > bar) & alone & ~mask)


def _noise_and_band(
    record: Record, name: str, own: NDArray[np.intp], spikes: NDArray[np.intp]
) -> tuple[float | None, float | None, bool]:
    """Noise and bandwidth as in `_spectrum`, from the samples `own` at their own instants.

    Isolated spikes count as missing: the spectrum of one is flat, as that of noise is.
    """
    if spikes.size:
        record = record.mark_missing(name, np.isin(np.arange(record.N), spikes))
    mask = record.is_missing(name)
    kept = np.asarray(record.filled(name)[own], dtype=np.float64)
    shifted = kept - float(record[name][~mask].mean())
    interval = record.Ts * float(own[-1] - own[0]) / max(own.size - 1, 1)
    if own.size == record.N or gaps_of(mask).rate is not None:
        return _spectrum(shifted, interval)
    even = np.linspace(own[0], own[-1], own.size)
    noise = _noise_between(record.t[own], kept)
    return _spectrum(np.interp(even, own, shifted), interval, noise)


def _noise_between(t: FloatArray, x: FloatArray) -> float | None:
    """Standard deviation of noise, from what each sample is off the cubic through its four
    neighbours at their own instants `t`; None for too few, and without any.

    The largest 5 % are left out, as spikes and gaps are among them: 0.759 of the variance of
    normal deviates is left.
    """
    if x.size < 64:
        return None
    beside = np.array([0, 1, 3, 4])
    times = np.lib.stride_tricks.sliding_window_view(t, 5)
    near = times[:, beside] - times[:, 2:3]
    weights = np.ones_like(near)
    for j, k in np.argwhere(~np.eye(4, dtype=bool)):
        weights[:, j] *= near[:, k] / (near[:, k] - near[:, j])
    values = np.lib.stride_tricks.sliding_window_view(x, 5)
    off = values[:, 2] - (weights * values[:, beside]).sum(axis=1)
    off /= np.sqrt(1 + (weights**2).sum(axis=1))
    kept = np.abs(off) <= np.quantile(np.abs(off), 0.95)
    noise = float(np.sqrt(np.mean(off[kept] ** 2) / 0.759))
    return noise if noise > 1e-9 * float(np.abs(x).max()) else None  # else rounding alone


def _spectrum(
    x: FloatArray, Ts: float, noise: float | None = None
) -> tuple[float | None, float | None, bool]:
    """Return noise (`noise`, or white, as dense as the highest fifth), bandwidth [Hz], and whether
    it falls."""
    if x.size < 64:
        return None, None, False
    from scipy.signal import welch

    nperseg = int(np.clip(2 ** int(np.log2(x.size / 8)), 32, 4096))
    f, S = welch(x, fs=1 / Ts, nperseg=nperseg, detrend="constant")
    top = (f >= 0.8 * f[-1]) & (f < f[-1])
    floor = float(np.median(S[top])) if noise is None else 2 * noise**2 * Ts
    above = np.flatnonzero(S[1:] > 4 * floor) + 1
    bandwidth = float(f[above[-1]]) if above.size else 0.0
    return float(np.sqrt(floor * 0.5 / Ts)), bandwidth, bool(floor > 0.1 * S[1:].mean())
