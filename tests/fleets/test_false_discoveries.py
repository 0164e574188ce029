"""Rates over many records: what each procedure rejects, and that it holds its level."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta, false_discovery_control, norm

from casid.fleets.false_discoveries import (
    benjamini_hochberg,
    e_benjamini_hochberg,
    e_values,
    lord,
    shares,
)


@pytest.mark.parametrize("seed", range(5))
def test_benjamini_hochberg_is_that_of_scipy(seed: int) -> None:
    p = np.random.default_rng(seed).beta(0.4, 3.0, 200)
    assert np.array_equal(benjamini_hochberg(p, 0.1), false_discovery_control(p) <= 0.1)


def test_an_e_value_of_a_uniform_p_has_mean_one() -> None:
    """Which is what makes it one; the integral below 1e-300 is 1 / 690."""
    whole, _ = quad(lambda log: float(e_values(np.exp([log]))[0] * np.exp(log)), -690.0, 0.0)
    assert whole == pytest.approx(1.0 - 1.0 / 690.0, abs=1e-3)


def test_e_values_fall_with_p_to_one_half() -> None:
    p = np.array([1e-12, 1e-3, 0.2, 0.9, 1.0])
    e = e_values(p)
    assert np.all(np.diff(e) < 0)
    assert e[-1] == pytest.approx(0.5, abs=1e-5)
    assert np.all(np.isfinite(e_values(np.array([0.0]))))


def test_e_bh_of_equal_evidence_needs_n_over_k_level() -> None:
    e = np.array([50.0] * 4 + [1.0] * 6)  # 10 / (4 * 0.05) = 50
    assert e_benjamini_hochberg(e, 0.05).sum() == 4
    assert e_benjamini_hochberg(0.99 * e, 0.05).sum() == 0


def _false_share(reject: np.ndarray, is_null: np.ndarray) -> float:
    return float((reject & is_null).sum() / max(reject.sum(), 1))


def test_rates_hold_where_all_records_share_one_sea() -> None:
    """Equally correlated statistics: e-BH holds whatever they are, BH as they are positive.

    400 fleets of 200 records, 5 % of them with a cause; one-sided p of normal statistics.
    """
    rng = np.random.default_rng(1)
    shares_bh, shares_e = [], []
    for _ in range(400):
        is_null = rng.random(200) > 0.05
        common = rng.standard_normal()
        z = np.sqrt(0.5) * common + np.sqrt(0.5) * rng.standard_normal(200) + 5.0 * ~is_null
        p = norm.sf(z)
        shares_bh.append(_false_share(benjamini_hochberg(p, 0.1), is_null))
        shares_e.append(_false_share(e_benjamini_hochberg(e_values(p), 0.1), is_null))
    error = 3.0 * np.std(shares_bh) / np.sqrt(400)
    assert np.mean(shares_bh) <= 0.1 + error
    assert np.mean(shares_e) <= 0.1


def test_shares_of_the_level_sum_to_no_more_than_one() -> None:
    total = shares(10**6)
    assert np.all(np.diff(total) <= 0)
    assert total.sum() < 1.0


def test_alarms_are_never_taken_back() -> None:
    p = np.random.default_rng(3).beta(0.3, 2.0, 120)
    alarms, levels = lord(p, 0.05)
    for n in (1, 40, 119):
        before, at = lord(p[:n], 0.05)
        assert np.array_equal(before, alarms[:n])
        assert np.allclose(at, levels[:n], rtol=1e-12)


def test_alarms_hold_their_rate_and_find_what_is_clear() -> None:
    """300 streams of 300 records: the share of false alarms stays below the level."""
    rng = np.random.default_rng(4)
    false, found = [], []
    for _ in range(300):
        is_null = rng.random(300) > 0.05
        p = np.where(is_null, rng.random(300), beta.rvs(0.05, 20, size=300, random_state=rng))
        alarms, _ = lord(p, 0.05)
        false.append(_false_share(alarms, is_null))
        found.append(alarms[~is_null].mean() if (~is_null).any() else 1.0)
    assert np.mean(false) <= 0.05
    assert np.mean(found) > 0.5
