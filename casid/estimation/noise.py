"""The noise of a simulation error: from sensors, measured inputs and disturbances.

A measured input is noisy, and the model's resonance amplifies that noise (errors in variables); a
force that nobody models does the same. With G_j the model's transfer functions at the estimate,

    S_i(w) = sigma_i^2 + sum_j |G_ij(w)|^2 sigma_j^2                                          (1)

for output i. What sensors and actuators do beyond an expression (delays, lags) is part of G: of the
recorded input's noise on its way in, and of everything that an output's sensor passes on; the
sensor's own white noise comes after it. The noise of sensors and measured inputs is white. A force
that nobody models (wind, waves, a road) is not: where the residual shows it, sigma_j^2 of a balance
is a function of frequency, linear between knots an octave apart. The variances minimise Whittle's
likelihood of the residual; the square root of S whitens residuals and sensitivities alike.
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

LOWEST = 4
"""Line of the spectrum at the lowest knot of a disturbance's spectrum."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Frequency responses of the sampled, linearised model to its noise sources."""

    omega: Array  # (F,) rad/sample, 0..pi
    gain2: Array  # (F, ny, ns) squared magnitudes
    sources: tuple[str, ...]
    Ts: float = 1.0  # s
    gain: Array | None = None  # (F, ny, ns) the responses themselves; a phase per source is free


@dataclass(frozen=True, slots=True, eq=False)
class Colour:
    """Spectrum of a disturbance beside its white part, linear in the logarithm of frequency."""

    omega: Array  # (K,) rad/s, rising; constant beyond its ends
    power: Array  # (K,) variance a sample

    def at(self, omega: Array) -> Array:
        """The spectrum at frequencies in rad/s."""
        return hats(self.omega, omega) @ self.power


def hats(knots: Array, omega: Array) -> Array:
    """Piecewise linear functions of log frequency, (F, K): one at its knot, all together one."""
    place = np.log(np.maximum(omega, TINY))
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(place, np.log(knots), row) for row in eye])


def octaves(sample_times: Sequence[float], samples: Sequence[int]) -> Array:
    """Knots [rad/s] an octave apart, from `LOWEST` lines of the longest record to Nyquist."""
    low = min(2 * np.pi * LOWEST / (n * Ts) for n, Ts in zip(samples, sample_times, strict=True))
    high = np.pi / min(sample_times)
    return np.geomspace(low, high, max(int(np.ceil(np.log2(high / low))), 1) + 1)


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
    g = g * _sensor_stages(criterion, x, experiment, len(omega) - 1)[:, :, None]
    return Response(omega, np.abs(g) ** 2, (*measured, *model.balances), d.Ts, g)


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
    """H (n + 1, ny) of what each output's sensor passes on, on 0..pi; clipping left out."""
    out = np.ones((n + 1, len(criterion.outputs)), dtype=complex)
    back = (-1.0) ** np.arange(n + 1)  # the pulse comes in the middle
    for stage in criterion.model.stages:
        if stage.is_of_input or stage.kind == "clip":
            continue
        y = np.zeros(2 * n)
        y[n] = 1.0
        value = criterion.value_of(stage.parameter, x, experiment)
        through_sensor(stage.kind, y, None, value, criterion.data[experiment].Ts, -1)
        out[:, criterion.outputs.index(stage.channel)] *= back * rfft(y)
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
    colours: Mapping[str, Colour] = field(default_factory=dict)  # disturbances that are not white
    likelihood: float = -np.inf  # Whittle's, log, of what it was estimated from
    _roots: dict[tuple[int, int], Array] = field(default_factory=dict, init=False, repr=False)

    def quiet(self, input_sd: Mapping[str, float]) -> NoiseModel:
        """The same without disturbances: sensors and measured inputs only."""
        found = {name: input_sd.get(name, 0.0) for name in self.source_sd}
        return replace(self, source_sd=found, colours={})

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
            found += sum(self._coloured_power(name) for name in group if name in self.colours)
            could = sum(largest[name] ** 2 * gains[name] for name in inputs)
            share = np.sqrt(min(found / could, 1.0)) if could > 0 else 0.0
            out.update({name: float(share * largest[name]) for name in inputs})
        return out

    def share_of_disturbances(self, input_sd: Mapping[str, float]) -> float:
        """Share of the weighted outputs' power that neither sensors nor measured inputs give."""
        quiet, weights = self.quiet(input_sd), self.weights**2
        every = range(len(self.responses))
        part, whole = (
            sum(float(np.mean(noise.spectrum(e) @ weights)) for e in every)
            for noise in (quiet, self)
        )
        return 1 - part / whole if whole > 0 else 0.0

    def _coloured_power(self, name: str) -> float:
        """What a disturbance gives to the outputs beside its white part, summed as gains are."""
        total = 0.0
        for r in self.responses:
            colour = self.colours[name].at(r.omega / r.Ts)
            total += float(np.mean(r.gain2[:, :, r.sources.index(name)] * colour[:, None]))
        return total

    @staticmethod
    def _gain(name: str, r: Response) -> float:
        return float(r.gain2[:, :, r.sources.index(name)].mean())

    def spectrum(self, experiment: int) -> Array:
        """S (F, ny) per sample, output units squared, on the response's frequencies."""
        r = self.responses[experiment]
        out = np.repeat(self.output_sd[None, :] ** 2, len(r.omega), axis=0)
        for j, source in enumerate(r.sources):
            out += r.gain2[:, :, j] * self.source_spectrum(source, experiment)[:, None]
        return out

    def source_spectrum(self, source: str, experiment: int) -> Array:
        """Variance a sample (F,) of one source, on the response's frequencies."""
        r = self.responses[experiment]
        white = np.full(len(r.omega), self.source_sd[source] ** 2)
        colour = self.colours.get(source)
        return white if colour is None else white + colour.at(r.omega / r.Ts)

    def floor(self, experiment: int) -> Array:
        """(ny,) rms that the best possible model would leave."""
        s = self.spectrum(experiment)
        return np.asarray(
            np.sqrt(np.trapezoid(s, self.responses[experiment].omega, axis=0) / np.pi)
        )

    def whiten(self, columns: Array, experiment: int) -> Array:
        """Columns (N, ny, m), times `weights`, filtered by S^(-1/2) to white noise of unit size.

        A force moves several outputs at once: S^(-1/2) is that of the matrix of their spectra.
        """
        n, ny, m = columns.shape
        if not any(self.source_sd.values()) and not self.colours:
            return np.asarray(columns / (self.output_sd * self.weights)[None, :, None])
        size = next_fast_len(2 * n, real=True)
        root = self._root_of(experiment, size)
        out = np.empty(columns.shape)
        for first in range(0, m, GROUP):
            group = slice(first, min(first + GROUP, m))
            # Along the last axis: each column lies in one piece while it is transformed.
            spectra = [rfft(np.ascontiguousarray(columns[:, i, group].T), size) for i in range(ny)]
            for i in range(ny):
                mixed = sum(root[i, k] * spectra[k] for k in range(ny))
                out[:, i, group] = irfft(mixed, size, overwrite_x=True)[:, :n].T
        return out

    def _root_of(self, experiment: int, size: int) -> Array:
        """S^(-1/2) (ny, ny, size // 2 + 1) of the weighted outputs on the grid of a transform."""
        if (experiment, size) not in self._roots:
            grid = np.linspace(0, np.pi, size // 2 + 1)
            omega = self.responses[experiment].omega
            s = self._matrix(experiment) * np.outer(self.weights, self.weights)
            on_grid = np.empty((len(grid), *s.shape[1:]), dtype=s.dtype)
            for i, k in np.ndindex(*s.shape[1:]):
                on_grid[:, i, k] = np.interp(grid, omega, s[:, i, k])
            self._roots[experiment, size] = np.moveaxis(_inverse_root(on_grid), 0, -1)
        return self._roots[experiment, size]

    def _matrix(self, experiment: int) -> Array:
        """Spectra and cross-spectra (F, ny, ny) of the outputs, output units squared."""
        r = self.responses[experiment]
        if r.gain is None or r.gain.shape[1] == 1:
            return self.spectrum(experiment)[:, :, None] * np.eye(r.gain2.shape[1])
        source = [np.sqrt(self.source_spectrum(s, experiment)) for s in r.sources]
        g = r.gain * np.stack(source, axis=-1)[:, None, :]
        return np.asarray(g @ g.conj().swapaxes(1, 2) + np.diag(self.output_sd**2))

    def share_of(self, part: NoiseModel, experiment: int) -> Array:
        """What a part of this noise leaves of its whitened spectra, (F, ny) on 0..pi, 1 at most."""
        omega = self.responses[experiment].omega
        root = _inverse_root(self._matrix(experiment))
        left = root @ part._matrix(experiment) @ root.conj().swapaxes(1, 2)
        share = np.minimum(np.diagonal(left, axis1=1, axis2=2).real, 1.0)
        grid = np.linspace(0, np.pi, len(omega))
        return np.column_stack([np.interp(grid, omega, column) for column in share.T])


def _inverse_root(s: Array) -> Array:
    """S^(-1/2) of Hermitian matrices (F, n, n)."""
    if s.shape[1] == 1:
        return np.asarray(1 / np.sqrt(s))
    values, vectors = np.linalg.eigh(s)
    values = np.maximum(values, 1e-15 * values[:, -1:])
    return np.asarray((vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2))


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
    responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    every = list(responses[0].sources)
    alike: list[tuple[str, ...]] = [(name,) for name in every if name in known]
    rest = [name for name in every if name not in known]
    alike += _alike(responses, every, rest) if merge else [(name,) for name in rest]
    sources = [group[0] for group in alike]
    forces = {g[0]: g[-1] for g in alike if g[-1] in criterion.model.balances}
    names = [*criterion.outputs, *sources]
    spectra = _spectra(residuals, responses, sources, len(criterion.outputs))
    require_finite("the residual's spectra", spectra.power, spectra.design)
    smallest = (
        float(np.average(spectra.power, weights=spectra.count)) if len(spectra.power) else 0.0
    )
    floor = 1e-8 * max(smallest, TINY)
    least = np.zeros(len(names))
    least[: len(criterion.outputs)] = np.maximum(resolution(criterion) ** 2 / 12, floor)
    given = np.array([known[name] ** 2 if name in known else np.nan for name in names])
    knots = octaves([d.Ts for d in criterion.data], [d.N for d in criterion.data])
    floors = input_noise_floor(criterion.data, list(criterion.model.inputs))
    places = {names.index(s): floors.get(s, 0.0) ** 2 for s in forces}
    value, colours, likelihood = _coloured(spectra, given, least, knots, places)
    found = dict(zip(names, np.sqrt(value).tolist(), strict=True))
    return NoiseModel(
        output_sd=np.array([found[name] for name in criterion.outputs]),
        source_sd={name: found[name] if name in sources else 0.0 for name in every},
        responses=responses,
        weights=criterion.weights,
        alike=tuple(alike),
        colours={forces[names[i]]: Colour(knots, power) for i, power in colours.items()},
        likelihood=likelihood,
    )


def resolution(criterion: SimulationError) -> Array:
    """(ny,) smallest distance between different values of each output: its noise is no less."""
    out = np.zeros(len(criterion.outputs))
    for i in range(len(out)):
        steps = [np.diff(np.unique(d.y[d.used[:, i], i])) for d in criterion.data]
        out[i] = min((float(s.min()) for s in steps if len(s)), default=0.0)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Periodograms of all residuals in bands, and what a unit variance of each source adds."""

    design: Array  # (B, ny + ns) |G|^2
    power: Array  # (B,)
    count: Array  # (B,) frequencies of each band
    omega: Array  # (B,) rad/s, their mean

    def likelihood(self, s: Array) -> float:
        """Whittle's log-likelihood of the spectrum `s` (B,)."""
        return -float(self.count @ (np.log(s) + self.power / s))


def _spectra(
    residuals: Sequence[Array], responses: Sequence[Response], sources: Sequence[str], ny: int
) -> _Spectra:
    rows, powers, counts, places = [], [], [], []
    for r, response in zip(residuals, responses, strict=True):
        columns = [response.sources.index(source) for source in sources]
        for i, (power, gain2, count, omega) in enumerate(_bins(r, response)):
            own = np.zeros((len(power), ny))
            own[:, i] = 1.0
            rows.append(np.hstack([own, gain2[:, columns]]))
            powers.append(power)
            counts.append(count)
            places.append(omega / response.Ts)
    joined = (np.concatenate(each) for each in (powers, counts, places))
    return _Spectra(np.vstack(rows), *joined)


def _coloured(
    spectra: _Spectra, given: Array, least: Array, knots: Array, forces: Mapping[int, float]
) -> tuple[Array, dict[int, Array], float]:
    """Variances, spectra beside them of those columns `forces` that are not white, likelihood.

    One after another, the one that gains most, while Schwarz's criterion gains. `forces` has the
    white noise of a measured input that acts alike: so much of what is white stays.
    """
    least = least.copy()
    value = _variances(spectra.design, spectra, given, least)
    best = spectra.likelihood(spectra.design @ value)
    white = least.copy()
    for j, floor in forces.items():
        white[j] = min(value[j], floor)
    shapes = hats(knots, spectra.omega)
    price = 0.5 * (len(knots) - 1) * float(np.log(2 * max(spectra.count.sum(), 1.0)))
    chosen: list[int] = []
    design, total = spectra.design, value
    while True:
        found = []
        for j in forces:
            if j in chosen:
                continue
            wide = np.hstack([design, spectra.design[:, [j]] * shapes])
            more = wide.shape[1] - len(given)
            kept = np.where(np.arange(len(given)) == j, white, least)
            v = _variances(
                wide,
                spectra,
                np.concatenate([given, np.full(more, np.nan)]),
                np.concatenate([kept, np.zeros(more)]),
            )
            found.append((spectra.likelihood(wide @ v) - price, j, v, wide))
        top = max(found, key=lambda f: f[0], default=None)
        if top is None or top[0] <= best:
            break
        best, j, total, design = top
        chosen.append(j)
        least[j] = white[j]
    value, colours = total[: len(given)].copy(), {}
    for k, j in enumerate(chosen):
        first = len(given) + k * len(knots)
        power = total[first : first + len(knots)]
        if not np.isfinite(given[j]):
            value[j] += power.min()  # what is in all of them is white
            power = power - power.min()
        colours[j] = power
    return value, colours, best


def _variances(design: Array, spectra: _Spectra, given: Array, least: Array) -> Array:
    """Variances that minimise Whittle's likelihood by scoring; `given` ones (else NaN) are kept.

    None is below `least`.
    """
    power, count = spectra.power, spectra.count
    fixed = np.isfinite(given)
    value = np.where(fixed, given, least)
    offset = design @ value
    free = design[:, ~fixed]
    floor = 1e-12 * max(float(power.max(initial=0.0)), TINY)
    s = np.maximum(power, floor) + offset
    solution = new = np.zeros(free.shape[1])
    for k in range(60):
        weight = np.sqrt(count) / s
        scale = np.sqrt(np.sum((free * weight[:, None]) ** 2, axis=0)) + TINY
        target = np.maximum(power - offset, 0.0) * weight
        new = _least(free * (weight[:, None] / scale), target, new) / scale
        step = 0.5 * (new - solution) if k else new
        solution = solution + step
        s = np.maximum(free @ solution + offset, floor)
        if k and np.all(np.abs(free @ step) <= 1e-4 * s):
            break
    value[~fixed] += solution
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
    if not sources:
        return []
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


def _bins(residual: Array, response: Response) -> list[tuple[Array, Array, Array, Array]]:
    """Periodogram and |G|^2 in bands of growing width: (power, gain2, count, omega) an output."""
    n = len(residual)
    omega = 2 * np.pi * np.arange(n // 2 + 1) / n
    edges = np.unique(np.round(np.geomspace(1, len(omega) + 1, 160)).astype(int)) - 1
    count = np.diff(edges)
    centre = np.add.reduceat(omega, edges[:-1]) / count
    out = []
    for i in range(residual.shape[1]):
        spectrum = np.abs(rfft(residual[:, i])) ** 2 / n
        power = np.add.reduceat(spectrum, edges[:-1]) / count
        columns = []
        for j in range(response.gain2.shape[2]):
            g = np.interp(omega, response.omega, response.gain2[:, i, j])
            columns.append(np.add.reduceat(g, edges[:-1]) / count)
        gain2 = np.column_stack(columns) if columns else np.zeros((len(power), 0))
        out.append((power, gain2, count.astype(float), centre))
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
