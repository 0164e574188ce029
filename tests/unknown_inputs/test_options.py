"""The options for an unknown input, Linder (2017) 7.3, on the linear pendulum of Table 7.2."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

import casid
from casid.errors import DataError, ModelError
from casid.estimation.prediction_error.input_models import as_known, as_random_walk
from casid.linear.filtering.noisy_model import White
from casid.linear.linear_model import linearise
from casid.unknown_inputs.option_comparison import OptionRow, UnknownInputComparison
from casid.unknown_inputs.options import (
    AS_EXACT,
    KNOWN,
    OPTIONS,
    PREDICTION,
    SHAPED,
    SIMULATION,
    WALK,
    WALK_INTEGRAL,
    WITH_ERRORS,
    compare_unknown_input_options,
)
from problems.pendulum import direct_model
from tests.support.linear_pendulum import LAG, TRUTH, Z_G, Z_S, G, M, simulate

Array = np.ndarray[Any, Any]


@cache
def on_telegraph() -> UnknownInputComparison:
    """The cart follows a telegraph through a lag: smooth between samples, no random walk."""
    record = simulate(duration=60.0, Ts=0.02, seed=3, noise_a=0.5)
    return compare_unknown_input_options(
        direct_model(), record, exact="a_y_true", integral="v_y", truth=TRUTH
    )


@cache
def on_walk() -> UnknownInputComparison:
    """The cart's acceleration is a random walk, as options (B) assume."""
    record = simulate(duration=60.0, Ts=0.01, seed=4, walk=2.0, noise_a=0.5)
    return compare_unknown_input_options(
        direct_model(),
        record,
        integral="v_y",
        truth=TRUTH,
        options=[WITH_ERRORS, WALK, WALK_INTEGRAL, PREDICTION],
    )


def z_scores(row: OptionRow) -> Array:
    """Errors in standard errors."""
    return np.array([row.error[n] / row.std_error(n) for n in row.parameters])


# -- the table ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_call_gives_one_row_an_option_and_one_table() -> None:
    found = on_telegraph()
    assert tuple(r.option for r in found.rows) == OPTIONS
    assert "".join(r.letter for r in found.rows) == "AAABBBCC"
    assert found.parameters == ("k", "d", "I_x")
    text = str(found)
    for row in found.rows:
        assert f"({row.letter}) {row.option}: {row.remark}" in text
        assert row.estimate is not None
        assert row.estimate.is_converged
    assert "truth k = 10.39, d = 0.1067, I_x = 0.1385" in text
    assert "k [N m/rad]" in text
    table = text.split("\n\n(A)")[0]
    assert max(len(line) for line in table.splitlines()) <= 110
    heads = [line.split()[1:] for line in table.splitlines() if line.startswith("option")]
    for part in ("k", "error", "gyro", "accel", "a_y", "v_y"):  # no column is lost
        assert any(part in head for head in heads)
    page = found._repr_html_()
    assert page.count("<tr>") == len(OPTIONS) + 1
    assert "errors in variables" in page
    assert repr(found).endswith("a_y: 8 options>")
    with pytest.raises(KeyError, match="there are known"):
        found["guess"]


@pytest.mark.slow
def test_remarks_say_what_is_consistent_and_why() -> None:
    found = on_telegraph()
    assert [r.option for r in found.rows if r.is_consistent] == [
        KNOWN,
        WITH_ERRORS,
        WALK,
        WALK_INTEGRAL,
        SHAPED,
    ]
    assert "errors in variables" in found[AS_EXACT].remark
    assert "direct term (Linder 2017, (7.31))" in found[PREDICTION].remark
    # A telegraph is no random walk, and the innovations show it; an exact input leaves them white.
    assert "accel leaves coloured residuals" in found[WALK].remark
    assert "coloured" not in found[KNOWN].remark
    assert "coloured" not in found[SHAPED].remark
    assert "coloured" not in on_walk()[WALK].remark


# -- what the options are worth -------------------------------------------------------------------


def test_known_input_gives_the_truth_and_noise_is_all_that_is_left() -> None:
    row = on_telegraph()[KNOWN]
    assert np.all(np.abs(z_scores(row)) < 4)
    # rms of N = 3000 normals: a relative standard deviation of 1 / sqrt(2 N) = 1.3 %.
    for output in ("gyro", "accel"):
        assert row.prediction_rms[output] == pytest.approx(0.01, rel=4 * 0.013)


@pytest.mark.parametrize("option", [WITH_ERRORS, WALK, WALK_INTEGRAL])
def test_random_walk_is_consistent_where_the_input_is_one(option: str) -> None:
    row = on_walk()[option]
    assert np.all(np.abs(z_scores(row)) < 4)


def test_shaped_noise_is_consistent_for_a_telegraph_through_a_lag() -> None:
    """Its spectrum is that of two real poles: 2 / s from the flips, 1 / LAG from the cart.

    Second moments are all that the criterion sees, so a distribution far from normal does no harm.
    """
    row = on_telegraph()[SHAPED]
    assert row.estimate is not None
    assert np.all(np.abs(z_scores(row)) < 4)
    for name, value in (
        ("w of a_y", np.sqrt(2 / LAG)),
        ("zeta of a_y", (2 + 1 / LAG) / (2 * np.sqrt(2 / LAG))),
    ):
        found = row.estimate.parameter(name)
        assert found.std_error is not None
        assert abs(found.value - value) < 4 * found.std_error


def test_what_is_measured_beside_the_walk_lowers_the_errors() -> None:
    """More information, smaller standard errors; the tolerance is for their own estimation."""
    found = on_walk()
    for name in found.parameters:
        for more in (WITH_ERRORS, WALK_INTEGRAL):
            assert found[more].std_error(name) < 1.05 * found[WALK].std_error(name)
    assert found[WALK_INTEGRAL].std_error("k") < 0.5 * found[WALK].std_error("k")


def test_exact_input_is_the_bound_for_the_others() -> None:
    found = on_telegraph()
    for row in found.rows[1:]:
        for name in found.parameters:
            assert row.std_error(name) > found[KNOWN].std_error(name)


def test_elimination_is_the_walk_whose_steps_are_large() -> None:
    """As q grows the accelerometer tells a_y at once: both predictors use the same, (7.24).

    Large steps: a_y moves by 2 sqrt(0.01) = 0.2 a sample, twenty times the accelerometer's noise,
    so that what the walk knows beforehand has a weight of 1/400: a fraction of a standard error.
    """
    found = on_walk()
    for name in found.parameters:
        gap = found[PREDICTION].value(name) - found[WALK].value(name)
        assert abs(gap) < found[WALK].std_error(name)


# -- the bias that theory predicts ----------------------------------------------------------------


def limit_with_neglected_noise(record: casid.Record, noise_a: float, noise: float) -> Array:
    """Where output error goes that takes y = u + e for u: the minimum of its expected criterion.

    With one variance for each output, the likelihood is minimised by sum_i log S_i, S_i the mean of
    |G0 - G|^2 |U|^2 + |G|^2 lambda_e + lambda_i over frequency (Parseval); G by straight lines
    between samples. Own formulas, from (7.16) and the record's own spectrum.
    """
    Ts, N = record.Ts, record.N
    # Periodic responses stand for the record's: its ends weigh as 2 I_1 / d = 2.7 s of 600 s.
    U2 = np.abs(np.fft.rfft(record["a_y_true"])) ** 2 / N
    z = np.exp(2j * np.pi * np.arange(len(U2)) / N)
    weight = np.full(len(U2), 2.0)
    weight[0] = 1.0
    S = M * Z_G

    def response(p: Array) -> Array:
        k, d, I_x = p
        I_1 = I_x + M * Z_G**2
        block = np.zeros((4, 4))
        block[:2, :2] = np.array([[0.0, 1.0], [-(k + S * G) / I_1, -d / I_1]]) * Ts
        block[1, 2], block[2, 3] = S / I_1 * Ts, 1.0
        e = expm(block)
        x = np.linalg.solve(
            z[:, None, None] * np.eye(2) - e[:2, :2],
            ((z - 1)[:, None] * e[:2, 3] + e[:2, 2])[:, :, None],
        )[:, :, 0]
        p_dot = (-(k + S * G) * x[:, 0] - d * x[:, 1] + S) / I_1
        return np.stack([x[:, 1], Z_S * p_dot + G * x[:, 0] - 1.0])

    truth = np.array(list(TRUTH.values()))
    G0 = response(truth)

    def criterion(scaled: Array) -> float:
        now = response(scaled * truth)
        power = np.abs(G0 - now) ** 2 * U2 + np.abs(now) ** 2 * noise_a**2
        return float(np.sum(np.log(power @ weight / N + noise**2)))

    options = {"xatol": 1e-8, "fatol": 1e-13, "maxiter": 4000}
    found = minimize(criterion, np.ones(3), method="Nelder-Mead", options=options)
    return np.asarray(found.x * truth)


@pytest.mark.slow
def test_input_noise_taken_as_exact_biases_by_the_amount_predicted() -> None:
    """The estimate is at its predicted limit, not at the truth, and far from it."""
    noise_a = 1.0
    record = simulate(duration=600.0, Ts=0.02, seed=5, noise_a=noise_a)
    found = compare_unknown_input_options(direct_model(), record, truth=TRUTH, options=[AS_EXACT])
    row = found[AS_EXACT]
    limit = limit_with_neglected_noise(record, noise_a, 0.01)
    errors = np.array([row.std_error(n) for n in row.parameters])
    values = np.array([row.value(n) for n in row.parameters])
    assert np.all(np.abs(values - limit) < 4 * errors)
    assert np.max(np.abs(limit - list(TRUTH.values())) / errors) > 8


# -- the models -----------------------------------------------------------------------------------


def test_random_walk_puts_an_integrator_before_the_model() -> None:
    """From the noise to every output: the direct model's transfer function over s."""
    values = {"k": 10.0, "d": 0.1, "I_x": 0.14}
    model, rate = as_random_walk(direct_model(), "a_y", measured=True, integral="v_y")
    walk, direct = linearise(model), linearise(direct_model())
    assert walk.outputs == ("gyro", "accel", "a_y", "v_y")
    j = walk.inputs.index(rate)
    for s in (0.3 + 1j, 2.0 - 5j):

        def response(linear: Any, column: int, at: complex = s) -> Array:
            A, B, C, D = linear.matrices(values)
            return np.asarray(C @ np.linalg.solve(at * np.eye(len(A)) - A, B) + D)[:, column]

        both = response(walk, j)
        np.testing.assert_allclose(both[:2], response(direct, 0) / s, rtol=1e-12)
        np.testing.assert_allclose(both[2:], [1 / s, 1 / s**2], rtol=1e-12)
    assert model.outputs["v_y"][1] == "m/s"
    assert model.inputs[rate].unit == "m/s^3"


def test_known_input_changes_nothing_but_the_input_s_kind() -> None:
    known, values = as_known(direct_model(), "a_y"), {"k": 10.0, "d": 0.1, "I_x": 0.14}
    assert known.inputs["a_y"].kind == "known"
    pairs = zip(
        linearise(known).matrices(values), linearise(direct_model()).matrices(values), strict=True
    )
    for got, expected in pairs:
        np.testing.assert_array_equal(got, expected)


# -- other models, other failures -----------------------------------------------------------------


def mass() -> casid.Model:
    """A mass on a spring, pushed by an unknown force; position and acceleration measured."""
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.unknown_input("push", "N")
    mass_, d, k = (
        m.parameter("mass", "kg", start=1.5, lower=0.1),
        m.parameter("d", "N s/m", start=1.0, lower=0.0),
        m.parameter("k", "N/m", start=40.0, lower=0.0),
    )
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass_, terms=[-k * x, -d * v, F])
    m.output("position", x, "m")
    m.output("accelerometer", m.der(v), "m/s^2")
    return m


def pushed() -> tuple[casid.Record, dict[str, float]]:
    from tests.support.truth import mass_spring_damper

    made = mass_spring_damper(seed=2, duration=60.0, Ts=0.02, signal="multisine", force_noise=0.3)
    noise = np.random.default_rng(1).standard_normal(len(made.columns["t"]))
    record = casid.Record(
        {
            "load cell": made.columns["force"],
            "true force": made.clean["force"],
            "position": made.columns["position"],
            "accelerometer": made.clean["acceleration"] + 0.02 * noise,
        },
        {"load cell": "N", "true force": "N", "position": "m", "accelerometer": "m/s^2"},
        Ts=0.02,
        name="pushed",
    )
    return record, {"mass": made.truth["m"], "d": made.truth["d"], "k": made.truth["k"]}


def test_any_model_will_do_and_an_option_that_fails_says_why() -> None:
    """Without a force measured, only ratios to the mass are seen (7.1): the rows say so."""
    record, truth = pushed()
    found = compare_unknown_input_options(
        mass(),
        record,
        measured="load cell",
        truth=truth,
        noise={"load cell": 0.3},
        options=[AS_EXACT, WITH_ERRORS, WALK],
    )
    failed = found[WALK]
    assert failed.estimate is None
    assert failed.remark.startswith("failed: mass: rank")
    assert "mass and k and d" in failed.remark or "not separately identifiable" in failed.remark
    assert "give one of them a known value" in failed.remark
    assert "--" in str(found)
    assert np.isnan(failed.value("k"))
    assert np.isnan(failed.std_error("k"))
    smoothed = found[WITH_ERRORS]
    assert abs(smoothed.error["k"]) < 0.05 * truth["k"]
    assert found.outputs == ("position", "accelerometer", "push")


def test_elimination_with_an_output_that_does_not_feel_the_input_keeps_its_row() -> None:
    record = simulate(duration=10.0, Ts=0.02, seed=1)
    found = compare_unknown_input_options(
        direct_model(), record, using="gyro", options=[SIMULATION, PREDICTION]
    )
    for row in found.rows:
        assert row.estimate is None
        assert "eliminated with an output that responds to it" in row.remark


def test_what_cannot_be_compared_is_refused() -> None:
    record = simulate(duration=2.0, Ts=0.02, seed=1)
    direct = direct_model()
    with pytest.raises(DataError, match="no channel 'speed' for integral; it has gyro"):
        compare_unknown_input_options(direct, record, integral="speed")
    with pytest.raises(DataError, match="no option 'guess'; there are known"):
        compare_unknown_input_options(direct, record, options=["guess"])
    with pytest.raises(DataError, match="needs a channel: give exact='name of the channel'"):
        compare_unknown_input_options(direct, record, options=[KNOWN])
    sizes: Any = [White("gyro", 0.01)]
    with pytest.raises(DataError, match=r"noise is a list; give a mapping .*\{'gyro': 0.01\}"):
        compare_unknown_input_options(direct, record, noise=sizes)
    with pytest.raises(DataError, match="noise names 'gyr', which .*; there are gyro, accel and"):
        compare_unknown_input_options(direct, record, noise={"gyr": 0.01})
    with pytest.raises(ModelError, match="'a_z' is not an unknown input; it has a_y"):
        compare_unknown_input_options(direct, record, unknown="a_z")
    with pytest.raises(DataError, match="needs a channel: give exact='name of the channel'"):
        compare_unknown_input_options(direct, record, options=KNOWN)
    indirect = direct.eliminate("a_y", using="accel")
    with pytest.raises(ModelError, match="has no unknown input to.*give the direct model"):
        compare_unknown_input_options(indirect, record)
    several = direct_model()
    several.unknown_input("wind", "N m")
    with pytest.raises(ModelError, match="several unknown inputs.*say which with unknown="):
        compare_unknown_input_options(several, record)
    with pytest.raises(ModelError, match="using='gyros' is not an output; name one of gyro, accel"):
        compare_unknown_input_options(direct, record, using="gyros")


def test_a_model_whose_outputs_do_not_feel_the_input_is_compared_without_elimination() -> None:
    """A lag behind a random walk, of which the position alone is seen: the walk's own structure."""
    rng = np.random.default_rng(4)
    blind = casid.Model("blind")
    x = blind.state("x", "m")
    a = blind.parameter("a", "1/s", start=1.0, lower=0.01)
    blind.derivative(x, blind.unknown_input("w", "m/s") - a * x)
    blind.output("y", x, "m")
    Ts, w, y = 0.05, np.cumsum(0.2 * rng.standard_normal(2000)), np.zeros(2000)
    for t in range(1999):
        y[t + 1] = np.exp(-2.0 * Ts) * y[t] + (1 - np.exp(-2.0 * Ts)) / 2.0 * w[t]
    record = casid.Record({"y": y + 0.01 * rng.standard_normal(2000)}, {"y": "m"}, Ts=Ts)
    mend = r"leave the options \(C\) out, options=\['random walk', 'shaped noise'\]"
    with pytest.raises(ModelError, match=f"w acts on no output at once.*{mend}"):
        compare_unknown_input_options(blind, record)
    with pytest.raises(ModelError, match=mend):
        compare_unknown_input_options(blind, record, options=PREDICTION)
    found = compare_unknown_input_options(blind, record, options=[WALK], truth={"a": 2.0})
    assert abs(z_scores(found[WALK])[0]) < 4


def test_process_noise_can_be_common_to_all_options() -> None:
    """White torque in the truth: the option that has it finds its size."""
    record = simulate(duration=60.0, Ts=0.02, seed=8, torque_sd=0.05)
    found = compare_unknown_input_options(
        direct_model(),
        record,
        exact="a_y_true",
        process=White("torque", 0.02, held=True),
        truth=TRUTH,
        options=[KNOWN],
    )
    row = found[KNOWN]
    assert row.estimate is not None
    assert np.all(np.abs(z_scores(row)) < 4)
    # Relative standard deviation of a variance from N normals: sqrt(2 / N) = 2.6 %, and the sensors
    # leave part of each torque in doubt.
    assert row.estimate["var(torque)"] == pytest.approx(0.05**2, rel=0.2)
