"""Joint and multi-stage instrumental variables on the pendulum of Table 7.2.

The data come from analysis/pendulum_study/records.py, whose sampled motion is an exact matrix
exponential and shares no code with the estimators.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import casid
from analysis.pendulum_study.records import PendulumRecords
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
from casid.estimation.moments.instruments.reference_filter_estimate import estimate_reference_filter
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.estimation.moments.validation import validate
from casid.identification.bootstrap import bootstrap
from casid.identification.moment_estimators import (
    Reusable,
    instrumental_variables,
    least_squares,
    multistage,
)
from casid.identification.profile_interval import profile
from problems.pendulum import TABLE_7_2, indirect_model

STAGES = (StageSpec(["I_x", "d"], ["nominal"]), StageSpec(["m", "z_m"], ["loaded"]))
WRONG_LAG = Instruments("ref", ReferenceFilter.lag(0.1))
TRUE_LAG = Instruments("ref", ReferenceFilter.lag(0.2))
FREE = ("I_x", "d", "m", "z_m")


def model(**known: float) -> casid.Model:
    starts = {"d": 0.09, "I_x": 0.15, "m": 0.1, "z_m": -0.2}
    free = {k: v for k, v in starts.items() if k not in known}
    return indirect_model().with_unknown(**free).with_known(k=TABLE_7_2["k"], **known)


@pytest.fixture(scope="module")
def study() -> PendulumRecords:
    return PendulumRecords(0.5, N=40_000, seed=2)


@pytest.fixture(scope="module")
def records(study: PendulumRecords) -> list[casid.Experiment]:
    return study.experiments(0)


@pytest.fixture(scope="module")
def staged(records):
    return multistage(model(), records, STAGES, WRONG_LAG)


@pytest.fixture(scope="module")
def joint(records):
    return instrumental_variables(model(), records, WRONG_LAG)


def test_without_noise_the_parameters_come_back_but_for_the_bilinear_map() -> None:
    """Trap T-6: a relative offset of (w T)^2/12 = 4e-4 at 6.7 rad/s and 0.01 s, twice allowed."""
    clean = PendulumRecords(0.5, N=40_000, noise=0.0, seed=2).experiments(0)
    e = instrumental_variables(model(), clean, TRUE_LAG)
    assert e["I_x"] == pytest.approx(TABLE_7_2["I_x"], rel=2 * 4e-4 * 2)
    assert e["d"] == pytest.approx(TABLE_7_2["d"], rel=2e-3)
    assert e["m"] == pytest.approx(TABLE_7_2["m"], rel=5e-3)
    assert e["z_m"] == pytest.approx(TABLE_7_2["z_m"], rel=5e-3)


def test_an_estimate_from_moments_is_asked_as_any_other(staged) -> None:
    row = staged.parameter("m")
    assert (row.value, row.unit, row.std_error) == (staged["m"], "kg", staged.std_error("m"))
    assert staged.parameters == staged.estimate.parameters
    assert any("Linder" in source for source in staged.references())
    with pytest.raises(KeyError, match=r"no parameter 'mass'; there are .*z_m"):
        staged.parameter("mass")


def test_stages_and_joint_agree_within_their_standard_errors(staged, joint) -> None:
    """Both are consistent, on overlapping data: their difference is below the sum of errors."""
    for name in FREE:
        distance = abs(staged[name] - joint[name])
        assert distance < 3 * max(staged.std_error(name), joint.std_error(name))


@pytest.mark.parametrize("form", ["eliminated", "lifted"])
def test_the_linear_form_has_the_optimum_of_the_physical_ones(records, staged, form: str) -> None:
    """Linear constraints keep the physical parameterisation exactly (7.41), (7.47)."""
    settings = MomentSettings(form=form)
    other = multistage(model(), records, STAGES, WRONG_LAG, settings=settings)
    for name in FREE:
        assert other[name] == pytest.approx(staged[name], rel=1e-6)
    assert other.covariance == pytest.approx(staged.covariance, rel=1e-4, abs=1e-16)


def test_lifted_and_eliminated_joint_programs_reach_one_optimum(records, joint) -> None:
    settings = MomentSettings(form="lifted")
    lifted = instrumental_variables(model(), records, WRONG_LAG, settings=settings)
    for name in FREE:
        assert lifted[name] == pytest.approx(joint[name], rel=1e-7)
    a, b = (e.stages[0].solution.value for e in (lifted, joint))
    assert a == pytest.approx(b, rel=1e-7)


def test_without_propagation_the_interval_of_the_load_is_too_narrow(staged) -> None:
    assert staged.std_error("m") > 1.01 * staged.std_error("m", propagated=False)
    assert staged.std_error("I_x") == pytest.approx(staged.std_error("I_x", propagated=False))


def test_a_prior_that_is_uncertain_widens_what_depends_on_it(records) -> None:
    certain, doubted = (
        multistage(
            model(),
            records,
            STAGES,
            WRONG_LAG,
            prior=Prior({"M": 22.04, "z_g": -0.018}, {"M": 0.2 * doubt, "z_g": 1e-4 * doubt}),
        )
        for doubt in (0, 1)
    )
    assert doubted["m"] == pytest.approx(certain["m"], rel=1e-9)
    assert doubted.std_error("m") > certain.std_error("m")
    # dI_x/dM at fixed S: I_2 = -S/beta_1 scales with S, so 1 % of M moves I_2 by 1 %.
    slope = (doubted.std_error("I_x") ** 2 - certain.std_error("I_x") ** 2) ** 0.5
    shifted = multistage(model(), records, STAGES, WRONG_LAG, prior=Prior({"M": 22.24}))
    moved = abs(shifted["I_x"] - certain["I_x"])
    other = multistage(model(), records, STAGES, WRONG_LAG, prior=Prior({"z_g": -0.0181}))
    moved = float(np.hypot(moved, abs(other["I_x"] - certain["I_x"])))
    assert slope == pytest.approx(moved, rel=0.05)


@pytest.mark.slow
def test_covariance_bootstrap_and_profile_tell_the_same_where_the_map_is_mild(staged) -> None:
    """400 resamples: the relative error of a standard deviation is 1/sqrt(800) = 3.5 %; blocks cut
    the memory of the products, and lose a little on top."""
    resampled = bootstrap(staged, runs=400, seed=1)
    for name in FREE:
        assert resampled.std_error(name) == pytest.approx(staged.std_error(name), rel=0.25)
    p = profile(staged, "m")
    width = 2 * 1.96 * staged.std_error("m")
    assert p.upper - p.lower == pytest.approx(width, rel=0.15)
    assert p.lower < staged["m"] < p.upper


@pytest.mark.slow
def test_intervals_cover_over_many_runs(study: PendulumRecords) -> None:
    """80 runs of m and of z_m. Binomial at 95 %: mean 76, sd 1.95; four of them allowed. I_x and d
    carry the bilinear offset and are compared in analysis/pendulum_study."""
    estimator = Reusable(
        model(), STAGES, WRONG_LAG, settings=MomentSettings(form="linear", iterations=1)
    )
    inside = {"m": 0, "z_m": 0}
    for run in range(80):
        e = estimator(study.experiments(run))
        for name in inside:
            inside[name] += abs(e[name] - TABLE_7_2[name]) < 1.96 * e.std_error(name)
    assert all(68 <= count for count in inside.values()), inside


def test_a_reusable_estimator_gives_what_a_fresh_one_gives(study: PendulumRecords) -> None:
    estimator = Reusable(model(), STAGES, WRONG_LAG, settings=MomentSettings(form="linear"))
    estimator(study.experiments(4))
    again = estimator(study.experiments(5))
    fresh = multistage(model(), study.experiments(5), STAGES, WRONG_LAG)
    for name in FREE:
        assert again[name] == pytest.approx(fresh[name], rel=1e-7)  # the solver's tolerance


def test_a_reusable_estimator_follows_another_prior(study: PendulumRecords) -> None:
    estimator = Reusable(model(), STAGES, WRONG_LAG, settings=MomentSettings(form="linear"))
    records, prior = study.experiments(4), Prior({"M": 22.24, "z_g": -0.0181}, {"M": 0.1})
    plain = estimator(records)
    again = replace(estimator, prior=prior)(records)
    fresh = multistage(model(), records, STAGES, WRONG_LAG, prior=prior)
    for name in FREE:
        assert again[name] == pytest.approx(fresh[name], rel=1e-7)  # the solver's tolerance
        assert again.std_error(name) == pytest.approx(fresh.std_error(name), rel=1e-4)
    assert abs(again["I_x"] - plain["I_x"]) > 1e-6


def test_a_wrong_reference_filter_costs_variance_not_consistency(records) -> None:
    """F_delta with 0.1 s instead of 0.2 s, and no filter at all."""
    for instruments in (TRUE_LAG, WRONG_LAG, Instruments("ref")):
        e = multistage(model(), records, STAGES, instruments)
        for name in ("m", "z_m"):
            assert abs(e[name] - TABLE_7_2[name]) < 4 * e.std_error(name)


def test_least_squares_is_biased_by_the_noise_on_its_regressors(records, staged) -> None:
    ls = multistage(model(), records, STAGES)
    assert abs(ls["m"] - TABLE_7_2["m"]) > 3 * ls.std_error("m")
    assert ls.propagated.p_value < 0.01
    assert staged.propagated.p_value > 0.001
    assert any("contradict" in w for w in ls.estimate.warnings)


def test_a_wrong_load_case_is_contradicted_by_the_moments(records) -> None:
    """The nominal record declared loaded: no pair (I_x, d) and (m, z_m) explains both."""
    nominal, loaded = records
    wrong = [casid.Experiment(nominal.record, {"m": 1.0, "z_m": -0.3}, "nominal"), loaded]
    e = multistage(model(), wrong, STAGES, WRONG_LAG)
    right = multistage(model(), records, STAGES, WRONG_LAG)
    assert right.propagated.p_value > 1e-3
    assert not right.estimate.warnings
    assert any("bound" in w for w in e.estimate.warnings)
    assert e.propagated.p_value < 1e-6


def test_records_of_different_sample_times_share_their_parameters(study: PendulumRecords) -> None:
    """Each its own discretisation."""
    nominal, loaded = study.experiments(1)
    slower = casid.Experiment(casid.decimate(loaded.record, 2), loaded.known, "loaded")
    e = multistage(model(), [nominal, slower], STAGES, WRONG_LAG)
    assert {p.Ts for st in e.stages for p in st.parts} == {0.01, 0.02}
    assert abs(e["m"] - TABLE_7_2["m"]) < 5 * e.std_error("m") + 0.01


def test_an_equality_constraint_holds_at_the_joint_estimate(records) -> None:
    """The load's moment m z_m known from the workshop: -0.0548 kg m."""
    product = TABLE_7_2["m"] * TABLE_7_2["z_m"]
    settings = MomentSettings(constraints=[lambda p: 10 * (p["m"] * p["z_m"] - product)])
    e = instrumental_variables(model(), records, WRONG_LAG, settings=settings)
    assert e["m"] * e["z_m"] == pytest.approx(product, rel=1e-6)
    free = instrumental_variables(model(), records, WRONG_LAG)
    assert e.std_error("m") < free.std_error("m")
    lifted = instrumental_variables(
        model(), records, WRONG_LAG, settings=replace(settings, form="lifted")
    )
    assert lifted.covariance == pytest.approx(e.covariance, rel=1e-3, abs=1e-14)


def test_a_bound_that_holds_is_reported_without_an_error_bar(records) -> None:
    tight = model()
    tight.parameters["m"] = replace(tight.parameters["m"], lower=0.0, upper=0.15, start=0.1)
    e = instrumental_variables(tight, records, WRONG_LAG)
    row = e.estimate.parameter("m")
    assert row.value == pytest.approx(0.15)
    assert row.std_error is None
    assert "upper bound" in row.note


def test_instruments_of_a_reference_that_never_moves_are_refused(records) -> None:
    nominal, loaded = records
    still = nominal.record.with_channel("ref", np.zeros(nominal.record.N), "m/s^2")
    with pytest.raises(casid.DataError, match="never moves.*record in which it is excited"):
        multistage(
            model(), [casid.Experiment(still, {"m": 0.0}, "nominal"), loaded], STAGES, WRONG_LAG
        )


def test_parameters_that_cannot_be_told_apart_are_refused_before_the_solver(records) -> None:
    """(a) of Table 7.1: no data tell I_x from I_xm."""
    m = model().with_unknown(I_xm=0.001)
    with pytest.raises(casid.IdentifiabilityError) as refusal:
        instrumental_variables(
            m,
            records[:1],
            WRONG_LAG,
            free=["I_x", "I_xm", "d"],
            prior=Prior({"m": 0.1, "z_m": -0.2}),
        )
    assert "I_x" in str(refusal.value)
    assert "I_xm" in str(refusal.value)
    assert "known value" in str(refusal.value)


def test_an_unstable_start_falls_back_to_the_reference_and_says_so(records) -> None:
    """A pendulum without its spring falls over; the estimate does not mind the start."""
    m = model()
    soft = m.with_unknown(k=0.5)
    e = instrumental_variables(soft, records, WRONG_LAG, prior=Prior({"d": TABLE_7_2["d"]}))
    assert any("unstable" in w and "reference" in w for w in e.estimate.warnings)
    assert abs(e["k"] - TABLE_7_2["k"]) < 6 * e.std_error("k") + 0.01


def test_settings_and_stages_that_make_no_sense_are_refused_with_their_mend(records) -> None:
    m = model()
    with pytest.raises(casid.ModelError, match="two stages"):
        multistage(m, records, [StageSpec(["m"]), StageSpec(["m", "z_m"])], WRONG_LAG)
    with pytest.raises(casid.ModelError, match="neither known nor estimated"):
        multistage(m, records, [StageSpec(["I_x", "d"])], WRONG_LAG)
    with pytest.raises(casid.ModelError, match="no record 'nominall'"):
        multistage(m, records, [StageSpec(FREE, ["nominall"])], WRONG_LAG)
    with pytest.raises(casid.ModelError, match="later stage.*reorder"):
        multistage(
            m,
            records,
            [StageSpec(["m", "z_m"], ["loaded"]), StageSpec(["I_x", "d"], ["nominal"])],
            WRONG_LAG,
        )
    with pytest.raises(casid.ModelError, match="n_y = -1"):
        Instruments("ref", n_y=-1)
    with pytest.raises(casid.ModelError, match="Reflect the root"):
        ReferenceFilter((1.0,), (1.0, -2.0))
    with pytest.raises(casid.ModelError, match="proper filter"):
        ReferenceFilter((1.0, 0.0), (1.0,))
    with pytest.raises(casid.DataError, match="no channel 'reff'"):
        multistage(m, records, STAGES, Instruments("reff"))
    with pytest.raises(casid.ModelError, match="negative eigenvalue"):
        Prior({"M": 1.0, "k": 1.0}, np.array([[1.0, 2.0], [2.0, 1.0]])).matrix()


def test_least_squares_alone_needs_no_instruments(records) -> None:
    e = least_squares(
        model(m=0.0),
        records[:1],
        free=["I_x", "d"],
    )
    assert e["I_x"] == pytest.approx(TABLE_7_2["I_x"], rel=0.05)
    assert "autocorrelation-robust" in e.estimate.assumes


def test_the_estimate_reads_as_a_page_and_is_written_as_json(staged, tmp_path) -> None:
    text = str(staged)
    for word in ("canonical correlations", "weakest along", "surplus", "earlier stages taken as"):
        assert word in text
    assert "rank of Phi 3 of 3" in text
    content = staged.to_json()
    assert content["schema"] == "casid.estimate/1"
    assert content["overidentification"]["degrees_of_freedom"] == staged.propagated.degrees
    assert content["instruments"]["stage 1/nominal/gyro"]["rank"] == 3
    assert content["std_error_unpropagated"]["m"] < content["parameters"]["m"]["std_error"]
    assert set(content["covariance"]["names"]) == set(FREE)
    assert json.loads(staged.write(tmp_path).read_text(encoding="utf-8")) == content


def test_simulation_from_the_reference_meets_data_that_were_not_fitted(study, staged) -> None:
    """(7.55) with the sign of E-14: the simulated signals are not upside down. The true F_delta."""
    fresh = PendulumRecords(0.5, N=20_000, seed=9).experiments(0)
    check = validate(model(), staged.values, fresh[1:], TRUE_LAG)
    gyro, accel = check["loaded", "gyro"], check["loaded", "accel"]
    assert gyro.fit > 90
    assert accel.fit > 90
    assert abs(gyro.period_error) < 0.01
    assert abs(gyro.peak_error) < 0.05
    wrong = validate(model(), {**staged.values, "k": 6.0}, fresh[1:], TRUE_LAG)
    assert wrong["loaded", "gyro"].fit < gyro.fit - 20
    assert len(check.plot().data) == 4


def test_the_reference_filter_is_found_where_nobody_knows_it(records, staged) -> None:
    """F_delta = 1/(0.2 s + 1): the pole of its samples is exp(-Ts/0.2), the static gain 1."""
    found = estimate_reference_filter(model(), staged.values, records[1], "ref")
    assert found.a[1] == pytest.approx(-np.exp(-0.01 / 0.2), rel=0.01)
    assert found.b.sum() / found.a.sum() == pytest.approx(1.0, rel=0.02)
    e = multistage(model(), records, STAGES, Instruments("ref", found))
    assert abs(e["m"] - TABLE_7_2["m"]) < 4 * e.std_error("m")
    slower = casid.Experiment(casid.decimate(records[1].record, 2), {}, "loaded")
    with pytest.raises(casid.DataError, match="estimate it again"):
        validate(model(), staged.values, slower, Instruments("ref", found))


def test_instruments_that_are_none_are_refused_with_what_they_are(records):
    with pytest.raises(casid.ModelError, match=r"give casid\.Instruments\('reference'\)"):
        instrumental_variables(model(), records, ["ref"])  # type: ignore[arg-type]
