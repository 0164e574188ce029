"""Orders of the polynomial family A y = sum_i (B_i/F_i) u_i + (C/D) e.

Coefficients are in ascending powers of q^-1, index = lag; (2.13) of Linder (2017) with an F_i for
every input (Ljung 1999, (4.33)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.stability import largest_root

PerInput = int | Mapping[str, int]
LAST_STABLE = 1 - 1e-6  # a root nearer to the unit circle counts as lying on it


def is_stable(polynomial: Array) -> bool:
    """Whether 1/polynomial is stable: every root inside the unit circle."""
    if len(polynomial) == 1:
        return True
    if len(polynomial) == 2:
        return bool(abs(polynomial[1]) < LAST_STABLE)
    return bool(np.all(np.isfinite(polynomial)) and largest_root(polynomial) < LAST_STABLE)


def settling(*polynomials: Array) -> int:
    """Samples until the slowest of the responses 1/polynomial has fallen to about 1 %."""
    radius = max((largest_root(p) for p in polynomials), default=0.0)
    order = max((len(p) - 1 for p in polynomials), default=0)
    if radius < 1e-6:
        return order
    return max(order, int(np.ceil(np.log(0.01) / np.log(min(radius, LAST_STABLE)))))


def reflected(polynomial: Array) -> tuple[Array, tuple[complex, ...]]:
    """The monic polynomial with its unstable roots z replaced by 1/conj(z), and those roots.

    A reflected root of C leaves the spectrum as it is (spectral factorisation); of F only the
    magnitude. Images closer to the circle than 0.99 are drawn in to 0.99.
    """
    if is_stable(polynomial):
        return polynomial, ()
    roots = np.roots(polynomial)
    out = np.abs(roots) >= LAST_STABLE
    image = roots.copy()
    image[out] = np.minimum(1 / np.abs(roots[out]), 0.99) * roots[out] / np.abs(roots[out])
    stable = np.real(np.poly(image))
    trailing = len(polynomial) - len(stable)  # np.roots drops vanishing last coefficients
    full = np.concatenate([stable, np.zeros(trailing)])
    return full, tuple(complex(r) for r in roots[out] if r.imag >= 0)


def is_number(value: Any) -> bool:
    """Whether it is a finite number; truth values and text are none."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return bool(np.isfinite(value))


def is_whole(value: Any) -> bool:
    """Whether it is a whole number of at least 0."""
    return is_number(value) and int(value) == value and bool(value >= 0)


@dataclass(frozen=True, slots=True)
class Orders:
    """Orders of A y = sum_i (B_i/F_i) u_i + (C/D) e.

    Parameters
    ----------
    na, nc, nd : number of free coefficients of A, C, D.
    nb, nf : of each B_i and F_i: one number for every input, or a mapping from input to number.
    nk : delay of each input in samples, B_i = q^-nk (b_nk + .. + b_{nk+nb-1} q^-(nb-1)).
    """

    na: int = 0
    nb: PerInput = 0
    nc: int = 0
    nd: int = 0
    nf: PerInput = 0
    nk: PerInput = 1


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The place of each coefficient in theta = [a, b of each input, c, d, f of each input]."""

    inputs: tuple[str, ...]
    na: int
    nb: tuple[int, ...]
    nc: int
    nd: int
    nf: tuple[int, ...]
    nk: tuple[int, ...]

    @classmethod
    def of(cls, orders: Orders, inputs: Sequence[str]) -> Layout:
        """Orders applied to named inputs.

        Raises
        ------
        ModelError
            If an order is negative or no integer, an input has no order, or nothing is free.
        """
        if not isinstance(orders, Orders):
            raise ModelError(
                f"orders = {orders!r}; give Orders(na=.., nb=.., nc=.., nd=.., nf=.., nk=..)"
            )

        def each(name: str, value: PerInput) -> tuple[int, ...]:
            """One order per input, of a number for all of them or a mapping by name."""
            if not isinstance(value, Mapping):
                return tuple(_whole(name, value) for _ in inputs)
            if set(value) != set(inputs):
                raise ModelError(
                    f"{name} names {', '.join(value) or 'no input'}, the data have "
                    f"{', '.join(inputs) or 'none'}; give one number for each input of the data"
                )
            return tuple(_whole(f"{name}[{i}]", value[i]) for i in inputs)

        layout = cls(
            tuple(inputs),
            _whole("na", orders.na),
            each("nb", orders.nb),
            _whole("nc", orders.nc),
            _whole("nd", orders.nd),
            each("nf", orders.nf),
            each("nk", orders.nk),
        )
        for name, nb, nf in zip(inputs, layout.nb, layout.nf, strict=True):
            if nb == 0:
                raise ModelError(
                    f"input {name} has nb = 0, so it does not act{', yet nf > 0' if nf else ''}; "
                    "give nb of at least 1, or leave the input out"
                )
        if not inputs and (orders.nb != 0 or orders.nf != 0):
            raise ModelError(
                f"nb = {orders.nb!r} and nf = {orders.nf!r} without an input; give u, or set both "
                "to 0 for a model of y alone"
            )
        if not inputs and layout.na and layout.nd:
            raise ModelError(
                f"na = {layout.na} and nd = {layout.nd} without an input: only the product A D "
                "acts on y; put its order into na and set nd = 0"
            )
        return layout

    @property
    def structure(self) -> str:
        """The field's name of the structure."""
        a, c, d, f = self.na > 0, self.nc > 0, self.nd > 0, any(self.nf)
        if not self.inputs:
            return "ARMA" if c else "AR"
        if f:
            return ("BJ" if c or d else "OE") if not a else "polynomial"
        if not d:
            return "ARMAX" if c else ("ARX" if a else "FIR")
        return "ARARMAX" if c and a else ("ARARX" if a else "BJ")

    @property
    def is_linear(self) -> bool:
        """Whether the predictor is linear in the coefficients (C = D = F = 1)."""
        return not (self.nc or self.nd or any(self.nf))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients in order; the number is the lag."""
        out = [f"a{k + 1}" for k in range(self.na)]
        for name, nb, nk in zip(self.inputs, self.nb, self.nk, strict=True):
            out += [f"b{k}[{name}]" for k in range(nk, nk + nb)]
        out += [f"c{k + 1}" for k in range(self.nc)] + [f"d{k + 1}" for k in range(self.nd)]
        for name, nf in zip(self.inputs, self.nf, strict=True):
            out += [f"f{k + 1}[{name}]" for k in range(nf)]
        return tuple(out)

    @property
    def n(self) -> int:
        """Number of free coefficients."""
        return self.na + sum(self.nb) + self.nc + self.nd + sum(self.nf)

    @property
    def longest_lag(self) -> int:
        """Oldest sample that the predictor's finite parts reach, D A y and D B u."""
        reach = [nk + nb - 1 for nk, nb in zip(self.nk, self.nb, strict=True)]
        return self.nd + max([self.na, *reach])

    def split(self, theta: Array) -> Polynomials:
        """The polynomials of theta (n,)."""
        place = 0

        def take(n: int) -> Array:
            nonlocal place
            place += n
            return theta[place - n : place]

        one = np.ones(1)
        a = np.concatenate([one, take(self.na)])
        b = [np.concatenate([np.zeros(k), take(n)]) for k, n in zip(self.nk, self.nb, strict=True)]
        c, d = np.concatenate([one, take(self.nc)]), np.concatenate([one, take(self.nd)])
        f = [np.concatenate([one, take(n)]) for n in self.nf]
        return Polynomials(a, b, c, d, f)

    def join(self, p: Polynomials) -> Array:
        """Theta (n,) of polynomials."""
        parts = [p.A[1:], *(b[k:] for b, k in zip(p.B, self.nk, strict=True)), p.C[1:], p.D[1:]]
        return np.concatenate([*parts, *(f[1:] for f in p.F)])


@dataclass(frozen=True, slots=True, eq=False)
class Polynomials:
    """A, C, D and one B, F for each input, ascending powers of q^-1."""

    A: Array
    B: list[Array]
    C: Array
    D: Array
    F: list[Array]


def _whole(name: str, value: Any) -> int:
    """An order as a whole number of at least zero; anything else is refused."""
    if not is_whole(value):
        raise ModelError(
            f"order {name} = {value!r}: give a whole number of at least 0, the number of "
            f"{'samples of delay' if name.startswith('nk') else 'free coefficients'}"
        )
    return int(value)
