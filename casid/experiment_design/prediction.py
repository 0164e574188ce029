"""What an experiment would show: simulations, sensitivities and information of every hypothesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.integration.simulator import Simulator
from casid.experiment_design.hypotheses import Comparison, Hypothesis
from casid.experiment_design.limits import signal_function
from casid.experiment_design.setup import Setup


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """One hypothesis simulated: x (N + 1, nx), y (N, ny), dy (N, ny, nv) where differentiated."""

    x: Array
    y: Array
    dy: Array | None = None

    @property
    def is_finite(self) -> bool:
        """True where nothing diverged."""
        return bool(np.all(np.isfinite(self.x)) and np.all(np.isfinite(self.y)))


@dataclass(slots=True, eq=False)
class Prediction:
    """Simulates the hypotheses of a set-up.

    Parameters
    ----------
    substeps : Runge-Kutta steps a sample.
    """

    setup: Setup
    hypotheses: Sequence[Hypothesis]
    comparisons: Sequence[Comparison]
    substeps: int = 1
    made: dict[Any, Any] = field(default_factory=dict, repr=False)  # simulators, kept by `replace`

    def simulator(self, i: int, Ts: float, *, acting: bool = False) -> Simulator:
        """The simulator of one hypothesis, or of its direct model, at a sample time, made once."""
        h = self.hypotheses[i]
        model, free = (h.acting, ()) if acting else (h.model, h.moving)
        key = id(model), free, Ts, self.substeps
        if key not in self.made:
            # With the model, whose identity is the key.
            self.made[key] = Simulator(model, Ts, free, substeps=self.substeps), model
        found: Simulator = self.made[key][0]
        return found

    @property
    def differentiated(self) -> set[int]:
        """Places of the hypotheses that are rivals."""
        return {c.rival for c in self.comparisons}

    @property
    def possible(self) -> list[int]:
        """Places of the hypotheses that may be the truth: those that have to keep the limits."""
        wrong = {c.rival for c in self.comparisons if c.truth is not None}
        return [i for i in range(len(self.hypotheses)) if i not in wrong]

    @property
    def sources(self) -> list[int]:
        """For every hypothesis, the one whose motion its sensors show: the truth, or itself."""
        out = list(range(len(self.hypotheses)))
        for c in self.comparisons:
            out[c.rival] = c.rival if c.truth is None else c.truth
        return out

    def shown(self, i: int, u: Array, release: Array) -> Array:
        """(N, outputs of the direct model): what all sensors show if hypothesis i is true."""
        h, setup = self.hypotheses[i], self.setup
        columns = setup.columns(h.acting, u, setup.Ts)
        with np.errstate(all="ignore"):
            run = self.simulator(i, setup.Ts, acting=True).simulate(
                columns, h.vector, setup.initial(h.model, release)
            )
        return np.asarray(run.y)

    def measured(self, i: int, u: Array, release: Array) -> dict[str, Array]:
        """Channel -> (N,) of those that stand for inputs, as the truth i would show them."""
        h = self.hypotheses[i]
        if not h.driven_by:
            return {}
        y, outputs = self.shown(i, u, release), list(h.acting.outputs)
        return {n: y[:, outputs.index(n)] for n in h.driven_by}

    def course(self, i: int, u: Array, release: Array, *, tangent: bool = False) -> Course:
        """Hypothesis i under the samples `u` (N, nu) of the designed inputs.

        The columns of `dy` are the free parameters and the initial states that are estimated.
        """
        h, setup = self.hypotheses[i], self.setup
        x0 = setup.initial(h.model, release)
        measured = self.measured(self.sources[i], u, release)
        columns = setup.columns(h.model, u, setup.Ts, measured)
        simulator = self.simulator(i, setup.Ts)
        with np.errstate(all="ignore"):
            if not tangent:
                run = simulator.simulate(columns, h.vector, x0)
                return Course(run.x, run.y)
            run = simulator.sensitivities(columns, h.vector, x0)
        assert run.dy is not None
        states = list(h.model.states)
        first = len(h.moving)
        kept = [*range(first), *(first + states.index(n) for n in h.free_states)]
        return Course(run.x, run.y, run.dy[:, :, kept])

    def grams(self, u: Array, release: Array) -> list[Array] | None:
        """Information (n, n) of each comparison, its last column the misfit; None if it diverges.

        Columns: initial states, free parameters, and y(truth) - y(rival) where there is a truth.
        """
        courses = {}
        for i in {k for c in self.comparisons for k in c if k is not None}:
            courses[i] = self.course(i, u, release, tangent=i in self.differentiated)
            if not courses[i].is_finite:
                return None
        return [self._gram(c, courses) for c in self.comparisons]

    def _gram(self, c: Comparison, courses: dict[int, Course]) -> Array:
        rival, h = courses[c.rival], self.hypotheses[c.rival]
        assert rival.dy is not None
        n = len(h.moving)
        order = [*range(n, rival.dy.shape[2]), *range(n)]
        columns = rival.dy[:, :, order]
        if c.truth is not None:
            misfit = courses[c.truth].y - rival.y
            columns = np.concatenate([columns, misfit[:, :, None]], axis=2)
        columns = (columns / self.setup.noise[None, :, None]).reshape(-1, columns.shape[2])
        return np.asarray(columns.T @ columns)

    def ranges(self, u: Array, release: Array, *, finer: int = 1) -> Array:
        """(n, 2) lowest and highest value of each limited signal, whatever the truth.

        At `finer` times the sampling rate; infinite where a simulation diverges.
        """
        setup, names = self.setup, self.setup.limits.signals
        found = np.tile([np.inf, -np.inf], (len(names), 1))
        Ts, fine = setup.Ts / finer, setup.finer(u, finer) if finer > 1 else u
        for i in self.possible:
            h = self.hypotheses[i]
            columns = setup.columns(h.acting, fine, Ts)
            with np.errstate(all="ignore"):
                run = self.simulator(i, Ts, acting=True).simulate(
                    columns, h.vector, setup.initial(h.model, release)
                )
            if not np.all(np.isfinite(run.x)):
                return np.tile([-np.inf, np.inf], (len(names) or 1, 1))
            if names:
                values = self._limited(h, run.x[:-1], columns)
                found[:, 0] = np.minimum(found[:, 0], values.min(axis=0))
                found[:, 1] = np.maximum(found[:, 1], values.max(axis=0))
        return found

    def excess(self, u: Array, release: Array, *, finer: int = 1) -> Array:
        """(n,) how far limited signals leave their limits, whatever the truth; inf: diverged."""
        found = self.ranges(u, release, finer=finer)
        ends = np.array(list(self.setup.limits.signals.values())).reshape(-1, 2)
        if len(ends) != len(found):
            return np.full(1, np.inf)  # diverged, and no signal is limited
        over = np.maximum(found[:, 1] - ends[:, 1], ends[:, 0] - found[:, 0])
        return np.asarray(np.where(np.isinf(found).any(axis=1), np.inf, np.maximum(over, 0.0)))

    def _limited(self, h: Hypothesis, x: Array, columns: Array) -> Array:
        key = id(h.acting), len(x)
        if key not in self.made:
            function = signal_function(h.acting.explicit(), list(self.setup.limits.signals))
            self.made[key] = function.map(len(x)), h.acting
        p = np.tile(h.vector[:, None], (1, len(x)))
        return np.asarray(self.made[key][0](x.T, columns.T, p)).T

    def is_allowed(self, u: Array, release: Array, *, finer: int = 1) -> bool:
        """True where no hypothesis leaves a limit at `finer` times the sampling rate."""
        return bool(np.all(self.excess(u, release, finer=finer) <= 0.0))
