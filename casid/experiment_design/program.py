"""The design as a nonlinear program: direct multiple shooting with the sensitivities as states.

The states of every hypothesis, and of a rival the sensitivities S = dx/d(theta, x_0),

    dx/dt = f(x, u),   dS/dt = f_x S + f_theta                                                 (1)

are integrated by Runge-Kutta steps within each interval of the input, and tied at its ends (Bock
and Plitt 1984). Information is summed along the intervals and is a variable of its own, so that
the Hessian of the Lagrangian stays sparse: what is maximised depends on it alone. All derivatives
are exact, those of the sensitivities among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.solver import Solver, limited, set_up
from casid.experiment_design.hypotheses import Hypothesis
from casid.experiment_design.information import Target, score_function
from casid.experiment_design.limits import signal_function
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.statement import (
    Statement,
    input_scales,
    inputs_limited,
    inputs_stated,
    release_scales,
)
from casid.experiment_design.thresholds import DESIGN
from casid.time_limit import time_factor

OPTIONS = {
    "ipopt.tol": 1e-5,
    # Done where the criterion no longer gains, whatever the multipliers still do.
    "ipopt.acceptable_tol": 1e6,
    "ipopt.acceptable_dual_inf_tol": 1e10,
    "ipopt.acceptable_constr_viol_tol": 1e-4,
    "ipopt.acceptable_compl_inf_tol": 1e-2,
    "ipopt.acceptable_obj_change_tol": 1e-3,
    "ipopt.acceptable_iter": 4,
    "ipopt.mu_init": 1e-2,
    "ipopt.bound_push": 1e-3,
    "ipopt.bound_frac": 1e-3,
    "ipopt.mu_strategy": "monotone",
    "ipopt.mumps_pivot_order": 6,  # approximate minimum degree that knows of dense rows
}


class Solved(NamedTuple):
    """Where the solver ended."""

    u: Array  # (N, nu) samples
    release: Array  # (nr,)
    status: str
    iterations: int
    slack: Array  # (n,) by which each limited signal had to be relaxed, SI


class _Branch(NamedTuple):
    """One hypothesis in the program."""

    hypothesis: Hypothesis
    nx: int
    nv: int  # columns of S: initial states, then free parameters; 0 where it is no rival
    scale: Array  # (nv,) of the columns


@dataclass(slots=True, eq=False)
class Program:
    """The program of one set-up and its hypotheses.

    Parameters
    ----------
    targets : of each comparison.
    steps : Runge-Kutta steps an interval.
    margins : (n,) kept off the ends of each limited signal, SI.
    floors : (m,) scores that have to be reached; then the input's energy is what is minimised.
    """

    prediction: Prediction
    targets: Sequence[Target]
    steps: int
    margins: Array
    floors: Array | None = None
    solver: Solver = field(default_factory=lambda: Solver("ipopt", DESIGN.iterations, OPTIONS))
    _branches: list[_Branch] = field(init=False)
    _interval: Any = field(init=False)
    _points: Any = field(init=False)

    def __post_init__(self) -> None:
        p = self.prediction
        self._branches = [_branch(h, i in p.differentiated) for i, h in enumerate(p.hypotheses)]
        self._points = p.setup.excitation.points(self.steps)
        self._interval = self._interval_function()

    # -- one interval ------------------------------------------------------------------------

    def _interval_function(self) -> Any:
        """(z, U) -> z after the interval, information, limited signals at its steps; SX.

        `U` is (inputs of all hypotheses * (2 steps + 1),): each at the ends and middles of steps.
        """
        setup, m = self.prediction.setup, self.steps
        h = setup.excitation.per * setup.Ts / m
        z = ca.SX.sym("z", sum(b.nx * (1 + b.nv) for b in self._branches))
        widths = [len(b.hypothesis.model.inputs) for b in self._branches]
        inputs = ca.SX.sym("U", sum(widths) * (2 * m + 1))
        at = ca.reshape(inputs, sum(widths), 2 * m + 1)
        rates = [self._rate(b) for b in self._branches]
        cuts = np.cumsum([0] + [b.nx * (1 + b.nv) for b in self._branches])
        ends = np.cumsum([0, *widths])
        state = [z[int(cuts[i]) : int(cuts[i + 1])] for i in range(len(rates))]
        information: Any = 0
        signals = []
        possible = self.prediction.possible
        for j in range(m):
            u = [at[int(a) : int(b), :] for a, b in zip(ends, ends[1:], strict=False)]
            information += ca.vertcat(*self._shown(state, [c[:, 2 * j] for c in u]))
            signals += [
                self._limited(self._branches[i], state[i][: self._branches[i].nx], u[i][:, 2 * j])
                for i in possible
            ]
            state = [
                _rk4(rate, s, c[:, 2 * j : 2 * j + 3], h)
                for rate, s, c in zip(rates, state, u, strict=True)
            ]
        weight = setup.excitation.per / m
        out = [ca.vertcat(*state), weight * information, ca.vertcat(*signals)]
        return ca.Function("interval", [z, inputs], [ca.densify(part) for part in out])

    def _rate(self, b: _Branch) -> Any:
        """(z, u) -> dz/dt of one hypothesis: states, and S column by column."""
        e, values = b.hypothesis.model.explicit(), b.hypothesis.vector
        z = ca.SX.sym("z", b.nx * (1 + b.nv))
        s = ca.reshape(z[b.nx :], b.nx, b.nv)
        slopes = ca.jacobian(e.f, e.x) @ s + self._direct(e.f, b) if b.nv else ca.SX(b.nx, 0)
        both = ca.vertcat(e.f, ca.vec(slopes))
        both = ca.substitute(both, ca.vertcat(e.x, e.p), ca.vertcat(z[: b.nx], ca.DM(values)))
        return ca.Function("rate", [z, e.u], [ca.densify(both)])

    @staticmethod
    def _direct(expression: Any, b: _Branch) -> Any:
        """d expression / d(initial states, free parameters), scaled, without the states' part."""
        e = b.hypothesis.model.explicit()
        free = ca.vertcat(*[e.p[e.parameters.index(n)] for n in b.hypothesis.moving])
        own = ca.jacobian(expression, free) if b.hypothesis.moving else ca.SX(expression.numel(), 0)
        n0 = b.nv - len(b.hypothesis.moving)
        return ca.horzcat(ca.SX(expression.numel(), n0), own) @ ca.diag(ca.DM(b.scale))

    def _shown(self, state: Sequence[Any], u: Sequence[Any]) -> list[Any]:
        """Upper triangles of the information that one sample gives to each comparison."""
        y: list[Any] = []
        dy: list[Any] = []
        for b, z, inputs in zip(self._branches, state, u, strict=True):
            e = b.hypothesis.model.explicit()
            s = ca.reshape(z[b.nx :], b.nx, b.nv)
            rows = [e.h]
            if b.nv:
                rows.append(ca.jacobian(e.h, e.x) @ s + self._direct(e.h, b))
            known = ca.vertcat(e.x, e.u, e.p)
            at = ca.vertcat(z[: b.nx], inputs, ca.DM(b.hypothesis.vector))
            found = ca.substitute(rows, [known], [at])
            y.append(found[0])
            dy.append(found[1] if b.nv else None)
        parts = []
        for c in self.prediction.comparisons:
            columns = dy[c.rival]
            if c.truth is not None:
                columns = ca.horzcat(columns, y[c.truth] - y[c.rival])
            columns = ca.diag(ca.DM(1 / self.prediction.setup.noise)) @ columns
            parts.append(ca.vec(_upper(columns.T @ columns)))
        return parts

    def _limited(self, b: _Branch, x: Any, u: Any) -> Any:
        names = list(self.prediction.setup.limits.signals)
        if not names:
            return ca.SX(0, 1)
        return signal_function(b.hypothesis.model.explicit(), names)(x, u, b.hypothesis.vector)

    # -- numbers -----------------------------------------------------------------------------

    def rollout(self, w: Array, release: Array) -> tuple[Array, Array, Array]:
        """Nodes (nz, n + 1), information (ng,) and limited signals (n, ...) of an input."""
        U = self._inputs_of(w)
        z = self._first(release)
        nodes, total, signals = [z], np.zeros(1), []
        for i in range(U.shape[1]):
            z, gram, limited = (np.asarray(v).ravel() for v in self._interval(z, U[:, i]))
            nodes.append(z)
            total = total + gram
            signals.append(limited)
        return np.column_stack(nodes), np.asarray(total), np.array(signals)

    def grams(self, information: Array) -> list[Array]:
        """Information matrices of the comparisons in physical units, from what is summed."""
        out, first = [], 0
        for c in self.prediction.comparisons:
            b = self._branches[c.rival]
            n = b.nv + (c.truth is not None)
            size = n * (n + 1) // 2
            g = _full(information[first : first + size], n)
            scale = np.append(b.scale, 1.0)[:n]
            out.append(g / np.outer(scale, scale))
            first += size
        return out

    def _inputs_of(self, w: Any) -> Any:
        """(inputs * (2 steps + 1), intervals) of all hypotheses, for w (n, nu); SX, MX or numbers.

        Inputs that are not designed are numbers.
        """
        setup, width = self.prediction.setup, 2 * self.steps + 1
        n, length = setup.excitation.intervals, setup.excitation.per * setup.Ts
        t = np.add.outer(np.linspace(0, length, width), length * np.arange(n))
        basis = ca.DM(self._points)
        designed = {
            name: ca.reshape(setup.rest[name] + basis @ w[:, k], width, n)
            for k, name in enumerate(setup.designed)
        }
        rows = []
        for b in self._branches:
            names = list(b.hypothesis.model.inputs)
            others = setup.others(b.hypothesis.model, t.ravel())
            given = {k: ca.DM(v.reshape(width, n)) for k, v in others.items()}
            rows.append([{**designed, **given}[name] for name in names])
        every = [name for row in rows for name in row]
        lines = [values[j, :] for j in range(width) for values in every]
        return ca.vertcat(*lines) if lines else ca.DM(0, n)

    def _first(self, release: Any) -> Any:
        """The first node: initial states, and S = (I, 0) in scaled columns."""
        setup, parts = self.prediction.setup, []
        place = {name: i for i, name in enumerate(setup.released)}
        for b in self._branches:
            model = b.hypothesis.model
            start = setup.initial(model, np.zeros(len(place)))
            x0 = [
                release[place[name]] if name in place else start[i]
                for i, name in enumerate(model.states)
            ]
            s = np.zeros((b.nx, b.nv))
            for j, name in enumerate(b.hypothesis.free_states[: b.nv]):
                s[list(model.states).index(name), j] = b.scale[j]
            parts += [*x0, *s.ravel(order="F").tolist()]
        if any(isinstance(v, ca.MX) for v in parts):
            return ca.vertcat(*parts)
        return np.array([float(v) for v in parts])

    # -- solving -----------------------------------------------------------------------------

    def solve(
        self, w: Array, release: Array, *, seconds: float = np.inf, elastic: bool = False
    ) -> Solved:
        """Improve an input, decision variables `w` (n, nu) and displacements (nr,).

        `seconds` of the processor are the most that it takes.
        `elastic` minimises instead by how much limited signals have to be relaxed.
        """
        statement = self._stated(w, release, elastic)
        options = limited(self.solver.nlpsol_options(), self.solver)
        if np.isfinite(seconds) and self.solver.name == "ipopt":
            options["ipopt.max_cpu_time"] = max(seconds, 0.1) * time_factor()
        nlpsol = set_up("experiment design", self.solver, statement.problem, options)
        found = nlpsol(
            x0=statement.start,
            lbx=statement.lower,
            ubx=statement.upper,
            lbg=statement.low,
            ubg=statement.high,
        )
        stats = nlpsol.stats()
        x = np.asarray(found["x"]).ravel()
        setup = self.prediction.setup
        n, nu = setup.excitation.n, len(setup.designed)
        w = (x[: n * nu].reshape(nu, n).T) * input_scales(setup)
        r = x[n * nu : n * nu + len(setup.released)] * release_scales(setup)
        slack = x[len(x) - len(self.margins) :] * setup.limits.widths if elastic else 0.0
        u = setup.at_rest + setup.excitation.samples @ w
        for k, name in enumerate(setup.designed):
            u[:, k] = np.clip(u[:, k], *setup.limits.inputs[name])
        for k, name in enumerate(setup.released):
            r[k] = np.clip(r[k], *setup.limits.release[name])
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        return Solved(u, r, status, iterations, slack * np.ones(len(self.margins)))

    def _stated(self, w0: Array, release0: Array, elastic: bool) -> Statement:
        made = Statement()
        setup = self.prediction.setup
        count = setup.excitation.intervals
        scales, released = input_scales(setup), release_scales(setup)
        w, flat = inputs_stated(made, setup, w0, scales)
        low, high = np.array(list(setup.limits.release.values())).reshape(-1, 2).T
        r = made.variable("r", release0 / released, low / released, high / released) * released
        nodes, information, _ = self.rollout(w0, release0)
        size = np.maximum(np.max(np.abs(nodes), axis=1), 1e-8)
        z = made.variable("Z", (nodes[:, 1:-1] / size[:, None]).ravel(order="F"))
        inner = ca.reshape(z, len(size), count - 1) * ca.repmat(ca.DM(size), 1, count - 1)
        Z = ca.horzcat(self._first([r[i] for i in range(len(released))]), inner)
        after, grams, signals = self._interval.map(count)(Z, self._inputs_of(w))
        made.require((after[:, :-1] - inner) / ca.repmat(ca.DM(size), 1, count - 1))
        slack = ca.MX(0, 1)
        inputs_limited(made, setup, w)
        g = self._lifted(made, information, grams)
        if elastic:
            slack = made.variable("slack", np.ones(len(self.margins)), 0.0, np.inf)
        self._limits_stated(made, signals, slack)
        objective = ca.sum1(slack) if elastic else self._objective(made, g, flat, information)
        made.finish(objective)
        return made

    def _lifted(self, made: Statement, information: Array, grams: Any) -> list[tuple[Any, Array]]:
        """Scaled information matrices as variables, with their scales, one a comparison."""
        out: list[tuple[Any, Array]] = []
        first = 0
        for c in self.prediction.comparisons:
            n = self._branches[c.rival].nv + (c.truth is not None)
            size = n * (n + 1) // 2
            own = information[first : first + size]
            roots = np.sqrt(np.maximum(np.diag(_full(own, n)), 1e-30))
            units = _upper_of(np.outer(roots, roots))
            g = made.variable(f"G{len(out)}", own / units)
            made.require(ca.sum2(grams[first : first + size, :]) / ca.DM(units) - g)
            out.append((_full_symbol(g, n), roots))
            first += size
        return out

    def _objective(
        self, made: Statement, g: Sequence[tuple[Any, Array]], w: Any, information: Array
    ) -> Any:
        """The smallest score, to be maximised; or the input's energy under floors of the scores."""
        found = []
        for (matrix, roots), target, c in zip(
            g, self.targets, self.prediction.comparisons, strict=True
        ):
            b = self._branches[c.rival]
            scale = np.append(b.scale, 1.0)[: len(roots)]
            found.append(score_function(len(roots), target, roots / scale)(matrix))
        score = ca.vertcat(*found)
        if self.floors is not None:
            made.require(score, self.floors, np.inf)
            return ca.sumsqr(w) / max(w.numel(), 1)
        if score.numel() == 1:
            return -score
        # Equal at the start up to the smallest: the others lie above it.
        values = ca.Function("v", [made.x], [score])(made.begin)
        least = made.variable("least", [float(ca.mmin(values))])
        made.require(score - ca.repmat(least, score.numel(), 1), 0.0, np.inf)
        return -least

    def _limits_stated(self, made: Statement, signals: Any, slack: Any) -> None:
        limits = self.prediction.setup.limits
        if not limits.signals:
            return
        widths, k = limits.widths, len(limits.signals)
        rows = signals.shape[0]
        ends = np.array(list(limits.signals.values()))
        low, high = (ends[:, 0] + self.margins) / widths, (ends[:, 1] - self.margins) / widths
        scaled = signals / ca.repmat(ca.DM(np.tile(widths, rows // k)), 1, signals.shape[1])
        times = rows // k * signals.shape[1]
        low, high = np.tile(low, times), np.tile(high, times)
        if slack.numel():
            more = ca.repmat(slack, times, 1)
            made.require(ca.vec(scaled) + more, low, np.inf)
            made.require(ca.vec(scaled) - more, -np.inf, high)
        else:
            made.require(scaled, low, high)


def _branch(h: Hypothesis, is_rival: bool) -> _Branch:
    nx = len(h.model.states)
    if not is_rival:
        return _Branch(h, nx, 0, np.zeros(0))
    states = [abs(h.model.states[n].start) or 1.0 for n in h.free_states]
    values = [abs(h.values[n]) or 1.0 for n in h.moving]
    return _Branch(h, nx, len(states) + len(values), np.array(states + values))


def _rk4(rate: Any, z: Any, u: Any, h: float) -> Any:
    """One step; `u` (inputs, 3) at its beginning, middle and end."""
    k1 = rate(z, u[:, 0])
    k2 = rate(z + h / 2 * k1, u[:, 1])
    k3 = rate(z + h / 2 * k2, u[:, 1])
    k4 = rate(z + h * k3, u[:, 2])
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _upper(g: Any) -> Any:
    """The entries (i, j), i <= j, column by column, of a symbolic matrix."""
    n = g.shape[0]
    return ca.vertcat(*[g[i, j] for j in range(n) for i in range(j + 1)])


def _upper_of(g: Array) -> Array:
    return np.array([g[i, j] for j in range(len(g)) for i in range(j + 1)])


def _full(upper: Array, n: int) -> Array:
    out = np.zeros((n, n))
    places = [(i, j) for j in range(n) for i in range(j + 1)]
    for (i, j), v in zip(places, upper, strict=True):
        out[i, j] = out[j, i] = v
    return out


def _full_symbol(upper: Any, n: int) -> Any:
    place = {(i, j): j * (j + 1) // 2 + i for j in range(n) for i in range(j + 1)}
    rows = [[upper[place[min(i, j), max(i, j)]] for j in range(n)] for i in range(n)]
    return ca.vertcat(*[ca.horzcat(*row) for row in rows])
