"""Monitor a few parameters of a system that runs: estimates with intervals, and alarms.

The system was calibrated once: most parameters are known, with a covariance. A few, such as a load,
may change. Windows of the stream arrive as additive moments (`windowed_moments`), and with the
mean moments s_c(theta) = Y_c - Phi_c g(theta, eta) of window c, known parameters eta,

    estimate:  theta_hat = argmin ||s_W(theta) - s_0||^2_{V^-1} + ||theta - start||^2_{P^-1},  (1)
    detector:  u_c = theta_0 + G (s_c(theta_0) - s_0),  G = (J' V^-1 J)^-1 J' V^-1,            (2)

J = Phi dg/dtheta. A reference stretch, on which theta_0 is known, gives V, the covariance of a
window's moments as their spread over its windows (batch means: whatever the colour of the errors,
as long as windows are longer than their memory), and s_0, what moments are there at theta_0 where
model and system agree, up to noise. Subtracting s_0 (`differential`) takes out what the model gets
wrong alike before and after; the calibration's errors then count only as far as they are another
error at another load.

(2) is linear in the moments, so that it needs no iteration, has no bias of short windows, and is
the one-step estimate of the local approach (Benveniste, Basseville & Moustakides 1987, IEEE Trans.
Automatic Control 32, 583-592). Its changes are found by `change_detection`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.moments.change_detection import Change, ChangeDetector
from casid.estimation.moments.gram import Moments
from casid.estimation.moments.prior import Prior
from casid.estimation.moments.windowed_moments import FadingSums, SlidingSums
from casid.linear.difference_equation import difference_equation
from casid.linear.lagged_columns import Column
from casid.model.model import Model

Function = Callable[[Mapping[str, float]], float]


@dataclass(frozen=True, slots=True)
class Derived:
    """A number that follows from all parameters, with the limit it should not fall below.

    Attributes
    ----------
    function : of a mapping of every parameter of the model to its value.
    unit : of its value.
    limit : alarm when the lower end of its interval is below; None: no alarm.
    """

    function: Function
    unit: str
    limit: float | None = None


@dataclass(frozen=True, slots=True)
class Interval:
    """A number with its standard error and a two-sided interval."""

    value: float
    std_error: float
    lower: float
    upper: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.lower:.4g}, {self.upper:.4g}] {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """What is known at one time.

    Attributes
    ----------
    time : end of the last window [s], from the first sample that entered the sums.
    estimates : free parameter or derived number -> interval.
    windows : that the estimate comes from.
    statistic : T^2 of the detector; nan while it learns. p_value : of it.
    """

    time: float
    estimates: Mapping[str, Interval]
    windows: int
    statistic: float
    p_value: float

    def __getitem__(self, name: str) -> Interval:
        """The interval of a free parameter or a derived number."""
        return self.estimates[name]

    def __str__(self) -> str:
        found = ", ".join(f"{n} {i}" for n, i in self.estimates.items())
        return f"t = {self.time:.0f} s, {self.windows} windows: {found}"


@dataclass(frozen=True, slots=True, eq=False)
class Alarm:
    """What was found, when, and how sure it is.

    Attributes
    ----------
    kind : "change" of the free parameters, or "limit": a derived number is near its limit.
    what : the free parameters, or the derived number.
    time : of the alarm; since : when the change is thought to have been [s].
    statistic, p_value : of the detector for a change; for a limit, standard errors from the limit,
        and the probability of a smaller number.
    before, after : estimates on either side of a change; equal for a limit.
    """

    kind: Literal["change", "limit"]
    what: str
    time: float
    since: float
    statistic: float
    p_value: float
    before: Mapping[str, Interval]
    after: Mapping[str, Interval]

    def __str__(self) -> str:
        if self.kind == "limit":
            return f"t = {self.time:.0f} s: {self.what} is small: {self.after[self.what]}"
        moved = "; ".join(f"{n} from {i} to {self.after[n]}" for n, i in self.before.items())
        return (
            f"t = {self.time:.0f} s: {self.what} changed at about {self.since:.0f} s "
            f"(T^2 = {self.statistic:.1f}, p = {self.p_value:.1e}): {moved}"
        )


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """How a stream is watched.

    Attributes
    ----------
    every : windows from one status to the next.
    span : windows in the estimate; it never reaches back beyond a change that was found.
    forgetting : weight of a window relative to the next one, instead of `span`.
    differential : subtract s_0 of the reference stretch.
    level : of the intervals, two-sided.
    power_memory : windows over which the power of the equation error is followed, by forgetting.
        The variance of u_c is taken as proportional to it, or to the window's own power where that
        is larger: a window's own is too noisy to call it a quiet one, but a sea that grows rough at
        once must not look like a change. A heuristic.
    method : discretisation of the model.
    """

    every: int = 3
    span: int = 15
    forgetting: float | None = None
    differential: bool = True
    level: float = 0.95
    power_memory: float = 15.0
    method: str = "bilinear"


class Monitor:
    """Estimates and alarms from windows of a stream.

    Parameters
    ----------
    model : indirect model with one output, without unknown inputs.
    Ts : sample time [s].
    known : calibrated parameters with their covariance; those of the model that are neither here
        nor free are taken at their own values, as exact.
    free : parameter -> its value theta_0 on the reference stretch.
    reference : windows of that stretch, in order, made as those to come.
    instruments : columns on channels of the windows, such as `windowed_moments.on_simulated`.
    detector : its rate is per window.
    start : free parameter -> what is thought of it before the stream, with a standard error, which
        counts in the estimates as one more measurement; theta_0 without one by default.
    derived : name -> a number to be reported, with its limit.

    Raises
    ------
    ModelError
        If a parameter is not there, or the model has several outputs.
    DataError
        If the reference stretch has fewer windows than twice the instruments.
    IdentifiabilityError
        If no window could tell the free parameters at theta_0, as the height of a load of 0 kg.
    SolveError
        From `add`, if the iteration of (1) does not come to rest.

    Attributes
    ----------
    status : of every `every` windows; alarms : of all windows; vectors : time [s], u_c of (2) and
        its relative variance, so that another detector may be tried on what has passed.
    """

    def __init__(
        self,
        model: Model,
        *,
        Ts: float,
        known: Prior,
        free: Mapping[str, float],
        reference: Sequence[Moments],
        instruments: Sequence[Column],
        detector: ChangeDetector,
        start: Mapping[str, tuple[float, float]] | None = None,
        derived: Mapping[str, Derived] | None = None,
        settings: MonitorSettings | None = None,
    ) -> None:
        from scipy.special import ndtri

        self.settings = settings or MonitorSettings()
        if len(model.outputs) != 1:
            raise ModelError(
                f"{model.name} has outputs {', '.join(model.outputs)}; one is monitored. Take the "
                "others out of the model, or monitor each."
            )
        for name in (*known.values, *free):
            model.parameter_named(name)
        twice = [n for n in free if n in known.values]
        if twice or not free:
            raise ModelError(
                f"monitor: {twice[0] + ' is free and known at once' if twice else 'nothing free'}. "
                "Name what may change in free=, and what was calibrated in known=."
            )
        self._units = {p.name: p.unit for p in model.parameters.values()}
        self.free, self.known = tuple(free), tuple(known.values)
        self._equation = difference_equation(
            model, next(iter(model.outputs)), Ts, method=self.settings.method
        )
        self._Ts, self._instruments = float(Ts), tuple(instruments)
        self._values = {
            p.name: p.value if p.value is not None else p.start for p in model.parameters.values()
        } | {n: float(v) for n, v in {**known.values, **free}.items()}
        self._known_covariance = known.matrix()
        self._derived = dict(derived or {})
        self._quantile = float(ndtri(0.5 + self.settings.level / 2))
        self._start = np.array([(start or {}).get(n, (v, math.inf))[0] for n, v in free.items()])
        spread = np.array([(start or {}).get(n, (v, math.inf))[1] for n, v in free.items()])
        self._prior = np.diag(1.0 / spread**2)
        self._theta_0 = np.array([float(v) for v in free.values()])
        self._learn(reference)
        self.detector = detector
        s = self.settings
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
        Y, Phi = self._moments(window)
        theta = self._coefficients_0
        power = self._power(window, theta) / self._reference_power
        self._usual += (power - self._usual) / max(self.settings.power_memory, 1.0)
        scale = max(power, self._usual)
        vector = self._theta_0 + self._gain @ (Y - Phi @ theta - self._offset)
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

    # -- what the reference stretch teaches --------------------------------------------------

    def _learn(self, reference: Sequence[Moments]) -> None:
        n, nz = len(reference), len(self._instruments)
        if n < max(2 * nz, 10):
            raise DataError(
                f"monitor: a reference stretch of {n} windows for {nz} instruments; the spread of "
                f"their moments needs {max(2 * nz, 10)} or more. Record longer, or cut shorter "
                "windows."
            )
        theta, slope, known_slope = self._coefficients(self._theta_0)
        self._coefficients_0 = theta
        pairs = [self._moments(m) for m in reference]
        s = np.stack([Y - Phi @ theta for Y, Phi in pairs])
        self._reference_power = float(np.mean([self._power(m, theta) for m in reference]))
        self._n_reference = n
        mean = s.mean(axis=0)
        self._spread = (s - mean).T @ (s - mean) / (n - 1)
        self._Phi_0 = np.mean([Phi for _, Phi in pairs], axis=0)
        self._known_slope_0 = self._Phi_0 @ known_slope
        self._offset = mean if self.settings.differential else np.zeros(nz)
        size = np.sqrt(np.maximum(np.diag(self._spread), TINY))
        values, vectors = np.linalg.eigh(self._spread / np.outer(size, size))
        keep = values > 1e-10 * values[-1]
        self._root = (vectors[:, keep] / np.sqrt(values[keep])).T / size  # R'R = V^-1
        A = self._root @ self._Phi_0 @ slope
        norms = np.linalg.norm(A, axis=0)
        told = A / np.where(norms > 0.0, norms, 1.0)
        if len(A) < len(self.free) or np.linalg.svd(told, compute_uv=False)[-1] < 1e-6:
            lost = [f for f, v in zip(self.free, norms, strict=True) if v == 0.0] or self.free
            raise IdentifiabilityError(
                f"monitor: at {self._point(self._theta_0)} the moments do not tell "
                f"{' and '.join(lost)} apart from the rest. Monitor fewer parameters, take more "
                "instruments, or start from another load."
            )
        self._gain = np.linalg.solve(A.T @ A, A.T @ self._root)

    def _moments(self, window: Moments) -> tuple[Array, Array]:
        phi = (self._equation.left, *self._equation.columns)
        cross = window.between(self._instruments, phi) / float(window.total[-1, -1])
        return cross[:, 0], cross[:, 1:]

    def _power(self, window: Moments, theta: Array) -> float:
        phi = (self._equation.left, *self._equation.columns)
        v = np.concatenate([[1.0], -theta])
        return max(float(v @ window.between(phi, phi) @ v) / float(window.total[-1, -1]), TINY)

    def _coefficients(self, theta_p: Array) -> tuple[Array, Array, Array]:
        """g, dg/d free, dg/d known."""
        names = self._equation.parameters
        at = {**self._values, **dict(zip(self.free, theta_p.tolist(), strict=True))}
        theta, J = self._equation.jacobian([at[n] for n in names])
        J = np.asarray(J)

        def columns(of: Sequence[str]) -> Array:
            zero = np.zeros(len(J))
            found = [J[:, names.index(n)] if n in names else zero for n in of]
            return np.stack(found, axis=1) if found else np.zeros((len(J), 0))

        return np.asarray(theta).ravel(), columns(self.free), columns(self.known)

    # -- estimating --------------------------------------------------------------------------

    def estimate(self, sums: Moments, windows: float) -> tuple[Array, Array]:
        """Free parameters, and the joint covariance of free and known ones, from sums.

        Parameters
        ----------
        sums : of some windows.
        windows : their number; with forgetting, (sum w)^2/(sum w^2).
        """
        Y, Phi = self._moments(sums)
        theta_p, R = self._theta_0.copy(), self._root
        scale = self._power(sums, self._coefficients_0) / self._reference_power
        own = scale / windows
        # V of the window, and of s_0
        factor = own + (1.0 / self._n_reference if self.settings.differential else 0.0)

        def cost(point: Array) -> float:
            e = R @ (Y - Phi @ self._coefficients(point)[0] - self._offset)
            d = point - self._start
            return float(e @ e) / factor + float(d @ self._prior @ d)

        value = cost(theta_p)
        for _ in range(50):
            theta, slope, _ = self._coefficients(theta_p)
            A = R @ Phi @ slope
            e = R @ (Y - Phi @ theta - self._offset)
            H = A.T @ A / factor + self._prior
            gradient = A.T @ e / factor - self._prior @ (theta_p - self._start)
            step = np.linalg.solve(H, gradient)
            if gradient @ step < 1e-8:  # a ten-thousandth of a standard error from the optimum
                break
            size = 1.0
            while (new := cost(theta_p + size * step)) > value and size > 1e-8:
                size *= 0.5
            if size <= 1e-8:
                break
            theta_p, value = theta_p + size * step, new
        else:
            raise SolveError(
                f"monitor: no estimate of {', '.join(self.free)} after 50 steps of Gauss-Newton. "
                "Take a longer span, or say what is known of them in start=."
            )
        _, slope, known_slope = self._coefficients(theta_p)
        A = R @ Phi @ slope
        H = A.T @ A / factor + self._prior
        D = Phi @ known_slope - (self._known_slope_0 if self.settings.differential else 0.0)
        inverse = np.linalg.inv(H)
        T = -inverse @ A.T @ R @ D / factor
        n = len(self.free)
        joint = np.zeros((n + len(self.known),) * 2)
        joint[:n, :n] = inverse + T @ self._known_covariance @ T.T
        joint[:n, n:] = T @ self._known_covariance
        joint[n:, :n] = joint[:n, n:].T
        joint[n:, n:] = self._known_covariance
        return theta_p, joint

    def intervals(self, sums: Moments, windows: float) -> dict[str, Interval]:
        """Intervals of the free parameters and of the derived numbers; see `estimate`."""
        theta_p, joint = self.estimate(sums, windows)
        out = {
            name: self._interval(float(value), float(joint[i, i]), self._units[name])
            for i, (name, value) in enumerate(zip(self.free, theta_p, strict=True))
        }
        names = (*self.free, *self.known)
        at = {**self._values, **dict(zip(self.free, theta_p.tolist(), strict=True))}
        for name, d in self._derived.items():
            gradient = np.zeros(len(names))
            for i, parameter in enumerate(names):
                h = 1e-5 * max(abs(at[parameter]), 1e-3)
                up, down = ({**at, parameter: at[parameter] + s * h} for s in (1.0, -1.0))
                gradient[i] = (d.function(up) - d.function(down)) / (2.0 * h)
            variance = float(gradient @ joint @ gradient)
            out[name] = self._interval(float(d.function(at)), variance, d.unit)
        return out

    def _interval(self, value: float, variance: float, unit: str) -> Interval:
        error = math.sqrt(max(variance, 0.0))
        half = self._quantile * error
        return Interval(value, error, value - half, value + half, unit)

    # -- reporting ---------------------------------------------------------------------------

    def _report(self, change: Change | None) -> list[Alarm]:
        from scipy.special import ndtr

        weights = self._sums.weights
        windows = float(weights.sum() ** 2 / (weights @ weights))
        found = self.intervals(self._sums.total, windows)
        told = (math.nan, math.nan) if change is None else (change.statistic, change.p_value)
        self.status.append(Status(self._time, found, len(weights), *told))
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

    def _point(self, theta_p: Array) -> str:
        return ", ".join(f"{n} = {v:g}" for n, v in zip(self.free, theta_p, strict=True))


__all__ = [
    "Alarm",
    "Derived",
    "Interval",
    "Monitor",
    "MonitorSettings",
    "Status",
]
