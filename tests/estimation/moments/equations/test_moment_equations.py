"""Moment equations: what least squares and instrumental variables are, stated on small data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import casid
from casid.estimation.cross_moments.moments import moments
from casid.estimation.moments.equations.moment_equations import MomentEquations, moment_equations
from casid.estimation.moments.equations.parts import parts_of
from casid.estimation.moments.equations.robust_weights import (
    huber,
    robust_weights,
    weighted_equations,
)
from casid.estimation.moments.instruments.instruments import Simulated, independent
from casid.linear.sampled.lagged_columns import Column
from problems.pendulum import experiments, indirect_model

TS = 0.01


@pytest.fixture(scope="module")
def part():
    model = indirect_model()
    return parts_of(model, experiments(duration=60.0, seed=3))[0]


def reference_instruments(part, lags: int = 6) -> Simulated:
    columns = tuple(Column(f"ref[t-{i}]", (("delta", i, 1.0),)) for i in range(lags))
    return Simulated({"delta": part.channels["ref"]}, columns, 0)


def test_least_squares_is_the_regression_on_the_columns(part) -> None:
    e = moment_equations(part, None)
    eq = part.equation
    phi = np.column_stack([c.samples(part.signals, eq.order) for c in eq.columns])
    left = eq.left.samples(part.signals, eq.order)
    expected = np.linalg.lstsq(phi, left, rcond=None)[0]
    assert e.unconstrained() == pytest.approx(expected, rel=1e-8)
    assert e.N == len(left)


def test_instrumental_variables_solve_the_mean_of_instrument_times_error(part) -> None:
    """As many instruments as coefficients: mean zeta (left - columns' theta) = 0, (2.41).

    The instruments are taken without their means.
    """
    simulated = reference_instruments(part, 3)
    e = moment_equations(part, simulated)
    theta = e.unconstrained()
    error = e.error(theta)
    for c in simulated.columns:
        zeta = c.samples(e.signals, e.start)
        zeta = zeta - zeta.mean()
        assert abs(np.mean(zeta * error)) < 1e-9 * np.std(zeta) * np.std(part.signals["gyro"])


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000),
)
def test_two_stage_least_squares_sees_the_span_of_the_instruments_alone(part, seed: int) -> None:
    """Recombining the instruments by any invertible matrix changes nothing."""
    rng = np.random.default_rng(seed)
    plain = reference_instruments(part)
    n = len(plain.columns)
    T = rng.standard_normal((n, n)) + 3 * np.eye(n)
    mixed = tuple(
        Column(f"mix {i}", tuple(("delta", j, float(T[i, j])) for j in range(n))) for i in range(n)
    )
    a = moment_equations(part, plain).unconstrained()
    b = moment_equations(part, replace(plain, columns=mixed)).unconstrained()
    assert b == pytest.approx(a, rel=1e-6)


def test_columns_that_repeat_one_another_are_reduced_to_their_span() -> None:
    def column(*taps: tuple[int, float]) -> Column:
        return Column("c", tuple(("w", lag, weight) for lag, weight in taps))

    three = [column((0, 1.0), (1, 2.0)), column((0, 2.0), (1, 4.0)), column((1, 1.0))]
    assert [c.taps for c in independent(three)] == [(("w", 0, 1.0),), (("w", 1, 1.0),)]
    two = [column((0, 1.0), (1, 2.0), (2, 1.0)), column((0, 2.0), (1, 4.0), (2, 2.0))]
    (one,) = independent(two)
    weights = np.array([w for _, _, w in one.taps])
    assert np.abs(weights / weights[0]) == pytest.approx([1.0, 2.0, 1.0])


def test_moments_of_two_records_give_what_one_record_of_both_gives() -> None:
    """The equations need sums alone, and sums add."""
    model = indirect_model()
    a, b = parts_of(model, experiments(duration=20.0, seed=5))
    order = a.equation.order
    sums = [moments(p.signals, order) for p in (a, b)]
    both = MomentEquations.from_moments(a.equation, sums[0] + sums[1])
    one, two = (MomentEquations.from_moments(a.equation, s) for s in sums)
    assert both.N == one.N + two.N
    expected = (one.N * one.Phi + two.N * two.Phi) / both.N
    assert both.Phi == pytest.approx(expected, rel=1e-13)


def test_a_constant_error_does_not_reach_instruments_without_mean(part) -> None:
    """A gyro's bias b leaves b (1 + a1 + a2) in the equation error."""
    simulated = reference_instruments(part)
    biased = replace(part, signals={**part.signals, "gyro": part.signals["gyro"] + 0.05})
    a, b = (moment_equations(p, simulated).unconstrained() for p in (part, biased))
    plain = moment_equations(part, None).unconstrained()
    moved = moment_equations(biased, None).unconstrained()
    assert np.max(np.abs(moved - plain)) > 10 * np.max(np.abs(b - a))


def test_outliers_cost_the_robust_estimate_less_than_the_plain_one(part) -> None:
    """(2.41) with Huber's alpha, over ten draws of one sample in a hundred shifted by 50 sigma."""
    simulated = reference_instruments(part, 12)
    truth = moment_equations(part, simulated)
    clean, size = truth.unconstrained(), np.sqrt(np.diag(truth.second)[1:])
    costs = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        y = part.signals["gyro"].copy()
        y[rng.integers(0, len(y), 60)] += 0.5
        e = moment_equations(replace(part, signals={**part.signals, "gyro": y}), simulated)
        theta = plain = e.unconstrained()
        for _ in range(30):
            weights = robust_weights(e.error(theta), huber())
            theta = weighted_equations(e, weights).unconstrained()
        costs.append([np.sum(((t - clean) * size) ** 2) for t in (theta, plain)])
    robust, not_robust = np.sum(costs, axis=0)
    assert robust < 0.5 * not_robust


def test_the_covariance_of_the_means_is_that_of_many_draws() -> None:
    """Coloured error, slow instruments: S from the product of two spectra.

    200 draws: the relative error of a variance is sqrt(2/200) = 10 %, four of them allowed.
    """
    from scipy.signal import lfilter

    rng = np.random.default_rng(4)
    N = 8000
    slow = lfilter([1.0], [1, -1.9, 0.95], rng.standard_normal(N))
    columns = tuple(Column(f"w[t-{i}]", (("w", i, 1.0),)) for i in (0, 3))

    def error() -> np.ndarray:
        return np.asarray(lfilter([1.0, -1.95, 1.0], [1.0, -0.3], rng.standard_normal(N + 50)))[50:]

    from casid.estimation.moments.equations.long_run_covariance import independent_covariances

    draws = np.array([[slow @ e / N, slow[:-3] @ e[3:] / N] for e in (error() for _ in range(200))])
    signals = {"w": np.concatenate([np.zeros(3), slow])}
    predicted = np.mean(
        [independent_covariances([error()], [columns], [signals]) for _ in range(5)], axis=0
    )
    assert np.diag(predicted) / N == pytest.approx(draws.var(axis=0), rel=0.4)


def test_records_are_refused_with_what_where_and_how() -> None:
    model = indirect_model()
    first, second = experiments(duration=20.0)
    with pytest.raises(casid.DataError, match="names of their own"):
        parts_of(model, [first, first])
    with pytest.raises(casid.ModelError, match="did you mean"):
        parts_of(model, [casid.Experiment(first.record, {"k_": 1.0}, "a")])
    mask = np.zeros(first.record.N, dtype=bool)
    mask[700] = True
    hole = casid.Experiment(first.record.mark_missing("gyro", mask), first.known, "hole")
    with pytest.raises(casid.DataError, match=r"t = 7 s.*record\.between"):
        parts_of(model, [hole])
    with pytest.raises(casid.ModelError, match="no output 'gyr'"):
        parts_of(model, [first], outputs=["gyr"])
    with pytest.raises(casid.DataError, match="name at least one"):
        parts_of(model, [])
