"""The noise of a simulation error: from sensors, measured inputs and disturbances.

A measured input is noisy, and the model's resonance amplifies that noise (errors in variables); a
force that nobody models does the same. With G_j the model's transfer functions at the estimate,

    S_i(w) = sigma_i^2 + sum_j |G_ij(w)|^2 sigma_j^2                                          (1)

for output i. What sensors and actuators do beyond an expression (delays, lags) is part of G: of the
recorded input's noise on its way in, and of everything that an output's sensor passes on; the
sensor's own white noise comes after it. The variances minimise Whittle's likelihood of the
residual; the square root of S whitens residuals and sensitivities alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.optimize import lsq_linear, nnls
from scipy.special import gammaincinv

from casid.arrays import TINY, Array, require_finite
from casid.estimation.simulation.sensor_dynamics import prepared_inputs, through_sensor
from casid.estimation.simulation.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.simulator import rk4_sample
from casid.model.model import Model

GROUP = 8
"""Columns that are whitened at once: their transforms take eight times their own room."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Frequency responses of the sampled, linearised model to its noise sources."""

    omega: Array  # (F,) rad/sample, 0..pi
    gain2: Array  # (F, ny, ns) squared magnitudes
    sources: tuple[str, ...]


def noise_response(criterion: SimulationError, x: Array, experiment: int) -> Response:
    """|G|^2 from every measured input and every balance to the outputs, linearised at the mean.

    The step of the simulation itself is linearised, so the response is that of what is simulated.
    """
    model, d = criterion.model, criterion.data[experiment]
    p, _ = criterion.parameter_vector(x, experiment)
    states = criterion.simulated(x, experiment).x  # kept: the residual comes from it as well
    disturbed = _with_disturbances(model)
    e = disturbed.explicit()
    nb = len(model.balances)
    u_next = ca.SX.sym("un", len(e.inputs))
    xs = rk4_sample(disturbed, e, u_next, d.Ts, criterion.substeps)
    jac = ca.Function(
        "lin",
        [e.x, e.u, u_next, e.p],
        [
            ca.jacobian(xs, e.x),
            ca.jacobian(xs, e.u),
            ca.jacobian(xs, u_next),
            ca.jacobian(e.h, e.x),
            ca.jacobian(e.h, e.u),
        ],
    )
    # Equivalent linearisation: the mean of the derivatives over the record, so that kinks and
    # amplitude-dependent terms count by how often they are met.
    pick = np.linspace(0, d.N - 1, min(d.N, 200)).astype(int)
    u = np.hstack([d.u[pick], np.zeros((len(pick), nb))])
    at_points = jac.map(len(pick))(states[pick].T, u.T, u.T, np.tile(p[:, None], (1, len(pick))))
    a, b0, b1, c, dd = (
        np.array(m).reshape(m.shape[0], len(pick), -1).mean(axis=1) for m in at_points
    )
    measured = [n for n in e.inputs if disturbed.inputs[n].kind == "measured"]
    # As fine as the record resolves: a lightly damped resonance is narrower than that already.
    omega = np.linspace(0, np.pi, min(d.N, 1 << 16) + 1)
    # An integrator has no finite response at zero frequency: stay within the record's resolution.
    omega[0] = 0.25 * omega[1]
    z = np.exp(1j * omega)
    eye = np.eye(len(a))
    lhs = z[:, None, None] * eye - a
    enters = _input_stages(criterion, x, experiment, e.inputs, measured, nb, len(omega) - 1)
    rhs = (b0 + z[:, None, None] * b1) @ enters
    g = c @ np.linalg.solve(lhs, rhs) + dd @ enters
    passed = _sensor_stages(criterion, x, experiment, len(omega) - 1)
    gain2 = np.abs(g) ** 2 * passed[:, :, None]
    return Response(omega, gain2, (*measured, *model.balances))


def _input_stages(
    criterion: SimulationError,
    x: Array,
    experiment: int,
    inputs: Sequence[str],
    measured: Sequence[str],
    balances: int,
    n: int,
) -> Array:
    """What the noise of each source is in the input columns that are simulated.

    (1, ni, ns) of ones and zeros, or (n + 1, ni, ns) on 0..pi where a stage prepares a column: the
    transform of what becomes of one noisy sample.
    """
    model, Ts = criterion.model, criterion.data[experiment].Ts
    places = [inputs.index(name) for name in measured]
    places += range(len(inputs) - balances, len(inputs))
    direct = np.zeros((1, len(inputs), len(places)))
    direct[0, places, range(len(places))] = 1.0
    stages = [s for s in model.stages if s.is_of_input]
    channels = [name for name in measured if any(s.channel == name for s in stages)]
    if not channels:
        return direct
    out = np.repeat(direct.astype(complex), n + 1, axis=0)
    values = {s.parameter: criterion.value_of(s.parameter, x, experiment) for s in stages}
    own = list(model.inputs)
    for channel in channels:
        u = np.zeros((2 * n, len(own)))
        u[n, own.index(channel)] = 1.0
        # Carriers are among the columns, but enter times a parameter that is zero.
        prepared = prepared_inputs(model, u, values, Ts)
        out[:, : len(own), measured.index(channel)] = rfft(prepared, axis=0)
    return out


def _sensor_stages(criterion: SimulationError, x: Array, experiment: int, n: int) -> Array:
    """|H|^2 (n + 1, ny) of what each output's sensor passes on, on 0..pi; clipping left out."""
    out = np.ones((n + 1, len(criterion.outputs)))
    for stage in criterion.model.stages:
        if stage.is_of_input or stage.kind == "clip":
            continue
        y = np.zeros(2 * n)
        y[n] = 1.0
        value = criterion.value_of(stage.parameter, x, experiment)
        through_sensor(stage.kind, y, None, value, criterion.data[experiment].Ts, -1)
        out[:, criterion.outputs.index(stage.channel)] *= np.abs(rfft(y)) ** 2
    return out


def _with_disturbances(model: Model) -> Model:
    from casid.model.model import Input

    new = model.copy()
    # What lags before the simulation moves in lines of its own; sensors come after it.
    new.stages = tuple(s for s in model.stages if s.is_of_input)
    for name, balance in model.balances.items():
        w = new.add_input(Input(f"disturbance of {name}", balance.unit, "unknown"))
        new.add_term(name, w)
    return new


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Variances of (1) and the whitening they give, in the criterion's weighted output units."""

    output_sd: Array  # (ny,) white noise of each output, output units
    source_sd: Mapping[str, float]  # measured input or balance -> white noise per sample
    responses: Sequence[Response]  # one an experiment
    weights: Array
    alike: Sequence[tuple[str, ...]] = ()  # sources of one shape; the first carries the variance
    _gains: dict[tuple[int, int], Array] = field(default_factory=dict, init=False, repr=False)

    def quiet(self, input_sd: Mapping[str, float]) -> NoiseModel:
        """The same without disturbances: sensors and measured inputs only."""
        return replace(self, source_sd={name: input_sd.get(name, 0.0) for name in self.source_sd})

    def of_inputs(self, largest: Mapping[str, float]) -> dict[str, float]:
        """What part of `source_sd` the measured inputs can account for.

        Parameters
        ----------
        largest : measured input -> upper bound on its white noise. Inputs that act alike share the
            variance found, each by the part it could have at its bound; the rest is a disturbance.
        """
        out = {}
        for group in self.alike:
            inputs = [name for name in group if name in largest]
            gains = {name: sum(self._gain(name, r) for r in self.responses) for name in group}
            found = sum(self.source_sd[name] ** 2 * gains[name] for name in group)
            could = sum(largest[name] ** 2 * gains[name] for name in inputs)
            share = np.sqrt(min(found / could, 1.0)) if could > 0 else 0.0
            out.update({name: float(share * largest[name]) for name in inputs})
        return out

    @staticmethod
    def _gain(name: str, r: Response) -> float:
        return float(r.gain2[:, :, r.sources.index(name)].mean())

    def spectrum(self, experiment: int) -> Array:
        """S (F, ny) per sample, output units squared, on the response's frequencies."""
        r = self.responses[experiment]
        variances = np.array([self.source_sd[s] ** 2 for s in r.sources])
        return np.asarray(self.output_sd[None, :] ** 2 + r.gain2 @ variances)

    def floor(self, experiment: int) -> Array:
        """(ny,) rms that the best possible model would leave."""
        s = self.spectrum(experiment)
        return np.asarray(
            np.sqrt(np.trapezoid(s, self.responses[experiment].omega, axis=0) / np.pi)
        )

    def excess(self, quiet: NoiseModel, samples: Sequence[int]) -> tuple[float, float]:
        """Mean square of this noise over that of `quiet`, and the latter's relative spread.

        The largest over the outputs, all records together; a mean of exponential periodograms has
        the variance sum S^2 / (sum S)^2.

        Parameters
        ----------
        samples : of each record.
        """
        total, other, square = (np.zeros(len(self.output_sd)) for _ in range(3))
        for e, n in enumerate(samples):
            omega, s, per = self.responses[e].omega, quiet.spectrum(e), n / (2 * np.pi)
            total += per * np.trapezoid(self.spectrum(e), omega, axis=0)
            other += per * np.trapezoid(s, omega, axis=0)
            square += per * np.trapezoid(s**2, omega, axis=0)
        i = int(np.argmax(total / np.maximum(other, TINY)))
        floor = max(float(other[i]), TINY)
        return float(total[i]) / floor, float(np.sqrt(square[i])) / floor

    def whiten(self, columns: Array, experiment: int) -> Array:
        """Columns (N, ny, m), times `weights`, filtered by S^(-1/2) to white noise of unit size."""
        n = len(columns)
        if not any(self.source_sd.values()):
            return np.asarray(columns / (self.output_sd * self.weights)[None, :, None])
        size = next_fast_len(2 * n, real=True)
        gains = self._gains_of(experiment, size)
        out = np.empty(columns.shape)
        for i, gain in enumerate(gains):
            for first in range(0, columns.shape[2], GROUP):
                group = slice(first, first + GROUP)
                # Along the last axis: each column lies in one piece while it is transformed.
                spectrum = rfft(np.ascontiguousarray(columns[:, i, group].T), size)
                spectrum *= gain
                out[:, i, group] = irfft(spectrum, size, overwrite_x=True)[:, :n].T
        return out

    def _gains_of(self, experiment: int, size: int) -> Array:
        """S^(-1/2) (ny, size // 2 + 1) of the weighted outputs on the grid of a transform."""
        if (experiment, size) not in self._gains:
            s = self.spectrum(experiment) * self.weights[None, :] ** 2
            grid = np.linspace(0, np.pi, size // 2 + 1)
            omega = self.responses[experiment].omega
            self._gains[experiment, size] = np.array(
                [1 / np.sqrt(np.interp(grid, omega, column)) for column in s.T]
            )
        return self._gains[experiment, size]


def estimate_noise(
    criterion: SimulationError,
    x: Array,
    *,
    known: Mapping[str, float] | None = None,
    residuals: Sequence[Array] | None = None,
    merge: bool = True,
) -> NoiseModel:
    """Estimate (1) from the residuals at `x` by Fisher scoring of Whittle's likelihood.

    Sources whose responses have the same shape (an input and a balance it enters) are
    indistinguishable: the variance is given to the first, measured inputs before balances, and
    `alike` lists them. A source whose noise is known is counted on its own.

    Parameters
    ----------
    known : channel -> standard deviation that is known and not estimated.
    residuals : (N, ny) an experiment, default those at `x`.
    """
    known = dict(known or {})
    ny = len(criterion.outputs)
    responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    every = list(responses[0].sources)
    alike: list[tuple[str, ...]] = [(name,) for name in every if name in known]
    rest = [name for name in every if name not in known]
    alike += _alike(responses, every, rest) if merge else [(name,) for name in rest]
    sources = [group[0] for group in alike]
    names = [*criterion.outputs, *sources]
    given = np.array([known[name] ** 2 if name in known else np.nan for name in names])
    spectra = _spectra(residuals, responses, sources, ny)
    require_finite("the residual's spectra", spectra.power, spectra.design)
    floor = 1e-8 * max(float(np.average(spectra.power, weights=spectra.count)), TINY)
    value = _variances(spectra, given, floor)
    output_sd = np.sqrt(np.maximum(value[:ny], floor))
    found = {name: float(np.sqrt(v)) for name, v in zip(sources, value[ny:], strict=True)}
    return NoiseModel(
        output_sd=output_sd,
        source_sd={name: found.get(name, 0.0) for name in every},
        responses=responses,
        weights=criterion.weights,
        alike=tuple(alike),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Periodograms of all residuals in bands, and what a unit variance of each source adds."""

    design: Array  # (B, ny + ns) |G|^2
    power: Array  # (B,)
    count: Array  # (B,) frequencies of each band


def _spectra(
    residuals: Sequence[Array], responses: Sequence[Response], sources: Sequence[str], ny: int
) -> _Spectra:
    rows, powers, counts = [], [], []
    for r, response in zip(residuals, responses, strict=True):
        places = [response.sources.index(source) for source in sources]
        for i, (power, gain2, count) in enumerate(_bins(r, response)):
            own = np.zeros((len(power), ny))
            own[:, i] = 1.0
            rows.append(np.hstack([own, gain2[:, places]]))
            powers.append(power)
            counts.append(count)
    return _Spectra(np.vstack(rows), np.concatenate(powers), np.concatenate(counts))


def _variances(spectra: _Spectra, given: Array, floor: float) -> Array:
    """Variances that minimise Whittle's likelihood by scoring; `given` ones (else NaN) are kept."""
    design, power, count = spectra.design, spectra.power, spectra.count
    fixed = np.isfinite(given)
    value = np.where(fixed, given, 0.0)
    offset = design @ value
    free = design[:, ~fixed]
    s = np.maximum(power, 1e-12 * max(float(power.max(initial=0.0)), TINY)) + offset
    solution = new = np.zeros(free.shape[1])
    for k in range(60):
        weight = np.sqrt(count) / s
        scale = np.sqrt(np.sum((free * weight[:, None]) ** 2, axis=0)) + TINY
        target = np.maximum(power - offset, 0.0) * weight
        new = _least(free * (weight[:, None] / scale), target, new) / scale
        solution = new if k == 0 else 0.5 * (solution + new)
        s = np.maximum(free @ solution + offset, floor)
    value[~fixed] = solution
    return value


def _least(a: Array, b: Array, near: Array) -> Array:
    """Non-negative x that minimises |a x - b|; the one with the zeros of `near`, if it is."""
    held = near <= 0.0
    if not held.all():
        x = np.zeros(a.shape[1])
        x[~held], _, rank, _ = np.linalg.lstsq(a[:, ~held], b, rcond=None)
        if rank == np.sum(~held) and np.all(x[~held] > 0.0):
            # Lawson and Hanson's condition, columns of unit size: none held at zero would grow.
            if np.all(a[:, held].T @ (b - a @ x) <= 1e-12 * np.linalg.norm(b)):
                return x
    try:
        return np.asarray(nnls(a, b)[0])
    except RuntimeError:  # its active set cycles where columns are nearly dependent
        return np.asarray(lsq_linear(a, b, bounds=(0.0, np.inf)).x)


def _alike(
    responses: Sequence[Response], sources: list[str], candidates: Sequence[str]
) -> list[tuple[str, ...]]:
    """Those of `candidates` in groups whose |G|^2 are multiples of one another; none that is 0."""
    groups: list[list[str]] = []
    stacked = np.concatenate([r.gain2.reshape(-1, len(sources)) for r in responses])
    logs = 0.5 * np.log(np.maximum(stacked, TINY))
    for name in candidates:
        j = sources.index(name)
        strong = stacked[:, j] > 1e-6 * stacked[:, j].max(initial=0.0)
        if not strong.any() or stacked[:, j].max() <= 0:
            continue
        for group in groups:
            gap = logs[strong, j] - logs[strong, sources.index(group[0])]
            if float(np.std(gap)) < 0.25:
                group.append(name)
                break
        else:
            groups.append([name])
    return [tuple(group) for group in groups]


def _bins(residual: Array, response: Response) -> list[tuple[Array, Array, Array]]:
    """Periodogram and |G|^2 in bands of growing width: (power, gain2, count) for each output."""
    n = len(residual)
    omega = 2 * np.pi * np.arange(n // 2 + 1) / n
    edges = np.unique(np.round(np.geomspace(1, len(omega) + 1, 160)).astype(int)) - 1
    count = np.diff(edges)
    out = []
    for i in range(residual.shape[1]):
        spectrum = np.abs(rfft(residual[:, i])) ** 2 / n
        power = np.add.reduceat(spectrum, edges[:-1]) / count
        columns = []
        for j in range(response.gain2.shape[2]):
            g = np.interp(omega, response.omega, response.gain2[:, i, j])
            columns.append(np.add.reduceat(g, edges[:-1]) / count)
        gain2 = np.column_stack(columns) if columns else np.zeros((len(power), 0))
        out.append((power, gain2, count.astype(float)))
    return out


def input_noise_floor(signals: Sequence[Signals], inputs: Sequence[str]) -> dict[str, float]:
    """Estimated bound on each input's white noise: the quietest spectrum near Nyquist.

    The upper half band of every record is cut into twenty parts. The quietest quarter of all parts
    is averaged, and divided by what that would be, of 1, for white noise alone: the parts of a
    tapered periodogram are Gamma distributed, and the quietest lie below the mean.
    """
    return {name: white_floor([d.u[:, i] for d in signals]) for i, name in enumerate(inputs)}


def white_floor(records: Sequence[Array]) -> float:
    """The same for one channel, (N,) a record."""
    parts: list[float] = []
    shape = np.inf
    for values in records:
        # A taper, else the ends' jump leaks to Nyquist.
        window = np.hanning(len(values))
        spectrum = np.abs(rfft((values - values.mean()) * window)) ** 2 / np.sum(window**2)
        pieces = [p for p in np.array_split(spectrum[len(spectrum) // 2 :], 20) if len(p)]
        parts += [float(p.mean()) for p in pieces]
        # Hann's bins are correlated by 2/3 and 1/6 in amplitude with the next and the second.
        shape = min(shape, float(np.mean([len(p) for p in pieces])) / (1 + 2 * (4 / 9 + 1 / 36)))
    kept, shape = max(len(parts) // 4, 1), max(shape, 0.5)
    ranks = (np.arange(1, kept + 1) - 0.375) / (len(parts) + 0.25)  # Blom's
    expected = float(np.mean(gammaincinv(shape, ranks))) / shape
    return float(np.sqrt(np.mean(sorted(parts)[:kept]) / expected))
