"""Verdicts of estimates and studies: what spoils the numbers is said before they are used."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from casid.estimation.estimate import Agreement, Identifiability
from casid.estimation.whiteness import Whiteness
from casid.model.quantities import (
    growth_text,
    instant_text,
    quantity_text,
    quantity_texts,
    span_text,
    unit_text,
    while_text,
)
from casid.report.verdicts import judged_estimate, judged_study
from tests.report.golden_results import monte_carlo
from tests.support import samples


def good():
    """A fit of 97 %, white, with no parameter at its bound."""
    e = samples.estimate(rmse=0.0101, held_out=0.0102)
    return replace(e, parameters=tuple(p for p in e.parameters if not p.note))


def fit_of(per_cent: float, outside: int = 2) -> Agreement:
    white = {"gyro": samples.whiteness_of(outside)}
    return Agreement({"a": {"gyro": 0.1}}, {"a": {"gyro": per_cent}}, white)


def test_a_white_residual_and_a_good_fit_can_be_used():
    judged = judged_estimate(good())
    assert (judged.word, judged.look) == ("usable", "adequate")
    assert "error bars can be used" in judged.sentence


@pytest.mark.parametrize(
    ("change", "look", "words"),
    [
        ({"fit": fit_of(60.0, 17)}, "undecided", "60 %. The residual is autocorrelated (gyro: 17"),
        ({"fit": fit_of(60.0, 17)}, "undecided", "The fit is below 90 %"),
        ({"fit": fit_of(60.0)}, "adequate", "The rest is consistent with white noise"),
        ({"fit": fit_of(12.0)}, "deficient", "next to nothing of gyro (12 %)"),
        (
            {"identifiability": Identifiability(2, 3, 0.0, "k and d")},
            "deficient",
            "2 of 3 unknowns",
        ),
        (
            {"identifiability": Identifiability(2, 3, 0.0, "tau does not move any output")},
            "deficient",
            "2 of 3 unknowns; tau does not move any output.",
        ),
        ({"suspects": ("gyro has the wrong sign",)}, "deficient", "Gyro has the wrong sign."),
    ],
)
def test_what_spoils_an_estimate_is_its_verdict(change, look, words):
    """Converged or not, a fit of 60 % with a coloured residual is not green."""
    e = good()
    if "suspects" in change:
        change = {"trust": replace(e.trust, **change)}
    judged = judged_estimate(replace(e, held_out=Agreement(), **change))
    assert judged.look == look
    assert words in judged.sentence
    assert judged.advice


@pytest.mark.parametrize(
    ("rmse", "rest", "word", "said"),
    [
        # A cup cools by 15.8 K as it is fitted, and by 1.13 K more at the end that is held out.
        (3.38, 1.13, "use with care", "gyro to 78.6 % (held out)"),
        (14.2, 1.13, "do not use", "next to nothing of gyro (10 %, held out)"),
        # A held-out record that moves by more is judged by its own motion.
        (14.2, 31.6, "use with care", "gyro to 55.1 % (held out)"),
    ],
)
def test_what_was_held_out_is_judged_by_the_motion_of_the_whole_record(
    rmse: float, rest: float, word: str, said: str
) -> None:
    """100 (1 - rmse / spread), with the larger spread: by that of a rest nothing is explained."""
    coloured = {"gyro": samples.whiteness_of(17)}
    fitted = Agreement({"a": {"gyro": 1.3}}, {"a": {"gyro": 100 * (1 - 1.3 / 15.8)}}, coloured)
    held = Agreement({"a": {"gyro": rmse}}, {"a": {"gyro": 100 * (1 - rmse / rest)}})
    judged = judged_estimate(replace(good(), fit=fitted, held_out=held))
    assert judged.word == word
    assert said in judged.sentence


def test_a_residual_that_may_be_autocorrelated_is_not_called_white():
    """Of instruments and equation errors: their error bars allow for it."""
    said = {"force": Whiteness(20, 20)}
    judged = judged_estimate(replace(good(), fit=Agreement(good().rmse, good().nrmse_fit, said)))
    assert judged.look == "adequate"
    assert "autocorrelated, for which the error bars allow" in judged.sentence
    assert "white" not in judged.sentence


def test_of_few_samples_nobody_says_that_their_residual_is_white():
    """Sixteen readings of a cooling cup leave a curve that is not autocorrelated enough to show."""
    said = {"cup": Whiteness(0, 14, meaning="too few")}
    judged = judged_estimate(replace(good(), fit=Agreement(good().rmse, good().nrmse_fit, said)))
    assert judged.word == "use with care"
    assert "cup: too few samples to test whether the residual is white" in judged.sentence
    assert "white noise" not in judged.sentence
    assert "several records" in judged.advice


def determined_to(relative: float, start: float = 1.0):
    e = good()
    first, *rest = e.parameters
    poor = replace(first, std_error=relative * abs(first.value), start=start)
    return replace(e, parameters=(poor, *rest)), first.name


@pytest.mark.parametrize(
    ("relative", "start", "word"),
    [
        (0.29, 1.0, "usable"),
        (0.31, 1.0, "imprecise"),
        (2.0, 1.0, "imprecise"),
        (2.0, 0.0, "usable"),
    ],
)
def test_a_value_with_an_error_bar_of_a_third_is_imprecise(relative, start, word):
    """The limit is that of practical identifiability; what starts at zero, an offset, may be it."""
    e, name = determined_to(relative, start)
    judged = judged_estimate(e)
    assert judged.word == word
    assert (f"Poorly determined: {name}" in judged.sentence) == (word == "imprecise")
    assert (f"--estimate {name}" in judged.advice) == (word == "imprecise")


def test_a_fit_that_did_not_converge_is_not_to_be_used():
    e = good()
    judged = judged_estimate(replace(e, solver=replace(e.solver, is_converged=False)))
    assert judged.look == "deficient"
    assert "no optimum" in judged.sentence


def test_a_parameter_at_its_bound_is_said_to_be_there():
    judged = judged_estimate(samples.estimate(rmse=0.0101, held_out=0.0102))
    assert "z_s ended at a bound" in judged.sentence


def test_a_study_says_whether_the_error_bars_keep_their_promise():
    study = monte_carlo()
    biased = judged_study(study)
    assert biased.look == "deficient"
    assert "k" in biased.sentence
    good = [replace(p, mean=p.truth, covered=round(0.95 * p.intervals)) for p in study.parameters]
    few = judged_study(replace(study, parameters=tuple(replace(p, n=20) for p in good)))
    assert few.look == "undecided"
    assert "--runs 203" in few.advice
    many = [replace(p, n=1000, intervals=1000, covered=950) for p in good]
    assert judged_study(replace(study, parameters=tuple(many))).look == "adequate"
    for spreads, word in ((0.3, "reliable"), (0.5, "not reliable")):  # cost 1.0 and 2.9 points
        moved = [
            p if p.truth is None else replace(p, mean=p.truth + spreads * p.spread) for p in many
        ]
        said = judged_study(replace(study, parameters=tuple(moved)))
        assert said.word == word
        assert ("small beside the spread" in said.sentence) == (word == "reliable")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.2e6, "s", "13.9 d"),
        (5400.0, "s", "90 min"),
        (7300.0, "s", "2.03 h"),
        (12.0, "s", "12 s"),
        (2.02e-4, "rad", "202 \u00b5rad"),
        (0.034, "rad/s", "34 mrad/s"),
        (2.1e11, "N/m", "210 GN/m"),
        (0.0005, "m^3/s", "0.0005 m^3/s"),
        (0.0005, "kg", "0.0005 kg"),
        (0.0005, "mm", "0.0005 mm"),
        (20.0, "deg", "20 deg"),
        (float("nan"), "m", "not finite m"),
        (0.0, "m", "0 m"),
    ],
)
def test_quantities_read_as_people_write_them(value, unit, text):
    assert quantity_text(value, unit) == text


def test_numbers_that_are_compared_share_their_prefix():
    assert quantity_texts([0.00528, 0.000202], "rad") == (["5.28", "0.202"], "mrad")
    assert unit_text("1/(rad^2 s^2)") == "1/(rad\u00b2 s\u00b2)"
    assert unit_text("m^2.5/s") == "m^2.5/s"


@pytest.mark.parametrize(
    ("start", "stop", "text"),
    [(86410.96, 86412.31, "86411.0 to 86412.3 s"), (0.00157, 0.0021, "0.00157 to 0.0021 s"),
     (12.0, 500.0, "12 to 500 s"), (3.0, 3.0, "3.000 to 3.000 s")],
)  # fmt: skip
def test_the_ends_of_an_interval_are_told_apart_however_late_it_is(start, stop, text):
    assert span_text(start, stop) == text


@pytest.mark.parametrize(
    ("start", "stop", "text"),
    [(179986.0, 185376.0, "50.0 h to 51.5 h"), (7.99, 14.51, "8.0 s to 14.5 s"),
     (1199.5, 1699.5, "20.0 min to 28.3 min"), (2.6e6, 3.5e6, "30 d to 41 d")],
)  # fmt: skip
def test_what_lasts_for_a_while_does_so_between_instants_that_its_length_tells_apart(
    start, stop, text
):
    """A door that is open for an hour and a half was open from 2.08 to 2.15 d."""
    assert while_text(start, stop) == text


def test_an_instant_is_in_hours_where_two_decimals_of_a_day_hide_what_is_resolved():
    """0.01 d is 14.4 min."""
    assert instant_text(179986.0, 300.0) == "50.0 h"
    assert instant_text(179986.0, 3600.0) == "2.1 d"
    assert instant_text(179986.0, 1.0) == "179986 s"


def test_a_growth_of_many_times_is_no_percentage():
    assert growth_text(1.13) == "by 13 %"
    assert growth_text(4574.0) == "4574 times as large"


def test_a_study_of_which_most_runs_failed_is_not_reliable_so_far():
    """Of 40 runs 30 gave no estimate: the ten that did are no sample of the records."""
    study = monte_carlo()
    good = tuple(p for p in study.parameters if p.name == "d")
    failed = [None] * 10 + ["SolveError: the criterion has a kink"] * 30
    table = study.campaign.table.assign(failed=failed)
    lost = replace(study, parameters=good, campaign=replace(study.campaign, table=table))
    said = judged_study(lost)
    assert (said.word, said.look) == ("undecided", "undecided")
    assert said.sentence.startswith("30 of 40 runs failed")
    assert "30 of" not in judged_study(replace(study, parameters=good)).sentence


def test_a_number_that_one_run_does_not_give_is_left_out_of_the_table():
    """The spread of one estimate is none: "-17 +- nan" was printed."""
    study = monte_carlo()
    one = tuple(replace(p, n=1, spread=math.nan) for p in study.parameters)
    assert "nan" not in str(replace(study, parameters=one))
