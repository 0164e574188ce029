"""What naming the causes leaves, and the bias that leaving them out had given."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from casid.data.files import write_json
from casid.diagnosis.verdict.remainder import Moved, NoiseFound, moved_parameters, what_remains
from casid.estimation.estimate import Estimated
from tests.support import sample_parts, samples

PART = {
    "baseline_rmse": {"phi": 3.0, "gyro": 1.0},
    "extended_rmse": {"phi": 1.0, "gyro": 0.6},
    "noise_floor": {"phi": 1.0, "gyro": 0.5},
}


def test_the_excess_is_the_squared_error_above_the_floor():
    """(9 - 1) + (4 - 1) = 11 before; 0 + (1.44 - 1) = 0.44 after: 4 % is left."""
    r = what_remains([("offset", "torque", 0.75), ("hold", "a", 0.25)], PART, p_value=0.5)
    assert r.unexplained == pytest.approx(0.04)
    assert [e.share for e in r.explained] == pytest.approx([0.72, 0.24])
    assert r.unexplained + sum(e.share for e in r.explained) == pytest.approx(1.0)
    assert r.over_floor == pytest.approx({"phi": 1.0, "gyro": 1.2})
    assert "explain 96 % of the excess misfit" in r.sentence
    assert "gyro ends at 1.2 times its noise floor" in r.sentence


def test_shares_do_not_depend_on_the_outputs_units():
    in_degrees = {k: {o: v * 57.3 for o, v in part.items()} for k, part in PART.items()}
    r = what_remains([], in_degrees)
    assert r.unexplained == pytest.approx(what_remains([], PART).unexplained)


@pytest.mark.parametrize(
    ("p_value", "after", "words"),
    [
        (None, 1.01, "No error remains above the floor"),
        (0.5, 1.01, "The remainder is consistent with noise"),
        (1e-6, 1.01, "part of the misfit is unexplained"),
        (0.5, 1.6, "An error above the floor remains that no effect of the catalogue explains"),
        (None, 1.6, "An error above the floor remains."),
    ],
)
def test_the_sentence_says_what_the_numbers_say(p_value, after, words):
    part = {
        "baseline_rmse": {"gyro": 3.0},
        "extended_rmse": {"gyro": after},
        "noise_floor": {"gyro": 1.0},
    }
    assert words in what_remains([("offset", "torque", 1.0)], part, p_value=p_value).sentence


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (1.07, 1.08, "Including the named cause brings the errors no nearer to their noise floors"),
        (2.0, 2.5, "no nearer to their noise floors: the error of x ends at 2.5 times its noise"),
        (2.0, 1.999, "The named cause explains less than 0.5 % of the excess misfit"),
        (2.0, 1.001, "The named cause explains more than 99.5 % of the excess misfit"),
        (2.0, 0.9, "The named cause explains all of the excess misfit, and the error of x ends at"),
        (2.0, 1.0, "ends at its noise floor"),
        (0.9, 0.8, "No error is above its noise floor without the named cause, which the course"),
    ],
)
def test_a_share_of_nothing_is_no_number(before: float, after: float, words: str) -> None:
    """Held out, an error may rise by chance, or be at its floor from the first: no 0 or 100 %."""
    part = {"baseline_rmse": {"x": before}, "extended_rmse": {"x": after}}
    part["noise_floor"] = {"x": 1.0}
    said = what_remains([("offset", "torque", 1.0)], part, p_value=0.5).sentence
    assert words in said
    assert " 0 %" not in said
    assert "100 %" not in said


@pytest.mark.parametrize(("chance", "is_more"), [(1.7, False), (1.5, True)])
def test_an_error_that_chance_gives_is_no_unexplained_one(chance: float, is_more: bool) -> None:
    part = {"baseline_rmse": {"x": 3.0}, "extended_rmse": {"x": 1.6}, "noise_floor": {"x": 1.0}}
    r = what_remains(
        [("offset", "torque", 1.0)], part, p_value=0.5, noise=NoiseFound(chance={"x": chance})
    )
    assert ("no effect of the catalogue explains" in r.sentence) == is_more
    said = "An error there of up to 1.7 times the floor may be due to chance and to the errors of"
    assert (said in r.sentence) != is_more
    assert ("The remainder of the fitted part is consistent with noise" in r.sentence) != is_more


@pytest.mark.parametrize(
    ("chance", "size", "is_short"),
    [(1.3, "up to 1.3", False), (4.2, "up to 4.2", True), (1.4e4, "more than 100", True)],
)
def test_a_held_out_part_that_tells_little_is_said_to(
    chance: float, size: str, is_short: bool
) -> None:
    part = {"baseline_rmse": {"x": 3.0}, "extended_rmse": {"x": 1.2}, "noise_floor": {"x": 1.0}}
    noise = NoiseFound(chance={"x": chance})
    r = what_remains([("offset", "torque", 1.0)], part, p_value=0.5, noise=noise)
    assert f"{size} times the floor" in r.sentence
    assert "in all but one record of 1000" in r.sentence
    assert ("The held-out part tells little" in r.sentence) == is_short


def test_a_residual_that_is_not_random_is_not_said_to_be_larger_than_the_noise_where_it_is_not():
    part = {"baseline_rmse": {"x": 0.6}, "noise_floor": {"x": 1.0}}
    said = what_remains([], part, p_value=1e-6).sentence
    assert "The remainder is no larger than the noise, but it is not random" in said
    assert "more than noise" not in said


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        (NoiseFound({"x": "4 of 20 lags"}), "as noise of measured inputs makes it"),
        (NoiseFound({"x": "4 of 20 lags"}, is_random=True), "as the disturbance makes it"),
        (
            NoiseFound({"x": "4 of 20 lags"}, is_of_inputs=False),
            "autocorrelated (x: 4 of 20 lags).",
        ),
    ],
)
def test_inputs_without_noise_do_not_colour_a_residual(noise: NoiseFound, said: str) -> None:
    part = {"baseline_rmse": {"x": 1.0}, "noise_floor": {"x": 1.0}}
    assert said in what_remains([], part, p_value=0.5, noise=noise).sentence


def test_what_a_random_disturbance_leaves_is_no_unexplained_misfit():
    part = {"baseline_rmse": {"gyro": 1.6}, "noise_floor": {"gyro": 1.0}}
    r = what_remains([], part, p_value=1e-6, noise=NoiseFound(is_random=True))
    assert "The remainder is a random disturbance" in r.sentence
    assert "unexplained" not in r.sentence


def test_a_disturbance_beside_a_model_that_explains_nothing_may_as_well_be_its_error() -> None:
    part = {"baseline_rmse": {"gyro": 1.6}, "noise_floor": {"gyro": 1.0}}
    r = what_remains([], part, p_value=1e-6, noise=NoiseFound(is_random=True, is_poor=True))
    assert "but so would an error of the model" in r.sentence
    assert "not an error of the model" not in r.sentence


@pytest.mark.parametrize(
    ("held", "is_said"), [({}, False), ({"y": 1.4}, False), ({"y": 3.7}, True)]
)
def test_a_fitted_part_that_is_explained_does_not_speak_for_a_held_out_one_that_is_not(
    held: dict[str, float], is_said: bool
) -> None:
    """A converter's mode and a knock fitted to one step, and nearly four times the floor later."""
    part = {
        "baseline_rmse": {"y": 0.161},
        "extended_rmse": {"y": 0.069},
        "noise_floor": {"y": 0.069},
    }
    noise = NoiseFound(is_random=True, held_out=held)
    r = what_remains([("missing_mode", "current", 1.0)], part, p_value=0.013, noise=noise)
    assert ("held out, the error of y is 3.7 times its noise floor" in r.sentence) is is_said
    assert ("not an error of the model" in r.sentence) is not is_said


@pytest.mark.parametrize("is_predicted", [False, True])
def test_a_large_error_that_its_past_predicts_is_the_disturbance(*, is_predicted: bool) -> None:
    part = {"baseline_rmse": {"y": 1.0}, "extended_rmse": {}, "noise_floor": {"y": 1.0}}
    noise = NoiseFound(is_random=True, held_out={"y": 3.2}, is_predicted=is_predicted)
    r = what_remains([], part, p_value=0.5, noise=noise)
    assert ("so the disturbance makes it" in r.sentence) is is_predicted
    assert ("or the model does not hold there" in r.sentence) is not is_predicted


def test_an_error_below_the_floor_is_no_negative_excess():
    part = {
        "baseline_rmse": {"gyro": 0.9},
        "extended_rmse": {},
        "noise_floor": {"gyro": 1.0},
    }
    r = what_remains([], part)
    assert r.unexplained == 0.0
    assert "No cause is named" in r.sentence


@pytest.mark.parametrize("floor", [{}, {"gyro": 0.0}])
def test_without_a_floor_nothing_is_said(floor):
    assert what_remains([], {"baseline_rmse": {"gyro": 1.0}, "noise_floor": floor}) is None


def test_least_squares_without_a_regressor_is_biased_by_the_regression_on_those_kept():
    """An omitted variable adds (Z'Z)^-1 Z'x g to the estimate, which `bias` shows.

    y = 2 z + 3 x + e with x = 0.5 z + v: without x, z takes 2 + 3 * 0.5. Tolerance: 4 standard
    errors of the bias over 20 000 samples, 3 sd(v) / sqrt(N) / sd(z) = 0.02, times 4.
    """
    rng = np.random.default_rng(3)
    z = rng.standard_normal(20_000)
    x = 0.5 * z + rng.standard_normal(z.size)
    y = 2 * z + 3 * x + 0.1 * rng.standard_normal(z.size)
    short = float(z @ y / (z @ z))
    full = np.linalg.lstsq(np.column_stack([z, x]), y, rcond=None)[0]
    m = Moved("b", "1", short, float(full[0]), 0.1 / math.sqrt(z.size))
    assert m.bias == pytest.approx(1.5, abs=0.085)
    assert m.shift < -1000  # hopelessly outside of what the full fit thinks possible


def test_a_move_within_its_error_is_not_listed_and_known_parameters_never_are():
    d = samples.deficient(N=100)
    extended = d.extended
    moved = moved_parameters(d.baseline, extended)
    assert [m.name for m in moved] == ["d", "k", "s"]  # the furthest first; I known, z_s at bound
    assert moved[0].bias == pytest.approx(0.33 - 0.081)
    assert moved[0].shift == pytest.approx((0.081 - 0.33) / 0.004)
    assert moved_parameters(d.baseline, d.baseline) == ()
    assert [m.name for m in moved_parameters(d.baseline, extended, at_least=10.0)] == ["d"]


@pytest.mark.parametrize(("before", "after"), [(4.2, 0.035), (0.035, 4.2)])
def test_a_shift_is_judged_by_the_larger_of_both_errors(before: float, after: float) -> None:
    m = Moved("H_inf", "W/K", 16.25, 24.98, std_error_after=after, std_error_before=before)
    assert m.shift == pytest.approx((24.98 - 16.25) / 4.2)


def test_a_parameter_that_left_for_a_bound_is_listed_without_a_shift():
    d = samples.deficient(N=100)
    at_bound = Estimated("k", 5.0, "N m/rad", note="at lower bound")
    e = replace(d.extended, parameters=(at_bound, *d.extended.parameters[1:]))
    last = moved_parameters(d.baseline, e)[-1]
    assert (last.name, last.shift, last.bias) == ("k", None, pytest.approx(5.52))


def test_all_that_is_new_stands_in_the_json_and_the_old_names_stay(tmp_path):
    """DESIGN section 5 fixes the fields; more may be added."""
    d = samples.rich()
    path = write_json(tmp_path / "diagnosis.json", d.to_json())
    read = json.loads(path.read_text())
    assert {"schema", "problem", "verdict", "causes", "fitted", "held_out", "advice"} <= set(read)
    assert read["moved"][0] == {
        "name": "d",
        "unit": "N m s/rad",
        "before": 0.33,
        "after": 0.081,
        "std_error_before": 0.004,
        "std_error_after": 0.004,
        "bias": pytest.approx(0.249),
        "shift": pytest.approx(-62.25),
    }
    assert read["remaining"]["explained"][0]["kind"] == "quadratic_damping"
    assert read["causes"][1]["description"].startswith("It depends on p")
    assert read["causes"][1]["by_record"]["swing-10"]["h"]["value"] == 0.112
    assert read["causes"][0]["by_record"] == {}
    assert len(read["isolability"]["cosines"]) == len(sample_parts.KEYS)
    assert [i["reason"] for i in read["invisible"]] == ["structural", "practical"]
    assert read["proposals"][-1]["record_length"] is None  # never
    assert read["calibration"]["alarms"] == 6 * 2
    bare = json.loads(json.dumps(samples.deficient(N=100).to_json()))
    for name in ("remaining", "unexplained", "isolability", "calibration"):
        assert bare[name] is None
    for name in ("moved", "invisible", "proposals"):
        assert bare[name] == []
