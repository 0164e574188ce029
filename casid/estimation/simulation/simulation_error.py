"""The simulation-error criterion over several experiments, and its minimisation.

    V(theta, x0) = 1/2 sum_e sum_k | W (y_k - yhat_k(theta, x0_e)) |^2                        (1)

over shared parameters, parameters of each experiment and initial states, as an NLP. With one
segment an experiment this is single shooting; with more it is multiple shooting, whose segments
are tied by equality constraints (Bock 1983). One pass over the data gives value, gradient and
Gauss-Newton matrix; nothing in the NLP grows with the number of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.record import Experiment, Record
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError, UnitError
from casid.estimation.local_rank import describe_null, local_rank
from casid.estimation.nlp.nlp import Evaluation, Nlp, Solution, Solver
from casid.estimation.simulation.sensor_dynamics import MEMORY, prepared_inputs, through_sensor
from casid.estimation.simulation.sensor_dynamics import delay_columns as delay_columns
from casid.estimation.simulation.simulator import Simulator
from casid.model.model import Model
from casid.model.units import describe_dimension, parse_unit, to_si

Whitener = Callable[[Array, int], Array]  # ((N, ny, m) columns, experiment) -> same shape


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What the criterion needs of one experiment, in model order and SI units."""

    name: str
    t: Array  # (N,)
    u: Array  # (N, nu)
    y: Array  # (N, ny)
    used: Array  # (N, ny) bool
    Ts: float
    known: Mapping[str, float]

    @property
    def N(self) -> int:
        """Number of samples."""
        return len(self.t)


def _place(jac: Array, dy: Array, index: Array) -> None:
    """Columns of `dy` to the places that `index` gives, -1 for none; some rows at a time."""
    keep = index >= 0
    for first in range(0, len(dy), 1 << 13):
        rows = slice(first, first + (1 << 13))
        jac[rows, :, index[keep]] = dy[rows][:, :, keep]


def signals_of(model: Model, experiment: Experiment) -> Signals:
    """The inputs and outputs of `model` taken from a record.

    Raises
    ------
    DataError
        If a channel is missing or in a unit of another dimension than the model's, or an input has
        missing samples.
    """
    record = experiment.record
    for name, entry in model.inputs.items():
        if entry.kind == "unknown":
            raise ModelError(
                f"{model.name}: input {name} is unknown; eliminate it with an output that feels it "
                f"(model.eliminate({name!r}, using=...)) before estimating"
            )
    for name in (*model.inputs, *model.outputs):
        entry_ = model.inputs.get(name)
        if name not in record.channels and not (entry_ and entry_.kind == "generated"):
            raise DataError(
                f"{record.name}: no channel {name!r} for {model.name}; it has "
                f"{', '.join(record.channels)}. Map one of them: --map {name}=column"
            )
    _refuse_foreign_units(model, record)
    columns = []
    for name, entry in model.inputs.items():
        if entry.kind == "generated":
            made = np.zeros(record.N) if entry.signal is None else entry.signal(record.t)
            columns.append(made)
            continue
        mask = record.missing.get(name)
        if mask is not None and bool(np.any(mask)):
            raise DataError(
                f"{record.name}: input {name} misses {int(np.sum(mask))} samples, the first at "
                f"t = {record.t[int(np.argmax(mask))]:g} s; an input must be complete. Cut the "
                "record with a window, or interpolate the channel beforehand"
            )
        columns.append(record[name])
    n = record.N
    y = np.column_stack([record[name] for name in model.outputs])
    used = np.column_stack(
        [
            ~record.missing[name] if name in record.missing else np.ones(n, dtype=bool)
            for name in model.outputs
        ]
    )
    return Signals(
        name=experiment.name,
        t=np.asarray(record.t),
        u=np.column_stack(columns) if columns else np.zeros((n, 0)),
        y=np.where(used, y, 0.0),
        used=used,
        Ts=record.Ts,
        known=dict(experiment.known),
    )


def _refuse_foreign_units(model: Model, record: Record) -> None:
    """A channel measures what the model says, or it is another quantity."""
    units = {n: e.unit for n, e in model.inputs.items() if e.kind != "generated"}
    units |= {n: unit for n, (_, unit) in model.outputs.items()}
    for name, unit in units.items():
        own = record.units[name]
        if own == unit:
            continue
        try:
            expected = parse_unit(unit)
        except UnitError:
            continue  # the model's own affair
        try:
            to_si(np.zeros(0), own, unit)
        except UnitError:
            raise DataError(
                f"{record.name}: channel {name} is in {own!r}, but {model.name} has it in {unit!r} "
                f"({describe_dimension(parse_unit(own).dimension)} against "
                f"{describe_dimension(expected.dimension)} in base units); map the channel that "
                f"measures it, or give its true unit: Record(..., units={{{name!r}: {unit!r}}})"
            ) from None


@dataclass(frozen=True, slots=True)
class Variable:
    """One scalar unknown of the NLP and where it comes from."""

    name: str
    source: str  # the parameter or state
    start: float
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Outputs, residuals and sensitivities of one experiment at one point."""

    y: Array  # (N, ny)
    residual: Array  # (N, ny), zero where a sample is not used
    jacobian: Array  # (N, ny, n), d yhat / d variables, zero where a sample is not used
    x: Array  # (N, nx)


class SimulationError:
    """Criterion (1) for a model and its experiments.

    Parameters
    ----------
    model : no unknown inputs left.
    experiments : one or more; their known values override the model's.
    own : names of parameters that every experiment has for itself.
    weights : (ny,) one over the size of each output's error; default one over its spread.
    whiten : turns (N, ny, m) columns of experiment e into white ones; applied after `weights`.
    segments : shooting segments an experiment.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        *,
        own: Sequence[str] = (),
        weights: Array | None = None,
        whiten: Whitener | None = None,
        segments: int = 1,
        substeps: int = 1,
        start: Mapping[str, float] | None = None,
    ) -> None:
        if not experiments:
            raise DataError("no experiment to fit; give at least one record")
        self.model, self.experiments = model, list(experiments)
        self.data = [signals_of(model, e) for e in experiments]
        self.whiten = whiten
        self.segments = segments
        free = [p.name for p in model.parameters.values() if not p.is_known]
        own = (own,) if isinstance(own, str) else own
        for name in own:
            model.parameter_named(name)
        self.free = [f for f in free if not all(f in d.known for d in self.data)]
        self.own = [f for f in self.free if f in own]
        self._simulators: dict[float, Simulator] = {}
        pinned = {p.name: p.lower for p in model.parameters.values() if p.lower == p.upper}
        pinned = {n: v for n, v in pinned.items() if n in self.free}
        for d in self.data:
            if d.Ts not in self._simulators:
                self._simulators[d.Ts] = Simulator(
                    model, d.Ts, self.free, substeps=substeps, pinned=pinned
                )
        self.outputs = tuple(model.outputs)
        self.substeps = substeps
        self.weights = self._default_weights() if weights is None else np.asarray(weights, float)
        self._burn()
        self.variables: list[Variable] = []
        self._index: list[list[Array]] = []  # per experiment and segment: (nv,) variable or -1
        self._cuts: list[Array] = []
        self._lay_out(dict(start or {}))
        # What was simulated last, as the solver, scores and reports ask for the same point.
        self._last: dict[int, tuple[bytes, Simulated]] = {}

    # -- the variables -----------------------------------------------------------------------

    def _default_weights(self) -> Array:
        total = np.zeros(len(self.outputs))
        for i in range(len(self.outputs)):
            values = np.concatenate([d.y[d.used[:, i], i] for d in self.data])
            total[i] = float(np.std(values)) if len(values) > 1 else 0.0
            if total[i] == 0.0:
                total[i] = float(np.max(np.abs(values), initial=0.0)) or 1.0
        return 1 / total

    def _burn(self) -> None:
        """Samples before those that a delayed or lagging output can know are not used."""
        for stage in self.model.stages:
            if stage.kind not in MEMORY:
                continue
            column = self.outputs.index(stage.channel)
            longest = MEMORY[stage.kind] * self.model.parameters[stage.parameter].upper
            for d in self.data:
                d.used[: min(int(np.ceil(longest / d.Ts)) + 1, d.N), column] = False

    def _state_scale(self, name: str) -> float:
        state = self.model.states[name]
        guess = self._measured_start(name, 0, 0)
        sizes = [abs(state.start), abs(guess or 0.0)]
        for i, (_, unit) in enumerate(self.model.outputs.values()):
            if unit == state.unit:
                sizes.append(1 / self.weights[i])
        return max(sizes) or 1.0

    def _measured_start(self, state: str, experiment: int, k: int) -> float | None:
        """The measured value of a state that is itself an output, a median of five samples."""
        import casadi as ca

        for i, (expression, _) in enumerate(self.model.outputs.values()):
            if ca.is_equal(ca.SX(expression), self.model.symbol(state), 1):
                d = self.data[experiment]
                values = d.y[k : k + 5, i][d.used[k : k + 5, i]]
                return float(np.median(values)) if len(values) else None
        return None

    def _add(self, name: str, source: str, start: float, lo: float, hi: float, scale: float) -> int:
        self.variables.append(Variable(name, source, float(np.clip(start, lo, hi)), lo, hi, scale))
        return len(self.variables) - 1

    def _lay_out(self, start: dict[str, float]) -> None:
        several = len(self.data) > 1
        shared: dict[str, int] = {}
        for name in self.free:
            if name in self.own:
                continue
            p = self.model.parameters[name]
            s = start.get(name, p.start)
            if not p.lower <= s <= p.upper:
                raise SolveError(
                    f"start {name} = {s:g} lies outside its bounds [{p.lower:g}, {p.upper:g}]; "
                    "move the start inside or widen the bounds"
                )
            shared[name] = self._add(name, name, s, p.lower, p.upper, abs(s) or abs(p.start) or 1.0)
        for e, d in enumerate(self.data):
            label = f"@{d.name}" if several else ""
            place = dict(shared)
            for name in self.own:
                if name in d.known:
                    continue
                p = self.model.parameters[name]
                s = start.get(f"{name}{label}", start.get(name, p.start))
                place[name] = self._add(
                    f"{name}{label}", name, s, p.lower, p.upper, abs(s) or abs(p.start) or 1.0
                )
            cuts = np.linspace(0, d.N, self.segments + 1).astype(int)
            rows = []
            for i in range(self.segments):
                local = [place[f] if f in place and f not in d.known else -1 for f in self.free]
                for name, state in self.model.states.items():
                    if i == 0 and state.initial is not None:
                        local.append(-1)
                        continue
                    tag = f"{name}(0){label}" if i == 0 else f"{name}[{i}]{label}"
                    guess = self._measured_start(name, e, int(cuts[i]))
                    s = start.get(tag, guess if guess is not None else state.start)
                    # Bounds of a state hold at the start of the record.
                    lo, hi = (state.lower, state.upper) if i == 0 else (-np.inf, np.inf)
                    local.append(self._add(tag, name, s, lo, hi, self._state_scale(name)))
                rows.append(np.array(local))
            self._index.append(rows)
            self._cuts.append(cuts)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the NLP's variables."""
        return tuple(v.name for v in self.variables)

    @property
    def start(self) -> Array:
        """(n,) start values."""
        return np.array([v.start for v in self.variables])

    @property
    def n_constraints(self) -> int:
        """Continuity constraints between segments."""
        return len(self.data) * (self.segments - 1) * len(self.model.states)

    @property
    def n_samples(self) -> int:
        """Samples that count, over experiments and outputs."""
        return int(sum(d.used.sum() for d in self.data))

    # -- simulating --------------------------------------------------------------------------

    def parameter_vector(self, x: Array, experiment: int, segment: int = 0) -> tuple[Array, Array]:
        """All model parameters (np,) and the initial state (nx,) of one segment at `x` (n,)."""
        d, index = self.data[experiment], self._index[experiment][segment]
        values = {
            p.name: p.value if p.is_known else p.start for p in self.model.parameters.values()
        }
        values.update(d.known)
        for name, i in zip(self.free, index, strict=False):
            if i >= 0:
                values[name] = float(x[i])
        initial = []
        for state, i in zip(self.model.states.values(), index[len(self.free) :], strict=True):
            initial.append(float(x[i]) if i >= 0 else float(state.initial or 0.0))
        for stage in self.model.stages:
            if stage.is_of_input:
                values[stage.parameter] = 0.0  # what it does is in the input's column, see below
        names = self._simulators[d.Ts].equations.parameters
        return np.array([values[n] for n in names], dtype=float), np.array(initial)

    def simulate(
        self, x: Array, experiment: int, *, signals: Signals | None = None, tangent: bool = False
    ) -> tuple[Array, Array, Array | None]:
        """Outputs (N, ny), states (N, nx) and tangent (N, ny, n) of one experiment.

        Other `signals` (more samples, other inputs) may be simulated with the same variables.
        """
        d = signals if signals is not None else self.data[experiment]
        simulator = self._simulators[d.Ts]
        n, ny = len(self.variables), len(self.outputs)
        cuts = self._cuts[experiment].copy()
        cuts[-1] = d.N
        inputs = self._prepared_inputs(x, experiment, d)
        y, states = np.empty((d.N, ny)), np.empty((d.N, len(self.model.states)))
        jac: Array | None = None
        for i, index in enumerate(self._index[experiment]):
            part = slice(int(cuts[i]), int(cuts[i + 1]))
            p, x0 = self.parameter_vector(x, experiment, i)
            u = inputs[part]
            if tangent:
                run = simulator.sensitivities(u, p, x0)
                if jac is None:  # not before: the simulation takes as much room for itself
                    jac = np.zeros((d.N, ny, n))
                assert run.dy is not None
                _place(jac[part], run.dy, index)
            else:
                run = simulator.simulate(u, p, x0)
            y[part], states[part] = run.y, run.x[:-1]
        p, _ = self.parameter_vector(x, experiment)
        self._through_sensors(y, jac, p, d, self._index[experiment][0])
        return y, states, jac

    def _prepared_inputs(self, x: Array, experiment: int, d: Signals) -> Array:
        """The input columns as they act, and those that carry the tangents of what was done."""
        stages = [s for s in self.model.stages if s.is_of_input]
        if not stages:
            return d.u
        values = {s.parameter: self.value_of(s.parameter, x, experiment) for s in stages}
        return prepared_inputs(self.model, d.u, values, d.Ts)

    def value_of(self, name: str, x: Array, experiment: int) -> float:
        """The value of one parameter in an experiment, at `x`."""
        if name in self.free:
            i = int(self._index[experiment][0][self.free.index(name)])
            if i >= 0:
                return float(x[i])
        p = self.model.parameters[name]
        return float(self.data[experiment].known.get(name, p.start if p.value is None else p.value))

    def _through_sensors(
        self, y: Array, jac: Array | None, p: Array, d: Signals, index: Array
    ) -> None:
        """Apply the model's sensor stages in place."""
        names = self._simulators[d.Ts].equations.parameters
        for stage in self.model.stages:
            if stage.is_of_input:
                continue
            c = self.outputs.index(stage.channel)
            value = p[names.index(stage.parameter)]
            place = index[self.free.index(stage.parameter)] if stage.parameter in self.free else -1
            through_sensor(
                stage.kind, y[:, c], None if jac is None else jac[:, c, :], value, d.Ts, int(place)
            )

    def simulated(self, x: Array, experiment: int, *, signals: Signals | None = None) -> Simulated:
        """Residuals and sensitivities of one experiment, unweighted."""
        if signals is None:
            key = x.tobytes()
            if experiment not in self._last or self._last[experiment][0] != key:
                self._last[experiment] = (
                    key,
                    self._simulated(x, experiment, self.data[experiment]),
                )
            return self._last[experiment][1]
        return self._simulated(x, experiment, signals)

    def _simulated(self, x: Array, experiment: int, d: Signals) -> Simulated:
        with np.errstate(all="ignore"):
            y, states, jac = self.simulate(x, experiment, signals=d, tangent=True)
        assert jac is not None
        used = d.used
        if not used.all():
            jac *= used[:, :, None]
        return Simulated(y, np.where(used, d.y - y, 0.0), jac, states)

    def columns(
        self, x: Array, experiment: int, *, signals: Signals | None = None
    ) -> tuple[Array, Array]:
        """Weighted and whitened residual (N, ny) and tangent (N, ny, n)."""
        at = self.simulated(x, experiment, signals=signals)
        stack = np.concatenate([at.residual[:, :, None], at.jacobian], axis=2)
        stack *= self.weights[None, :, None]
        if self.whiten is not None and np.all(np.isfinite(stack)):
            stack = self.whiten(stack, experiment)
        return stack[:, :, 0], stack[:, :, 1:]

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient, Gauss-Newton matrix and continuity constraints at `x` (n,)."""
        n = len(self.variables)
        value, gradient, hessian = 0.0, np.zeros(n), np.zeros((n, n))
        with np.errstate(all="ignore"):
            for e in range(len(self.data)):
                r, j = self.columns(x, e)
                r, j = r.ravel(), j.reshape(-1, n)
                value += 0.5 * float(r @ r)
                gradient -= j.T @ r
                hessian += j.T @ j
            constraints, jacobian = self._continuity(x)
        return Evaluation(value, gradient, hessian, constraints, jacobian)

    def _continuity(self, x: Array) -> tuple[Array, Array]:
        n, nx = len(self.variables), len(self.model.states)
        rows, jacs = [np.zeros(0)], [np.zeros((0, n))]
        if self.segments == 1:
            return rows[0], jacs[0]
        scale = np.array([self._state_scale(s) for s in self.model.states])
        for e, d in enumerate(self.data):
            cuts, simulator = self._cuts[e], self._simulators[d.Ts]
            inputs = self._prepared_inputs(x, e, d)
            for i in range(self.segments - 1):
                p, x0 = self.parameter_vector(x, e, i)
                part = inputs[cuts[i] : cuts[i + 1]]
                run = simulator.sensitivities(part, p, x0, after=inputs[cuts[i + 1]])
                index, nxt = self._index[e][i], self._index[e][i + 1][-nx:]
                j = np.zeros((nx, n))
                keep = index >= 0
                assert run.dx_end is not None
                j[:, index[keep]] = run.dx_end[:, keep]
                j[np.arange(nx), nxt] -= 1.0
                rows.append((run.x[-1] - x[nxt]) / scale)
                jacs.append(j / scale[:, None])
        return np.concatenate(rows), np.vstack(jacs)

    def scores(self, x: Array) -> Array:
        """(sum of N, n) per-sample scores J_k' r_k, outputs summed, experiments stacked."""
        parts = []
        for e in range(len(self.data)):
            r, j = self.columns(x, e)
            parts.append(np.einsum("ki,kin->kn", r, j))
        return np.concatenate(parts)


# -- minimising ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A minimum of the simulation-error criterion."""

    criterion: SimulationError
    solution: Solution
    starts_tried: int = 1
    starts_agreeing: int = 1
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def x(self) -> Array:
        """(n,) the minimiser."""
        return self.solution.x

    @property
    def values(self) -> dict[str, float]:
        """Every variable by name."""
        return dict(zip(self.criterion.names, self.x.tolist(), strict=True))


def widened(fit: Fit, model: Model) -> SimulationError:
    """The criterion of a fit for a model with more parameters, all of them at their start."""
    base = fit.criterion
    wide = SimulationError(
        model,
        base.experiments,
        own=base.own,
        weights=base.weights,
        whiten=base.whiten,
        substeps=base.substeps,
        start=fit.values,
    )
    for d, own in zip(wide.data, base.data, strict=True):
        d.used[:] &= own.used
    return wide


Constraint = Callable[[Mapping[str, Any]], Any]


def minimize_simulation_error(
    criterion: SimulationError,
    *,
    solver: Solver | None = None,
    starts: int = 1,
    seed: int = 0,
    constraints: Sequence[Constraint] = (),
    check_rank: bool = True,
    throw: bool = True,
    retry: bool = True,
    near: bool = False,
) -> Fit:
    """Minimise (1), from the declared start and `starts - 1` random ones; the best is kept.

    Parameters
    ----------
    constraints : each takes a mapping of variable names to CasADi symbols and returns an expression
        that is to be zero (linear or not).
    retry : whether a start that does not converge is tried once more from where it ended.
    near : the start is next to its minimum: a solver that succeeds there is not asked again.

    Raises
    ------
    IdentifiabilityError
        Before the solver starts, where the data leave a direction unseen.
    SolveError
        If no start leads to an optimum.
    """
    nlp = Nlp(criterion.model.name)
    symbols = {
        v.name: nlp.variable(v.name, v.start, lower=v.lower, upper=v.upper, scale=v.scale)
        for v in criterion.variables
    }
    nlp.minimize(criterion)
    for i, constraint in enumerate(constraints):
        nlp.equality(constraint(symbols), name=f"constraint {i + 1}")
    x0 = criterion.start
    first = criterion.evaluate(x0)
    if not np.isfinite(first.value):
        raise SolveError(_divergence(criterion, x0))
    if criterion.n_samples <= len(x0):
        raise DataError(
            f"{criterion.data[0].name}: {criterion.n_samples} samples cannot pay for {len(x0)} "
            "unknowns (parameters and initial states); widen the window or give known values"
        )
    if check_rank and not constraints and criterion.segments == 1:
        _refuse_unidentifiable(criterion, x0, first.hessian)
    best: Solution | None = None
    values = []
    failures: list[str] = []
    for k in range(max(starts, 1)):
        point = x0 if k == 0 else _random_start(criterion, x0, np.random.default_rng((seed, k)))
        try:
            solution = nlp.solve(solver, point.tolist(), throw=False, natural_scales=True)
        except SolveError as error:
            failures.append(str(error))
            continue
        is_done = solution.is_converged or (
            near
            and solution.status == "Solve_Succeeded"
            and solution.value > 0.5 * first.value
            and k == 0
        )
        if retry and not is_done:
            # The natural scales of a far start are wrong at the end: once more from there.
            solution = nlp.solve(solver, solution.x.tolist(), throw=False, natural_scales=True)
        values.append(solution.value)
        if best is None or (solution.is_converged, -solution.value) > (
            best.is_converged,
            -best.value,
        ):
            best = solution
    if best is None:
        raise SolveError(failures[0])
    if throw and not best.is_converged:
        raise SolveError(
            f"{criterion.model.name}: {best.solver} stopped with {best.status} after "
            f"{best.iterations} iterations (scaled gradient {best.scaled_gradient:.1e}, constraint "
            f"violation {best.constraint_violation:.1e}): {best.mend}"
        )
    agree = int(np.sum(np.array(values) <= best.value * (1 + 1e-6) + 1e-12))
    return Fit(criterion, best, max(starts, 1), agree)


def _refuse_unidentifiable(criterion: SimulationError, x0: Array, hessian: Array) -> None:
    scale = np.array([v.scale for v in criterion.variables])
    rank = local_rank(hessian, x0, criterion.names, scale)
    if rank.is_full:
        return
    # A start may be special (a zero, a symmetry): look beside it before refusing.
    beside = _random_start(criterion, x0, np.random.default_rng(99))
    at = criterion.evaluate(beside)
    if np.isfinite(at.value):
        rank = local_rank(at.hessian, beside, criterion.names, scale)
        if rank.is_full:
            return
    raise IdentifiabilityError(
        f"{criterion.model.name}: rank {rank.rank} of {rank.unknowns} unknowns in "
        f"{', '.join(d.name for d in criterion.data)}; {describe_null(rank)}"
        f"{_constant_inputs(criterion)}"
    )


def _constant_inputs(criterion: SimulationError) -> str:
    """Inputs that never move, which may be why; an empty text where all do."""
    said = [
        f"{name} of {d.name} is constant ({d.u[0, i]:g})"
        for d in criterion.data
        for i, (name, entry) in enumerate(criterion.model.inputs.items())
        if entry.kind == "measured" and np.ptp(d.u[:, i]) == 0.0
    ]
    return f". Input {' and '.join(said)}: check its cable and its mapping" if said else ""


def _random_start(criterion: SimulationError, x0: Array, rng: np.random.Generator) -> Array:
    point = x0.copy()
    for i, v in enumerate(criterion.variables):
        if v.source in criterion.model.states:
            point[i] += 0.1 * v.scale * rng.standard_normal()
        elif v.start != 0.0:
            point[i] = v.start * np.exp(0.5 * rng.standard_normal())
        else:
            point[i] = v.scale * 0.3 * rng.standard_normal()
        low, high = v.lower, v.upper
        inset = 1e-6 * v.scale
        point[i] = float(np.clip(point[i], min(low + inset, high), max(high - inset, low)))
    return point


def _divergence(criterion: SimulationError, x: Array) -> str:
    for e, d in enumerate(criterion.data):
        with np.errstate(all="ignore"):
            y, _, _ = criterion.simulate(x, e)
        bad = ~np.all(np.isfinite(y), axis=1)
        if bad.any():
            k = int(np.argmax(bad))
            return (
                f"{criterion.model.name}: the simulation of {d.name} diverges at t = {d.t[k]:g} s "
                f"(sample {k}) from the start values; change the start, fix a parameter, or use "
                "multiple shooting (segments=...) if the model is unstable"
            )
    return (
        f"{criterion.model.name}: the sensitivities are not finite at the start; "
        "change the start values, or use multiple shooting (segments=...) if the model is unstable"
    )
