"""What a discretisation does to parameters: the bias of its regression on noise-free samples.

Samples of a continuous system do not obey the bilinear (or an Euler) difference equation exactly.
Fitting that equation to them by least squares gives parameters that are off by an amount that no
number of samples removes: of order (w T)^2 / 12 for the bilinear transform, w T / 2 for the Euler
methods, w the frequency that matters [rad/s]. The limit of infinitely many samples is computed
here in the frequency domain, where a column of the regression is a known function of frequency.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError, nearest
from casid.linear.linear_model import LinearModel, TransferMatrix, linearise
from casid.linear.sampled.difference_equation import DifferenceEquation, difference_equation
from casid.linear.sampled.discretisation import METHODS, check_method, discretise
from casid.linear.sampled.inverse_map import invert
from casid.linear.sampled.lagged_columns import Column
from casid.model.model import Model
from casid.presentation import Presented

Spectrum = Callable[[Array], Array]
"""Frequencies [rad/s] -> spectral density, up to a factor."""

TRUTHS = ("zoh", "foh", "continuous")


@dataclass(frozen=True, slots=True, eq=False)
class BiasRow:
    """One discretisation at one sample time.

    Attributes
    ----------
    scale : (w T)^2 / 12, w the fastest pole's modulus: what the bilinear bias is compared with.
    bias : parameter -> estimate / true value - 1 (the difference itself where the true value is 0).
    """

    Ts: float
    method: str
    scale: float
    bias: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class BiasTable(Presented):
    """Rows of `bias_table`; `str` prints them."""

    output: str
    truth: str
    free: tuple[str, ...]
    rows: tuple[BiasRow, ...]

    def __repr__(self) -> str:
        return f"<BiasTable of {', '.join(self.free)}: {len(self.rows)} rows>"


@names_wrong_types(ModelError)
def bias_table(
    model: Model | LinearModel,
    Ts: Sequence[float] | float,
    free: Sequence[str] | str,
    values: Mapping[str, float] | None = None,
    *,
    output: str | None = None,
    methods: Sequence[str] | str = METHODS,
    truth: str = "foh",
    spectrum: Spectrum | Mapping[str, Spectrum] | None = None,
    points: int = 2000,
) -> BiasTable:
    """The bias of each parameter, for each discretisation and sample time, without noise.

    Parameters
    ----------
    model : in continuous time; a `Model`, or the `LinearModel` of one.
    Ts : sample times [s], or a single one.
    free : the parameters that are estimated, or the name of a single one.
    values : true values of the unknown parameters; known ones have their own unless given here.
    output : which output's regression; may be left out where there is one.
    methods : discretisations to compare, see `METHODS`, or a single one.
    truth : what the continuous system's inputs do between samples: "zoh", "foh" or, for signals
        without content above the Nyquist frequency, "continuous".
    spectrum : of the inputs, one for all or one for each by name; inputs are independent. White up
        to three times the fastest pole, or the Nyquist frequency where that is lower, by default.
    points : frequencies, evenly between 0 and the Nyquist frequency or the end of the default.

    Raises
    ------
    ModelError, IdentifiabilityError
        As `difference_equation` and `invert`; or if the spectrum excites too little to determine
        the coefficients.
    """
    times: list[Any] = [Ts] if np.ndim(Ts) == 0 else list(np.asarray(Ts, dtype=object).ravel())
    free = (free,) if isinstance(free, str) else tuple(free)
    methods = (methods,) if isinstance(methods, str) else tuple(methods)
    linear = model if isinstance(model, LinearModel) else linearise(model)
    if truth not in TRUTHS:
        raise ModelError(f"there is no truth {truth!r}{nearest(truth, TRUTHS)}")
    if output is None:
        if len(linear.outputs) != 1:
            raise ModelError(
                f"{linear.name} has outputs {', '.join(linear.outputs)}; choose one, output=..."
            )
        output = linear.outputs[0]
    transfer = linear.transfer(output)
    fastest = float(np.abs(np.roots(transfer.evaluate(values)[0])).max(initial=0.0))
    found = []
    for T in times:
        check_method("zoh", T)
        nyquist = np.pi / T
        top = nyquist if spectrum is not None or fastest == 0.0 else min(3.0 * fastest, nyquist)
        w = (np.arange(points) + 0.5) * top / points
        responses = _responses(transfer, truth, T, w, values)
        for method in methods:
            equation = difference_equation(linear, output, T, method=method)
            estimate = _limit(equation, w, responses, spectrum, free, values or {})
            bias = _relative(estimate, equation, values, free)
            found.append(BiasRow(float(T), method, (fastest * T) ** 2 / 12.0, bias))
    return BiasTable(output, truth, free, tuple(found))


def _relative(
    estimate: Array,
    equation: DifferenceEquation,
    values: Mapping[str, float] | None,
    free: Sequence[str],
) -> dict[str, float]:
    """estimate / true value - 1 by name; the difference itself where the true value is 0."""
    true = equation.vector(values)
    bias = {}
    for name, value in zip(free, estimate, strict=True):
        reference = float(true[equation.parameters.index(name)])
        bias[name] = float(value - reference) / (reference if reference else 1.0)
    return bias


def _responses(
    transfer: TransferMatrix, truth: str, T: float, w: Array, values: Mapping[str, float] | None
) -> dict[str, Array]:
    """The frequency response of the output to each input, as `truth` has it between samples."""
    if truth == "continuous":
        s = 1j * w
        a, rows = transfer.evaluate(values)
        found = [np.polyval(b, s) / np.polyval(a, s) for b in rows[0]]
    else:
        a, rows = discretise(transfer, T, truth).evaluate(values)
        x = np.exp(-1j * w * T)
        found = [np.polyval(b[::-1], x) / np.polyval(a[::-1], x) for b in rows[0]]
    return dict(zip(transfer.inputs, found, strict=True))


def _limit(
    equation: DifferenceEquation,
    w: Array,
    responses: Mapping[str, Array],
    spectrum: Spectrum | Mapping[str, Spectrum] | None,
    free: Sequence[str],
    values: Mapping[str, float],
) -> Array:
    """The parameters that least squares on infinitely many samples finds."""
    blocks, targets = [], []
    for u in equation.inputs:
        shape = spectrum.get(u) if isinstance(spectrum, Mapping) else spectrum
        if shape is None and isinstance(spectrum, Mapping):
            raise ModelError(
                f"no spectrum is given for the input {u!r}; give one for each of "
                f"{', '.join(equation.inputs)}"
            )
        root = np.sqrt(np.ones_like(w) if shape is None else np.asarray(shape(w), dtype=float))
        signals = {equation.output: responses[u], u: np.ones_like(w, dtype=complex)}
        phi = np.stack([_response(c, signals, w * equation.Ts) for c in equation.columns], axis=1)
        left = _response(equation.left, signals, w * equation.Ts)
        phi, left = phi * root[:, None], left * root
        blocks += [phi.real, phi.imag]
        targets += [left.real, left.imag]
    Phi, Y = np.vstack(blocks), np.concatenate(targets)
    size = np.linalg.norm(Phi, axis=0)
    if not np.isfinite(size).all() or (size == 0.0).any():
        raise ModelError(
            f"{equation.name}: a pole lies on the frequency axis or the spectrum is empty; give a "
            "spectrum that leaves the pole out"
        )
    Q, R = np.linalg.qr(Phi / size)
    singular = np.linalg.svd(R, compute_uv=False)
    if singular[-1] < 1e-13 * singular[0]:
        raise IdentifiabilityError(
            f"{equation.name}: this spectrum does not determine {', '.join(equation.coefficients)} "
            f"at Ts = {equation.Ts:g} s; widen it or sample more slowly"
        )
    theta = np.linalg.solve(R, Q.T @ Y) / size
    found, _ = invert(equation, theta, values, tuple(free), weight=R * size)
    return found


def _response(column: Column, signals: Mapping[str, Array], wT: Array) -> Array:
    """The frequency response of a column, signals being responses to one unit input."""
    total = np.zeros(len(wT), dtype=complex)
    for channel, lag, weight in column.taps:
        if channel in signals:
            total += weight * signals[channel] * np.exp(-1j * wT * lag)
    return total
