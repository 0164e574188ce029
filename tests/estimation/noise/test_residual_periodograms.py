"""What a fit takes out of residuals does not depend on the units of its parameters."""

from __future__ import annotations

import numpy as np
import pytest

from casid.estimation.noise.residual_periodograms import (
    Spectra,
    band_edges,
    restricted,
    with_tangent,
)


@pytest.mark.parametrize("unit", [1e-120, 1e6, 1e301])
def test_sensitivities_of_any_size_take_the_same_directions(unit):
    """Also of a size whose square is no number: near parameters at which a model is unstable."""
    rng = np.random.default_rng(1)
    N = 600
    columns = rng.standard_normal((N, 1, 3)).cumsum(axis=0)
    columns[:, :, 2] = columns[:, :, 1] + 0.1 * columns[:, :, 0]  # no direction of its own
    bands = len(band_edges(N)) - 1
    ones = np.ones(bands)
    spectra = Spectra(np.ones((bands, 1)), ones, ones, ones, np.zeros(bands, dtype=int))
    shape = np.linspace(1.0, 9.0, bands)
    expected = restricted(with_tangent(spectra, [columns]), shape)
    found = restricted(with_tangent(spectra, [columns * [unit, 1.0, 1.0]]), shape)
    assert found == pytest.approx(expected, rel=1e-6)
