"""Variances under many spectra of a force at once: the maxima are those of one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from casid.estimation.disturbances import variance_scoring
from casid.estimation.disturbances.variance_scoring import likelihoods
from casid.estimation.noise.residual_periodograms import Spectra
from casid.estimation.noise.variances import variances, whittle

BANDS = 120
OMEGA = np.linspace(0.02, 3.0, BANDS)
OUTPUT = np.repeat([0, 1], BANDS)


def designs(sources: int) -> np.ndarray:
    """(30, 2 BANDS, sources): two sensors, and resonances at different places."""
    rng = np.random.default_rng(1)
    rows = np.repeat(np.eye(2), BANDS, axis=0)
    out = []
    for _ in range(30):
        places, widths = rng.uniform(0.1, 2.5, sources - 2), rng.uniform(0.05, 0.5, sources - 2)
        peaks = 1 / (1 + ((OMEGA[:, None] - places) / widths) ** 2)
        out.append(np.hstack([rows, np.vstack([peaks, OMEGA[:, None] ** 2 * peaks])]))
    return np.array(out)


@pytest.mark.parametrize(
    "true",
    [
        (1.0, 0.5, 20.0),
        (0.0, 1.0, 5.0),
        (1.0, 1.0, 0.0),
        (1.0, 0.5, 20.0, 0.0, 3.0, 1.0),
        (0.0, 0.5, 0.0, 8.0, 0.0, 1.0, 2.0),
        (1.0, 0.5, 0.0, 8.0, 0.0, 1.0, 2.0, 0.0, 3.0, 0.0),
    ],
)
def test_the_maxima_over_the_variances_are_those_of_each_spectrum_alone(true) -> None:
    """Also where a variance is zero, at the edge of what is allowed."""
    rng = np.random.default_rng(2)
    n = len(true)
    design = designs(n)
    count = np.tile(np.repeat([1.0, 4.0], BANDS // 2), 2)
    power = np.maximum(design[4] @ np.array(true), 1e-6) * rng.gamma(count, 1 / count)
    spectra = Spectra(design[4], power, count, np.tile(OMEGA, 2), OUTPUT)
    for given in (np.full(n, np.nan), np.array([0.9, *[np.nan] * (n - 1)])):
        found = likelihoods(spectra, design, given, 1e-6)
        for value, own in zip(found, design, strict=True):
            alone = replace(spectra, design=own)
            exact = whittle(alone, variances(alone, given, tolerance=1e-9))
            if n <= 3:
                assert value == pytest.approx(exact, abs=1e-3)
            else:  # a wrong spectrum has flat and several maxima: one alone may end at less
                assert value < exact + 0.05


@pytest.mark.parametrize("sources", [6, 10])
def test_a_grid_beside_several_sources_is_scored_in_one_pass(sources: int, monkeypatch) -> None:
    """Ten variances, four sensors' and two inputs' and four forces', or six of 30 spectra.

    One spectrum at a time, they took half of a diagnosis.
    """
    alone: list[tuple[np.ndarray, ...]] = []
    solve = variance_scoring.non_negative
    monkeypatch.setattr(
        variance_scoring, "non_negative", lambda *of: (alone.append(of), solve(*of))[1]
    )
    design = designs(sources)
    power = design[4] @ np.linspace(1.0, 2.0, sources)
    spectra = Spectra(design[0], power, np.ones(2 * BANDS), np.tile(OMEGA, 2), OUTPUT)
    assert np.argmin(likelihoods(spectra, design, np.full(sources, np.nan), 1e-3)) == 4
    assert len(alone) < len(design)


@pytest.mark.parametrize("unknowns", [2, 4, 6, 10])
def test_steps_of_the_scoring_are_least_squares_without_negative_unknowns(unknowns: int) -> None:
    """Of random problems, half of whose unknowns are zero at the solution."""
    rng = np.random.default_rng(unknowns)
    a, b = rng.random((200, 40, unknowns)), rng.standard_normal((200, 40))
    found = variance_scoring._least(a, b, np.ones((200, unknowns), dtype=bool))
    assert 0.2 < np.mean(found == 0.0) < 0.9
    exact = [nnls(*pair)[0] for pair in zip(a, b, strict=True)]
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_the_zeros_that_exchanging_begins_with_and_its_end_make_no_difference(monkeypatch) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.random((50, 40, 5)), rng.standard_normal((50, 40))
    soon = variance_scoring._least(a, b, np.ones((50, 5), dtype=bool))
    monkeypatch.setattr(variance_scoring, "EXCHANGES", 1)
    for kept in (np.ones((50, 5), dtype=bool), rng.random((50, 5)) > 0.5):
        np.testing.assert_allclose(variance_scoring._least(a, b, kept), soon, atol=1e-9)
