"""What estimates tend to, computed from spectra, and what they give: closed loops and noisy inputs.

Every signal is a known response to independent white sources, so that the limit of an estimator is
a few integrals over one period of frequency. The simulations are recursions written out here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from casid.estimation.cross_moments.moments import moments
from casid.estimation.moments.equations.moment_covariance import moment_covariance
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.moments.instruments.instruments import Instruments, Loop, Simulated
from casid.estimation.prediction_error.polynomial.estimation import armax, arx
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.lagged_columns import Column
from problems.pendulum import TABLE_7_2, indirect_model

N = 200_000
POINTS = 4096
BACK = np.exp(-2j * np.pi * np.arange(POINTS) / POINTS)  # q^-1 on the unit circle


def at(polynomial: Sequence[float]) -> Any:
    return np.polynomial.polynomial.polyval(BACK, np.asarray(polynomial, dtype=float))


@dataclass(frozen=True)
class Source:
    """White noise of this size, and how it reaches every channel: (numerator, denominator)."""

    size: float
    to: dict[str, tuple[Sequence[float], Sequence[float]]]


def simulate(
    sources: Sequence[Source], channels: Sequence[str], seed: int, n: int = N
) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    out = {c: np.zeros(n) for c in channels}
    for s in sources:
        white = s.size * rng.standard_normal(n)
        for c, (b, a) in s.to.items():
            out[c] += lfilter(b, a, white)
    return out


def responses(sources: Sequence[Source], channel: str) -> list[Any]:
    return [
        s.size * at(s.to[channel][0]) / at(s.to[channel][1])
        if channel in s.to
        else np.zeros(POINTS, dtype=complex)
        for s in sources
    ]


def column_response(sources: Sequence[Source], column: Column) -> list[Any]:
    total: list[Any] = [np.zeros(POINTS, dtype=complex) for _ in sources]
    for channel, lag, weight in column.taps:
        for k, r in enumerate(responses(sources, channel)):
            total[k] = total[k] + weight * BACK**lag * r
    return total


def mean(left: list[Any], right: list[Any]) -> float:
    return float(sum(np.mean(a * b.conj()).real for a, b in zip(left, right, strict=True)))


def limit_of_least_squares(sources: Sequence[Source], equation: Any) -> Any:
    """R^-1 E[phi left], (2.52)."""
    phi = [column_response(sources, c) for c in equation.columns]
    left = column_response(sources, equation.left)
    R = np.array([[mean(a, b) for b in phi] for a in phi])
    return np.linalg.solve(R, [mean(a, left) for a in phi])


def limit_of_prediction_error(sources: Sequence[Source], start: Any, na: int, nb: int) -> Any:
    """argmin E[eps^2] of ARMAX with one coefficient in C: eps = (A y - B u)/C, (2.53)."""
    y, u = responses(sources, "y"), responses(sources, "u")

    def loss(theta: Any) -> float:
        A, B, C = [1, *theta[:na]], theta[na : na + nb], [1, theta[-1]]
        if abs(theta[-1]) >= 1:
            return np.inf
        return float(
            sum(
                np.mean(np.abs((at(A) * p - at(B) * q) / at(C)) ** 2)
                for p, q in zip(y, u, strict=True)
            )
        )

    return minimize(
        loss,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 20_000},
    ).x


def estimated(equation: Any, signals: dict[str, Any], instruments: Simulated | None) -> Any:
    """(theta, standard errors) of least squares or instrumental variables."""
    columns = (equation.left, *equation.columns, *(instruments.columns if instruments else ()))
    sums = moments(signals, max(c.order for c in columns))
    e = MomentEquations.from_moments(
        equation, sums, None if instruments is None else instruments.columns, signals=signals
    )
    theta = e.unconstrained()
    S = moment_covariance([e], [theta], ["record"])
    w = e.root_weight("2sls", theta, None)
    gain = np.linalg.pinv(w @ e.Phi) @ w
    return theta, np.sqrt(np.diag(gain @ S @ gain.T))


# -- the pendulum: errors in variables in a closed loop -------------------------------------------


def pendulum_loop(Ts: float) -> tuple[Any, list[Source], Any]:
    """Torque disturbance, noise on both sensors; the bilinear loop (7.55) in its own polynomials:

    y = (n - B a)/D, u = [fn n/(c (1 - q^-2)) - A a]/D, D = A - (b0/c) fn, n = b0 (1 - q^-2) tau.
    """
    v = TABLE_7_2
    S = v["M"] * v["z_g"]
    I_2 = v["I_x"] + v["M"] * v["z_g"] * (v["z_g"] - v["z_s"])
    alpha1, alpha2, beta1 = v["d"] / I_2, v["k"] / I_2, -S / I_2
    den = 4 + 2 * alpha1 * Ts + alpha2 * Ts**2
    A = np.array([1, (2 * alpha2 * Ts**2 - 8) / den, (4 - 2 * alpha1 * Ts + alpha2 * Ts**2) / den])
    b0 = 2 * beta1 * Ts / den
    c, g, z_s = 2 / Ts, 9.81, v["z_s"]
    fn = np.array([z_s * c**2 + g, 2 * g - 2 * z_s * c**2, z_s * c**2 + g])
    B, D = b0 * np.array([1.0, 0.0, -1.0]), A - b0 / c * fn
    slow = [1.0, -0.9]
    sources = [
        Source(
            0.3,
            {
                "gyro": (-B, np.convolve(D, slow)),
                "accel": (-A, np.convolve(D, slow)),
                "a": ([1.0], slow),
            },
        ),
        Source(0.5, {"gyro": (B, D), "accel": (b0 / c * fn, D)}),
        Source(0.02, {"gyro": ([1.0], [1.0])}),
        Source(0.05, {"accel": ([1.0], [1.0])}),
    ]
    return np.array([A[1], A[2], b0]), sources, difference_equation(indirect_model(), "gyro", Ts)


@pytest.mark.parametrize("seed", [1, 2])
def test_least_squares_tends_to_its_predicted_limit_and_instruments_to_the_truth(seed: int) -> None:
    theta, sources, equation = pendulum_loop(0.05)
    signals = simulate(sources, ("gyro", "accel", "a"), seed)
    predicted = limit_of_least_squares(sources, equation)
    ls, error = estimated(equation, {k: signals[k] for k in ("gyro", "accel")}, None)
    assert np.all(np.abs(ls - predicted) < 4 * error)
    assert np.max(np.abs(predicted - theta) / error) > 30
    columns = tuple(Column(f"a[t-{i}]", (("a", i, 1.0),)) for i in range(12))
    iv, error = estimated(equation, signals, Simulated({}, columns, 0))
    assert np.all(np.abs(iv - theta) < 4 * error)


def test_the_loop_formed_algebraically_is_the_recursion_written_out() -> None:
    """Traps T-1 and T-2: casid's loop from the direct model against (7.55) in polynomials."""
    theta, sources, _ = pendulum_loop(0.05)
    loop = Loop(indirect_model(), 0.05)
    a = np.random.default_rng(3).standard_normal(500)
    values = {**{k: v for k, v in TABLE_7_2.items() if k in loop.parameters}, "m": 0.0}
    values |= {"I_xm": 0.0, "g": 9.81}
    found = loop.driven({"a_y": a}, values)
    for channel in ("gyro", "accel"):
        numerator, denominator = sources[0].to[channel]
        plain = np.asarray(denominator)
        D = np.polynomial.polynomial.polydiv(plain, [1.0, -0.9])[0]
        expected = lfilter(numerator, D, a)
        # the reference enters (7.30) as -a_y
        assert found[channel] == pytest.approx(expected, abs=1e-9 * np.max(np.abs(expected)))
    assert theta[0] < 0


# -- a loop with a direct term: prediction error with the right noise model -----------------------


def loop_with_direct_term(C: Sequence[float]) -> tuple[Any, list[Source], Any]:
    """A y = B u + C e with b0 != 0, u = F y - a with f0 != 0: the loop has an algebraic part."""
    A, B, F = np.array([1.0, -0.7]), np.array([0.5, 0.2]), np.array([-0.6, 0.3])
    D = np.convolve(A, [1, 0]) - np.convolve(B, F)
    slow = [1.0, -0.5]
    sources = [
        Source(
            1.0,
            {"y": (-B, np.convolve(D, slow)), "u": (-A, np.convolve(D, slow)), "a": ([1.0], slow)},
        ),
        Source(1.0, {"y": (C, D), "u": (np.convolve(F, C), D)}),
    ]
    equation = SimpleNamespace(
        output="y",
        left=Column("y", (("y", 0, 1.0),)),
        columns=(
            Column("-y[t-1]", (("y", 1, -1.0),)),
            Column("u[t]", (("u", 0, 1.0),)),
            Column("u[t-1]", (("u", 1, 1.0),)),
        ),
        coefficients=("a1", "b0", "b1"),
    )
    return np.array([A[1], *B]), sources, equation


def test_direct_prediction_error_is_biased_by_the_direct_term_as_predicted() -> None:
    """7.3.2: the true noise model (ARX, then ARMAX) does not help; the external reference does."""
    theta, sources, equation = loop_with_direct_term([1.0])
    signals = simulate(sources, ("y", "u", "a"), 5)
    predicted = limit_of_least_squares(sources, equation)
    m = arx(signals["y"], signals["u"], na=1, nb=2, nk=0)
    found = np.array([m.A[1], *next(iter(m.B.values()))])
    error = np.array(list(m.std_errors.values()))
    assert np.all(np.abs(found - predicted) < 5 * error)
    assert np.max(np.abs(predicted - theta) / error) > 30
    columns = tuple(Column(f"a[t-{i}]", (("a", i, 1.0),)) for i in range(8))
    iv, error = estimated(equation, signals, Simulated({}, columns, 0))
    assert np.all(np.abs(iv - theta) < 4 * error)


def test_armax_in_that_loop_tends_to_the_minimum_of_its_expected_criterion() -> None:
    C = [1.0, 0.6]
    theta, sources, _ = loop_with_direct_term(C)
    signals = simulate(sources, ("y", "u", "a"), 6)
    predicted = limit_of_prediction_error(sources, [*theta, 0.6], 1, 2)
    m = armax(signals["y"], signals["u"], na=1, nb=2, nc=1, nk=0)
    found = np.array([m.A[1], *next(iter(m.B.values())), m.C[1]])
    error = np.array(list(m.std_errors.values()))
    assert np.all(np.abs(found - predicted) < 5 * error)
    assert np.max(np.abs(predicted[:3] - theta) / error[:3]) > 20


# -- what a wrong reference filter costs ----------------------------------------------------------


def test_a_wrong_filter_costs_the_variance_that_the_sandwich_predicts() -> None:
    """0.1 s for 0.2 s: consistent, and the spread over runs is that of the standard errors.

    40 runs: a standard deviation is known to 1/sqrt(80) = 11 %, three of them allowed.
    """
    theta, sources, equation = pendulum_loop(0.05)
    loop = Loop(indirect_model(), 0.05)
    values = {**{k: v for k, v in TABLE_7_2.items() if k in loop.parameters}, "m": 0.0}
    values |= {"I_xm": 0.0, "g": 9.81}
    wrong: list[Any] = []
    for seed in range(40):
        signals = simulate(sources, ("gyro", "accel", "a"), 100 + seed, 20_000)
        blurred = lfilter([0.2], [1, -0.8], signals["a"])
        z = loop.instruments({"a_y": blurred}, values, Instruments("a"), ["gyro"])
        found, error = estimated(equation, {**signals, **z.signals}, z)
        wrong.append([found, error])
    spread = np.std([f for f, _ in wrong], axis=0, ddof=1)
    stated = np.mean([e for _, e in wrong], axis=0)
    assert spread == pytest.approx(stated, rel=0.33)
    centre = np.mean([f for f, _ in wrong], axis=0)
    assert np.all(np.abs(centre - theta) < 4 * spread / np.sqrt(40))
