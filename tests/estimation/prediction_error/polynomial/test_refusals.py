"""What cannot be estimated by a polynomial model is refused with place and remedy."""

from __future__ import annotations

import numpy as np
import pytest

from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    armax,
    arx,
    oe,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.records import stretches
from tests.support.polynomial_systems import record


def test_a_constant_input_is_named_with_the_direction_it_leaves_open():
    y, _, _, _ = record("ARX", 100, seed=30)
    with pytest.raises(
        IdentifiabilityError,
        match=r"excite 1 of the 2 lags that B needs: 1 u\[t-1\] - 1 u\[t-2\] = 0"
        r".*input u is constant \(2\).*richer input, or lower",
    ):
        arx(y, np.full(100, 2.0), na=1, nb=2)
    assert arx(y, np.full(100, 2.0), na=1, nb=1).n == 2  # one coefficient: an offset, and told


def test_a_sine_tells_two_coefficients_and_no_more():
    """Persistently exciting of order two (Ljung 1999, section 13.2)."""
    y, _, _, _ = record("OE", 200, seed=31)
    u = np.sin(0.3 * np.arange(200))
    oe(y, u, nb=1, nf=1, throw=False)
    with pytest.raises(IdentifiabilityError, match=r"excite 2 of the 3 lags that B and F need"):
        oe(y, u, nb=2, nf=1)


def test_two_inputs_that_are_one_cannot_be_told_apart():
    y, u, _, _ = record("ARX", 200, seed=32)
    with pytest.raises(IdentifiabilityError, match=r"1 left\[t-1\] - 0.5 right\[t-1\] = 0"):
        arx(y, {"left": u, "right": 2 * u}, na=1, nb=1)


def test_orders_too_high_for_data_without_noise_are_refused():
    y, u, _, _ = record("ARX", 200, seed=33, noise=0.0)
    refusal = "determines 5 of 6 coefficients.*Lower the orders"
    with pytest.raises(IdentifiabilityError, match=refusal):
        arx(y, u, na=3, nb=3)


def test_an_optimum_on_the_unit_circle_is_refused_with_the_polynomial():
    """An integrator with white output noise is ARMAX with A = C = 1 - q^-1."""
    rng = np.random.default_rng(34)
    u = rng.normal(size=400)
    y = 0.1 * np.r_[0.0, np.cumsum(u)[:-1]] + 0.1 * rng.normal(size=400)
    with pytest.raises(SolveError, match=r"root of C of modulus 0\.999.*unit circle.*Lower nc"):
        armax(y, u, na=1, nb=1, nc=1)
    assert not armax(y, u, na=1, nb=1, nc=1, throw=False).is_converged


BAD = [
    (dict(na=-1, nb=1), ModelError, "order na = -1: give a whole number of at least 0"),
    (dict(na=1.5, nb=1), ModelError, "order na = 1.5"),
    (dict(na=1, nb=0), ModelError, "input u has nb = 0.*leave the input out"),
    (dict(na=1, nb={"v": 1}), ModelError, "nb names v, the data have u"),
    (dict(na=1, nb=1, nk=-1), ModelError, r"order nk = -1"),
    (dict(na=1, nb=1, discard=-2), DataError, "discard = -2; give the whole number"),
    (dict(na=1, nb=1, discard=98), DataError, "2 residuals are too few for 2.*longer records"),
    (dict(na=1, nb=1, discard=100), DataError, "100 samples, but.*first 100 do not count"),
    (dict(na=1, nb=1, errors="hac"), ModelError, "errors = 'hac'; choose 'white' or 'robust'"),
    (dict(na=1, nb=1, Ts=0.0), DataError, "sample time Ts = 0.0; give"),
    (dict(na=1, nb=1, Ts="0.01"), DataError, "Ts = '0.01'; give a number of seconds above 0"),
    (dict(na=None, nb=1), ModelError, "order na = None: give a whole number of at least 0"),
    (dict(na=1, nb=1, discard="3"), DataError, "discard = '3'; give the whole number"),
    (dict(na=1, nb=1, solver=3.0), SolveError, r"a float is no solver; give Solver\('ipopt'\)"),
]


@pytest.mark.parametrize(("options", "error", "message"), BAD)
def test_impossible_requests_are_refused_with_a_mend(options, error, message):
    y, u, _, _ = record("ARX", 100, seed=35)
    with pytest.raises(error, match=message):
        arx(y, u, **options)


def test_a_record_is_refused_with_what_makes_lists_of_it():
    y, u, _, _ = record("ARX", 100, seed=36)
    held = Record({"y": y, "u": u}, {"y": "m", "u": "N"}, Ts=0.1)
    mend = (
        r"y, u = casid\.estimation\.prediction_error\.polynomial\.records\.stretches"
        r"\(record, output, inputs\)"
    )
    for given_, what in (
        (held, "a record"),
        ([held, held], "a record"),
        ([Experiment(held, {}, "first")] * 2, "a list of records"),
        (Experiment(held, {}, "first"), "a record"),
    ):
        with pytest.raises(DataError, match=f"y is {what}; give its channels.*{mend}"):
            arx(given_, na=1, nb=1)
    with pytest.raises(DataError, match=f"u is a record.*{mend}"):
        arx(y, held, na=1, nb=1)
    ys, us = stretches(held, "y", ["u"])
    model, plain = arx(ys, us, na=1, nb=1), arx(y, u, na=1, nb=1)
    np.testing.assert_array_equal(model.theta, plain.theta)
    with pytest.raises(DataError, match=mend):
        model.predict(held)
    with pytest.raises(DataError, match="y is a list that holds what is no real number; give an"):
        arx(["a", "b"], na=1)
    with pytest.raises(DataError, match="y is a NoneType that holds"):
        arx(None, na=1)
    for wrong, what in ((None, "None"), (held, "a record")):
        with pytest.raises(DataError, match=rf"u is {what}; give .* u=\{{'u': record\['u'\]\}}"):
            model.simulate(wrong)
    np.testing.assert_array_equal(model.simulate({"u": held["u"]}), model.simulate(u))
    with pytest.raises(DataError, match="u has shape"):
        model.simulate(3.0)


def test_a_solver_is_taken_by_its_name_and_a_start_that_is_none_is_refused():
    y, u, orders, _ = record("OE", 300, seed=37)
    by_name = prediction_error(y, u, orders, solver="ipopt")
    np.testing.assert_array_equal(
        by_name.theta, prediction_error(y, u, orders, solver=Solver("ipopt")).theta
    )
    with pytest.raises(ModelError, match="start is a list; give a model as prediction_error"):
        prediction_error(y, u, orders, start=[0.0])
    with pytest.raises(ModelError, match=r"orders = \(2, 2\); give Orders\(na=..,"):
        prediction_error(y, u, (2, 2))


def test_data_that_cannot_be_used_are_refused_with_place_and_mend():
    y, u, _, _ = record("ARX", 100, seed=36)
    broken = y.copy()
    broken[7] = np.nan
    with pytest.raises(DataError, match="y holds 1 samples that are not finite.* at k = 7"):
        arx(broken, u, na=1, nb=1)
    with pytest.raises(DataError, match="record 2: y holds 1.*give the parts as a list"):
        arx([y, broken], [u, u], na=1, nb=1)
    with pytest.raises(DataError, match="give u as a list of 2 entries"):
        arx([y, y], u, na=1, nb=1)
    with pytest.raises(DataError, match=r"u has shape \(99,\), y has \(100,\); cut both"):
        arx(y, u[:-1], na=1, nb=1)
    with pytest.raises(DataError, match=r"y has shape \(100, 1\); give one output"):
        arx(y[:, None], u, na=1, nb=1)
    with pytest.raises(DataError, match=r"u has shape \(2, 100\) beside 100 samples"):
        arx(y, np.stack([u, u]), na=1, nb=1)
    with pytest.raises(DataError, match="y is constant .*nothing to fit"):
        arx(np.ones(100), u, na=1, nb=1)
    with pytest.raises(DataError, match="1 residuals are too few for 5 coefficients"):
        armax(y[:3], u[:3], na=2, nb=2, nc=1)
    with pytest.raises(DataError, match="2 samples, but the predictor reaches back 2"):
        arx(y[:2], u[:2], na=2, nb=1)
    with pytest.raises(ModelError, match="every order is 0"):
        prediction_error(y, None, Orders())
    with pytest.raises(ModelError, match="without an input; give u"):
        prediction_error(y, None, Orders(na=1, nb=1))
    with pytest.raises(ModelError, match="only the product A D acts"):
        prediction_error(y, None, Orders(na=1, nd=1))
    model = arx(y, u, na=1, nb=1)
    with pytest.raises(DataError, match="inputs are wind, the model has u"):
        model.predict(y, {"wind": u})
    with pytest.raises(ModelError, match="no input to simulate from"):
        prediction_error(y, None, Orders(na=1)).simulate(u)
