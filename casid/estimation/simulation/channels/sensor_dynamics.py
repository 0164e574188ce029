"""What sensors and actuators do to whole columns: delays, first-order lags and clipping.

A stage of an output is applied to what was simulated and to its sensitivities. A stage of an input
is applied to the recorded column before the simulation; the change that its parameter brings goes
into a generated column, its carrier, which the model multiplies by that parameter, held at zero.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.estimation.simulation.channels.first_order_lags import (
    delay_held,
    filtered,
    lag_columns,
    lag_held,
    lag_lines,
)
from casid.estimation.simulation.channels.known_rest import rest_before
from casid.estimation.simulation.channels.rate_limits import (
    change_with_rate,
    rate_limited,
    through_limit,
)
from casid.estimation.simulation.channels.sample_lines import delayed_lines, lines_of
from casid.estimation.simulation.integration import band_limited
from casid.model.declarations import Hold, Stage
from casid.model.model import Model

MEMORY = {"delay": 1.0, "lag": 5.0, "filter": 5.0, "late_input": 1.0, "lag_input": 5.0}
"""How long the unknown past is felt in a stage, in units of its parameter.

Five time constants after its start less than a hundredth of what was before remains. What a late
or lagging input did before the record all outputs show; after that time the initial state makes up
for it.
"""

MOST_OF_LAG = {"lag": 0.25, "filter": 0.25, "lag_input": 0.1}
"""Share of a record, or of its first window, that is left out for a lag at most.

What was before dies away, and a lag whose five time constants are longer would leave nothing to
fit; a window of which nothing counts would begin in a state that nothing determines. All outputs
show the lag of a command: no more is left out of all than for its dead time. Of a delay there is no
remainder that is small: it is left out to its end.
"""

STILL = 10
"""Samples at one value as the record begins, of a command that was there before.

Its lag then begins in the state that it ends in: nothing is due to the past, and the first move,
which may be all that shows the lag, counts. A controller's command moves with every sample.
"""


def begins_still(model: Model, stage: Stage, u: Array) -> bool:
    """True of an actuator's lag whose command, of the inputs (N, nu), does not move at first."""
    if stage.kind != "lag_input":
        return False
    first = u[:STILL, list(model.inputs).index(stage.channel)]
    return bool(np.all(first == first[0]))


def due_to_past(kind: str, longest: float, N: int, window: int = 0) -> int:
    """How many first samples of a record of N are due to its past, of a stage with `MEMORY`.

    Parameters
    ----------
    longest : its parameter at most, in samples.
    window : samples of each window that the record is simulated in, 0 without any.
    """
    most = N
    if kind in MOST_OF_LAG:
        most = int(MOST_OF_LAG[kind] * (min(window, N) if window else N))
    return int(min(np.ceil(MEMORY[kind] * longest) + 1, most))


def due_to_earlier_inputs(
    model: Model, u: Array, Ts: float, *, window: int = 0, without: Collection[str] = ()
) -> BoolArray:
    """(N, ny) the first samples of what is late or lags, due to inputs before these u (N, nu).

    None are where a known rest says what was before.

    Parameters
    ----------
    window : as for `due_to_past`.
    without : kinds of stages that do not count.
    """
    out = np.zeros((len(u), len(model.outputs)), dtype=bool)
    stages = [s for s in model.stages if s.kind in MEMORY and s.kind not in without]
    rest = rest_before(model)
    for stage in stages:
        is_known = stage.channel in (rest.inputs if stage.is_of_input else rest.outputs)
        if not is_known and not begins_still(model, stage, u):
            longest = model.parameters[stage.parameter].upper / Ts
            first = due_to_past(stage.kind, longest, len(u), window)
            columns = slice(None) if stage.is_of_input else [*model.outputs].index(stage.channel)
            out[:first, columns] = True
    return out


GROUP = 8
"""Columns of a Jacobian that pass a stage at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """An output at the end of each sample, before held inputs step to the next."""

    y: Array  # (N,)
    jac: Array | None = None  # (N, n)

    def part(self, rows: slice) -> Before:
        """The signals in these rows."""
        return Before(self.y[rows], None if self.jac is None else self.jac[rows])


def through_sensor(
    kind: str,
    y: Array,
    jac: Array | None,
    value: float,
    Ts: float,
    place: int,
    before: Before | None = None,
    *,
    at_rest: bool = False,
) -> None:
    """Apply one output stage in place.

    An output that steps with a held input is a held column of its steps and a smooth rest: to the
    sensor that is late the step is not there yet at the sample that it falls on.

    Parameters
    ----------
    y : (N,) the simulated output.
    jac : (N, n) its sensitivities, None where not requested.
    value : the stage's parameter [s], or the limit in units of the output.
    place : column of `jac` of the parameter, -1 where it is known.
    before : of an output that steps, what it was at the samples before.
    at_rest : it was before the first sample what it is there.
    """
    change: Array
    steps = d_steps = None
    if before is not None and kind not in ("clip", "filter"):
        steps = _steps(y, before.y)
        y -= steps
        if jac is not None and before.jac is not None:
            d_steps = _steps(jac, before.jac)
            jac -= d_steps
    if kind == "clip":
        above, below = y > value, y < -value
        y[above], y[below] = value, -value
        change = above.astype(float) - below
        if jac is not None:
            jac[above | below] = 0.0
    elif kind == "delay":
        change = -delay_columns(y, value / Ts, derivative=True, at_rest=at_rest) / Ts
        y[:] = delay_columns(y, value / Ts, at_rest=at_rest)
    else:
        passed = lag_columns(y, value / Ts, at_rest=at_rest) if kind == "lag" else None
        y[:], change = passed or filtered(y, value / Ts)
        change = change / Ts
    if jac is not None and kind != "clip" and value != 0.0:
        # Some columns at a time: what is interpolated takes several times their room.
        for first in range(0, jac.shape[1], GROUP):
            some = jac[:, first : first + GROUP]
            some[:] = late_columns(kind, some, value / Ts, at_rest=at_rest)
    if steps is not None:
        held = delay_held if kind == "delay" else lag_held
        late, d_late = held(steps, value / Ts)
        y += late
        change = change + d_late / Ts
        if jac is not None and d_steps is not None:
            jac += held(d_steps, value / Ts)[0]
    if jac is not None and place >= 0:
        jac[:, place] += change


def _steps(y: Array, before: Array) -> Array:
    """The sum of the steps so far of columns (N, ...); `before` has what came before the next."""
    steps = np.zeros_like(y)
    np.cumsum(y[1:] - before[:-1], axis=0, out=steps[1:])
    return steps


def late_columns(kind: str, columns: Array, samples: float, *, at_rest: bool) -> Array:
    """Columns (N, ...) behind a delay, a lag or a filter of so many samples."""
    if kind == "delay":
        return delay_columns(columns, samples, at_rest=at_rest)
    if kind == "lag":
        return lag_columns(columns, samples, at_rest=at_rest)[0]
    return filtered(columns, samples)[0]


_ORDER = ("late_input", "rate_input", "lag_input")
"""Of what an actuator does that leaves lines: it moves late, at a rate, and acts with a lag."""


def prepared_inputs(
    model: Model,
    u: Array,
    values: Mapping[str, float],
    Ts: float,
    stages: Sequence[Stage] | None = None,
    rest: Mapping[str, float] | None = None,
) -> Array:
    """A copy of the inputs (N, nu) with every input stage applied and all carriers filled.

    What happened to the record comes first, the dead time, the largest rate and then the lag of an
    actuator last: an input that is held or joined by straight lines leaves these as a line in
    every sample, which begins and ends where its companions say; its own column has the values at
    the samples. A band-limited input stays one.

    Parameters
    ----------
    values : of the stages' parameters, SI units.
    stages : of inputs, where not all of the model's are applied.
    rest : input -> what it was before the record, where that is known.
    """
    out, rest = u.copy(), rest or {}
    place = {name: i for i, name in enumerate(model.inputs)}
    if stages is None:
        stages = [s for s in model.stages if s.is_of_input]
    for channel in dict.fromkeys(s.channel for s in stages):
        columns = {channel: u[:, place[channel]]}
        mine = [s for s in stages if s.channel == channel]
        for stage in mine:
            if stage.kind == "play_input":
                gap = values[stage.parameter]
                last, sign = play(columns[channel], gap or stage.least, stage.begins)
                if gap:
                    columns = {n: c[last] for n, c in columns.items()}
                columns[channel] = columns[channel] - gap * sign
                columns[stage.carrier] = -sign
            elif not stage.makes_lines:
                value = values[stage.parameter]
                change = _slope(columns[channel], value if stage.kind == "delay_input" else 0.0, Ts)
                columns = {n: _moved(stage.kind, c, value, Ts) for n, c in columns.items()}
                columns[stage.carrier] = change
        acting = sorted((s for s in mine if s.makes_lines), key=lambda s: _ORDER.index(s.kind))
        if Stage.line_of(channel)[0] not in place:
            for stage in acting:
                r = values[stage.parameter] / Ts
                change = _acted(stage.kind, columns[channel], r)[1]
                columns = {n: _acted(stage.kind, c, r)[0] for n, c in columns.items()}
                columns[stage.carrier] = change / Ts
            for name, column in columns.items():
                out[:, place[name]] = column
            continue
        hold, before = model.acting_hold(channel), rest.get(channel)
        for name, lines in _lines(acting, columns, values, Ts, hold, before).items():
            for own, at in zip((name, *Stage.line_of(name)), lines.T, strict=True):
                out[:, place[own]] = at
    return out


def _acted(kind: str, column: Array, samples: float) -> tuple[Array, Array]:
    """A band-limited column behind a dead time or a lag, and its derivative with that."""
    if kind == "late_input":
        return band_limited.moved(column, samples)
    return lag_columns(column, samples)


def _lines(
    stages: list[Stage],
    columns: dict[str, Array],
    values: Mapping[str, float],
    Ts: float,
    hold: Hold,
    before: float | None,
) -> dict[str, Array]:
    """The line in each sample (N, 3) that becomes of a channel and of what carries its tangents.

    `columns` has the channel first. The `stages` are in their `_ORDER`. What was before the record
    depends on no parameter: tangents were zero there.
    """
    channel = next(iter(columns))
    of_tangents = None if before is None else 0.0
    lines: dict[str, Array] = {}
    for stage in stages:
        r = values[stage.parameter] / Ts
        if stage.kind == "late_input":
            late, change = delayed_lines(columns[channel], r, hold, before)
            lines = {n: delayed_lines(c, r, hold, of_tangents)[0] for n, c in columns.items()}
            lines[channel] = late
            lines[stage.carrier] = change / Ts
            continue
        lines = lines or {n: lines_of(c, hold) for n, c in columns.items()}
        if stage.kind == "rate_input":
            _limit_rate(lines, stage, values, Ts, before)
            continue
        steps = hold == "zoh"
        lagging, change = lag_lines(lines[channel], r, steps=steps, before=before)
        lines = {n: lag_lines(c, r, steps=steps, before=of_tangents)[0] for n, c in lines.items()}
        lines[channel] = lagging
        lines[stage.carrier] = change / Ts
    return lines


def _limit_rate(
    lines: dict[str, Array],
    stage: Stage,
    values: Mapping[str, float],
    Ts: float,
    before: float | None,
) -> None:
    """Send the lines of a channel through its largest rate, in place.

    Without a share of it the command acts as it is, and what the rate would change is its tangent.
    """
    share, command = values[stage.share], lines[stage.channel]
    limited = rate_limited(command, values[stage.parameter] * Ts, before)
    change = limited.lines - command
    if share:
        tangents = {n: c for n, c in lines.items() if n != stage.channel}
        for n, moved in through_limit(command, limited, tangents).items():
            lines[n] = lines[n] + share * (moved - lines[n])
        lines[stage.channel] = command + share * change
        lines[stage.carrier] = share * Ts * change_with_rate(command, limited)
    else:
        lines[stage.carrier] = np.zeros_like(command)
    lines[stage.carriers[1]] = change


def play(column: Array, gap: float, begins: float = 0.0) -> tuple[Array, Array]:
    """The contacts of a command with play: what acts is column[last] - gap sign.

    Parameters
    ----------
    begins : where what acts stands beside the command as the record begins, in gaps: -1 to 1.

    Returns
    -------
    last : (N,) sample at which the command last pushed.
    sign : (N,) 1 where it pushed upwards, -1 downwards, and -`begins` before the first contact.
    """
    u = column.tolist()
    last, sign = np.zeros(len(u), dtype=int), np.zeros(len(u))
    acting, at, pushed = u[0] + begins * gap, 0, -begins
    for k, now in enumerate(u):
        if now - gap > acting:
            acting, at, pushed = now - gap, k, 1.0
        elif now + gap < acting:
            acting, at, pushed = now + gap, k, -1.0
        last[k], sign[k] = at, pushed
    return last, sign


def _moved(kind: str, column: Array, value: float, Ts: float) -> Array:
    """A recorded input column as it acted: earlier, or rid of its sensor's lag."""
    if kind == "delay_input":
        return delay_columns(column, -value / Ts)
    return np.asarray(column + value * _slope(column, 0.0, Ts))


def _slope(column: Array, ahead: float, Ts: float) -> Array:
    """Centred slope of a column, `ahead` seconds later, per second."""
    return delay_columns(column, -ahead / Ts, derivative=True) / Ts


def delay_weights(samples: float, *, derivative: bool = False) -> tuple[int, Array]:
    """A delay by cubic convolution (Keys 1981), or the slope per sample there.

    Returns
    -------
    whole, weights : sample k of the delayed column is the sum of weights[i] y[k - whole - 2 + i],
        i = 0..3.
    """
    whole = int(np.floor(samples))
    s = samples - whole  # y(k - whole - s): between k - whole - 1 (s = 1) and k - whole (s = 0)
    v = 1.0 - s  # position between the left and right neighbour
    if derivative:
        w = [
            -0.5 + 2 * v - 1.5 * v**2,
            -5 * v + 4.5 * v**2,
            0.5 + 4 * v - 4.5 * v**2,
            -v + 1.5 * v**2,
        ]
    else:
        w = [
            -0.5 * v + v**2 - 0.5 * v**3,
            1 - 2.5 * v**2 + 1.5 * v**3,
            0.5 * v + 2 * v**2 - 1.5 * v**3,
            -0.5 * v**2 + 0.5 * v**3,
        ]
    return whole, np.array(w)


def delay_columns(
    y: Array, samples: float, *, derivative: bool = False, at_rest: bool = False
) -> Array:
    """Columns (N, ...) delayed by a fractional number of samples, or their slope per sample there.

    Cubic convolution: exact for quadratics, once differentiable in the delay, and centred, so that
    its slope at zero delay brings no half-sample error. The ends are extended by straight lines,
    the first one by its value where it was `at_rest` there.
    """
    whole, w = delay_weights(samples, derivative=derivative)
    pad = abs(whole) + 3
    ramp = np.arange(1, pad + 1, dtype=float).reshape(-1, *([1] * (y.ndim - 1)))
    left = y[:1] - (0.0 if at_rest else 1.0) * ramp[::-1] * (y[1:2] - y[:1])
    right = y[-1:] + ramp * (y[-1:] - y[-2:-1])
    long = np.concatenate([left, y, right])
    n = len(y)
    first = pad - whole - 2
    return np.asarray(sum(w[i] * long[first + i : first + i + n] for i in range(4)))
