"""Remedies side by side: which is best for each coefficient at N samples, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from casid.errors import ModelError
from casid.presentation import Presented, present
from casid.unknown_inputs.limits.asymptotics import Asymptotics

NO_BIAS = 1e-7
"""Of the standard deviation of one sample and of the value itself: a bias below is rounding, or the
truncation of a response, and would show only after 1e14 samples."""


@dataclass(frozen=True, slots=True, eq=False)
class RemedyRow:
    """A remedy and its result, or the reason why it cannot be used.

    Attributes
    ----------
    remark : where its bias comes from, what it models; empty where there is nothing to add.
    has_known_stage : whether its first stage is known: no choice where that has to be estimated.
    """

    name: str
    kind: str
    result: Asymptotics | None
    refused: str = ""
    remark: str = ""
    has_known_stage: bool = False

    def estimates(self, parameter: str) -> bool:
        """Whether it estimates this coefficient's true value."""
        return self.result is not None and parameter in self.result.truth

    def bias(self, parameter: str) -> float:
        """Limit minus truth as a number, rounding taken for zero."""
        result = self._found()
        bias = float(result.bias(parameter))
        size = math.sqrt(result.variance(parameter)) + abs(float(result.truth[parameter]))
        return 0.0 if abs(bias) <= NO_BIAS * size else bias

    def rmse(self, parameter: str, N: float) -> float:
        """Root mean square error at N samples."""
        return math.sqrt(self._found().variance(parameter) / N + self.bias(parameter) ** 2)

    def _found(self) -> Asymptotics:
        if self.result is None:
            raise ModelError(f"{self.name} has no result: {self.refused}")
        return self.result


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The best remedy for one coefficient, and the reason."""

    parameter: str
    remedy: str
    rmse: float
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Presented):
    """Remedies for unknown inputs side by side.

    Attributes
    ----------
    rows : one a remedy; the first knows all inputs, for reference.
    parameters : coefficients of the true relation.
    unknown : the inputs that are not available.
    N : samples that standard errors are given at.
    accuracy : coefficient -> root mean square error wanted.
    """

    rows: tuple[RemedyRow, ...]
    parameters: tuple[str, ...]
    unknown: tuple[str, ...]
    N: float
    accuracy: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.N > 0:
            raise ModelError(f"N = {self.N!r}; give a number of samples above 0")
        for name, value in self.accuracy.items():
            if name not in self.parameters or not value > 0:
                raise ModelError(
                    f"accuracy of {name} = {value!r}; give a value above 0 for one of "
                    f"{', '.join(self.parameters)}"
                )

    def __getitem__(self, name: str) -> Asymptotics:
        """The result of a remedy by its name."""
        for row in self.rows:
            if row.name == name:
                return row._found()
        raise ModelError(f"no remedy {name!r}; there are {', '.join(r.name for r in self.rows)}")

    @property
    def is_symbolic(self) -> bool:
        """Whether it is symbolic; `at` puts numbers in the place of symbols."""
        return any(r.result is not None and r.result.is_symbolic for r in self.rows)

    def at(self, values: Mapping[str, float], N: float | None = None) -> Comparison:
        """The comparison with numbers in place of symbols.

        A remedy that has no limit at these numbers has the reason in place of its result.
        """
        rows = tuple(_at(row, values) for row in self.rows)
        return replace(self, rows=rows, N=self.N if N is None else N)

    def candidates(self, parameter: str) -> list[RemedyRow]:
        """Remedies that estimate this coefficient without what is unknown, best first at N.

        Raises
        ------
        ModelError
            If symbols remain.
        """
        if self.is_symbolic:
            raise ModelError(
                "a symbolic comparison has no order; give numbers, comparison.at({'alpha': 0.7, "
                "..})"
            )
        rows = [r for r in self.rows if r.estimates(parameter) and r.kind != "known"]
        rows = [r for r in rows if not r.has_known_stage]
        return sorted(rows, key=lambda r: r.rmse(parameter, self.N))

    def best(self, parameter: str) -> Choice | None:
        """The remedy with the smallest root mean square error at N; None where none estimates it.

        Raises
        ------
        ModelError
            If symbols remain.
        """
        rows = self.candidates(parameter)
        if not rows:
            return None
        best = rows[0]
        rmse = best.rmse(parameter, self.N)
        return Choice(parameter, best.name, rmse, self._why(parameter, best, rows[1:]))

    def _why(self, parameter: str, best: RemedyRow, others: Sequence[RemedyRow]) -> str:
        bias, P = best.bias(parameter), best._found().variance(parameter)
        error = math.sqrt(P / self.N)
        if bias == 0:
            parts = [f"no bias, standard error {error:.3g}"]
        else:
            parts = [f"its bias {bias:.3g} is small beside standard errors of the others"]
            exact = [r for r in others if r.bias(parameter) == 0]
            if exact:
                least = min(exact, key=lambda r: float(r._found().variance(parameter)))
                until = (float(least._found().variance(parameter)) - P) / bias**2
                parts.append(f"from N = {math.ceil(until)} on {least.name} is better")
            else:
                parts = [f"every remedy is biased, this least in total (bias {bias:.3g})"]
        for other in others[:1]:
            own = other.rmse(parameter, self.N)
            cause = "bias" if abs(other.bias(parameter)) > own / math.sqrt(2) else "variance"
            equal = own < 1.0005 * best.rmse(parameter, self.N)
            compared = "does as well" if equal else f"has {own:.3g}, most of it {cause}"
            parts.append(f"{other.name} {compared}")
        biased = [
            r
            for r in others
            if bias == 0 and r.bias(parameter) != 0 and r._found().variance(parameter) < P
        ]
        if biased:
            first = max(biased, key=lambda r: self._until(parameter, P, r))
            until = self._until(parameter, P, first)
            if until >= 2:
                parts.append(f"{first.name} is better up to N = {math.floor(until)}")
        return "; ".join(parts)

    @staticmethod
    def _until(parameter: str, P: Any, row: RemedyRow) -> float:
        """Samples up to which a biased remedy of less variance wins over an exact one with P."""
        return float((P - row._found().variance(parameter)) / row.bias(parameter) ** 2)

    def cost_of_neglecting(self, parameter: str) -> str:
        """What neglecting costs beside knowing the input, and whether measuring it pays; one line.

        Raises
        ------
        ModelError
            If symbols remain.
        """
        rows = self.candidates(parameter)
        what = ", ".join(self.unknown)
        if not what:
            return f"{parameter}: no input is unknown"
        plain = [r for r in rows if r.kind == "neglect"]
        if not plain:
            verb = "is" if len(self.unknown) == 1 else "are"
            return f"{parameter}: cannot be had while {what} {verb} neglected"
        own = plain[0].rmse(parameter, self.N)
        text = f"{parameter}: neglecting {what} leaves rmse {own:.3g}"
        bias = plain[0].bias(parameter)
        text += f" (bias {bias:.3g})" if bias else " (no bias)"
        known = [r for r in self.rows if r.kind == "known" and r.estimates(parameter)]
        if known:
            text += f", knowing it {known[0].rmse(parameter, self.N):.3g}"
        sensed = [r for r in rows if r.kind in ("predict", "measure", "eliminate")]
        if sensed:
            with_sensor = sensed[0].rmse(parameter, self.N)
            least = min(r.rmse(parameter, self.N) for r in rows if r not in sensed)
            verdict = "worth measuring" if with_sensor < 0.98 * least else "not worth measuring"
            text += f", a sensor {with_sensor:.3g} ({sensed[0].name}): {verdict}"
        return text

    def table(self) -> list[dict[str, Any]]:
        """One mapping for each remedy and coefficient, for a CSV file or a data frame."""
        made: list[dict[str, Any]] = []
        for row in self.rows:
            for name in self.parameters:
                if row.result is None or not row.estimates(name):
                    continue
                r = row.result
                entry = {"remedy": row.name, "coefficient": name, "limit": r[name]}
                entry |= {"bias": r.bias(name), "variance": r.variance(name)}
                entry["amse at 1"] = r.amse(name)
                if not self.is_symbolic:
                    entry["N"] = self.N
                    entry["std error"] = r.std_error(name, self.N)
                    entry["amse at N"] = r.amse(name, self.N)
                    if name in self.accuracy:
                        entry["N wanted"] = r.samples_for(name, self.accuracy[name])
                made.append(entry)
        return made

    def plot(self) -> Any:
        """Figure: what each remedy gives at N, and its error against N."""
        return present(self, "figure")

    def __repr__(self) -> str:
        able = sum(r.result is not None for r in self.rows)
        return (
            f"<Comparison of {able} remedies for {', '.join(self.unknown)}: "
            f"{', '.join(self.parameters)}>"
        )


def _at(row: RemedyRow, values: Mapping[str, float]) -> RemedyRow:
    if row.result is None:
        return row
    try:
        return replace(row, result=row.result.at(values))
    except ModelError as why:
        return replace(row, result=None, refused=str(why))
