"""What to do about an unknown input: the remedies of Linder (2017), 3.3-3.6, on one system.

Neglect it, approximate it or its contribution by known signals, predict it from a measurement
(two stages), use the measurement as it is (errors in variables), with instruments, or eliminate it
with a sensor that feels it. One call gives each remedy's limit, covariance and mean square error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from casid.errors import CasidError, IdentifiabilityError, ModelError
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
    """

    name: str
    kind: str
    estimator: Regression | Estimator


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
    eliminated : unknown input -> what a sensor that feels it says of it, such as "y_I - u_K"
        defined as a signal of the system (Example 4.2).
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
        If the input measurement cannot recover the inputs (which ones is told).
    """
    asked = [unknown] if isinstance(unknown, str) else list(unknown)
    task = _Task(system, output, dict(regressors), asked, dict(truth), list(known), prefilter)
    task.require_sound()
    if isinstance(measured, InputMeasurement):
        task.system, measured = measured.recover(system)
    remedies = [
        Remedy("all inputs known, LS", "known", task.regression(dict(regressors))),
        *task.neglecting(),
        *task.approximating(approximations, explain),
        *task.measuring(dict(measured or {})),
        *task.eliminating(dict(eliminated or {})),
        *extra,
    ]
    rows = [_row(task, remedy) for remedy in remedies]
    wanted = dict(accuracy) if isinstance(accuracy, Mapping) else {}
    if accuracy is not None and not isinstance(accuracy, Mapping):
        wanted = dict.fromkeys(regressors, float(accuracy))
    return Comparison(tuple(rows), tuple(regressors), tuple(asked), N, wanted)


@dataclass(slots=True, eq=False)
class _Task:
    """The question, and the regressions that answer it."""

    system: LinearSignals
    output: Term
    regressors: dict[str, Term]
    unknown: list[str]
    truth: dict[str, Any]
    known: list[Term]
    prefilter: Any

    def require_sound(self) -> None:
        """Refuse unknown inputs that are no regressors, and coefficients without truth."""
        used = {split_term(t)[1] for t in self.regressors.values()}
        for name in self.unknown:
            if name not in used:
                raise ModelError(
                    f"unknown input {name} is no regressor; the regressors are "
                    f"{', '.join(term_text(t) for t in self.regressors.values())}"
                )
        without = [n for n in self.regressors if n not in self.truth]
        if without:
            raise ModelError(
                f"no true value of {', '.join(without)}; give truth={{..}} for every coefficient, "
                "since bias is the question"
            )

    def regression(
        self,
        regressors: dict[str, Term],
        instruments: Sequence[Term] | None = None,
        generated: Mapping[str, FirstStage] | None = None,
    ) -> Regression:
        """A regression of the output with the task's prefilter."""
        return Regression(
            self.output, regressors, instruments, self.prefilter, dict(generated or {})
        )

    def without_unknown(self) -> dict[str, Term]:
        """The regressors that are available."""
        return {n: t for n, t in self.regressors.items() if split_term(t)[1] not in self.unknown}

    def replaced(self, by: Mapping[str, str]) -> dict[str, Term]:
        """The regressors with signals in the place of unknown inputs; those without are left out.

        Raises
        ------
        ModelError
            If a signal is given for what is no unknown input.
        """
        for name in by:
            if name not in self.unknown:
                raise ModelError(
                    f"{by[name]} is given for {name}, which is no unknown input; these are "
                    f"{', '.join(self.unknown)}"
                )
        made: dict[str, Term] = {}
        for name, term in self.regressors.items():
            sign, signal, lag = split_term(term)
            if signal in self.unknown:
                if signal not in by:
                    continue
                signal = by[signal]
            made[name] = (("-" if sign < 0 else "") + signal, lag)
        return made

    def shown(self, by: Mapping[str, str]) -> str:
        """The signals that replace, and the inputs that stay neglected beside them."""
        left = [name for name in self.unknown if name not in by]
        return ", ".join(by.values()) + (f" and neglect {', '.join(left)}" if left else "")

    def neglecting(self) -> list[Remedy]:
        """(3.15), by LS and with the known signals as instruments."""
        left = self.without_unknown()
        if not left:
            return []
        made = [Remedy("neglect, LS", "neglect", self.regression(left))]
        if self.known:
            made.append(Remedy("neglect, IV", "neglect", self._lazily(left)))
        return made

    def approximating(
        self, approximations: Mapping[str, str] | None, explain: Sequence[Sequence[Term]] | None
    ) -> list[Remedy]:
        """(3.26) and (3.31): the input, or its contribution, by known signals."""
        made = []
        if approximations:
            name = f"approximate by {self.shown(approximations)}"
            made.append(Remedy(name, "approximate", self.regression(self.replaced(approximations))))
        lists = explain if explain is not None else ([self.known] if self.known else [])
        for terms in lists:
            added = {f"b[{term_text(t)}]": t for t in terms}
            name = f"explain by {terms_text(terms)}"
            made.append(
                Remedy(name, "approximate", self.regression({**self.without_unknown(), **added}))
            )
        return made

    def measuring(self, measured: Mapping[str, str]) -> list[Remedy]:
        """Two stages (Example 3.8), errors in variables (3.9), instruments (3.10)."""
        if not measured:
            return []
        put, shown, made = self.replaced(measured), self.shown(measured), []
        if self.known:
            for is_known, text in ((False, "two-stage"), (True, "first stage known")):
                stages = {
                    f"{name} predicted": FirstStage(signal, self.known, is_known)
                    for name, signal in measured.items()
                }
                by = {name: f"{name} predicted" for name in measured}
                estimator = self.regression(self.replaced(by), None, stages)
                made.append(Remedy(f"predict from {shown}, {text}", "predict", estimator))
        made.append(Remedy(f"measure {shown}, LS", "measure", self.regression(put)))
        if self.known:
            made.append(Remedy(f"measure {shown}, IV", "measure", self._lazily(put)))
        return made

    def eliminating(self, eliminated: Mapping[str, str]) -> list[Remedy]:
        """The input as another sensor tells it, section 4.2."""
        if not eliminated:
            return []
        put, shown = self.replaced(eliminated), self.shown(eliminated)
        made = [Remedy(f"eliminate with {shown}, LS", "eliminate", self.regression(put))]
        if self.known:
            made.append(Remedy(f"eliminate with {shown}, IV", "eliminate", self._lazily(put)))
        return made

    def _lazily(self, regressors: dict[str, Term]) -> Estimator:
        """IV with all known signals; too few of them are a reason, not an error."""

        def estimate(system: LinearSignals) -> Asymptotics:
            regression = self.regression(regressors, self.known)
            true = {n: self.truth[n] for n in regressors if n in self.truth}
            return regression_limit(system, regression, true)

        return estimate


def _row(task: _Task, remedy: Remedy) -> RemedyRow:
    try:
        if isinstance(remedy.estimator, Regression):
            names = remedy.estimator.regressors
            true = {n: task.truth[n] for n in names if n in task.truth}
            found = regression_limit(task.system, remedy.estimator, true, method=remedy.name)
        else:
            found = remedy.estimator(task.system)
    except IdentifiabilityError as refused:
        return RemedyRow(remedy.name, remedy.kind, None, str(refused))
    except ModelError as refused:
        if "instruments for the" not in str(refused):
            raise
        return RemedyRow(remedy.name, remedy.kind, None, str(refused))
    except CasidError as refused:
        return RemedyRow(remedy.name, remedy.kind, None, str(refused))
    return RemedyRow(remedy.name, remedy.kind, found)
