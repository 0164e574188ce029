"""A closed loop as difference equations: formed in algebra, then simulated as one filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, SolveError, nearest
from casid.linear.sampled.discretisation import substitution
from casid.linear.stability import largest_root


@dataclass(frozen=True, slots=True, eq=False)
class DiscreteLoop:
    """The closed loop as difference equations with one denominator, in powers of q^-1.

    Attributes
    ----------
    outputs : y_O, then u_I.
    inputs : the eliminated inputs w, then u_K, then the balances' disturbances tau.
    numerators : (output, input) -> (n+1,) ascending powers of q^-1.
    denominator : (n+1,), the first entry 1.
    leading : det(I - G_O F_y) at p = 2/Ts, what 1/(1 - G_O F_y) starts with.
    """

    name: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    Ts: float
    numerators: Mapping[tuple[str, str], Array]
    denominator: Array
    leading: float

    @property
    def poles(self) -> Array:
        """Poles in z."""
        return np.roots(self.denominator)

    @property
    def is_stable(self) -> bool:
        """True if all poles lie inside the unit circle."""
        return largest_root(self.denominator) < 1.0

    def simulate(self, signals: Mapping[str, Array]) -> dict[str, Array]:
        """Outputs from rest, (N,) each, for the given inputs (N,); one that is not given is zero.

        Raises
        ------
        ModelError
            If a signal is no input of the loop, or lengths differ.
        SolveError
            If the loop is unstable; names its poles.
        """
        import scipy.signal

        for name in signals:
            if name not in self.inputs:
                raise ModelError(
                    f"{self.name}: {name!r} does not drive the loop{nearest(name, self.inputs)}"
                )
        lengths = sorted({len(s) for s in signals.values()})
        if len(lengths) != 1:
            raise ModelError(
                f"{self.name}: signals have {lengths} samples; give one or more of one length"
            )
        if not self.is_stable:
            worst = self.poles[np.argmax(np.abs(self.poles))]
            raise SolveError(
                f"{self.name}: the closed loop is unstable (a pole at z = {worst:.4g}, Ts = "
                f"{self.Ts:g} s), so it cannot be simulated from rest; check the parameters' "
                "values, or build instruments from the reference alone"
            )
        out = {}
        for row in self.outputs:
            total = np.zeros(lengths[0])
            for name, signal in signals.items():
                b = self.numerators[row, name]
                total += scipy.signal.lfilter(b, self.denominator, np.asarray(signal, dtype=float))
            out[row] = total
        return out

    def __repr__(self) -> str:
        state = "stable" if self.is_stable else "unstable"
        return (
            f"<DiscreteLoop {self.name}: {', '.join(self.inputs)} -> {', '.join(self.outputs)}; "
            f"order {len(self.denominator) - 1}, {state}, leading coefficient {self.leading:.4g}>"
        )


def bilinear(coefficients: Array, Ts: float) -> Array:
    """(1 + q^-1)^n times a polynomial in p at p = (2/Ts)(1 - q^-1)/(1 + q^-1).

    Parameters
    ----------
    coefficients : (n+1,) descending powers of p.

    Returns
    -------
    (n+1,) ascending powers of q^-1.
    """
    n = len(coefficients) - 1
    K = np.array(substitution(n, Ts, "bilinear"), dtype=float)
    return np.asarray((2.0 / Ts) ** n * coefficients @ K)
