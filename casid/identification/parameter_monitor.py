"""Monitor a few parameters of a system in operation: estimates with intervals, and alarms.

The system was calibrated once: most parameters are known, with a covariance. A few, such as a load,
may change. Windows of the stream arrive as additive moments (`windowed_moments`), which give
one-step estimates, whose changes are found by `change_detection`, and estimates with intervals over
the windows since the last change (`window_estimator`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.cross_moments.gram import Moments
from casid.estimation.cross_moments.windowed_moments import FadingSums, SlidingSums
from casid.estimation.moments.change_detection import Change, ChangeDetector
from casid.identification.monitor_status import Alarm, Derived, Interval, MonitorSettings, Status
from casid.identification.window_estimator import MonitoredParameters, WindowEstimator
from casid.linear.sampled.lagged_columns import Column
from casid.model.model import Model


class Monitor:
    """Estimates and alarms from windows of a stream.

    Parameters
    ----------
    model : indirect model with one output, without unknown inputs.
    Ts : sample time [s].
    parameters : what may change, what is known.
    reference : windows of the reference stretch, in order, made as those to come.
    instruments : columns on channels of the windows, such as `windowed_moments.on_simulated`.
    detector : its rate is per window.
    derived : name -> a number to be reported, with its limit.

    Raises
    ------
    ModelError
        If a parameter is not there, or the model has several outputs.
    DataError
        If the reference stretch has fewer windows than twice the instruments.
    IdentifiabilityError
        If no window determines the free parameters at theta_0, as the height of a load of 0 kg.
    SolveError
        From `add`, if the iteration for an estimate does not settle.

    Attributes
    ----------
    status : of every `every` windows; alarms : of all windows; vectors : time [s], the one-step
        estimate and its relative variance, so that another detector may be tried on the past.
    """

    def __init__(
        self,
        model: Model,
        *,
        Ts: float,
        parameters: MonitoredParameters,
        reference: Sequence[Moments],
        instruments: Sequence[Column],
        detector: ChangeDetector,
        derived: Mapping[str, Derived] | None = None,
        settings: MonitorSettings | None = None,
    ) -> None:
        from scipy.special import ndtri

        self.settings = s = settings or MonitorSettings()
        self.estimator = WindowEstimator(
            model,
            Ts,
            parameters,
            reference,
            instruments,
            differential=s.differential,
            method=s.method,
        )
        self.free = self.estimator.free
        self._model = model
        self._Ts = float(Ts)
        self._derived = dict(derived or {})
        self._quantile = float(ndtri(0.5 + s.level / 2))
        self.detector = detector
        self._sums = SlidingSums(s.span) if s.forgetting is None else FadingSums(s.forgetting)
        self._recent = SlidingSums(max(detector.widths))
        self._older: Moments | None = None  # since the last change, before `_recent`
        self._n_older = 0
        self._count, self._time, self._usual = 0, 0.0, 1.0
        self._low: set[str] = set()
        self.status: list[Status] = []
        self.alarms: list[Alarm] = []
        self.vectors: list[tuple[float, Array, float]] = []

    def add(self, window: Moments) -> list[Alarm]:
        """Take the next window; returns the alarms it raises."""
        self._count += 1
        self._time += window.N * self._Ts
        power = self.estimator.power(window)
        self._usual += (power - self._usual) / max(self.settings.power_memory, 1.0)
        scale = max(power, self._usual)
        vector = self.estimator.one_step(window)
        self.vectors.append((self._time, vector, scale))
        change = self.detector.add(vector, scale)
        self._sums.add(window)
        kept = self._recent.windows
        if len(kept) == max(self.detector.widths):
            self._older = kept[0] if self._older is None else self._older + kept[0]
            self._n_older += 1
        self._recent.add(window)
        raised = []
        if change is not None and self.detector.is_alarm(change):
            raised.append(self._changed(change))
        if self._count % self.settings.every == 0:
            raised += self._report(change)
        self.alarms += raised
        return raised

    def intervals(self, sums: Moments, windows: float) -> dict[str, Interval]:
        """Intervals of the free parameters and of the derived numbers, in their units."""
        model = self._model
        theta_p, joint = self.estimator.estimate(sums, windows)
        out = {
            name: self._interval(
                model.shown(name, float(value)),
                model.shown_size(name, math.sqrt(max(joint[i, i], 0.0))),
                model.unit_of(name),
            )
            for i, (name, value) in enumerate(zip(self.free, theta_p, strict=True))
        }
        names = (*self.free, *self.estimator.known)
        at = {**self.estimator.values, **dict(zip(self.free, theta_p.tolist(), strict=True))}
        for name, d in self._derived.items():
            gradient = np.zeros(len(names))
            for i, parameter in enumerate(names):
                h = 1e-5 * max(abs(at[parameter]), 1e-3)
                up, down = ({**at, parameter: at[parameter] + s * h} for s in (1.0, -1.0))
                high, low = (d.function(model.in_declared_units(v)) for v in (up, down))
                gradient[i] = (high - low) / (2.0 * h)
            error = math.sqrt(max(float(gradient @ joint @ gradient), 0.0))
            value = float(d.function(model.in_declared_units(at)))
            out[name] = self._interval(value, error, d.unit)
        return out

    def _interval(self, value: float, error: float, unit: str) -> Interval:
        half = self._quantile * error
        return Interval(value, error, value - half, value + half, unit)

    # -- reporting ---------------------------------------------------------------------------

    def _report(self, change: Change | None) -> list[Alarm]:
        from scipy.special import ndtr

        weights = self._sums.weights
        windows = float(weights.sum() ** 2 / (weights @ weights))
        found = self.intervals(self._sums.total, windows)
        test = (math.nan, math.nan) if change is None else (change.statistic, change.p_value)
        self.status.append(Status(self._time, found, len(weights), *test))
        raised = []
        for name, d in self._derived.items():
            if d.limit is None:
                continue
            i = found[name]
            if i.lower >= d.limit:
                self._low.discard(name)
            elif name not in self._low:
                self._low.add(name)
                away = (i.value - d.limit) / max(i.std_error, TINY)
                p = float(ndtr(-away))
                raised.append(Alarm("limit", name, self._time, self._time, away, p, found, found))
        return raised

    def _changed(self, change: Change) -> Alarm:
        kept = self._recent.windows
        after = kept[len(kept) - change.width :]
        before = kept[: len(kept) - change.width]
        older = [self._older] if self._older is not None else []
        first = self.intervals(sum((*older, *before)), self._n_older + len(before))  # type: ignore[arg-type]
        second = self.intervals(sum(after), change.width)  # type: ignore[arg-type]
        since = self._time - sum(m.N for m in after) * self._Ts
        self.detector.restart(change.width)
        self._sums.keep_last(change.width)
        self._recent.keep_last(change.width)
        self._older, self._n_older = None, 0
        return Alarm(
            "change",
            " and ".join(self.free),
            self._time,
            since,
            change.statistic,
            change.p_value,
            first,
            second,
        )
