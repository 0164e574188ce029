"""The estimate: what was estimated, how sure, from which data, and whether it may be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from casid.arrays import Array
from casid.data.files import write_json
from casid.deprecation import renamed
from casid.errors import UnknownNameError
from casid.estimation.covariance import Sampled, sample_through
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.whiteness import Whiteness
from casid.grouping import Grouped
from casid.model.declared_units import quantity_of
from casid.model.units import from_si, is_si, parse_unit, si_unit, to_si
from casid.presentation import Presented, present
from casid.saving.saved import Saved

if TYPE_CHECKING:
    from collections.abc import Callable


Bound = Literal["lower", "upper", ""]


@dataclass(frozen=True, slots=True)
class Estimated:
    """One parameter of an estimate, every number in `unit`."""

    name: str
    value: float
    unit: str
    known: bool = False
    std_error: float | None = None  # None: known, at a bound, or not identifiable
    start: float | None = None
    note: str = ""
    ends: tuple[float, float] | None = None  # of an interval that is not normal
    interval_kind: str = "quick"  # normal; or "profile", "bootstrap", whose ends stand in `ends`
    resolution: float | None = None  # of an instant [s] that is searched for
    bound: Bound = ""  # at which the fit ended

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval, of the kind that `interval_kind` names; infinite where it has no end."""
        if self.ends is not None:
            return self.ends
        if self.std_error is None:
            return None
        return self.value - 1.96 * self.std_error, self.value + 1.96 * self.std_error

    def in_unit(self, unit: str) -> Estimated:
        """The parameter in another unit of its dimension."""
        if unit == self.unit:
            return self
        factor = parse_unit(self.unit).factor / parse_unit(unit).factor

        def converted(value: float) -> float:
            return float(from_si(to_si(value, self.unit), unit))

        return replace(
            self,
            value=converted(self.value),
            unit=unit,
            std_error=None if self.std_error is None else self.std_error * factor,
            start=None if self.start is None else converted(self.start),
            ends=None if self.ends is None else (converted(self.ends[0]), converted(self.ends[1])),
        )

    def to_json(self) -> dict[str, Any]:
        """The fields as `estimate.json` holds them."""
        interval = self.interval
        return {
            "value": self.value,
            "std_error": self.std_error,
            "interval": [e if np.isfinite(e) else None for e in interval] if interval else None,
            **({"interval_kind": self.interval_kind} if interval else {}),
            "unit": self.unit,
            "known": self.known,
            **({"note": self.note} if self.note else {}),
        }

    def __repr__(self) -> str:
        error = "" if self.std_error is None else f" +- {self.std_error:.2g}"
        note = ", ".join(x for x in ("known" if self.known else "", self.note) if x)
        return f"<{self.name} = {self.value:.5g}{error} {self.unit}{f' ({note})' if note else ''}>"


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Rank of the sensitivities at the estimate, and of the model for any data."""

    rank: int
    unknowns: int
    smallest_singular_value: float  # columns scaled to length one
    undetermined: str = ""
    structural: str = ""  # exact rank of model and experiments, determined before the fit
    unseen = renamed("unseen", "undetermined")

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "rank": self.rank,
            "unknowns": self.unknowns,
            "smallest_singular_value": self.smallest_singular_value,
            "unseen": self.undetermined,
            "structural": self.structural,
        }


@dataclass(frozen=True, slots=True, eq=False)
class RecordView:
    """Measured and simulated signals of one record, for figures, in the units that it states."""

    name: str
    t: Array  # (N,) s, the record's own clock
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    measured: Array  # (N, ny)
    used: Array  # (N, ny) bool, False where a sample is left out (missing, outlier, clipped)
    fitted: Array  # (N,) bool, False in the held-out part
    baseline: Array  # (N, ny) simulation before
    extended: Array | None  # (N, ny) simulation after
    inputs: tuple[str, ...]
    input_units: tuple[str, ...]
    u: Array  # (N, nu)
    states: tuple[str, ...]
    state_units: tuple[str, ...]
    x: Array  # (N, nx) simulated states of the best model

    def in_units(self, units: Mapping[str, str]) -> RecordView:
        """The signals named in `units` in those units, name -> unit."""
        outputs = [(n, u, units.get(n, u)) for n, u in _pairs(self.outputs, self.output_units)]
        inputs = [(n, u, units.get(n, u)) for n, u in _pairs(self.inputs, self.input_units)]
        states = [(n, u, units.get(n, u)) for n, u in _pairs(self.states, self.state_units)]
        return replace(
            self,
            measured=_columns_in(self.measured, outputs),
            baseline=_columns_in(self.baseline, outputs),
            extended=None if self.extended is None else _columns_in(self.extended, outputs),
            u=_columns_in(self.u, inputs),
            x=_columns_in(self.x, states),
            output_units=tuple(unit for _, _, unit in outputs),
            input_units=tuple(unit for _, _, unit in inputs),
            state_units=tuple(unit for _, _, unit in states),
        )

    def __repr__(self) -> str:
        return f"<RecordView {self.name}: {len(self.t)} samples of {', '.join(self.outputs)}>"


def _pairs(names: Sequence[str], units: Sequence[str]) -> Iterable[tuple[str, str]]:
    return zip(names, units, strict=True)


def _columns_in(values: Array, columns: Sequence[tuple[str, str, str]]) -> Array:
    """(N, n) values with column j, of (name, its unit, another), in the other unit."""
    out = values.copy()
    for j, (_, unit, other) in enumerate(columns):
        if other != unit:
            out[:, j] = from_si(to_si(values[:, j], unit), other)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """How sure the estimated values are."""

    names: tuple[str, ...]
    covariance: Array  # (n, n), in the units of the parameters
    assumes: str  # what the standard errors assume
    intervals: Mapping[str, str] = field(default_factory=dict)  # kind -> what it assumes


@dataclass(frozen=True, slots=True)
class SolverEvidence:
    """Whether the values are an optimum."""

    status: str
    is_converged: bool
    iterations: int
    scaled_gradient: float
    starts_tried: int = 1
    starts_agreeing: int = 1


Measure = Mapping[str, Mapping[str, float]]  # record -> output -> number


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well model and measurements agree."""

    rmse: Measure = field(default_factory=dict)  # rms simulation error
    nrmse: Measure = field(default_factory=dict)  # per cent
    whiteness_tests: Mapping[str, Whiteness] = field(default_factory=dict)  # output -> test
    measured_by: str = "Free simulation against the measured outputs"

    @property
    def whiteness(self) -> dict[str, str]:
        """Output -> the test of its residual, in words."""
        return {k: str(test) for k, test in self.whiteness_tests.items()}

    @property
    def coloured(self) -> dict[str, str]:
        """Outputs whose residual should be white and is not, with the lags outside the band."""
        return {k: t.counts for k, t in self.whiteness_tests.items() if t.meaning == "incomplete"}

    @property
    def untested(self) -> tuple[str, ...]:
        """Outputs with too few samples for the test whether their residual is white."""
        return tuple(k for k, t in self.whiteness_tests.items() if t.meaning == "too few")

    @property
    def autocorrelated(self) -> dict[str, str]:
        """Outputs with more than three lags outside the band, expected by the method or not."""
        return {k: t.counts for k, t in self.whiteness_tests.items() if t.is_coloured}


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the values come from."""

    provenance: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = ()  # papers behind the methods


@dataclass(frozen=True, slots=True)
class Trust:
    """What else bears on the trust in an estimate."""

    evidence: Mapping[str, str] = field(default_factory=dict)  # what was looked at -> sentence
    suspects: tuple[str, ...] = ()  # channels or terms with the wrong sign, each with its remedy
    not_done: tuple[str, ...] = ()  # what the budget left no time for


@dataclass(frozen=True, slots=True, eq=False)
class Estimate(Presented, Saved):
    """Values, covariance, what it assumes, solver evidence, fit and provenance.

    Attributes
    ----------
    parameters, initial_states : values, standard errors and 95 % intervals, each in the unit that
        stands in it; `estimate["k"]` is the value of one.
    uncertainty : covariance (n, n) of the names in it, in their units, and what it assumes; for
        each kind of interval what such a one assumes (`parameter.interval_kind` names its own).
    solver : status, iterations and scaled gradient of the solver that found the values.
    fit, held_out : record -> output -> rms error and normalised fit, in the records that were
        fitted and in those that were not.
    identifiability : rank of the sensitivities at the estimate, and of the equations for any data.
    units : output -> unit that its errors are in.
    """

    problem: str
    method: str
    parameters: tuple[Estimated, ...]
    initial_states: tuple[Estimated, ...]
    uncertainty: Uncertainty
    solver: SolverEvidence
    fit: Agreement  # in the records that were fitted
    held_out: Agreement = field(default_factory=Agreement)
    identifiability: Identifiability = field(default_factory=lambda: Identifiability(0, 0, 0.0))
    units: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    origin: Origin = field(default_factory=Origin)
    records: tuple[RecordView, ...] = ()  # measured and simulated signals, for figures
    trust: Trust = Trust()
    model: FittedModel | None = None  # with the estimated values; None where it has no states

    def __getitem__(self, name: str) -> float:
        """The value of a parameter or initial state."""
        return self.parameter(name).value

    def parameter(self, name: str) -> Estimated:
        """The parameter or initial state called `name`.

        Raises
        ------
        UnknownNameError
            With the names that there are.
        """
        for p in (*self.parameters, *self.initial_states):
            if p.name == name:
                return p
        raise UnknownNameError(f"no parameter {name!r}; there are {', '.join(self.names)}")

    def of_interval_kind(self, kind: str) -> tuple[str, ...]:
        """Parameters and initial states whose interval is of a kind, by name."""
        rows = (*self.parameters, *self.initial_states)
        return tuple(p.name for p in rows if p.interval is not None and p.interval_kind == kind)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of parameters and initial states."""
        return tuple(p.name for p in (*self.parameters, *self.initial_states))

    covariance_names: ClassVar[Grouped[tuple[str, ...]]] = Grouped("uncertainty", "names")
    covariance: ClassVar[Grouped[Array]] = Grouped("uncertainty")
    assumes: ClassVar[Grouped[str]] = Grouped("uncertainty")  # What the standard errors assume
    intervals: ClassVar[Grouped[Mapping[str, str]]] = Grouped("uncertainty")
    status: ClassVar[Grouped[str]] = Grouped("solver")  # The solver's status
    is_converged: ClassVar[Grouped[bool]] = Grouped("solver")  # True if the values are an optimum
    iterations: ClassVar[Grouped[int]] = Grouped("solver")  # The solver's iterations
    scaled_gradient: ClassVar[Grouped[float]] = Grouped("solver")
    starts_tried: ClassVar[Grouped[int]] = Grouped("solver")  # Number of starts
    starts_agreeing: ClassVar[Grouped[int]] = Grouped("solver")
    rmse: ClassVar[Grouped[Measure]] = Grouped("fit")  # Record -> output -> rms error
    nrmse_fit: ClassVar[Grouped[Measure]] = Grouped("fit", "nrmse")
    held_out_rmse: ClassVar[Grouped[Measure]] = Grouped("held_out", "rmse")
    held_out_fit: ClassVar[Grouped[Measure]] = Grouped("held_out", "nrmse")
    whiteness: ClassVar[Grouped[Mapping[str, str]]] = Grouped("fit")
    fit_is: ClassVar[Grouped[str]] = Grouped("fit", "measured_by")
    evidence: ClassVar[Grouped[Mapping[str, str]]] = Grouped("trust")
    suspects: ClassVar[Grouped[tuple[str, ...]]] = Grouped("trust")
    not_done: ClassVar[Grouped[tuple[str, ...]]] = Grouped("trust")
    provenance: ClassVar[Grouped[tuple[str, ...]]] = Grouped("origin")
    versions: ClassVar[Grouped[Mapping[str, str]]] = Grouped("origin")  # Package -> version
    sources: ClassVar[Grouped[tuple[str, ...]]] = Grouped("origin")

    def in_units(self, units: Mapping[str, str]) -> Estimate:
        """The estimate with every number of what `units` names in that unit.

        Parameters
        ----------
        units : parameter, state, input or output -> unit of its dimension; whatever is not named
            stays as it is.

        Raises
        ------
        UnitError
            For a unit that cannot be read.
        """
        if not units:
            return self
        parameters = tuple(p.in_unit(_unit_in(units, p)) for p in self.parameters)
        initial = tuple(p.in_unit(_unit_in(units, p)) for p in self.initial_states)
        before = {p.name: p.unit for p in (*self.parameters, *self.initial_states)}
        after = {p.name: p.unit for p in (*parameters, *initial)}
        scale = np.array([_factor(before, after, n) for n in self.covariance_names])
        outputs = {n: units.get(n, unit) for n, unit in self.units.items()}

        def converted(fit: Agreement) -> Agreement:
            return replace(fit, rmse=measure_in(fit.rmse, self.units, outputs))

        return replace(
            self,
            parameters=parameters,
            initial_states=initial,
            uncertainty=replace(
                self.uncertainty, covariance=self.covariance * np.outer(scale, scale)
            ),
            fit=converted(self.fit),
            held_out=converted(self.held_out),
            units=outputs,
            records=tuple(r.in_units(units) for r in self.records),
        )

    def in_si(self) -> Estimate:
        """The estimate with every number in SI."""
        named = {quantity_of(p.name): p.unit for p in (*self.parameters, *self.initial_states)}
        for r in self.records:
            named |= dict(_pairs(r.inputs, r.input_units)) | dict(_pairs(r.states, r.state_units))
        named |= self.units
        return self.in_units({n: si_unit(u) for n, u in named.items() if u and not is_si(u)})

    def sample(
        self,
        function: Callable[[Mapping[str, float]], Sequence[float] | float],
        *,
        draws: int = 10_000,
        seed: int = 0,
        valid: Callable[[Array], bool] | None = None,
    ) -> Sampled:
        """Draws of N(theta, P) through any nonlinear map, with the share of invalid draws.

        Parameters
        ----------
        function : takes parameter -> value, each in its unit; returns one number or several.
        draws, seed : how many draws, and of which seed.
        valid : whether a draw's values count; default all that are finite.
        """
        known = {p.name: p.value for p in self.parameters}
        # Inner nodes of multiple shooting are no parameters.
        kept = [i for i, n in enumerate(self.covariance_names) if n in self.names]
        names = [self.covariance_names[i] for i in kept]
        covariance = self.covariance[np.ix_(kept, kept)]

        def of_draw(point: Array) -> Array:
            values = {**known, **dict(zip(names, point.tolist(), strict=True))}
            return np.atleast_1d(np.asarray(function(values), dtype=float))

        theta = np.array([self[n] for n in names])
        return sample_through(of_draw, theta, covariance, draws=draws, seed=seed, valid=valid)

    def to_inference_data(self, *, draws: int = 1000, seed: int = 0) -> Any:
        """Draws of N(theta, P) as the posterior of an ArviZ InferenceData, one chain.

        Estimated parameters and initial states, each with its unit in the variable's attributes.
        What the normal approximation assumes is in the attribute `assumes`.

        Raises
        ------
        DataError
            If ArviZ is not installed: ``pip install "casid[arviz]"``.
        """
        from casid.estimation.inference_data import inference_data

        names = tuple(n for n in self.covariance_names if n in self.names)
        found = self.sample(lambda values: [values[n] for n in names], draws=draws, seed=seed)
        units = {p.name: p.unit for p in (*self.parameters, *self.initial_states)}
        said = {"problem": self.problem, "method": self.method, "assumes": self.assumes}
        return inference_data(found.values, names, units, said)

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.sources

    def to_json(self) -> dict[str, Any]:
        """The content of `estimate.json` (schema casid.estimate/1)."""
        return {
            "schema": "casid.estimate/1",
            "problem": self.problem,
            "method": self.method,
            "parameters": {p.name: p.to_json() for p in self.parameters},
            "initial_states": {p.name: p.to_json() for p in self.initial_states},
            "covariance": {
                "names": list(self.covariance_names),
                "matrix": self.covariance.tolist(),
            },
            "assumes": self.assumes,
            **({"intervals": dict(self.intervals)} if self.intervals else {}),
            "status": self.status,
            "converged": self.is_converged,
            "fit": {
                "rmse": {k: dict(v) for k, v in self.rmse.items()},
                "nrmse_percent": {k: dict(v) for k, v in self.nrmse_fit.items()},
                "held_out_rmse": {k: dict(v) for k, v in self.held_out_rmse.items()},
                "held_out_nrmse_percent": {k: dict(v) for k, v in self.held_out_fit.items()},
                "residuals": dict(self.whiteness),
            },
            "solver": {
                "iterations": self.iterations,
                "scaled_gradient": self.scaled_gradient,
                "starts_tried": self.starts_tried,
                "starts_agreeing": self.starts_agreeing,
            },
            "identifiability": self.identifiability.to_json(),
            "warnings": list(self.warnings),
            "suspects": list(self.suspects),
            "not_done": list(self.not_done),
            **({"evidence": dict(self.evidence)} if self.evidence else {}),
            "provenance": list(self.provenance),
            "versions": dict(self.versions),
        }

    def __repr__(self) -> str:
        free = sum(not p.known for p in self.parameters)
        bound = sum(bool(p.bound) for p in self.parameters)
        fits = [f for d in self.nrmse_fit.values() for f in d.values()]
        word = "converged" if self.is_converged else f"NOT converged ({self.status})"
        return (
            f"<Estimate {self.problem}: {word}, {free} free, {bound} at bound, "
            f"fit {min(fits, default=float('nan')):.1f} %>"
        )

    def plot(self) -> Any:
        """The estimates with their intervals as a Plotly figure."""
        return present(self, "figure")

    def write(self, folder: str | Path) -> Path:
        """Write `estimate.json` into `folder`, whole or not at all; returns its path."""
        return write_json(Path(folder) / "estimate.json", self.to_json())


def measure_in(measure: Measure, before: Mapping[str, str], after: Mapping[str, str]) -> Measure:
    """RMS errors by record and output, from the outputs' units `before` to those `after`."""
    return {
        record: {output: v * _factor(before, after, output) for output, v in errors.items()}
        for record, errors in measure.items()
    }


def _factor(before: Mapping[str, str], after: Mapping[str, str], name: str) -> float:
    """Factor of a difference between the units that two mappings have for a name; 1 without one."""
    if before.get(name) == after.get(name):
        return 1.0
    return parse_unit(before[name]).factor / parse_unit(after[name]).factor


def _unit_in(units: Mapping[str, str], row: Estimated) -> str:
    return units.get(quantity_of(row.name), row.unit)
