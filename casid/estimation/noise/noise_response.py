"""Frequency responses of a simulated model to its sources of noise: inputs and `forces`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.fft import rfft

from casid.arrays import Array
from casid.errors import SolveError
from casid.estimation.noise.filled_noise import noise_spectrum
from casid.estimation.noise.forces import places_of_forces, with_forces
from casid.estimation.noise.resolving_steps import fewest_steps
from casid.estimation.noise.windowed_response import windowed_spectra
from casid.estimation.simulation.channels.sensor_dynamics import prepared_inputs, through_sensor
from casid.estimation.simulation.integration.band_limited import responses_between
from casid.estimation.simulation.integration.simulator import band_limited, rk4_sample
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.explicit_form import Explicit
from casid.model.model import Model

POINTS = 200
"""Samples of a record at which a model that is not linear is linearised."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Frequency responses of the sampled, linearised model to its noise sources."""

    omega: Array  # (F,) rad/sample, 0..pi
    gain2: Array  # (F, ny, ns) squared magnitudes
    sources: tuple[str, ...]
    gain: Array | None = None  # (F, ny, ns) complex, where several outputs are whitened together
    cross: Array | None = None  # (F, ny, ny, ns) spectra where they are no products of gains

    def reshaped(self, shapes: Array) -> Response:
        """The responses to sources whose spectra are times `shapes` (F, ns)."""
        return replace(
            self,
            gain2=self.gain2 * shapes[:, None],
            gain=None if self.gain is None else self.gain * np.sqrt(shapes)[:, None],
            cross=None if self.cross is None else self.cross * shapes[:, None, None],
        )


def noise_response(
    criterion: SimulationError,
    x: Array,
    experiment: int,
    *,
    omega: Array | None = None,
    states: Array | None = None,
    is_beside: bool = False,
) -> Response:
    """|G|^2 from measured inputs, balances and stated rates to the outputs, linearised on average.

    The step of the simulation itself is linearised, so the response is that of what is simulated.
    Of an input that is filled between its samples it is that of the noise of those.

    Parameters
    ----------
    omega : (F,) rad/sample, above 0; default even from 0 to pi, as finely as the record resolves.
    states : (points, nx) at the samples of `linearised_at`, where they are known.
    is_beside : `x` is no point of the search, whose sensitivities would be of use afterwards.
    """
    if omega is not None and criterion.model.stages:
        # What sensors and actuators do beyond expressions is transformed on an even grid.
        even = noise_response(criterion, x, experiment, states=states, is_beside=is_beside)
        assert even.gain is not None
        places = np.clip(np.searchsorted(even.omega, omega), 0, len(even.omega) - 1)
        gain = even.gain[places]
        return Response(omega, np.abs(gain) ** 2, even.sources, gain)
    disturbed, e, means = _mean_slopes(criterion, x, experiment, states, is_beside=is_beside)
    a, b0, b1, inside, c, dd = means
    parts = len(inside) + 1
    model, d = criterion.model, criterion.data[experiment]
    if not all(bool(np.isfinite(m).all()) for m in means):
        raise SolveError(
            f"{model.name}: the simulation of {d.name} diverges at these values, so its response "
            "to noise is not known; change the start values, or fix a parameter"
        )
    forced = places_of_forces(model)
    measured = [n for n in e.inputs if disturbed.inputs[n].kind == "measured"]
    if omega is None:
        # As fine as the record resolves: a lightly damped resonance is narrower than that already.
        omega = np.linspace(0, np.pi, min(d.N, 1 << 16) + 1)
        # An integrator has no finite response at zero: stay within the record's resolution.
        omega[0] = 0.25 * omega[1]
    z = np.exp(1j * omega)
    eye = np.eye(len(a))
    lhs = z[:, None, None] * eye - a
    enters = _input_stages(
        criterion, x, experiment, e.inputs, measured, len(forced), len(omega) - 1
    )
    rhs = b0 + z[:, None, None] * b1
    if inside.any():
        course = responses_between(omega, parts)
        rhs = rhs + np.einsum("fk,kxu->fxu", course, inside)
    rhs = rhs @ enters
    g = c @ np.linalg.solve(lhs, rhs) + dd @ enters
    sensors = _sensor_stages(criterion, x, experiment, len(omega) - 1)
    own = np.ones((len(omega), g.shape[2]))
    for i, name in enumerate(measured):
        column, named = list(model.inputs).index(name), (name, model.inputs[name].hold)
        own[:, i] = np.sqrt(noise_spectrum(criterion.data, experiment, column, named, omega))
    g = g * sensors[:, :, None] * own[:, None, :]
    found = Response(omega, np.abs(g) ** 2, (*measured, *forced), g)
    if not criterion.is_cut(experiment):
        return found
    samples = int(np.median(np.diff([0, *criterion.starts_anew(experiment), d.N])))
    cross = windowed_spectra(_entering(means, enters), samples, criterion.weights, omega)
    cross *= np.einsum("fi,fk,fj->fikj", sensors, sensors.conj(), own**2)
    return with_windowed_spectra(found, cross)


def with_windowed_spectra(found: Response, cross: Array) -> Response:
    """The response with these spectra in the place of products of its gains."""
    assert found.gain is not None
    gain2 = np.einsum("fiij->fij", cross).real
    size = np.abs(found.gain)
    phase = np.divide(found.gain, size, out=np.ones_like(found.gain), where=size > 0.0)
    gain = phase * np.sqrt(gain2)
    return replace(found, gain2=gain2, gain=gain, cross=cross)


def _entering(means: tuple[Array, ...], enters: Array) -> tuple[Array, Array, Array, Array, Array]:
    """A, B0, B1, C, D of a sample from the sources, of mean slopes and `_input_stages`.

    What is band-limited enters as if straight lines joined it, and of stages the size alone counts.
    """
    a, b0, b1, inside, c, dd = means
    b0, b1 = on_lines(b0, b1, inside)
    direct = np.sqrt(np.mean(np.abs(enters) ** 2, axis=0))
    return a, b0 @ direct, b1 @ direct, c, dd @ direct


def on_lines(b0: Array, b1: Array, inside: Array) -> tuple[Array, Array]:
    """How inputs enter at a sample and the next one, those in between joined by straight lines."""
    shares: Array = np.arange(1, len(inside) + 1) / (len(inside) + 1)
    shares = shares.reshape(-1, *[1] * (inside.ndim - 1))
    return b0 + np.sum((1 - shares) * inside, axis=0), b1 + np.sum(shares * inside, axis=0)


def linearised_at(n: int) -> Array:
    """The samples at which a record of n is linearised for its mean response."""
    return np.linspace(0, n - 1, min(n, POINTS)).astype(int)


def _mean_slopes(
    criterion: SimulationError,
    x: Array,
    experiment: int,
    states: Array | None,
    *,
    is_beside: bool,
) -> tuple[Model, Explicit, tuple[Array, ...]]:
    """The model with a force in each balance, its equations, and the mean slopes of a sample.

    Equivalent linearisation: the mean of the derivatives over the record, so that kinks and
    amplitude-dependent terms count by how often they are met.
    """
    d = criterion.data[experiment]
    disturbed, e, _, is_constant = linearised(criterion, d.Ts, 1)
    pick = linearised_at(d.N)
    if is_constant:
        states, pick = np.zeros((1, len(e.states))), pick[:1]
    elif states is None and is_beside:
        states = criterion.simulate(x, experiment)[1][pick]
    elif states is None:  # kept: the residual comes from it as well
        states = criterion.simulated(x, experiment).x[pick]
    a, b0, b1, inside, c, dd = slopes_of_samples(
        criterion, x, experiment, states, d.u[pick], d.u[pick]
    )
    sizes = _gains(np.concatenate([b0, b1, *inside, dd]))
    nx, ny, between = len(e.states), len(e.outputs), len(inside)
    b0, b1, inside, dd = np.split(sizes, [nx, 2 * nx, len(sizes) - ny])
    inside = inside.reshape(between, nx, len(e.inputs))
    return disturbed, e, (a.mean(axis=1), b0, b1, inside, c.mean(axis=1), dd)


def may_vary(criterion: SimulationError) -> bool:
    """True unless the model is linear and constant: then its response is the same all along."""
    return not all(linearised(criterion, d.Ts, 1)[3] for d in criterion.data)


def multiplied_inputs(criterion: SimulationError) -> tuple[str, ...]:
    """The inputs on which slopes of the equations depend, as a flow that carries heat."""
    found: tuple[str, ...] = criterion.built("multiplied inputs", lambda: _multiplied(criterion))
    return found


def _multiplied(criterion: SimulationError) -> tuple[str, ...]:
    e = criterion.model.explicit()
    slopes = [ca.jacobian(of, by) for of in (e.f, e.h) for by in (e.x, e.u)]
    met = ca.which_depends(ca.veccat(*slopes), e.u)
    return tuple(name for name, is_met in zip(e.inputs, met, strict=True) if is_met)


def slopes_of_samples(
    criterion: SimulationError, x: Array, experiment: int, states: Array, u: Array, u_next: Array
) -> tuple[Array, ...]:
    """Slopes (rows, points, columns) of a sample at states (points, nx): `_linearisation`'s.

    Those in what band-limited inputs are within the sample are (parts - 1, nx, points, inputs).

    Parameters
    ----------
    u, u_next : (points, nu) the recorded inputs there, and at the sample after.
    """
    d, points = criterion.data[experiment], len(states)
    substeps = _substeps(criterion, x, experiment, states, u)
    disturbed, e, slopes, _ = linearised(criterion, d.Ts, substeps)
    ni, parts = len(e.inputs), 2 * substeps
    here, ahead = (np.hstack([v, np.zeros((points, ni - v.shape[1]))]) for v in (u, u_next))
    banded = [e.inputs.index(name) for name in band_limited(disturbed)]
    share = np.arange(1, parts) / parts
    within = here[:, banded, None] * (1 - share) + ahead[:, banded, None] * share
    p = np.tile(criterion.parameter_vector(x, experiment)[0][:, None], (1, points))
    key = ("noise response", d.Ts, substeps, points)
    mapped = criterion.built(key, lambda: slopes.map(points))
    found = mapped(states.T, here.T, ahead.T, within.reshape(points, -1).T, p)
    a, b0, b1, course, c, dd = (np.array(m).reshape(m.shape[0], points, -1) for m in found)
    inside = np.zeros((parts - 1, *b0.shape))
    for i, column in enumerate(banded):
        inside[..., column] = np.moveaxis(
            course[..., i * (parts - 1) : (i + 1) * (parts - 1)], -1, 0
        )
    return a, b0, b1, inside, c, dd


def _gains(at_points: Array) -> Array:
    """(rows, sources) by which white noise enters, of gains (rows, points, sources) that vary.

    What it leaves has the mean square of them: the noise of a supply pressure that a valve opens
    to either side has a gain of zero on average. Each row has the sign by which it goes with the
    others (the first eigenvector of their correlations), and a gain that stays is what it is.
    """
    mean, square = at_points.mean(axis=1), np.sqrt(np.mean(at_points**2, axis=1))
    out = mean.copy()
    for j in range(at_points.shape[2]):
        rows = square[:, j] > 0.0
        if not rows.any():
            continue
        scaled = at_points[rows, :, j] / square[rows, j, None]
        main = np.linalg.eigh(scaled @ scaled.T)[1][:, -1]
        signs = np.where(main < 0.0, -1.0, 1.0)
        turned = np.sum(signs * mean[rows, j] / square[rows, j]) < 0.0
        out[rows, j] = square[rows, j] * (-signs if turned else signs)
    return np.asarray(out)


def _substeps(
    criterion: SimulationError, x: Array, experiment: int, states: Array, u: Array
) -> int:
    """The fewest steps of a sample whose slopes in the states are those of all, once a model.

    A simulation needs its steps for errors that add up, and to resolve an input; how noise passes
    is known well enough where one sample is. What is band-limited takes three at least: its course
    over a third of a sample is a parabola to all that counts, over a half one it is not.
    """
    Ts, most = criterion.data[experiment].Ts, criterion.substeps

    def chosen() -> int:
        model, *_ = linearised(criterion, Ts, 1)
        e, least = model.explicit(), 3 if band_limited(model) else 1
        if most <= least:
            return most
        pick = linearised_at(len(states))
        rates = ca.Function("rates", [e.x, e.u, e.p], [ca.jacobian(e.f, e.x)]).map(len(pick))
        here = np.zeros((len(pick), len(e.inputs)))
        here[:, : u.shape[1]] = u[pick]
        p = np.tile(criterion.parameter_vector(x, experiment)[0][:, None], (1, len(pick)))
        found = np.array(rates(states[pick].T, here.T, p))
        nx = len(e.states)
        slopes = Ts * found.reshape(nx, len(pick), nx).swapaxes(0, 1)
        return fewest_steps(slopes, least, most)

    found: int = criterion.built(("steps of the noise response", Ts), chosen)
    return found


def linearised(
    criterion: SimulationError, Ts: float, substeps: int
) -> tuple[Model, Explicit, Any, bool]:
    """The `_linearisation` of a model, built once."""
    found: tuple[Model, Explicit, Any, bool] = criterion.built(
        ("noise response", Ts, substeps), lambda: _linearisation(criterion, Ts, substeps)
    )
    return found


def _linearisation(
    criterion: SimulationError, Ts: float, substeps: int
) -> tuple[Model, Explicit, Any, bool]:
    """The model with a force in each balance, its equations, and the derivatives of a sample.

    The function takes states, inputs, inputs at the next sample, band-limited ones in between (as
    `rk4_sample` does) and parameters; last whether it depends on parameters alone.
    """
    model = criterion.model.copy()
    # What lags before the simulation moves in lines of its own; sensors come after it.
    model.stages = tuple(s for s in model.stages if s.is_of_input)
    disturbed = with_forces(model, places_of_forces(model), "unknown")
    e = disturbed.explicit()
    u_next = ca.SX.sym("un", len(e.inputs))
    within = ca.SX.sym("within", len(band_limited(disturbed)) * (2 * substeps - 1))
    xs = rk4_sample(disturbed, e, u_next, Ts, substeps, within)
    slopes = [ca.jacobian(xs, of) for of in (e.x, e.u, u_next, within)]
    slopes += [ca.jacobian(e.h, of) for of in (e.x, e.u)]
    moving = ca.veccat(e.x, e.u, u_next, within)
    is_constant = not ca.depends_on(ca.veccat(*slopes), moving)
    return disturbed, e, ca.Function("lin", [e.x, e.u, u_next, within, e.p], slopes), is_constant


def _input_stages(
    criterion: SimulationError,
    x: Array,
    experiment: int,
    inputs: Sequence[str],
    measured: Sequence[str],
    forces: int,
    n: int,
) -> Array:
    """Stages that the noise of each source passes on its way to the simulated input columns.

    (1, ni, ns) of ones and zeros, or (n + 1, ni, ns) on 0..pi where a stage prepares a column: the
    transform of what becomes of one noisy sample.
    """
    model, Ts = criterion.model, criterion.data[experiment].Ts
    places = [inputs.index(name) for name in measured]
    places += range(len(inputs) - forces, len(inputs))
    direct = np.zeros((1, len(inputs), len(places)))
    direct[0, places, range(len(places))] = 1.0
    # An actuator at its largest rate passes no noise of its command, and follows it otherwise.
    stages = [s for s in model.stages if s.is_of_input and s.kind != "rate_input"]
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
        prepared = prepared_inputs(model, u, values, Ts, stages)
        out[:, : len(own), measured.index(channel)] = rfft(prepared, axis=0)
    return out


def _sensor_stages(criterion: SimulationError, x: Array, experiment: int, n: int) -> Array:
    """H (n + 1, ny) of what each output's sensor passes on, on 0..pi; clipping left out.

    Errors count in units of the noise, on average as the slopes do.
    """
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
    sizes = criterion.data[experiment].sizes
    return out if sizes is None else out * np.mean(1 / sizes, axis=0)
