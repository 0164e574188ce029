"""The noise of short records on its way to the estimates."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.ship_basin.records import basin, experiments_of
from analysis.ship_basin.runs import LOAD, How, estimated
from casid.estimation.moments.equations.long_run_covariance import LONGEST_SEGMENT, segments
from casid.estimation.moments.equations.moment_covariance import (
    are_short,
    combined_covariance,
    moment_covariance,
)
from casid.identification.profile_interval import profile


@pytest.fixture(scope="module")
def found():
    """Case 1 of the basin, 36 to 63 s: with few lags of the instruments, and with many."""
    experiments = experiments_of(basin(1), 1)
    return {lags: estimated(experiments, How(lags=lags)) for lags in (2, 16)}


def test_lags_that_add_nothing_leave_the_standard_errors_alone(found):
    """What is projected on 2 and on 16 lags of smooth signals is the same, and so is its error.

    The estimates differ by less than half a standard error, so the standard errors may differ by
    that share of their square at most; spectra that are smeared before instruments are combined
    make those of 16 lags twice as large.
    """
    few, many = found[2], found[16]
    for n in LOAD:
        assert abs(few[n] - many[n]) < 0.5 * few.std_error(n)
        assert many.std_error(n) == pytest.approx(few.std_error(n), rel=0.25)


def test_profiles_of_short_records_have_the_width_of_their_standard_errors(found):
    """The map is mild on a fifth of the parameter: the profile is the estimate +- 1.96 std errors.

    The curvature shifts both ends the same way, and leaves the width to second order.
    """
    estimate = found[2]
    own = profile(estimate, "zbar_m")
    width = 2 * 1.96 * estimate.std_error("zbar_m")
    assert own.upper - own.lower == pytest.approx(width, rel=0.15)


def test_combining_before_and_after_the_spectra_is_the_same_where_nothing_is_smeared(found):
    """Both are bilinear in the instruments: combinations of single lags of one channel agree."""
    stage = found[2].stages[0]
    e, theta = stage.equations[0], stage.thetas[0]
    assert are_short([e])
    assert segments(e.N) < LONGEST_SEGMENT
    rows = np.eye(len(e.Z))[:3]
    whole = moment_covariance([e], [theta], ["nominal"], how="independent")
    combined = combined_covariance([e], [theta], ["nominal"], rows)
    # Edges alone: of 7 segments, lags of a few samples move the ends.
    assert np.diag(combined) == pytest.approx(np.diag(rows @ whole @ rows.T), rel=0.05)


def test_least_squares_has_no_instruments_to_combine(found):
    plain = estimated(experiments_of(basin(1), 1), How(lags=None))
    assert not are_short(plain.stages[0].equations)
    assert are_short(found[2].stages[0].equations)
