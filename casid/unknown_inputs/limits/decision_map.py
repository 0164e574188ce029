"""Where in a plane of two symbols one estimator beats another, in variance and in total error.

Linder (2017), Figure 3.5, for any two estimators of one coefficient that have formulas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError
from casid.presentation import Viewed, present
from casid.unknown_inputs.limits.asymptotics import Asymptotics

REGIONS = ("in neither", "in variance alone", "in mean square error alone", "in both")


@dataclass(frozen=True, slots=True, eq=False)
class DecisionMap(Viewed):
    """Differences first minus second over a grid; negative where the first is better.

    Attributes
    ----------
    x, y : symbols on the axes; x_values (nx,), y_values (ny,).
    variance, amse : (ny, nx) of one sample and of N samples, coefficient unit squared.
    """

    first: str
    second: str
    parameter: str
    x: str
    y: str
    x_values: Array
    y_values: Array
    variance: Array
    amse: Array
    N: float

    @property
    def regions(self) -> Array:
        """(ny, nx) index into `REGIONS` of where the first estimator is better."""
        return np.asarray((self.variance < 0) + 2 * (self.amse < 0))

    def plot(self, curves: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None) -> Any:
        """The map as a Plotly figure.

        Parameters
        ----------
        curves : name -> (x, y) of a boundary to be drawn beside, such as a closed form.
        """
        return present(self, "figure", curves)

    def __repr__(self) -> str:
        return (
            f"<DecisionMap {self.first} against {self.second} for {self.parameter}: "
            f"{len(self.x_values)} {self.x} x {len(self.y_values)} {self.y}>"
        )


@names_wrong_types(ModelError)
def decision_map(
    first: Asymptotics,
    second: Asymptotics,
    parameter: str,
    x: tuple[str, Sequence[float] | Array],
    y: tuple[str, Sequence[float] | Array],
    values: Mapping[str, float] | None = None,
    *,
    N: float = 1,
) -> DecisionMap:
    """Compare two estimators with formulas over a plane.

    Parameters
    ----------
    first, second : from `regression_limit` of a symbolic system, with truth.
    parameter : the coefficient.
    x, y : symbol and its values, (nx,) and (ny,).
    values : numbers of all other symbols.
    N : samples of the mean square error; 1 as in the thesis, (2.60).

    Raises
    ------
    ModelError
        If a symbol has no value, or an axis is no symbol of the estimators.
    """
    import sympy

    swap = {sympy.Symbol(k): sympy.sympify(v) for k, v in (values or {}).items()}
    difference = {
        "variance": first.variance(parameter) - second.variance(parameter),
        "amse": first.amse(parameter, N) - second.amse(parameter, N),
    }
    axes = [sympy.Symbol(x[0]), sympy.Symbol(y[0])]
    symbols = {s for d in difference.values() for s in sympy.sympify(d).free_symbols}
    _require_plane(symbols, axes, swap, parameter)
    X, Y = np.meshgrid(np.asarray(x[1], dtype=float), np.asarray(y[1], dtype=float))
    found = {}
    for name, expression in difference.items():
        put = sympy.sympify(expression).subs(swap)
        with np.errstate(all="ignore"):
            grid = sympy.lambdify(axes, put, "numpy")(X, Y)
        found[name] = np.broadcast_to(np.asarray(grid, dtype=float), X.shape)
    return DecisionMap(
        first.method,
        second.method,
        parameter,
        x[0],
        y[0],
        X[0],
        Y[:, 0],
        found["variance"],
        found["amse"],
        N,
    )


def _require_plane(
    symbols: set[Any], axes: Sequence[Any], values: Mapping[Any, Any], parameter: str
) -> None:
    """Refuse axes that are no symbols of the estimators, and other symbols without value."""
    absent = [str(a) for a in axes if a not in symbols]
    if absent:
        raise ModelError(
            f"{', '.join(absent)} is no symbol of these estimators of {parameter}; they have "
            f"{', '.join(sorted(map(str, symbols)))}"
        )
    left = symbols - set(axes) - set(values)
    if left:
        raise ModelError(
            f"no value of {', '.join(sorted(map(str, left)))}; give values={{..}} for every symbol "
            "that is not on an axis"
        )
