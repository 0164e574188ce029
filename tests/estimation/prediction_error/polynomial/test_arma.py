"""Noise models of a residual: their optimum, their errors, and the filter that whitens."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from casid.errors import DataError, ModelError
from casid.estimation.prediction_error.polynomial.arma import Arma, arma, arma_order
from tests.support.recursion import filtered

try:
    from statsmodels.tsa.statespace.sarimax import SARIMAX
except ImportError:
    SARIMAX = None

AR, MA = (1.0, -1.2, 0.5), (1.0, 0.5)


if SARIMAX is not None:

    class FromRest(SARIMAX):
        """An exact likelihood whose process starts from rest, as casid's filters do."""

        def __init__(self, endog, **options):
            super().__init__(
                endog, enforce_stationarity=False, enforce_invertibility=False, **options
            )

        def update(self, params, *args, **options):
            super().update(params, *args, **options)
            selection, covariance = self.ssm["selection"], self.ssm["state_cov"]
            start = np.zeros(self.ssm.k_states)
            self.ssm.initialize_known(start, selection @ covariance @ selection.T)
            self.ssm.loglikelihood_burn = 0


def disturbance(n: int, seed: int, ar=AR, ma=MA, burn: int = 500) -> np.ndarray:
    """A stationary stretch."""
    return lfilter(ma, ar, np.random.default_rng(seed).normal(size=n + burn))[burn:]


def test_arma_is_the_maximum_of_statsmodels_likelihood():
    pytest.importorskip("statsmodels")
    v = filtered(MA, AR, np.random.default_rng(3).normal(size=600))
    model = arma(v, 2, 1, discard=0)
    assert model.fit is not None
    reference = FromRest(v, order=(2, 0, 1))
    ours = np.r_[-model.ar[1:], model.ma[1:], 2 * model.fit.loss]
    assert reference.loglike(ours) == pytest.approx(1 + 3 - model.fit.aic / 2, rel=1e-9)
    fit = reference.fit(method="bfgs", disp=0, maxiter=200, gtol=1e-7)
    # Its derivatives are differences: a hundredth of a standard error.
    assert np.all(np.abs(fit.params[:-1] - ours[:-1]) < 1e-2 * model.std_errors)
    assert fit.llf <= reference.loglike(ours) + 1e-8
    # The expected information, theirs by differences of the likelihood: a few per cent at N = 600.
    assert fit.bse[:-1] == pytest.approx(model.std_errors, rel=0.1)


def test_the_stationary_likelihood_lies_within_a_transient_of_it():
    """Exact maximum likelihood differs by terms of order 1/N, below the errors of 1/sqrt(N)."""
    pytest.importorskip("statsmodels")
    v = disturbance(4000, 4)
    model = arma(v, 2, 1)
    ours = np.r_[-model.ar[1:], model.ma[1:]]
    start = np.r_[ours, model.variance]
    exact = SARIMAX(v, order=(2, 0, 1)).fit(start, method="lbfgs", disp=0, pgtol=1e-9, factr=10)
    # About 6 samples of transient and up to 50 discarded, of 4000: sqrt(50/4000) of an error.
    assert np.all(np.abs(exact.params[:-1] - ours) < 0.2 * model.std_errors)


@pytest.mark.parametrize("pole", [0.3, 0.9])
def test_errors_of_first_order_models_are_those_of_theory(pole):
    """var a = (1 - a^2)/N for AR(1), and the same for MA(1) (Box and Jenkins 1970, ch. 7)."""
    n = 20_000
    for v, orders in (
        (disturbance(n, 5, (1.0, -pole), (1.0,)), (1, 0)),
        (disturbance(n, 6, (1.0,), (1.0, pole)), (0, 1)),
    ):
        model = arma(v, *orders)
        sigma = np.sqrt((1 - pole**2) / n)
        assert abs(abs(model.theta[0]) - pole) < 4 * sigma
        # d sigma / d pole times the error of the pole, four of them.
        slack = 4 * sigma * pole / (1 - pole**2) + 4 / np.sqrt(2 * n)
        assert model.std_errors[0] == pytest.approx(sigma, rel=slack)
        assert model.variance == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))


def test_errors_of_a_mixed_model_are_those_of_theory():
    """v = (1 + c q^-1)/(1 + a q^-1) e: the information is
    [[1/(1 - a^2), -1/(1 - a c)], [., 1/(1 - c^2)]] (Box and Jenkins 1970, section 7.2)."""
    a, c, n = -0.8, 0.5, 40_000
    model = arma(disturbance(n, 7, (1.0, a), (1.0, c)), 1, 1)
    information = np.array([[1 / (1 - a**2), -1 / (1 - a * c)], [-1 / (1 - a * c), 1 / (1 - c**2)]])
    expected = np.linalg.inv(information) / n
    assert model.covariance == pytest.approx(expected, rel=0.05)
    error = model.theta - [a, c]
    assert error @ np.linalg.solve(expected, error) < 13.8  # chi-squared, two of them, 0.999


@pytest.mark.parametrize(("na", "nc"), [(4, 4), (0, 4), (4, 0), (2, 3)])
def test_higher_orders_whiten_their_own_noise(na, nc):
    rng = np.random.default_rng(8)
    ar = np.real(np.poly([0.85 * np.exp(0.6j), 0.85 * np.exp(-0.6j), 0.5, -0.4][:na]))
    ma = np.real(np.poly([0.7 * np.exp(1.8j), 0.7 * np.exp(-1.8j), 0.6, -0.5][:nc]))
    v = lfilter(np.atleast_1d(ma), np.atleast_1d(ar), rng.normal(size=10_000))
    model = arma(v, na, nc)
    white = model.whiten(v)[model.memory :]
    r = np.array([white[k:] @ white[: len(white) - k] for k in range(21)]) / (white @ white)
    assert np.sum(np.abs(r[1:]) > 1.96 / np.sqrt(len(white))) <= 4  # 1 of 20 expected
    assert model.is_invertible
    assert model.is_stationary
    assert model.variance == pytest.approx(1.0, abs=4 * np.sqrt(2 / 10_000))


def test_whitening_returns_the_innovations_and_colouring_undoes_it():
    e = np.random.default_rng(9).normal(size=(300, 2))
    model = Arma(np.array(AR), np.array(MA), 1.0, np.zeros((3, 3)))
    v = np.column_stack([filtered(MA, AR, column) for column in e.T])
    assert model.whiten(v) == pytest.approx(e, abs=1e-11)
    assert model.colour(e) == pytest.approx(v, abs=1e-11)
    grid = (np.arange(2048) + 0.5) / 2048 * np.pi
    impulse = filtered(MA, AR, np.r_[1.0, np.zeros(400)])
    assert np.mean(model.spectrum(grid)) == pytest.approx(float(impulse @ impulse), rel=1e-9)


def test_the_transient_of_whitening_is_over_after_its_memory():
    """A stretch cut out of its past is whitened up to c^k of what its first samples lack."""
    v = disturbance(500, 13, (1.0, -0.5), (1.0, 0.9))
    model = Arma(np.array([1.0, -0.5]), np.array([1.0, 0.9]), 1.0, np.zeros((2, 2)))
    gap = np.abs(model.whiten(v)[200:] - model.whiten(v[200:]))
    assert model.memory == 1 + 44  # 0.9^44 = 0.0097
    assert gap[model.memory] < 0.01 * gap[0] * 1.5  # the first samples lack ar's reach as well
    assert gap[model.memory] > 0.001 * gap[0]


def test_a_filter_that_would_be_unstable_is_refused():
    model = Arma(np.array([1.0]), np.array([1.0, -1.25]), 1.0, np.zeros((1, 1)))
    assert not model.is_invertible
    with pytest.raises(ModelError, match="root of modulus 1.25.*reflect it"):
        model.whiten(np.ones(3))


def test_orders_zero_are_the_variance():
    v = np.random.default_rng(10).normal(size=100)
    model = arma(v, 0, 0)
    assert model.variance == pytest.approx(float(np.mean(v**2)))
    assert model.whiten(v) == pytest.approx(v)
    assert model.theta.shape == (0,)
    assert model.is_converged


def test_records_are_one_noise_without_being_joined():
    """The information of stretches adds: two halves give the covariance of the whole."""
    v = disturbance(8000, 11)
    whole, halves = arma(v, 2, 1), arma([v[:4000], v[4000:]], 2, 1)
    assert halves.covariance == pytest.approx(whole.covariance, rel=0.05)
    assert np.all(np.abs(halves.theta - whole.theta) < 0.3 * whole.std_errors)


def test_a_previous_estimate_starts_the_next():
    v = disturbance(3000, 12)
    first = arma(v, 2, 1)
    assert first.fit is not None
    again = arma(v, 2, 1, start=first, discard=first.fit.discarded[0])
    assert again.fit is not None
    assert again.fit.start == "the model given"
    assert again.fit.iterations <= 2
    assert np.all(np.abs(again.theta - first.theta) < 1e-3 * first.std_errors)


def test_a_start_with_a_root_outside_the_circle_is_reflected_and_said():
    """Noise differenced twice has its moving average's roots on the circle."""
    v = np.diff(np.random.default_rng(1).normal(size=3000), 2)
    model = arma(v, 0, 2, throw=False)
    assert any("root of C reflected" in note for note in model.notes)
    assert model.is_invertible


@pytest.mark.parametrize("orders", [(0, 0), (1, 0), (1, 1), (2, 1)])
def test_the_order_is_chosen_by_bic(orders):
    """Consistent: the share of wrong choices vanishes with N (Hannan and Rissanen 1982)."""
    ar = {0: (1.0,), 1: (1.0, -0.8), 2: AR}[orders[0]]
    ma = {0: (1.0,), 1: MA}[orders[1]]
    for seed in range(3):
        model = arma_order(disturbance(5000, 20 + seed, ar, ma))
        assert (len(model.ar) - 1, len(model.ma) - 1) == orders


def test_residuals_that_carry_no_model_are_refused():
    with pytest.raises(DataError, match="y is constant"):
        arma(np.zeros(100), 1, 1)
    with pytest.raises(DataError, match="are too few for 4"):
        arma(np.random.default_rng(0).normal(size=6), 2, 2)
    with pytest.raises(ModelError, match="order nc = -1"):
        arma(np.random.default_rng(0).normal(size=60), 2, -1)
    with pytest.raises(DataError, match="too few to choose"):
        arma_order(np.random.default_rng(0).normal(size=12))
