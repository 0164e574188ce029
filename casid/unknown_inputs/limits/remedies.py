"""What to do about an unknown input: the remedies of Linder (2017), 3.3-3.6, on one system.

Neglect it, approximate it or its contribution by known signals, predict it from a measurement
(two stages), use the measurement as it is (errors in variables), with instruments, or eliminate it
with a sensor that it acts on. One call gives each remedy's limit, covariance and mean square error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from casid.argument_types import names_wrong_types
from casid.errors import IdentifiabilityError, ModelError
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import Comparison, RemedyRow
from casid.unknown_inputs.limits.input_measurement import InputMeasurement
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import (
    FirstStage,
    Regression,
    Term,
    split_term,
    term_text,
    terms_text,
)
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedy_table import Substitution, attempted_row, remedy_table

Estimator = Callable[[LinearSignals], Asymptotics]


@dataclass(frozen=True, slots=True, eq=False)
class Remedy:
    """A way to estimate, by its name.

    Parameters
    ----------
    name : in tables.
    kind : "known", "neglect", "approximate", "predict", "measure", "eliminate" or "own".
    estimator : a `Regression`, or a function of the system that returns `Asymptotics` (such as
        one that calls `prediction_error_limit`).
    has_known_stage : whether its first stage is known: no choice where that has to be estimated.
    """

    name: str
    kind: str
    estimator: Regression | Estimator
    has_known_stage: bool = False


@names_wrong_types(ModelError)
def compare_remedies(
    system: LinearSignals,
    output: Term,
    regressors: Mapping[str, Term],
    unknown: str | Sequence[str],
    truth: Mapping[str, Any],
    *,
    known: Sequence[Term] = (),
    approximations: Mapping[str, str] | None = None,
    explain: Sequence[Sequence[Term]] | None = None,
    measured: Mapping[str, str] | InputMeasurement | None = None,
    eliminated: Mapping[str, str] | None = None,
    prefilter: Any = None,
    extra: Sequence[Remedy] = (),
    N: float = 1000,
    accuracy: float | Mapping[str, float] | None = None,
) -> Comparison:
    """Compare the remedies for unknown inputs on a system.

    Parameters
    ----------
    output, regressors : the true relation, output = sum coefficient * regressor + noise, unknown
        inputs among the regressors: {"bK": "u_K", "bU": ("u_U", 1)}.
    unknown : signals that are not available.
    truth : coefficient -> true value, for every regressor.
    known : signals (and lags of them) that are known exactly or are independent of the noise:
        references. They explain, predict, and serve as instruments.
    approximations : unknown input -> the signal it is replaced by. Here and below, an unknown
        input that has no signal is neglected beside those that have one.
    explain : lists of known signals that are added as regressors in the input's place; default
        all of `known` in one.
    measured : unknown input -> its measurement, or an `InputMeasurement` of several.
    eliminated : unknown input -> its value computed from a sensor that it acts on, such as
        "y_I - u_K" defined as a signal of the system (Example 4.2).
    prefilter : of all regressions.
    extra : further remedies.
    N : samples of the standard errors.
    accuracy : root mean square error wanted, one for all coefficients or each.

    Returns
    -------
    Comparison; a remedy that cannot be used has its reason in place of numbers.

    Raises
    ------
    ModelError
        If a signal, truth or unknown input is missing.
    IdentifiabilityError
        If the input measurement cannot recover the inputs (they are named).

    Example
    -------
    >>> import casid
    >>> system = casid.LinearSignals.of(
    ...     {"u": "0.7*r + w", "z": "u + e_z", "y": "1.3*r - 0.8*u + e_y"},
    ...     {"r": 1.2, "w": 0.6, "e_z": 0.4, "e_y": 0.3},
    ... )
    >>> casid.compare_remedies(
    ...     system, "y", {"a": "r", "b": "u"}, unknown="u", truth={"a": 1.3, "b": -0.8},
    ...     measured={"u": "z"},
    ... )
    <Comparison of 3 remedies for u: a, b>
    """
    absent = [unknown] if isinstance(unknown, str) else list(unknown)
    _require_sound(regressors, absent, truth)
    if isinstance(measured, InputMeasurement):
        system, measured = measured.recover(system)
    table = _substitutions(absent, explain, known, approximations, measured, eliminated)
    task = _Task(output, regressors, absent, known, truth, prefilter)
    remedies = [*(remedy for row in table for remedy in task.remedies(row)), *extra]
    rows = [_row(system, remedy, truth) for remedy in remedies]
    wanted = _accuracies(accuracy, regressors)
    return Comparison(tuple(rows), tuple(regressors), tuple(absent), N, wanted)


def _substitutions(
    absent: Sequence[str],
    explain: Sequence[Sequence[Term]] | None,
    known: Sequence[Term],
    approximations: Mapping[str, str] | None,
    measured: Mapping[str, str] | None,
    eliminated: Mapping[str, str] | None,
) -> list[Substitution]:
    """The remedy table, in which all of `known` explain the inputs where no list of them does."""
    lists = explain if explain is not None else ([known] if known else [])
    explained = [(terms_text(t), t) for t in lists]
    return remedy_table(absent, approximations, explained, measured, eliminated)


def _accuracies(
    accuracy: float | Mapping[str, float] | None, coefficients: Iterable[str]
) -> dict[str, float]:
    """Coefficient -> root mean square error wanted; empty where none is."""
    if accuracy is None:
        return {}
    if isinstance(accuracy, Mapping):
        return dict(accuracy)
    return dict.fromkeys(coefficients, float(accuracy))


def _require_sound(
    regressors: Mapping[str, Term], unknown: Sequence[str], truth: Mapping[str, Any]
) -> None:
    """Refuse unknown inputs that are no regressors, and coefficients without truth."""
    used = {split_term(t)[1] for t in regressors.values()}
    for name in unknown:
        if name not in used:
            raise ModelError(
                f"unknown input {name} is no regressor; the regressors are "
                f"{', '.join(term_text(t) for t in regressors.values())}"
            )
    without = [n for n in regressors if n not in truth]
    if without:
        raise ModelError(
            f"no true value of {', '.join(without)}; give truth={{..}} for every coefficient, "
            "since bias is the question"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """The relation, and the regressions that estimate it by each remedy."""

    output: Term
    regressors: Mapping[str, Term]
    unknown: Sequence[str]
    known: Sequence[Term]
    truth: Mapping[str, Any]
    prefilter: Any

    def remedies(self, row: Substitution) -> Iterator[Remedy]:
        """By LS and, with known signals, IV (3.10) and two stages (Example 3.8).

        What approximates or explains is known, so that it needs no instruments.
        """
        terms = self._terms(row.by)
        if row.kind == "approximate":
            added = {f"b[{term_text(t)}]": t for t in row.explained}
            yield Remedy(row.name, row.kind, self._regression({**terms, **added}))
        elif terms:
            if self.known and row.kind == "measure":
                yield from self._predictions(row)
            yield Remedy(f"{row.name}, LS", row.kind, self._regression(terms))
            if self.known and row.kind != "known":
                yield Remedy(f"{row.name}, IV", row.kind, self._instrumental(terms))

    def _predictions(self, row: Substitution) -> Iterator[Remedy]:
        for is_known, text in ((False, "two-stage"), (True, "first stage known")):
            stages = {
                f"{name} predicted": FirstStage(signal, self.known, is_known)
                for name, signal in row.by.items()
            }
            terms = self._terms({name: f"{name} predicted" for name in row.by})
            estimator = self._regression(terms, None, stages)
            name = f"predict from {row.signals}, {text}"
            yield Remedy(name, "predict", estimator, has_known_stage=is_known)

    def _terms(self, by: Mapping[str, str]) -> dict[str, Term]:
        """The regressors, unknown inputs replaced by signals; without one they are left out."""
        made: dict[str, Term] = {}
        for name, term in self.regressors.items():
            sign, signal, lag = split_term(term)
            if signal not in self.unknown or signal in by:
                made[name] = (("-" if sign < 0 else "") + by.get(signal, signal), lag)
        return made

    def _regression(
        self,
        terms: dict[str, Term],
        instruments: Sequence[Term] | None = None,
        generated: Mapping[str, FirstStage] | None = None,
    ) -> Regression:
        return Regression(self.output, terms, instruments, self.prefilter, generated or {})

    def _instrumental(self, terms: dict[str, Term]) -> Estimator:
        """IV with all known signals; too few of them are a reason, not an error."""

        def estimate(system: LinearSignals) -> Asymptotics:
            """The limit of the regression on these terms; without one, unidentifiable."""
            try:
                regression = self._regression(terms, self.known)
            except ModelError as why:
                raise IdentifiabilityError(str(why)) from why
            return regression_limit(system, regression, {n: self.truth[n] for n in terms})

        return estimate


def _row(system: LinearSignals, remedy: Remedy, truth: Mapping[str, Any]) -> RemedyRow:
    """A remedy's limit; wrong signals are an error, no reason."""

    def estimate() -> Asymptotics:
        """The limit of the remedy's estimator, against the true values."""
        if not isinstance(remedy.estimator, Regression):
            return remedy.estimator(system)
        true = {n: truth[n] for n in remedy.estimator.regressors if n in truth}
        return regression_limit(system, remedy.estimator, true, method=remedy.name)

    row = attempted_row(remedy.name, remedy.kind, estimate, raised=ModelError)
    return replace(row, has_known_stage=remedy.has_known_stage)
