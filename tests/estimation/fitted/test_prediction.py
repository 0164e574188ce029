"""With a noise model, a fitted model predicts: innovations, errors that grow, a simulation."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.identification.grey_box import Prediction, minimize_prediction_error
from casid.linear.filtering.noisy_model import White
from tests.identification.test_grey_box import A, lag_model, lag_record

TS, Q, R = 0.2, 0.5, 0.2


@pytest.fixture(scope="module")
def prediction() -> Prediction:
    noise = [White("w", 0.7), White("y", 0.4)]
    return minimize_prediction_error(lag_model(), [lag_record(3, N=2000)], noise)


def test_residuals_one_sample_ahead_are_the_innovations_of_the_fit(prediction):
    found = prediction.model.residuals(lag_record(3, N=2000), horizon=1)
    innovations = prediction.innovations(0)[:, 0]
    assert found["y"] == pytest.approx(innovations, abs=1e-12)


def test_errors_grow_with_the_horizon_as_the_covariance_of_the_state_does(prediction):
    """P[k+1] = F^2 P[k] + q from the predictor's P; the error of y has variance P[k] + r.

    Anderson and Moore 1979, section 4.1, at the true parameters; 3 standard errors of a variance
    from 2000 correlated samples are about 15 per cent.
    """
    F = np.exp(-A * TS)
    q = Q * (1 - F**2) / (2 * A)
    P = (F**2 * R + q - R + np.sqrt((F**2 * R + q - R) ** 2 + 4 * q * R)) / 2
    record = lag_record(3, N=2000)
    for horizon in range(1, 6):
        error = prediction.model.residuals(record, horizon)["y"][10:]
        assert np.var(error) == pytest.approx(P + R, rel=0.15)
        P = F**2 * P + q


def test_a_prediction_from_the_first_sample_is_the_simulation(prediction):
    """No output has come in yet; RK4 steps of a tenth of the time constant agree to 1e-6."""
    record = lag_record(3, N=2000)
    far = prediction.model.predict(record, 3000)["y"]
    assert far == pytest.approx(prediction.model.simulate(record)["y"], abs=1e-5)


def test_a_record_that_was_not_fitted_starts_from_a_state_of_its_own(prediction):
    """Cut in two, its second part is predicted as before: a stable predictor forgets its start."""
    model, other = prediction.model, lag_record(8)
    best = model.residuals(other, horizon=1)["y"]
    assert np.std(best) == pytest.approx(np.sqrt(R + 0.1), rel=0.2)
    cut = model.predict(other.between(20.0, 100.0), 1)
    assert cut.t0 == pytest.approx(20.0)
    assert cut["y"][60:] == pytest.approx(model.predict(other, 1)["y"][160:501], abs=1e-6)


def test_a_predicting_model_is_saved_with_its_noise(prediction, tmp_path):
    record = lag_record(8)
    again = casid.load(prediction.model.save(tmp_path / "lag.casid"))
    assert again.noise.sources == prediction.model.noise.sources
    before = prediction.model.predict(record, 2)["y"]
    assert np.array_equal(again.predict(record, 2)["y"], before)
