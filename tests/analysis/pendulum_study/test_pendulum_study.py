"""The simulation study 7.5.1 in short: what its runs, numbers and predictions stand on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import casid
from analysis.common.output import Output
from analysis.common.targets import Target
from analysis.pendulum_study.records import PendulumRecords
from analysis.pendulum_study.runs import (
    AS_GIVEN,
    FREE,
    LAG,
    STAGES,
    STARTS,
    Bench,
    Estimator,
    Runs,
    bench,
    row_of,
    sampled,
)
from analysis.pendulum_study.statistics import load_by_formula, shares
from analysis.pendulum_study.study import (
    Desk,
    Extent,
    bilinear_prediction,
    direct_regression,
    study,
)
from casid.campaigns.campaign import run_seed
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.identification.moment_estimators import multistage
from problems.pendulum import TABLE_7_2, indirect_model

N = 30_000
EVERYTHING: tuple[Estimator, ...] = ("ls", "iv", "identity")


@pytest.fixture(scope="module")
def runs() -> Runs:
    return Runs(0.5, N=N, seed=2, estimators=EVERYTHING)


@pytest.fixture(scope="module")
def model() -> casid.Model:
    return indirect_model().with_unknown(**STARTS).with_known(k=TABLE_7_2["k"])


def test_a_run_is_the_same_in_any_order(runs: Runs) -> None:
    """Caches hold what depends on the reference alone."""
    first = runs(run_seed(0, 3))
    runs(run_seed(0, 4))
    again = runs(run_seed(0, 3))
    assert first == again


def test_closed_forms_and_kept_sums_give_what_ipopt_gives_on_fresh_records(runs, model) -> None:
    """Of a strictly convex program in three variables; Ipopt's tolerance."""
    records = runs.bench.study.experiments(5)
    found = runs.bench.estimate(runs.bench.study._drawn, EVERYTHING)
    settings = MomentSettings(form="linear", weighting="identity", iterations=3)
    for name, instruments, chosen in (
        ("ls", None, MomentSettings(form="linear")),
        ("identity", AS_GIVEN, settings),
    ):
        e = multistage(model, records, STAGES, instruments, settings=chosen)
        for parameter, value in zip(FREE, found[name].values, strict=True):
            assert value == pytest.approx(e[parameter], rel=1e-6)


def test_least_squares_is_start_enough_for_the_instruments(runs, model) -> None:
    """Instruments from its biased estimate, or refined until they settle: a tenth of the standard
    error apart, and standard errors alike to 2 %."""
    records = runs.bench.study.experiments(6)
    staged = runs.bench.estimate(runs.bench.study._drawn, ("iv",))["iv"]
    errors = np.sqrt(np.diag(staged.propagated().covariance))
    settled = multistage(model, records, STAGES, Instruments("ref", LAG))
    for parameter, value, error in zip(FREE, staged.values, errors, strict=True):
        assert abs(value - settled[parameter]) < 0.1 * error
        assert error == pytest.approx(settled.std_error(parameter), rel=0.02)


def test_without_noise_the_bilinear_map_alone_is_left() -> None:
    """Its offsets follow from the spectrum of a_s: within a tenth, the record being one of many."""
    found = bench(0.5, N, 2, 0.01).noise_free(("iv",))["iv"]
    predicted = bilinear_prediction()
    assert found[0] / TABLE_7_2["I_x"] - 1 == pytest.approx(predicted["I_x"], rel=0.1)
    # Between (w T)^2/12 at the resonances of the direct and of the indirect model, T-6.
    assert (0.0668**2) / 12 < -predicted["I_x"] < (0.1325**2) / 12
    assert abs(found[2] / TABLE_7_2["m"] - 1) < 1e-3


def test_the_default_weighting_has_a_fraction_of_the_spread_of_none(runs: Runs) -> None:
    row = runs(run_seed(0, 1))
    assert row["identity.m.std_error"] > 10 * row["iv.m.std_error"]
    # The first stage, taken as exact, narrows what Q = I says of m much more.
    assert row["identity.m.own"] < 0.75 * row["identity.m.std_error"]
    assert 0.9 < row["iv.m.own"] / row["iv.m.std_error"] < 0.97


def test_columns_as_given_are_what_an_identity_weights() -> None:
    """Eight lags span six: reduced, Q = I is another estimator."""
    assert not AS_GIVEN.reduce
    own = bench(0.5, N, 2, 0.01)
    fits = own.estimate(own.study.clean, ("identity",))["identity"].stages
    assert all(len(f.equations[0].instruments) == 8 for f in fits)
    reduced = Instruments("ref", LAG, n_delta=0)
    assert reduced.reduce
    assert len(own.estimate(own.study.clean, ("iv",))["iv"].stages[0].equations[0].Z) == 6


def test_intervals_are_left_out_where_they_are_not_asked_for(runs: Runs) -> None:
    sparse = replace(runs, every=2, estimators=("ls", "iv"))
    with_, without = sparse(run_seed(0, 2)), sparse(run_seed(0, 3))
    assert with_["iv.m.std_error"] > 0
    assert np.isnan(without["iv.m.std_error"])
    assert without["iv.m"] == runs(run_seed(0, 3))["iv.m"]


def test_the_published_map_gives_the_load_of_the_stage(runs: Runs) -> None:
    """(7.36) and (7.38) on the linear parameters: what the numeric inverse found."""
    import pandas as pd

    rows = [runs(run_seed(0, k)) for k in range(3)]
    table = pd.DataFrame(rows)
    m, z_m = load_by_formula(table, "iv")
    assert m == pytest.approx(table["iv.m"].to_numpy(), rel=1e-6)
    assert z_m == pytest.approx(table["iv.z_m"].to_numpy(), rel=1e-6)


def test_sampling_meets_the_delta_method_where_the_map_is_straight() -> None:
    """300 draws: the error of a standard deviation is 1/sqrt(600) = 4 %; three of them allowed."""
    own = Bench(PendulumRecords(3.0, N=N, seed=2))
    found = own.estimate(own.study.draw(own.study.generator(0)), ("identity",))["identity"]
    drawn = sampled(found, np.random.default_rng(1), 300)
    errors = np.sqrt(np.diag(found.propagated().covariance))
    assert np.std(drawn, axis=0, ddof=1) == pytest.approx(errors, rel=0.12)


def test_the_direct_model_errs_with_the_square_of_the_amplitude() -> None:
    """sin(phi) - phi and cos(phi) - 1 are of second order relative to the linear terms."""
    small, large = (direct_regression(A, 4000) for A in (0.4, 0.8))
    for name in ("I_x", "k"):
        assert large[name] / small[name] == pytest.approx(4.0, rel=0.1)
    bent, straight = (
        Bench(PendulumRecords(1.0, N=4000, seed=2, truth=truth)).noise_free(("ls",))["ls"]
        for truth in ("nonlinear", "linear")
    )
    assert np.max(np.abs(bent / straight - 1)) < 0.01 * large["k"]


def test_shares_count_what_the_thesis_counts() -> None:
    assert shares(np.array([-0.1, 0.05, 0.15, 0.25, 0.4])) == {
        "> 0": 0.8,
        "+-0.1": 0.4,
        "> 0.1": 0.6,
    }


@pytest.mark.slow
def test_the_study_prints_its_targets_and_keeps_its_tables_and_figures(tmp_path: Path) -> None:
    tiny = Extent(
        runs=3, others=2, profiles=2, floor=2, N=8000, N_nonlinear=2000, every=1, is_full=False
    )
    targets = list(study(Desk(1, Output(tmp_path), False), tiny))
    assert all(isinstance(t, Target) for t in targets)
    assert json.dumps([t.is_met for t in targets])
    names = {p.name for p in tmp_path.iterdir()}
    assert {"estimates.csv", "figure_7_10_signals.html", "figure_7_12_loaded.html"} <= names
    assert (tmp_path / "runs" / "floor" / "results.parquet").exists()


def test_a_row_is_flat_numbers(runs: Runs) -> None:
    own = runs.bench
    row = row_of(own.estimate(own.study.clean, EVERYTHING), True)
    assert all(isinstance(v, float | bool) for v in row.values())
    assert {"ls.I_x", "iv.m.own", "identity.b0.loaded", "iv.p_value"} <= set(row)


def test_the_closed_form_is_refused_where_there_is_none(runs: Runs, model) -> None:
    settings = MomentSettings(form="eliminated", solver="null space")
    with pytest.raises(casid.ModelError, match="form='linear' alone; leave it out"):
        multistage(model, runs.bench.study.experiments(0), STAGES, settings=settings)
