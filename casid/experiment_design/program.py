"""The design as a nonlinear program in the input, its states eliminated (see `rollout`).

Its value is a function of the information that is summed along the record, and its constraints are
the limits at every step. All derivatives are exact, those of the sensitivities among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.solver import Solver, limited, set_up
from casid.experiment_design.information import Target, score_function
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.rollout import Rollout
from casid.experiment_design.statement import Statement, inputs_limited
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
    rollout: Rollout = field(init=False)

    def __post_init__(self) -> None:
        self.rollout = Rollout(self.prediction, self.steps)

    # -- numbers -----------------------------------------------------------------------------

    def grams(self, information: Array) -> list[Array]:
        """Information matrices of the comparisons in physical units, from what is summed."""
        out, first = [], 0
        for c in self.prediction.comparisons:
            b = self.rollout.branches[c.rival]
            n = b.nv + (c.truth is not None)
            size = n * (n + 1) // 2
            g = _full(information[first : first + size], n)
            scale = np.append(b.scale, 1.0)[:n]
            out.append(g / np.outer(scale, scale))
            first += size
        return out

    # -- solving -----------------------------------------------------------------------------

    def solve(
        self,
        w: Array,
        release: Array,
        *,
        seconds: float = np.inf,
        slack: tuple[float, float] | None = None,
    ) -> Solved:
        """Improve an input, decision variables `w` (n, nu) and displacements (nr,).

        `seconds` of the processor are the most that it takes.
        `slack` minimises instead by how much limited signals are relaxed, as a share of their
        widths within these bounds.
        """
        statement = self._stated(w, release, slack)
        options = limited(self.solver.nlpsol_options(), self.solver)
        if slack is not None:  # how far limits are relaxed is wanted exactly
            options = {k: v for k, v in options.items() if "acceptable" not in k}
        options["hess_lag"] = statement.hessian
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
        setup = self.prediction.setup
        w, r = statement.parted(np.asarray(found["x"]).ravel())
        u = setup.at_rest + setup.excitation.samples @ w
        for k, name in enumerate(setup.designed):
            u[:, k] = np.clip(u[:, k], *setup.limits.inputs[name])
        for k, name in enumerate(setup.released):
            r[k] = np.clip(r[k], *setup.limits.release[name])
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        return Solved(u, r, status, iterations)

    def _stated(self, w0: Array, release0: Array, bounds: tuple[float, float] | None) -> Statement:
        made = Statement(self.rollout, w0, release0)
        inputs_limited(made, self.prediction.setup, made.w)
        slack = ca.MX(0, 1)
        if bounds is not None:
            begin = np.ones(len(self.margins)) if bounds[1] > 0 else np.zeros(len(self.margins))
            slack = made.variable("slack", begin, *bounds)
        information = self.rollout.outputs(w0, release0).information
        self._limits_stated(made, made.outputs[len(information) :], slack)
        relaxed = bounds is not None
        made.finish(ca.sum1(slack) if relaxed else self._objective(made, information))
        return made

    def _objective(self, made: Statement, information: Array) -> Any:
        """The smallest score, to be maximised; or the input's energy under floors of the scores."""
        found, first = [], 0
        for target, c in zip(self.targets, self.prediction.comparisons, strict=True):
            b = self.rollout.branches[c.rival]
            n = b.nv + (c.truth is not None)
            size = n * (n + 1) // 2
            own = information[first : first + size]
            roots = np.sqrt(np.maximum(np.diag(_full(own, n)), 1e-30))
            units = _upper_of(np.outer(roots, roots))
            matrix = _full_symbol(made.outputs[first : first + size] / ca.DM(units), n)
            scale = np.append(b.scale, 1.0)[:n]
            found.append(score_function(n, target, roots / scale)(matrix))
            first += size
        score = ca.vertcat(*found)
        if self.floors is not None:
            made.require(score, self.floors, np.inf)
            return ca.sumsqr(made.flat) / max(made.flat.numel(), 1)
        if score.numel() == 1:
            return -score
        # Equal at the start up to the smallest: the others lie above it.
        values = ca.Function("v", [made.outputs], [score])(made.begun)
        least = made.variable("least", [float(ca.mmin(values))])
        made.require(score - ca.repmat(least, score.numel(), 1), 0.0, np.inf)
        return -least

    def _limits_stated(self, made: Statement, signals: Any, slack: Any) -> None:
        limits = self.prediction.setup.limits
        if not limits.signals:
            return
        times = signals.numel() // len(limits.signals)
        widths = np.tile(limits.widths, times)
        ends = np.array(list(limits.signals.values()))
        low = np.tile(ends[:, 0] + self.margins, times) / widths
        high = np.tile(ends[:, 1] - self.margins, times) / widths
        scaled = signals / ca.DM(widths)
        if slack.numel():
            more = ca.repmat(slack, times, 1)
            made.require(scaled + more, low, np.inf)
            made.require(scaled - more, -np.inf, high)
        else:
            made.require(scaled, low, high)


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
