"""The Gaussian prediction-error criterion of nonlinear models with process noise.

    V(theta) = 1/2 sum_e sum_t sum_i ( eps_i^2 / S_i + log S_i ) + constant                 (1)

over the samples that there are, with the innovations eps and their variances S of an extended
Kalman filter (`extended_filter`). The likelihood where the model is linear; otherwise as near to it
as the motion is linear within the spread of what is not known of the states (Kristensen, Madsen and
Jorgensen 2004, (10)-(14)). The sensitivities of eps and S are exact: V is differentiated as it is
computed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypedDict

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.errors import DataError
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.prediction_error.extended_filter import ExtendedFilter, FilteredRecord
from casid.estimation.prediction_error.unknown_noise import NoisyUnknowns
from casid.estimation.simulation.records.signals import signals_of
from casid.estimation.unknowns import LastOf, Unknowns, Variable
from casid.grouping import Grouped
from casid.linear.filtering.noisy_model import NoisePlaces, White
from casid.model.model import Model


class ExtendedOptions(TypedDict, total=False):
    """Optional arguments of an `ExtendedPredictionError`."""

    own: Sequence[str]
    initial: Mapping[str, Any] | None
    start: Mapping[str, float] | None
    substeps: int


class ExtendedPredictionError:
    """Criterion (1) for a model, its noise and its experiments.

    Parameters
    ----------
    model, experiments, noise, own, start : as for `PredictionError`; outputs may miss samples, and
        no noise is held.
    initial : state -> standard deviation of its initial value about the declared start, a number or
        an SX expression of the model's parameters. The initial values of the others are estimated,
        and have none.
    substeps : Runge-Kutta steps a sample.

    Raises
    ------
    ModelError
        For noise that is missing, held or enters nowhere, or that acts on an output directly;
        sensors with delays or clipping; a start for what is no variable.
    DataError
        For channels that are missing.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        noise: Sequence[White] | White,
        *,
        own: Sequence[str] = (),
        initial: Mapping[str, Any] | None = None,
        start: Mapping[str, float] | None = None,
        substeps: int = 1,
    ) -> None:
        if not experiments:
            raise DataError("no experiment to fit; give at least one record")
        self.model, self.experiments, self.substeps = model, list(experiments), substeps
        self.places = NoisePlaces(model, noise)
        self.noise, self.outputs = self.places.noise, self.places.outputs
        self.initial: dict[str, Any] = dict(initial or {})
        self.notes: tuple[str, ...] = ()
        self.unknowns = Unknowns(
            model, [(e.name, model.in_si(e.known)) for e in experiments], own, start
        )
        self.free, self.own = self.unknowns.free, self.unknowns.own
        self.data = [signals_of(self.places.driven, e) for e in experiments]
        self._laid_out = NoisyUnknowns(
            self.unknowns, self.places, self.data, self.initial, start or {}
        )
        self.offset = 0.0  # the constant of (1)
        self._filters = {Ts: self._filter(Ts) for Ts in {d.Ts for d in self.data}}
        self._spread = self._initial_spread()
        self._last: LastOf[FilteredRecord] = LastOf()

    @property
    def _columns(self) -> Array:
        """Local unknowns that are one in some experiment: those that a filter differentiates in."""
        return np.flatnonzero((np.array(self._laid_out.index) >= 0).any(axis=0))

    @property
    def _n_values(self) -> int:
        """Parameters and variances among the local unknowns; initial states follow."""
        return len(self.free) + len(self.places.sources)

    def _filter(self, Ts: float) -> ExtendedFilter:
        names = list(self.model.parameters)
        rows = [names.index(f) for f in self.free]
        rows += range(len(names), len(names) + len(self.places.sources))
        seeds = np.zeros((len(names) + len(self.places.sources), len(self._columns)))
        for j, column in enumerate(self._columns.tolist()):
            if column < self._n_values:
                seeds[rows[column], j] = 1.0
        return ExtendedFilter(self.places, Ts, seeds, substeps=self.substeps)

    def _initial_spread(self) -> Any:
        """All parameters (np,) -> variances of the initial states, and their slopes (nx, np)."""
        states = list(self.model.states)
        p = ca.vertcat(*[self.model.symbol(name) for name in self.model.parameters])
        variances = ca.vertcat(*[ca.SX(self.initial.get(name, 0.0)) ** 2 for name in states])
        slopes = ca.jacobian(variances, p)
        return ca.Function("spread", [p], [ca.densify(variances), ca.densify(slopes)])

    variables: ClassVar[Grouped[list[Variable]]] = Grouped("unknowns")  # The NLP's variables
    names: ClassVar[Grouped[tuple[str, ...]]] = Grouped("unknowns")  # Names of the NLP's variables
    start: ClassVar[Grouped[Array]] = Grouped("unknowns")  # (n,) start values

    @property
    def n_constraints(self) -> int:
        """Number of constraints of its own: none."""
        return 0

    @property
    def n_samples(self) -> int:
        """Samples that count, over experiments and outputs."""
        return int(sum(d.used.sum() for d in self.data))

    def parameters(self, x: Array, e: int) -> dict[str, float]:
        """Every parameter of the model in one experiment at `x`."""
        return self._laid_out.parameters(x, e)

    def initial_state(self, x: Array, e: int) -> Array:
        """Initial state (nx,) of one experiment at `x`."""
        return self._laid_out.initial_state(x, e)

    def initial_spread(self, x: Array, e: int) -> dict[str, float]:
        """State -> standard deviation of its initial value, of those that have one."""
        p = list(self.parameters(x, e).values())
        sd = np.sqrt(np.array(self._spread(p)[0]).ravel())
        named = dict(zip(self.model.states, sd.tolist(), strict=True))
        return {name: named[name] for name in self.initial}

    # -- the filter --------------------------------------------------------------------------

    def filtered(self, x: Array, e: int) -> FilteredRecord:
        """The filter over one experiment at `x`, with sensitivities in its local unknowns."""
        return self._last(x, e, lambda x, e: self._filtered(x, e, tangent=True))

    def _filtered(self, x: Array, e: int, *, tangent: bool) -> FilteredRecord:
        d, laid_out = self.data[e], self._laid_out
        run = self.filter_of(e)
        p = np.array(list(laid_out.parameters(x, e).values()), dtype=float)
        with np.errstate(all="ignore"):
            variance, slope = (np.array(v) for v in self._spread(p))
        values = np.concatenate([p, laid_out.variances(x, e)])
        start = run.pack(laid_out.initial_state(x, e), np.diag(variance.ravel()))
        slopes = self._initial_slopes(run, slope) if tangent else None
        return run.run((d.u, d.y, d.used), values, start, slopes)

    def _initial_slopes(self, run: ExtendedFilter, spread: Array) -> Array:
        """(entries of state and covariance, n) of what a record begins with."""
        out = np.zeros((run.n_carry, len(self._columns)))
        names = list(self.model.parameters)
        for j, column in enumerate(self._columns.tolist()):
            if column >= self._n_values:
                out[column - self._n_values, j] = 1.0
            elif column < len(self.free):
                P = np.diag(spread[:, names.index(self.free[column])])
                out[:, j] = run.pack(np.zeros(run.nx), P)
        return out

    def filter_of(self, e: int) -> ExtendedFilter:
        """The filter of one experiment."""
        return self._filters[self.data[e].Ts]

    def innovations(self, x: Array, e: int) -> Array:
        """(N, ny) one-step prediction errors of one experiment; NaN where a sample is missing."""
        d = self.data[e]
        return np.where(d.used, d.y - self.filtered(x, e).predicted, np.nan)

    # -- the criterion -----------------------------------------------------------------------

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient and expected Hessian (Fisher information) of (1) at `x` (n,).

        Where the filter overflows (a line search went too far) all are NaN.
        """
        n = len(self.variables)
        value, gradient, hessian = self.offset, np.zeros(n), np.zeros((n, n))
        with np.errstate(all="ignore"):
            for e in range(len(self.data)):
                at = self.filtered(x, e)
                terms = _values(at, self.data[e].used)
                if not np.all(np.isfinite(terms)):
                    return Evaluation(np.nan, np.full(n, np.nan), np.full((n, n), np.nan))
                value += float(np.sum(terms))
                local, place = self._local(e)
                de, dS = (d[:, :, local] for d in _whitened_slopes(at, self.data[e].used))
                gradient[place] += _scores(at, de, dS).sum(axis=0)
                both = [d.reshape(-1, len(place)) for d in (de, dS)]
                # einsum starts no threads, which for so thin a product cost more than they bring.
                information = np.einsum("ti,tj->ij", both[0], both[0])
                information += 0.5 * np.einsum("ti,tj->ij", both[1], both[1])
                hessian[np.ix_(place, place)] += information
        return Evaluation(value, gradient, hessian)

    def value(self, x: Array) -> float:
        """(1) alone, in a fraction of the time; NaN where the filter overflows."""
        total = self.offset
        with np.errstate(all="ignore"):
            for e, d in enumerate(self.data):
                total += float(np.sum(_values(self._filtered(x, e, tangent=False), d.used)))
        return total

    @property
    def value_alone(self) -> Any:
        """`value`, for a solver's line search."""
        return self.value

    def _local(self, e: int) -> tuple[Array, Array]:
        """Columns of the sensitivities that are unknowns in an experiment, and the unknowns."""
        place = self._laid_out.index[e][self._columns]
        return np.flatnonzero(place >= 0), place[place >= 0]

    def scores(self, x: Array) -> Array:
        """(samples, n) derivatives of each sample's terms in (1), experiments stacked.

        Of the samples that have any output, one after another.
        """
        out = []
        for e, d in enumerate(self.data):
            at, (local, place) = self.filtered(x, e), self._local(e)
            de, dS = (each[:, :, local] for each in _whitened_slopes(at, d.used))
            rows = np.zeros((d.N, len(self.variables)))
            rows[:, place] = _scores(at, de, dS)
            out.append(rows[d.used.any(axis=1)])
        return np.concatenate(out)

    def quadratic(self, x: Array) -> float:
        """sum eps^2 / S at `x`: as large as the number of samples where the noise is right."""
        found = [self.filtered(x, e) for e in range(len(self.data))]
        return float(sum(np.sum(at.innovations**2 / at.variances) for at in found))

    def log_likelihood(self, x: Array) -> float:
        """log of the Gaussian density of all records."""
        return float(-(self.value(x) - self.offset) - 0.5 * self.n_samples * np.log(2 * np.pi))


def _values(at: FilteredRecord, used: Array) -> Array:
    """(N, ny) terms of (1); NaN where a variance is not positive."""
    return np.where(used, 0.5 * (at.innovations**2 / at.variances + np.log(at.variances)), 0.0)


def _whitened_slopes(at: FilteredRecord, used: Array) -> tuple[Array, Array]:
    """Derivatives (N, ny, n) of eps over the root of S, and of S over S; zero where none is."""
    assert at.d_innovations is not None
    assert at.d_variances is not None
    root = np.sqrt(at.variances)[:, :, None]
    there = used[:, :, None]
    return there * at.d_innovations / root, there * at.d_variances / root**2


def _scores(at: FilteredRecord, de: Array, dS: Array) -> Array:
    """(N, n) derivatives of the terms of (1), outputs summed, from `_whitened_slopes`."""
    white = at.innovations / np.sqrt(at.variances)
    return np.asarray(
        np.einsum("ti,tin->tn", white, de) + 0.5 * np.einsum("ti,tin->tn", 1 - white**2, dS)
    )
