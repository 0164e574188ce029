"""Sums of products of columns: the sums themselves, whatever was saved on the way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.estimation.cross_moments.column_products import column_products
from casid.linear.sampled.lagged_columns import Column

CHANNELS = ("u", "v", "w")


def column(draw_taps: list[tuple[str, int, float]]) -> Column:
    return Column("c", tuple(draw_taps))


taps = st.lists(
    st.tuples(st.sampled_from(CHANNELS), st.integers(0, 5), st.floats(-2, 2)),
    min_size=1,
    max_size=4,
)
some = st.lists(taps.map(column), min_size=1, max_size=4)


@settings(max_examples=60, deadline=None)
@given(left=some, right=some, more=st.integers(0, 4), N=st.integers(12, 60), seed=st.integers(0, 9))
def test_products_are_sums_over_the_samples(left, right, more, N, seed) -> None:
    """Rounding: 60 terms of size 10 or so."""
    rng = np.random.default_rng(seed)
    signals = {c: rng.standard_normal(N) for c in CHANNELS}
    start = max(c.order for c in (*left, *right)) + more
    for a, b in ((left, right), (left, left)):
        found = column_products(a, b, signals, start)
        rows = [np.stack([c.samples(signals, start) for c in group]) for group in (a, b)]
        assert found == pytest.approx(rows[0] @ rows[1].T, rel=1e-12, abs=1e-11)


def test_blocks_do_not_show_in_the_sums() -> None:
    """40 000 samples are three blocks; pairwise summation by NumPy is the reference."""
    rng = np.random.default_rng(0)
    x, y = (np.cumsum(rng.standard_normal(40_000)) for _ in range(2))
    a, b = Column("a", (("x", 3, 1.0),)), Column("b", (("y", 1, 1.0), ("y", 2, -0.5)))
    found = column_products([a], [b], {"x": x, "y": y}, 3)
    expected = np.sum(x[:-3] * (y[2:-1] - 0.5 * y[1:-2]))
    assert found[0, 0] == pytest.approx(expected, rel=1e-13)


def test_a_start_before_the_largest_lag_is_refused() -> None:
    c = Column("c", (("u", 4, 1.0),))
    with pytest.raises(ValueError, match="start = 2 for lags up to 4"):
        column_products([c], [c], {"u": np.zeros(20)}, 2)
