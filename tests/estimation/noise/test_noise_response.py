"""The response of outputs to noise where records are simulated window by window."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from casid.estimation.noise.noise_response import Response, with_windowed_spectra


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-160, 1e-3, 1e200])
def test_spectra_of_windows_keep_the_phase_of_the_response_and_replace_its_magnitude(size):
    """|gain|^2 is the spectrum of the windows, also where the response itself is nought.

    The response of a whole record may vanish at frequencies at which windows, which end, have
    power; near parameters at which a model is unstable it is as small or as large as numbers are.
    """
    omega = np.array([0.5, 1.5])
    gain = np.full((2, 1, 1), size * np.exp(0.3j))
    own = Response(omega, np.minimum(np.abs(gain), 1e100) ** 2, ("u",), gain)
    spectrum = np.array([4.0, 1e-12]).reshape(2, 1, 1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = with_windowed_spectra(own, spectrum.astype(complex))
    assert found.gain is not None
    assert np.abs(found.gain[:, 0, 0]) == pytest.approx([2.0, 1e-6])
    assert found.gain2[:, 0, 0] == pytest.approx([4.0, 1e-12])
    if size:
        assert np.angle(found.gain) == pytest.approx(0.3)
