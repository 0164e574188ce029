"""The linear polynomial model A y = sum_i (B_i/F_i) u_i + (C/D) e, estimated.

Coefficients are in ascending powers of q^-1, index = lag: A = [1, a1, .., a_na], and B_i carries
its delay as leading zeros. (2.13) of Linder (2017) with an F_i for every input (Ljung
1999, (4.33)).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import TINY, Array
from casid.data.record import Record
from casid.errors import DataError, ModelError, SolveError, UnknownNameError
from casid.estimation.prediction_error.polynomial.misfit import Misfit
from casid.estimation.prediction_error.polynomial.orders import is_stable
from casid.estimation.prediction_error.polynomial.records import one_record
from casid.grouping import Grouped
from casid.linear.stability import largest_root
from casid.presentation import Presented


@dataclass(frozen=True, slots=True)
class Search:
    """How an estimate was found: the solver's evidence, and where it started from."""

    status: str
    is_converged: bool
    iterations: int
    scaled_gradient: float
    start: str


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialModel(Presented):
    """An estimate of A y = sum_i (B_i/F_i) u_i + (C/D) e, e white with variance `noise_variance`.

    Attributes
    ----------
    A, C, D : (order + 1,) monic, ascending powers of q^-1.
    B : input -> (nk + nb,), the first nk zero; output unit per input unit.
    F : input -> (nf + 1,) monic.
    covariance : (n, n) of `theta`, Linder 2017, (2.54)-(2.56), under what `assumes` says.
    misfit : residuals, and what sums them up; search : how the estimate was found. The fields of
        both are attributes of the model, too.
    notes : reflected roots, near cancellations, what else spoils a number.
    """

    structure: str
    A: Array
    B: Mapping[str, Array]
    C: Array
    D: Array
    F: Mapping[str, Array]
    nk: Mapping[str, int]
    names: tuple[str, ...]
    theta: Array
    covariance: Array
    assumes: str
    Ts: float
    misfit: Misfit
    search: Search
    notes: tuple[str, ...] = ()

    # -- the groups' fields ------------------------------------------------------------------

    noise_variance: ClassVar[Grouped[float]] = Grouped("misfit")
    loss: ClassVar[Grouped[float]] = Grouped("misfit")  # V_N of Linder 2017, (2.36)
    fit: ClassVar[Grouped[float]] = Grouped("misfit")  # NRMSE fit of the one-step prediction [%]
    N: ClassVar[Grouped[int]] = Grouped("misfit")  # Residuals that count, over all records
    residuals: ClassVar[Grouped[tuple[Array, ...]]] = Grouped("misfit")
    discarded: ClassVar[Grouped[tuple[int, ...]]] = Grouped("misfit")
    input_correlation: ClassVar[Grouped[Mapping[str, Array]]] = Grouped("misfit")
    status: ClassVar[Grouped[str]] = Grouped("search")  # How the search ended
    is_converged: ClassVar[Grouped[bool]] = Grouped("search")  # Whether the estimate is an optimum
    iterations: ClassVar[Grouped[int]] = Grouped("search")  # Of the solver
    scaled_gradient: ClassVar[Grouped[float]] = Grouped("search")  # The largest at the estimate
    start: ClassVar[Grouped[str]] = Grouped("search")  # How the start values were found
    # -- numbers -----------------------------------------------------------------------------

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.B)

    @property
    def n(self) -> int:
        """Number of free coefficients."""
        return len(self.theta)

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard error of each free coefficient by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def values(self) -> dict[str, float]:
        """Each free coefficient by name."""
        return dict(zip(self.names, self.theta.tolist(), strict=True))

    def __getitem__(self, name: str) -> float:
        """A free coefficient by name, as ``model["b1[u]"]``."""
        if name not in self.names:
            raise UnknownNameError(f"no coefficient {name!r}; there are {', '.join(self.names)}")
        return float(self.theta[self.names.index(name)])

    @property
    def residual(self) -> Array:
        """The N residuals that count, records one after the other."""
        parts = [r[d:] for r, d in zip(self.residuals, self.discarded, strict=True)]
        return np.concatenate(parts)

    @property
    def aic(self) -> float:
        """Akaike's criterion of the Gaussian likelihood; the variance counts as a parameter."""
        return self._minus_two_log_likelihood + 2 * (self.n + 1)

    @property
    def bic(self) -> float:
        """Schwarz's criterion, counted as `aic`."""
        return self._minus_two_log_likelihood + float(np.log(self.N)) * (self.n + 1)

    @property
    def _minus_two_log_likelihood(self) -> float:
        return self.N * (float(np.log(2 * np.pi * max(2 * self.loss, TINY))) + 1)

    @property
    def is_stable(self) -> bool:
        """Whether the simulation is stable: roots of A and F inside the unit circle."""
        return all(is_stable(p) for p in (self.A, *self.F.values()))

    # -- signals -----------------------------------------------------------------------------

    def prediction_errors(self, y: ArrayLike, u: Any = None) -> Array:
        """eps = (D/C) (A y - sum_i (B_i/F_i) u_i), (N,), from zero filter states."""
        from scipy.signal import lfilter

        out, channels = one_record(y, u, self.inputs)
        v = lfilter(self.A, [1.0], out)
        for name, signal in channels.items():
            v = v - lfilter(self.B[name], self.F[name], signal)
        return np.asarray(lfilter(self.D, self.C, v))

    def predict(self, y: ArrayLike, u: Any = None) -> Array:
        """One-step prediction, (N,): y_t from y and u up to t - 1 (u_t where nk = 0).

        (2.19) of Linder (2017). Filter states are zero at the first sample, so the beginning holds
        a transient.
        """
        errors = self.prediction_errors(y, u)
        return np.asarray(np.asarray(y, dtype=np.float64) - errors)

    def simulate(self, u: Any) -> Array:
        """Noise-free response sum_i B_i/(A F_i) u_i, (N,), from rest.

        Raises
        ------
        SolveError
            If A or an F_i is unstable.
        DataError, ModelError
            If u does not fit the inputs, or there is no input.
        """
        from scipy.signal import lfilter

        if not self.inputs:
            raise ModelError(f"a model of structure {self.structure} has no input to simulate from")
        if u is None or isinstance(u, Record):
            held = ", ".join(f"{i!r}: record[{i!r}]" for i in self.inputs)
            raise DataError(
                f"u is {'None' if u is None else 'a record'}; give the inputs to simulate from, "
                f"u={{{held}}}"
            )
        first = next(iter(u.values()), ()) if isinstance(u, Mapping) else u
        n = len(np.atleast_1d(first))
        _, channels = one_record(np.zeros(n), u, self.inputs)
        if not self.is_stable:
            raise SolveError(
                f"the simulation diverges: A or F has a root of modulus "
                f"{max(largest_root(p) for p in (self.A, *self.F.values())):.4g}; use predict, or "
                "simulate the closed loop from its external signal"
            )
        total = np.zeros(n)
        for name, signal in channels.items():
            total += lfilter(self.B[name], np.convolve(self.A, self.F[name]), signal)
        return total

    # -- frequency ---------------------------------------------------------------------------

    def response(self, omega: ArrayLike) -> dict[str, Array]:
        """Frequency responses G_i = B_i/(A F_i) at omega [rad/s], complex."""
        z = np.exp(-1j * np.asarray(omega, dtype=np.float64) * self.Ts)
        a = _at(self.A, z)
        return {i: np.asarray(_at(self.B[i], z) / (a * _at(self.F[i], z))) for i in self.inputs}

    def spectrum(self, omega: ArrayLike) -> Array:
        """Spectrum of the disturbance C/(A D) e at omega [rad/s], output unit squared.

        lambda |C/(A D)|^2: its mean over 0 .. pi/Ts is the disturbance's variance; times Ts/pi it
        is a density per rad/s.
        """
        z = np.exp(-1j * np.asarray(omega, dtype=np.float64) * self.Ts)
        h = _at(self.C, z) / (_at(self.A, z) * _at(self.D, z))
        return np.asarray(self.noise_variance * np.abs(h) ** 2)

    def to_control(self, *, noise: bool = False) -> Any:
        """The model as a `control.TransferFunction` in z with sample time Ts.

        Inputs are the model's in order; with `noise` the innovation e is the last one.
        """
        import control

        pairs = [(self.B[i], np.convolve(self.A, self.F[i])) for i in self.inputs]
        if noise:
            pairs.append((self.C, np.convolve(self.A, self.D)))
        if not pairs:
            raise ModelError("no input: call to_control(noise=True) for the noise model")
        num, den = [], []
        for b, a in pairs:
            length = max(len(a), len(b))
            num.append(np.concatenate([b, np.zeros(length - len(b))]))
            den.append(np.concatenate([a, np.zeros(length - len(a))]))
        names = [*self.inputs, *(["e"] if noise else [])]
        return control.TransferFunction([num], [den], self.Ts, inputs=names, outputs=["y"])

    # -- text --------------------------------------------------------------------------------

    def __repr__(self) -> str:
        word = "" if self.is_converged else ", NOT converged"
        return (
            f"<PolynomialModel {self.structure}: {self.n} coefficients, N = {self.N}, "
            f"fit {self.fit:.1f} %{word}>"
        )


def _at(polynomial: Array, z: Array) -> Array:
    """A polynomial in ascending powers at z = exp(-i omega Ts)."""
    return np.asarray(np.polynomial.polynomial.polyval(z, polynomial))
