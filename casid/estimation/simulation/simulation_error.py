"""The simulation-error criterion over several experiments.

    V(theta, x0) = 1/2 sum_e sum_k | W (y_k - yhat_k(theta, x0_e)) |^2                        (1)

over shared parameters, parameters of each experiment and initial states, as an NLP. With one
segment an experiment this is single shooting; with more it is multiple shooting, whose segments
are tied by equality constraints (Bock 1983). An experiment with windows starts each of them in a
state of its own, and no constraint ties them. One pass over the data gives value, gradient and
Gauss-Newton matrix; nothing in the NLP grows with the number of samples.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from casid.arrays import Array, rows_between
from casid.data.experiment import Experiment
from casid.errors import DataError
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.simulation.channels.known_rest import rest_before
from casid.estimation.simulation.channels.own_instants import at_own_instants
from casid.estimation.simulation.channels.sensor_dynamics import (
    MEMORY,
    Before,
    due_to_earlier_inputs,
    prepared_inputs,
    through_sensor,
)
from casid.estimation.simulation.integration.simulator import Simulator, placed
from casid.estimation.simulation.records.measured_states import (
    declared_states,
    measured_states,
    output_equations,
    state_size,
)
from casid.estimation.simulation.records.signals import (
    Signals,
    output_spread,
    require_samples_for_segments,
    signals_of,
    window_cuts,
)
from casid.estimation.simulation.simulated_record import Simulated
from casid.estimation.unknowns import LastOf, LastPoints, Unknowns, Variable
from casid.grouping import Grouped
from casid.model.model import Model

Whitener = Callable[[Array, int], Array]  # ((N, ny, m) columns, experiment) -> same shape


class SimulationError:
    """Criterion (1) for a model and its experiments.

    Parameters
    ----------
    model : no unknown inputs left.
    experiments : one or more; their known values override the model's.
    own : names of parameters that every experiment has for itself.
    weights : (ny,) one over the size of each output's error; default one over its spread.
    whiten : turns (N, ny, m) columns of experiment e into white ones; applied after `weights`.
    segments : shooting segments an experiment; one with windows has these in their place.
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
        self.model, self.segments, self.substeps = model, segments, substeps
        self.joined, self._rest = segments > 1, rest_before(model)
        self._is_bounding, self._is_for_many = segments == 1, False
        self.outputs = tuple(model.outputs)
        self._simulators: dict[float, Simulator] = {}
        self._built: dict[object, Any] = {}  # of the model, shared by `of_records`
        self._take(experiments, own, weights, whiten, start)

    def of_records(
        self,
        experiments: Sequence[Experiment],
        *,
        weights: Array | None = None,
        whiten: Whitener | None = None,
        start: Mapping[str, float] | None = None,
    ) -> SimulationError:
        """The criterion of other records; functions built of the model are used again.

        Raises
        ------
        DataError
            If the records know other parameters than these do.
        """
        other = copy.copy(self)
        other._take(experiments, self.own, weights, whiten, start)
        return other

    def of_first_samples(self, count: int) -> SimulationError:
        """The criterion of the first samples of each segment or window, not joined."""
        other = copy.copy(self)
        other.joined, other.data = False, []
        other._last, other._evaluated = LastOf(), LastPoints()
        for d, cuts in zip(self.data, self._cuts, strict=True):
            part = np.searchsorted(cuts, np.arange(d.N), side="right") - 1
            early = np.arange(d.N) - cuts[part] < count
            other.data.append(replace(d, used=d.used & early[:, None]))
        return other

    def for_columns(self) -> SimulationError:
        """The same for columns of many records: steps are compiled, initial states not bounded."""
        other = copy.copy(self)
        other._is_bounding, other._is_for_many, other._simulators = False, True, {}
        return other

    def whitened(self, whiten: Whitener | None) -> SimulationError:
        """The criterion under another whitening."""
        other = copy.copy(self)
        other.whiten = whiten
        return other

    def built(self, key: object, build: Callable[[], Any]) -> Any:
        """Functions built of the model and the steps alone, once for all records."""
        if key not in self._built:
            self._built[key] = build()
        return self._built[key]

    def _take(
        self,
        experiments: Sequence[Experiment],
        own: Sequence[str],
        weights: Array | None,
        whiten: Whitener | None,
        start: Mapping[str, float] | None,
    ) -> None:
        """Lay out the variables of these records, and simulators at their sample times."""
        if not experiments:
            raise DataError("no experiment to fit; give at least one record")
        model = self.model
        self.experiments = list(experiments)
        self.data = [signals_of(model, e) for e in experiments]
        self.whiten = whiten
        require_samples_for_segments(self.data, self.segments, len(model.states))
        self.unknowns = Unknowns(model, [(d.name, d.known) for d in self.data], own, start)
        self.free, self.own = self.unknowns.free, self.unknowns.own
        pinned = {p.name: p.lower for p in model.parameters.values() if p.lower == p.upper}
        pinned = {n: v for n, v in pinned.items() if n in self.free}
        steps, uneven = self.substeps, any(d.instants is not None for d in self.data)
        for d in self.data:
            if d.Ts not in self._simulators:
                self._simulators[d.Ts] = Simulator(
                    model, d.Ts, self.free, substeps=steps, pinned=pinned, uneven=uneven
                )
                self._simulators[d.Ts].is_for_many = self._is_for_many
            elif self._simulators[d.Ts].free != tuple(self.free):
                raise DataError(
                    f"{d.name}: other parameters are known than in the records before it; state "
                    "its criterion anew"
                )
        self.spread = output_spread(self.data)
        self.weights = 1 / self.spread if weights is None else np.asarray(weights, float)
        self._as_read = [replace(d, used=d.used.copy()) for d in self.data]
        for e, d in zip(experiments, self.data, strict=True):
            d.used[due_to_earlier_inputs(model, d.u, d.Ts, window=e.window)] = False
        self._index: list[list[Array]] = []  # per experiment and segment: (nv,) variable or -1
        self._cuts: list[Array] = []
        self._sizes: dict[str, float] = {}  # of states where parts of records begin
        self._lay_out()
        self._last: LastOf[Simulated] = LastOf()
        self._evaluated: LastPoints[Evaluation] = LastPoints()
        self._courses: dict[int, tuple[Array, Array]] = {}  # inputs, and the same with courses
        if self._is_bounding and any(stage.kind in MEMORY for stage in model.stages):
            self._bound_initial_states()

    # -- the variables -----------------------------------------------------------------------

    def _bound_initial_states(self) -> None:
        """Bound the initial states, which only samples that are left out may determine."""
        for e in range(len(self.data)):
            with np.errstate(all="ignore"):
                states = self.simulate(self.start, e)[1]
            for part in self._index[e]:
                self.unknowns.keep_near(part[len(self.free) :], states)

    def _state_scale(self, name: str) -> float:
        size = state_size(self.model, name, self.data[0], self.spread)
        return max(size, self._sizes.get(name, 0.0)) or 1.0

    def _lay_out(self) -> None:
        unknowns = self.unknowns
        unknowns.add_shared()
        for e, d in enumerate(self.data):
            place = unknowns.add_own(e, clip=True)
            shared = [place.get(f, -1) for f in self.free]
            cuts = np.linspace(0, d.N, self.parts(e) + 1).astype(int)
            starts = self._part_starts(e, shared, cuts[:-1])
            rows = []
            for i, begun in enumerate(starts.tolist()):
                local = list(shared)
                for (name, state), start in zip(self.model.states.items(), begun, strict=True):
                    if i == 0 and state.initial is not None:
                        local.append(-1)
                        continue
                    # Bounds of a state hold at the start of the record.
                    bounds = (state.lower, state.upper) if i == 0 else (-np.inf, np.inf)
                    tag, scale = self._tag(name, i, e), self._state_scale(name)
                    local.append(
                        unknowns.add(tag, name, start, bounds, scale, clip=True, is_inner=i > 0)
                    )
                rows.append(np.array(local))
            self._index.append(rows)
            self._cuts.append(cuts)

    def _tag(self, state: str, part: int, experiment: int) -> str:
        """The name of the variable that a state is at the start of a part."""
        place = f"[{part}]" if part else "(0)"
        return f"{state}{place}{self.unknowns.label(experiment)}"

    def _part_starts(self, e: int, places: Sequence[int], at: Array) -> Array:
        """(parts, nx) where parts of a record begin: as given, measured (late ones, too), declared.

        A single part begins in what outputs determine only where the model is not finite otherwise.
        """
        model, unknowns, d = self.model, self.unknowns, self._as_read[e]
        starts = declared_states(model, d, at)
        tags = [[self._tag(name, i, e) for name in model.states] for i in range(len(at))]
        if not all(unknowns.is_given(tag) for row in tags for tag in row):
            values = unknowns.parameters(unknowns.start, e, places)
            equations = self.built("measured states", lambda: output_equations(model, self.free))
            p = np.array([values[name] for name in model.explicit().parameters], dtype=float)
            if len(at) > 1 or not equations.is_finite(starts[0], d.u[0], p):
                found = measured_states(equations, d, p, at, starts[0])
                starts = np.where(np.isfinite(found), found, starts)
        for i, row in enumerate(tags):
            starts[i] = [unknowns.given(tag, s) for tag, s in zip(row, starts[i], strict=True)]
        if len(at) > 1:
            sizes = np.abs(starts).max(axis=0).tolist()
            for name, size in zip(model.states, sizes, strict=True):
                self._sizes[name] = max(size, self._sizes.get(name, 0.0))
        return starts

    variables: ClassVar[Grouped[list[Variable]]] = Grouped("unknowns")  # The NLP's variables
    names: ClassVar[Grouped[tuple[str, ...]]] = Grouped("unknowns")  # Names of the NLP's variables
    start: ClassVar[Grouped[Array]] = Grouped("unknowns")  # (n,) start values

    def parts(self, experiment: int) -> int:
        """Segments or windows of one experiment, each of which starts in a state of its own."""
        window = self.experiments[experiment].window
        return len(window_cuts(self.data[experiment].N, window)) - 1 if window else self.segments

    def is_cut(self, experiment: int) -> bool:
        """True of an experiment in windows, which no constraint joins."""
        return self.parts(experiment) > 1 and not self.joined

    def starts_anew(self, experiment: int) -> Array:
        """(parts - 1,) the samples at which the simulation of one experiment starts anew."""
        return np.asarray(self._cuts[experiment][1:-1])

    @property
    def initial_states(self) -> tuple[int, ...]:
        """Places of initial states among the variables."""
        states = self.model.states
        return tuple(i for i, v in enumerate(self.variables) if v.source in states)

    @property
    def n_constraints(self) -> int:
        """Continuity constraints between segments."""
        return len(self.data) * (self.segments - 1) * len(self.model.states) if self.joined else 0

    @property
    def n_samples(self) -> int:
        """Samples that count, over experiments and outputs."""
        return int(sum(d.used.sum() for d in self.data))

    # -- simulating --------------------------------------------------------------------------

    def parameter_vector(self, x: Array, experiment: int, segment: int = 0) -> tuple[Array, Array]:
        """All model parameters (np,) and the initial state (nx,) of one segment at `x` (n,)."""
        d, index = self.data[experiment], self._index[experiment][segment]
        values = self.unknowns.parameters(x, experiment, index)
        for stage in self.model.stages:
            if stage.is_of_input:  # what it does is in the input's column, see below
                values.update(dict.fromkeys(stage.parameters, 0.0))
        names = self._simulators[d.Ts].equations.parameters
        p = np.array([values[n] for n in names], dtype=float)
        return p, self.unknowns.initial_state(x, index[len(self.free) :])

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
        stepping = simulator.stepping
        before = np.empty((d.N, len(stepping)))
        jac: Array | None = None
        dbefore: Array | None = None
        for i, index in enumerate(self._index[experiment]):
            part = slice(int(cuts[i]), int(cuts[i + 1]))
            p, x0 = self.parameter_vector(x, experiment, i)
            u = inputs[part]
            if tangent:
                run = simulator.sensitivities(u, p, x0)
                assert run.dy is not None
                assert run.dbefore is not None
                jac = placed(jac, run.dy, index, part, (d.N, ny, n))
                dbefore = placed(dbefore, run.dbefore, index, part, (d.N, len(stepping), n))
            else:
                run = simulator.simulate(u, p, x0)
            assert run.before is not None
            y[part], states[part], before[part] = run.y, run.x[:-1], run.before
        p, _ = self.parameter_vector(x, experiment)
        steps = {
            i: Before(before[:, k], None if dbefore is None else dbefore[:, k])
            for k, i in enumerate(stepping)
        }
        parts = rows_between([0, d.N] if self.joined else cuts)
        self._through_sensors(y, jac, p, d, self._index[experiment][0], steps, parts)
        at_own_instants(y, jac, d.instants, steps, cuts)
        return y, states, jac

    def state_tangents(self, x: Array, experiment: int) -> tuple[Array, Array] | None:
        """`Simulator.state_tangents` in all variables, of a record that starts once; else None."""
        if self.parts(experiment) > 1:
            return None
        d, index = self.data[experiment], self._index[experiment][0]
        inputs = self._prepared_inputs(x, experiment, d)
        found = self._simulators[d.Ts].state_tangents(inputs, *self.parameter_vector(x, experiment))
        if found is None:
            return None
        shape = (*found[0].shape, len(self.variables))
        return found[0], placed(None, found[1], index, slice(None), shape)

    def _prepared_inputs(self, x: Array, experiment: int, d: Signals) -> Array:
        """The input columns as they act, and those that carry the tangents of what was done."""
        if d is self.data[experiment] and not any(s.is_of_input for s in self.model.stages):
            of, wide = self._courses.get(experiment, (None, d.u))
            if of is not d.u:
                wide = self._simulators[d.Ts].with_courses(d.u)
                self._courses[experiment] = d.u, wide
            return wide
        return self._simulators[d.Ts].with_courses(self.acting_inputs(x, experiment, d))

    def acting_inputs(self, x: Array, experiment: int, d: Signals) -> Array:
        """(N, nu) the inputs as they act on the model, behind what sensors and actuators do."""
        names = [n for s in self.model.stages if s.is_of_input for n in s.parameters]
        at = {n: self.value_of(n, x, experiment) for n in names}
        return prepared_inputs(self.model, d.u, at, d.Ts, rest=self._rest.inputs)

    def value_of(self, name: str, x: Array, experiment: int) -> float:
        """The value of one parameter in an experiment, at `x`."""
        if name in self.free:
            i = int(self._index[experiment][0][self.free.index(name)])
            if i >= 0:
                return float(x[i])
        nominal = self.model.parameters[name].nominal
        return float(self.data[experiment].known.get(name, nominal))

    def _through_sensors(
        self,
        y: Array,
        jac: Array | None,
        p: Array,
        d: Signals,
        index: Array,
        steps: dict[int, Before],
        parts: Sequence[slice],
    ) -> None:
        """Apply the model's sensor stages in place; behind the first one nothing steps any more.

        A sensor that is late knows nothing of the window before: that ends in another state.
        """
        names = self._simulators[d.Ts].equations.parameters
        for stage in (s for s in self.model.stages if not s.is_of_input):
            c = self.outputs.index(stage.channel)
            value = p[names.index(stage.parameter)]
            place = index[self.free.index(stage.parameter)] if stage.parameter in self.free else -1
            is_clip = stage.kind == "clip"
            before = steps.get(c) if is_clip else steps.pop(c, None)
            rests = stage.channel in self._rest.outputs
            for rows in parts:
                of_column = None if jac is None else jac[rows, c, :]
                own = None if before is None else before.part(rows)
                if is_clip and own is not None:
                    through_sensor("clip", own.y, own.jac, value, d.Ts, int(place))
                args = y[rows, c], of_column, value, d.Ts, int(place), own
                through_sensor(stage.kind, *args, at_rest=rests and rows.start == 0)

    def simulated(self, x: Array, experiment: int, *, signals: Signals | None = None) -> Simulated:
        """Residuals and sensitivities of one experiment, unweighted."""
        if signals is None:
            return self._last(x, experiment, self._simulated)
        return self._simulated(x, experiment, signals)

    def _simulated(self, x: Array, experiment: int, signals: Signals | None = None) -> Simulated:
        d = self.data[experiment] if signals is None else signals
        with np.errstate(all="ignore"):
            y, states, jac = self.simulate(x, experiment, signals=d, tangent=True)
        assert jac is not None
        if not d.used.all():
            jac *= d.used[:, :, None]
        return Simulated(y, d.errors(y), d.in_sizes(jac), states)

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
        """Value, gradient, Gauss-Newton matrix and continuity constraints at `x` (n,).

        Those of the last points are kept: of a search that is where it began, and where it ended.
        """
        return self._evaluated((x, self.weights, self.whiten), lambda: self._evaluate(x))

    def _evaluate(self, x: Array) -> Evaluation:
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

    @property
    def value_alone(self) -> Callable[[Array], float] | None:
        """`evaluate` without derivatives, in a fraction of its time, for a single segment."""
        return None if self.joined else self._value

    def _value(self, x: Array) -> float:
        value = 0.0
        with np.errstate(all="ignore"):
            for e, d in enumerate(self.data):
                r = (d.errors(self.simulate(x, e)[0]) * self.weights)[:, :, None]
                if self.whiten is not None and np.all(np.isfinite(r)):
                    r = self.whiten(r, e)
                value += 0.5 * float(np.sum(r**2))
        return value

    def _continuity(self, x: Array) -> tuple[Array, Array]:
        n, nx = len(self.variables), len(self.model.states)
        rows, jacs = [np.zeros(0)], [np.zeros((0, n))]
        if not self.joined:
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
                j, keep = np.zeros((nx, n)), index >= 0
                assert run.dx_end is not None
                j[:, index[keep]] = run.dx_end[:, keep]
                j[np.arange(nx), nxt] -= 1.0
                rows.append((run.x[-1] - x[nxt]) / scale)
                jacs.append(j / scale[:, None])
        return np.concatenate(rows), np.vstack(jacs)

    def scores(self, x: Array) -> Array:
        """(M, n) per-sample scores J_k' r_k of `rows`, outputs summed, experiments stacked."""
        return np.concatenate([np.einsum("ki,kin->kn", r, j) for r, j in self.rows(x)])

    def rows(self, x: Array) -> Iterator[tuple[Array, Array]]:
        """`columns` of each experiment at the samples that there are; of a whitened one at all."""
        # Across gaps of zeros no correlation of scores would be seen.
        for e, d in enumerate(self.data):
            there = slice(None) if self.whiten is not None else d.used.any(axis=1)
            r, j = self.columns(x, e)
            yield r[there], j[there]
