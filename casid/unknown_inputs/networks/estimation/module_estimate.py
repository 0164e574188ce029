"""A module estimated from a record: the transfer function, how sure, by what, under which terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.algebra.rational import Rational
from casid.arrays import TINY, Array
from casid.data.record import Record
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.misfit import residual_input_correlation
from casid.estimation.prediction_error.polynomial.orders import is_stable
from casid.presentation import Presented
from casid.unknown_inputs.networks.estimation.consistency import Consistency
from casid.unknown_inputs.networks.estimation.module_data import ModuleData, module_data
from casid.unknown_inputs.networks.estimation.module_equation import ModuleEquation
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit
from casid.unknown_inputs.networks.nodes import edge_label, node_label


@dataclass(frozen=True, slots=True, eq=False)
class ModuleResponse:
    """Frequency response of a module with its errors.

    Attributes
    ----------
    omega : (F,) [rad/s]. value : (F,) complex.
    magnitude_error, phase_error : (F,) standard errors, of |G| and of its phase [rad].
    """

    omega: Array
    value: Array
    magnitude_error: Array
    phase_error: Array

    def band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper bound of the magnitude, (F,) each, at every frequency by itself."""
        from scipy.stats import norm

        reach = float(norm.ppf(0.5 + level / 2)) * self.magnitude_error
        size = np.abs(self.value)
        return np.maximum(size - reach, 0.0), size + reach

    def __repr__(self) -> str:
        return (
            f"<ModuleResponse at {len(self.omega)} frequencies, "
            f"{self.omega.min():.3g} to {self.omega.max():.3g} rad/s>"
        )


@dataclass(frozen=True, eq=False)
class ModuleEstimate(Presented):
    """G_ji, or what it becomes in the equation it was estimated from.

    Attributes
    ----------
    method : "ls", "iv", "two_stage" or "joint".
    equation : inputs, references, and whether G_ji is kept in it.
    consistency : of the method here, by the structure of the network.
    fit : coefficients and their covariance.
    """

    method: str
    equation: ModuleEquation
    consistency: Consistency
    fit: ModuleFit
    data: ModuleData

    # -- numbers -----------------------------------------------------------------------------

    @property
    def module(self) -> tuple[Any, Any]:
        """(j, i) of G_ji."""
        return self.equation.module

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficients: a1, b1[w1], f1[w1], .. and those of a noise model."""
        return self.fit.layout.names

    @property
    def theta(self) -> Array:
        """(n,) the coefficients."""
        return self.fit.theta

    @property
    def covariance(self) -> Array:
        """(n, n), under what `fit.assumes` says."""
        return self.fit.covariance

    def __getitem__(self, name: str) -> float:
        """A coefficient by name."""
        return float(self.theta[self._place(name)])

    def std_error(self, name: str) -> float:
        """Standard error of a coefficient."""
        i = self._place(name)
        return float(np.sqrt(max(self.covariance[i, i], 0.0)))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a coefficient, normal."""
        from scipy.stats import norm

        reach = float(norm.ppf(0.5 + level / 2)) * self.std_error(name)
        return self[name] - reach, self[name] + reach

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise ModelError(f"no coefficient {name!r}; there are {', '.join(self.names)}")
        return self.names.index(name)

    # -- transfer functions ------------------------------------------------------------------

    @cached_property
    def transfers(self) -> Mapping[str, Rational]:
        """Input channel -> B/(A F), all of the equation."""
        p = self.fit.layout.split(self.theta)
        return {
            u: _rational(b, np.convolve(p.A, f), self.data.Ts)
            for u, b, f in zip(self.fit.layout.inputs, p.B, p.F, strict=True)
        }

    @property
    def transfer(self) -> Rational:
        """The estimate of G_ji (of what it becomes, where it is not kept)."""
        return self.transfers[node_label(self.module[1])]

    def response(self, omega: ArrayLike) -> ModuleResponse:
        """Frequency response of the module at omega [rad/s], with errors by linearisation."""
        w = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        z = np.exp(-1j * w * self.data.Ts)
        layout, name = self.fit.layout, node_label(self.module[1])
        k = layout.inputs.index(name)

        def value(theta: Array) -> Array:
            p = layout.split(theta)
            at = np.polynomial.polynomial.polyval
            return np.asarray(at(z, p.B[k]) / (at(z, p.A) * at(z, p.F[k])))

        G = value(self.theta.astype(complex))
        slope = np.empty((len(w), layout.n), dtype=complex)
        for i in range(layout.n):
            step = 1e-6 * max(abs(float(self.theta[i])), 1e-3)
            moved = [self.theta.copy(), self.theta.copy()]
            moved[0][i] += step
            moved[1][i] -= step
            slope[:, i] = (value(moved[0]) - value(moved[1])) / (2 * step)
        turned = slope * (np.conj(G) / np.maximum(np.abs(G), TINY))[:, None]
        spread = [
            np.sqrt(np.maximum(np.einsum("fi,ij,fj->f", part, self.covariance, part), 0.0))
            for part in (turned.real, turned.imag)
        ]
        return ModuleResponse(w, G, spread[0], spread[1] / np.maximum(np.abs(G), TINY))

    # -- validation --------------------------------------------------------------------------

    def simulate(self, data: ModuleData | None = None) -> Array:
        """(N,) the output simulated from the measured inputs, from rest; no past output is used.

        Raises
        ------
        ModelError
            If an estimated module is unstable.
        """
        from scipy.signal import lfilter

        signals = self.data if data is None else data
        p = self.fit.layout.split(self.theta)
        unstable = [u for u, f in zip(self.fit.layout.inputs, p.F, strict=True) if not is_stable(f)]
        if unstable or not is_stable(p.A):
            raise ModelError(
                f"the module from {', '.join(unstable) or 'every input (A)'} is estimated unstable "
                "and cannot be simulated from rest; lower its order, or excite it more"
            )
        total = np.zeros(signals.N)
        for u, b, f in zip(self.fit.layout.inputs, p.B, p.F, strict=True):
            total += lfilter(b, np.convolve(p.A, f), signals.inputs[u])
        return total

    def simulated_fit(self, record: Record | None = None, *, skip: int | None = None) -> float:
        """NRMSE fit of that [%], of the record estimated from or another; nan where unstable.

        skip : first samples left out, by default a tenth.
        """
        data = self.data if record is None else module_data(self.equation, record)
        try:
            made = self.simulate(data)
        except ModelError:
            return float("nan")
        first = data.N // 10 if skip is None else skip
        y, made = data.y[first:], made[first:]
        return float(100 * (1 - np.linalg.norm(y - made) / np.linalg.norm(y - y.mean())))

    def reference_correlation(self) -> dict[str, int]:
        """Reference -> lags (of 21) at which it correlates with the residual beyond 95 %.

        One or two are chance; more mean that the orders, the inputs or the structure are wrong.
        """
        try:
            residual = (self.data.y - self.simulate())[self.data.N // 10 :]
        except ModelError:
            return {}
        found = {}
        for name, x in self.data.references.items():
            ratio = residual_input_correlation([residual], [x[self.data.N // 10 :]])
            found[name] = int(np.sum(np.abs(ratio) > 1))
        return found

    # -- text --------------------------------------------------------------------------------

    def __repr__(self) -> str:
        doubt = "" if self.consistency.is_consistent else ", NOT consistent"
        return f"<ModuleEstimate {edge_label(self.module)} by {self.method}{doubt}>"

    def transfer_text(self) -> str:
        """The estimate in q with five digits."""
        p = self.fit.layout.split(self.theta)
        k = self.fit.layout.inputs.index(node_label(self.module[1]))
        below = np.convolve(p.A, p.F[k])
        return f"({_powers(p.B[k])}) / ({_powers(below)})"


def _rational(b: Array, a: Array, Ts: float) -> Rational:
    """Polynomials in q^-1 as a function of q: both times the highest power."""
    n = max(len(a), len(b))
    above = [float(x) for x in b] + [0.0] * (n - len(b))
    below = [float(x) for x in a] + [0.0] * (n - len(a))
    from casid.algebra.coefficients import coefficient

    return Rational(
        tuple(coefficient(x) for x in above), tuple(coefficient(x) for x in below), "q", Ts
    )


def _powers(polynomial: Array) -> str:
    parts: list[str] = []
    for lag, x in enumerate(polynomial.tolist()):
        if x == 0.0:
            continue
        sign = ("-" if x < 0 else "") if not parts else (" - " if x < 0 else " + ")
        parts.append(f"{sign}{abs(x):.5g}" + (f" q^-{lag}" if lag else ""))
    return "".join(parts) or "0"
