"""Limit, covariance and mean square error of an estimator, and its errors at N samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.algebra.factoring import factored
from casid.arrays import Array
from casid.errors import ModelError
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class Asymptotics(Presented):
    """Where an estimator goes and how it varies: Linder (2017), (2.52)-(2.60).

    theta_hat -> limit, N Cov(theta_hat) -> covariance. Numbers, or sympy expressions (objects)
    where the system has symbols. Externals without an excess kurtosis are taken as Gaussian.

    Attributes
    ----------
    method : what estimates.
    names : of the n coefficients.
    limit : (n,).
    covariance : (n, n) P, of one sample: Cov(theta_hat) ~ P / N.
    residual_variance : of the residual at the limit, output unit squared.
    truth : coefficient -> true value, where there is one.
    notes : what spoils a number.
    """

    method: str
    names: tuple[str, ...]
    limit: Array
    covariance: Array
    residual_variance: Any
    truth: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def is_symbolic(self) -> bool:
        """Whether it is symbolic."""
        values = [*self.limit, *self.covariance.ravel(), *self.truth.values()]
        return any(getattr(v, "free_symbols", None) for v in values)

    def __getitem__(self, name: str) -> Any:
        """The limit of a coefficient."""
        return _plain(self.limit[self._place(name)])

    def bias(self, name: str) -> Any:
        """Limit minus truth; 0 exactly where symbols cancel."""
        if name not in self.truth:
            raise ModelError(
                f"{self.method}: no true value of {name}, so no bias; give truth={{{name!r}: ..}}"
            )
        difference = self[name] - self.truth[name]
        return _factored(difference) if hasattr(difference, "free_symbols") else float(difference)

    def variance(self, name: str) -> Any:
        """N times the variance of a coefficient."""
        return _plain(self.covariance[(self._place(name),) * 2])

    def std_error(self, name: str, N: float) -> float:
        """Standard error at N samples, the coefficient's unit."""
        return math.sqrt(self._number(self.variance(name)) / N)

    def amse(self, name: str, N: Any = 1) -> Any:
        """Mean square error at N samples, P / N + bias^2. N = 1 is the thesis's AMSE, (2.60)."""
        total = self.variance(name) / N + self.bias(name) ** 2
        return _factored(total) if hasattr(total, "free_symbols") else float(total)

    def samples_for(self, name: str, accuracy: float) -> float:
        """Samples until the root mean square error is `accuracy`; infinite where bias forbids it.

        Raises
        ------
        ModelError
            If the accuracy is not above zero, or symbols remain.
        """
        if not accuracy > 0:
            raise ModelError(f"accuracy of {name} = {accuracy}; give a value above 0")
        room = accuracy**2 - self._number(self.bias(name)) ** 2
        return self._number(self.variance(name)) / room if room > 0 else math.inf

    def at(self, values: Mapping[Any, float]) -> Asymptotics:
        """Numbers in place of symbols (all of them, or some).

        Raises
        ------
        ModelError
            If the formulas divide by zero there: regressors or instruments are dependent then.
        """
        import sympy

        swap = {sympy.Symbol(str(k)): sympy.sympify(v) for k, v in values.items()}

        def put(value: Any) -> Any:
            """A number or expression with the values substituted, refused where it has no limit."""
            value = sympy.sympify(value).subs(swap)
            if value.free_symbols:
                return value
            if not value.is_finite:
                given = ", ".join(f"{k} = {v}" for k, v in values.items())
                raise ModelError(
                    f"{self.method}: no limit at {given}, where its regressors or instruments are "
                    "linearly dependent; leave one of them out, or give other values"
                )
            return float(value)

        def put_all(array: Array) -> Array:
            filled = [put(v) for v in array.ravel()]
            kind = object if any(hasattr(v, "free_symbols") for v in filled) else float
            return np.array(filled, dtype=kind).reshape(array.shape)

        return replace(
            self,
            limit=put_all(self.limit),
            covariance=put_all(self.covariance),
            residual_variance=put(self.residual_variance),
            truth={n: put(v) for n, v in self.truth.items()},
        )

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise ModelError(
                f"{self.method} does not estimate {name}; it has {', '.join(self.names)}"
            )
        return self.names.index(name)

    def _number(self, value: Any) -> float:
        if getattr(value, "free_symbols", None):
            names = ", ".join(sorted(map(str, value.free_symbols)))
            raise ModelError(
                f"{self.method}: the symbols {names} have no values; use .at({{'..': ..}}) first"
            )
        return float(value)

    def __repr__(self) -> str:
        if self.is_symbolic:
            return f"<Asymptotics {self.method}: {', '.join(self.names)}, symbolic>"
        shown = ", ".join(f"{n} -> {v:.4g}" for n, v in zip(self.names, self.limit, strict=True))
        return f"<Asymptotics {self.method}: {shown}>"


def _plain(value: Any) -> Any:
    return float(value) if isinstance(value, np.floating) else value


def _factored(value: Any) -> Any:
    import sympy

    return factored(sympy.cancel(sympy.nsimplify(value, rational=True)))
