"""Random effects over assets and records against closed forms, and in simulation."""

from __future__ import annotations

import numpy as np
import pytest

from casid.fleets.random_effects import Sample, parameter_effects


def drawn(
    rng: np.random.Generator,
    *,
    assets: int,
    records: int,
    between: float,
    within: float,
    drift: float = 0.0,
    error: float | None = None,
    alone: float = 0.0,
) -> Sample:
    """Estimates about 10; the last asset drifts by `alone` more than the others."""
    asset = np.repeat(np.arange(assets), records)
    when = np.tile(np.arange(records, dtype=float), assets)
    s = np.full(len(asset), error) if error is not None else rng.uniform(0.05, 0.2, len(asset))
    own = drift + alone * (asset == assets - 1)
    value = 10.0 + between * rng.standard_normal(assets)[asset] + own * when
    value += within * rng.standard_normal(len(asset)) + s * rng.standard_normal(len(asset))
    return Sample("k", "N/m", value, s, when, [f"ship {a}" for a in asset])


def test_equal_errors_at_one_time_give_the_analysis_of_variance() -> None:
    """Balanced, no drift: tau_w^2 = MS_within - s^2 and tau_b^2 = (MS_between - MS_within) / n."""
    rng = np.random.default_rng(1)
    sample = drawn(rng, assets=12, records=8, between=1.0, within=0.5, error=0.2)
    sample = Sample("k", "N/m", sample.value, sample.error, np.zeros(96), sample.asset)
    groups = sample.value.reshape(12, 8)
    inside = groups.var(axis=1, ddof=1).mean()
    outside = 8 * groups.mean(axis=1).var(ddof=1)
    found = parameter_effects(sample)
    assert found is not None
    assert found.within**2 == pytest.approx(inside - 0.04, rel=1e-3)
    assert found.between**2 == pytest.approx((outside - inside) / 8, rel=1e-3)
    assert found.mean == pytest.approx(groups.mean(), rel=1e-6)
    assert found.mean_error == pytest.approx(np.sqrt(outside / 96), rel=1e-3)


def test_a_shrunk_mean_is_the_weighted_one_of_asset_and_fleet() -> None:
    """Balanced, no drift: the asset's own mean counts tau_b^2 / (tau_b^2 + (tau_w^2 + s^2) / n)."""
    rng = np.random.default_rng(2)
    sample = drawn(rng, assets=10, records=4, between=0.3, within=0.4, error=0.3)
    sample = Sample("k", "N/m", sample.value, sample.error, np.zeros(40), sample.asset)
    found = parameter_effects(sample)
    assert found is not None
    share = found.between**2 / (found.between**2 + (found.within**2 + 0.09) / 4)
    for asset, own in zip(found.assets, sample.value.reshape(10, 4).mean(axis=1), strict=True):
        assert asset.mean == pytest.approx(found.mean + share * (own - found.mean), rel=1e-6)


@pytest.mark.slow
def test_variances_mean_and_drift_are_recovered() -> None:
    """Over 40 fleets of 20 assets with 15 records: within four errors of the mean of 40."""
    rng = np.random.default_rng(3)
    found = [
        parameter_effects(drawn(rng, assets=20, records=15, between=0.5, within=0.1, drift=0.03))
        for _ in range(40)
    ]
    for name, truth in (("between", 0.5), ("within", 0.1), ("mean", 10.21), ("drift", 0.03)):
        values = np.array([getattr(f, name) for f in found])
        assert abs(values.mean() - truth) < 4 * values.std(ddof=1) / np.sqrt(40)
    covered = [abs(f.drift - 0.03) < 1.96 * f.drift_error for f in found if f is not None]
    assert np.mean(covered) > 0.8  # 0.95 less three binomial errors and more


def test_estimates_without_scatter_have_no_variance_beyond_their_errors() -> None:
    rng = np.random.default_rng(4)
    within = [
        parameter_effects(drawn(rng, assets=8, records=10, between=0.0, within=0.0))
        for _ in range(20)
    ]
    assert np.median([f.between for f in within if f is not None]) < 0.03  # of errors of 0.1
    assert np.median([f.within for f in within if f is not None]) < 0.03


def test_an_asset_that_drifts_alone_is_told_from_the_fleet() -> None:
    rng = np.random.default_rng(5)
    found = parameter_effects(
        drawn(rng, assets=10, records=20, between=0.3, within=0.05, drift=0.02, alone=0.05)
    )
    assert found is not None
    *others, last = found.assets
    assert last.p_value < 1e-6
    assert sum(a.p_value < 0.01 for a in others) <= 1
    assert last.drift == pytest.approx(0.07, abs=4 * last.drift_error)


def test_fewer_than_three_estimates_say_nothing() -> None:
    sample = Sample("k", "", np.ones(2), np.ones(2), np.zeros(2), ["a", "b"])
    assert parameter_effects(sample) is None
    nothing = Sample("k", "", np.ones(9), np.full(9, np.nan), np.zeros(9), ["a"] * 9)
    assert parameter_effects(nothing) is None
