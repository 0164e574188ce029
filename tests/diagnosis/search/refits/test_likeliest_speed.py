"""The likeliest speed of a reversal, among fits whose likelihood falls off fast on either side."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from casid.diagnosis.search.refits.friction_speeds import likeliest_speed
from casid.diagnosis.thresholds import FRICTION

N = 4000


def fits_about(top: float, sharpness: float):
    """Fits at speeds 2^k, with a logarithm of the likelihood of -sharpness (2^k - 2^top)^2."""
    tried: list[float] = []

    def doubled(k: float, near: object) -> SimpleNamespace:
        tried.append(k)
        loss = sharpness * (2.0**k - 2.0**top) ** 2
        return SimpleNamespace(
            solution=SimpleNamespace(value=float(np.exp(2 * loss / N))),
            criterion=SimpleNamespace(n_samples=N),
            values={"F_c": 1.0 + k},
        )

    return doubled, tried


@pytest.mark.parametrize("top", [0.35, -0.6, 1.4])
@pytest.mark.parametrize("sharpness", [1.0, 100.0, 3000.0])
def test_the_likeliest_speed_is_found_however_fast_the_likelihood_falls(
    top: float, sharpness: float
):
    """To within what no record tells apart: `FRICTION.clearly`, twice for where a parabola ends."""
    doubled, tried = fits_about(top, sharpness)
    found = likeliest_speed(doubled, None)  # type: ignore[arg-type]
    assert found is not None
    assert sharpness * (2.0**found.doublings - 2.0**top) ** 2 < 2 * FRICTION.clearly
    assert len(tried) <= 5 + FRICTION.refits


def test_where_the_likelihood_falls_fast_the_speed_adds_little_to_the_error_of_the_force():
    """An error of the speed of one standard deviation is where the likelihood has lost a half."""
    doubled, _ = fits_about(0.35, 3000.0)
    found = likeliest_speed(doubled, None)  # type: ignore[arg-type]
    assert found is not None
    slope = 2.0**0.35 * np.log(2.0)  # of 2^k
    expected = 1 / (np.sqrt(2 * 3000.0) * slope)
    assert abs(found.rounding["F_c"]) == pytest.approx(expected, rel=0.5)
