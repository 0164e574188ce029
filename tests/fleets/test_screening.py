"""Screening: what is missing passes, what is complete does not, and what is unlike is searched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.residual.spectral_peaks import find_peaks
from casid.diagnosis.evidence.scores.score_tests import scores_of
from casid.fleets.fleet_settings import Reference, reference_of
from casid.fleets.record_list import FleetRecord
from casid.fleets.screening import Screen, Screened, best_scored
from casid.fleets.thresholds import SCREENING
from tests.support.fleet_records import samples, write_problem, write_record

TRUTH = {"T": 6.0, "K": 2.0}


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> casid.Problem:
    return casid.load_problem(write_problem(tmp_path_factory.mktemp("problem")))


@pytest.fixture(scope="module")
def screen(problem: casid.Problem, tmp_path_factory: pytest.TempPathFactory) -> Screen:
    path = write_record(tmp_path_factory.mktemp("reference") / "r.csv", samples(1))
    return Screen.of(problem, problem.read(path), TRUTH, level=0.05)


def screened(screen: Screen, path: Path, **how: float) -> Screened:
    return screen(screen.declared.read(write_record(path / "r.csv", samples(**how))))


@pytest.mark.slow
def test_records_that_lack_nothing_seldom_pass(screen: Screen, tmp_path: Path) -> None:
    """Of 40 at a fifth of 5 %, two are as many as 6 % of all such tests would see by chance."""
    passed = [screened(screen, tmp_path, seed=s).passes(0.05) for s in range(100, 140)]
    assert sum(passed) <= 2


def test_its_fit_is_that_of_the_record(screen: Screen, tmp_path: Path) -> None:
    """Five standard errors of the truth, which they scatter by: K of another asset is its own."""
    found = {p.name: p for p in screened(screen, tmp_path, seed=7, gain=2.1).parameters}
    for name, truth in (("T", 6.0), ("K", 2.1)):
        assert found[name].std_error is not None
        assert abs(found[name].value - truth) < 5 * found[name].std_error
        assert found[name].std_error < 0.02 * truth
    assert found["T"].unit == "s"


def test_a_record_that_lacks_something_passes(screen: Screen, tmp_path: Path) -> None:
    assert screened(screen, tmp_path, seed=8, offset=0.1).passes(0.05)


def test_a_record_far_from_the_reference_finds_its_own_fit(screen: Screen, tmp_path: Path) -> None:
    found = screened(screen, tmp_path, seed=9, gain=20.0)
    (gain,) = [p.value for p in found.parameters if p.name == "K"]
    assert gain == pytest.approx(20.0, rel=0.01)
    assert not found.passes(0.05)


def test_a_fit_at_a_bound_is_searched(screen: Screen, tmp_path: Path) -> None:
    """Whether the fit settles there, which leaves a misfit, or does not."""
    found = screened(screen, tmp_path, seed=9, gain=500.0)  # of at most 100
    assert found.passes(0.05)


def test_a_first_sample_from_before_the_inputs_had_acted_is_left_out(
    screen: Screen, tmp_path: Path
) -> None:
    """It tells of no fault of a sensor, as an outlier within the record does."""
    for at, p_least in ((0, 0.05), (60, None)):
        data = samples(11)
        data["y"][at] += 0.4  # 20 standard deviations of its noise
        found = screen(screen.declared.read(write_record(tmp_path / "r.csv", data)))
        if p_least is None:
            assert found.why == "some of its samples are faulty"
        else:
            assert not found.why
            assert found.p_value > p_least


def test_of_effects_with_one_signature_one_is_taken_out(screen: Screen) -> None:
    """Regressed out of a residual, a column and its multiple leave the same of it."""
    table = scores_of(screen.columns, screen.at.criterion, input_sd={}, draws=0)
    places = best_scored(table)
    assert 1 <= len(places) <= SCREENING.taken_out
    assert max(s.unrobust for s in table.tested) == table.scores[places[0]].unrobust
    twice = replace(table, cosines=np.ones_like(table.cosines))
    assert best_scored(twice) == places[:1]


def test_effects_at_their_null_leave_residual_and_samples_as_they_are(
    screen: Screen, tmp_path: Path
) -> None:
    """The delays and lags of the catalogue are none yet: no first samples are due to the past.

    Those left out would be a jump in the residual, which whitening turns into a large innovation.
    """
    path = write_record(tmp_path / "r.csv", samples(12))
    record = screen.declared.in_si().read(path)
    base = screen.at.criterion
    own = base.of_records([record], weights=base.weights, start=screen.at.fit.values)
    wide = screen.columns_at(own, own.start).wide
    assert any(name.startswith("delay") for name in wide.names)
    np.testing.assert_array_equal(wide.data[0].used, own.data[0].used)
    residuals = (c.simulated(c.start, 0).residual for c in (wide, own))
    np.testing.assert_allclose(*residuals, atol=1e-9)


def test_a_record_with_other_channels_is_searched(screen: Screen, tmp_path: Path) -> None:
    data = samples(10)
    data["extra"] = np.sin(data["t"])
    found = screen(screen.declared.read(write_record(tmp_path / "r.csv", data)))
    assert found.why == "it has other channels than the asset's reference"


def test_the_reference_is_a_median_that_one_bad_record_does_not_move() -> None:
    records = [FleetRecord(f"{i}.csv", "a", i, False, 1, 1) for i in range(SCREENING.references)]
    fits = [{"K": 2.0 + 0.01 * i} for i in range(SCREENING.references - 1)]
    found = reference_of(list(zip(records, [*fits, {"K": 50.0}], strict=True)))
    assert found == Reference("2.csv", (("K", 2.02),))
    assert reference_of([]) is None


def test_a_narrow_peak_of_the_spectrum_is_a_line_only_beside_distant_neighbours() -> None:
    """Levels of near neighbours follow a peak of ten lines' width, and leave a line in place."""
    rng = np.random.default_rng(4)
    n = 600
    omega = 2 * np.pi * np.arange(n // 2 + 1) / n
    height = 1.0 + 30.0 / (1.0 + ((omega - 0.9) / 0.03) ** 2)
    draws = rng.standard_normal((40, n // 2 + 1)) + 1j * rng.standard_normal((40, n // 2 + 1))
    near = (SCREENING.beside, SCREENING.beside)
    alarms = {"near": 0, "usual": 0}
    for z in draws:
        noise = np.fft.irfft(np.sqrt(height) * z, n)[:, None]
        alarms["near"] += bool(find_peaks([noise], [1.0], neighbours=near))
        alarms["usual"] += bool(find_peaks([noise], [1.0]))
    assert alarms["near"] <= 5  # of 40 at 5 %: 3 % of such tests have more
    assert alarms["near"] < alarms["usual"]
    line = 0.5 * np.std(noise) * np.cos(2.2 * np.arange(n))[:, None]
    (found,) = find_peaks([noise + line], [1.0], neighbours=near)
    assert found.frequency == pytest.approx(2.2 / (2 * np.pi), abs=1e-3)
