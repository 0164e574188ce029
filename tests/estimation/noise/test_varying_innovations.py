"""A filter along the path whitens as the covariance of the whole record does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casid.compiler import compiler
from casid.estimation.noise import varying_innovations as varying
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.varying_innovations import (
    PartialVarying,
    VaryingInnovations,
    smoothed_sources,
    varying_innovations,
)
from casid.estimation.noise.varying_steps import Steps
from casid.estimation.simulation.integration import machine_code

N, TS = 40, 0.5
SD = np.array([0.1, 0.3])
FORCE, WHITE, CORNER = 0.8, 0.2, 0.3
WEIGHTS = np.array([2.0, 5.0])


def steps() -> Steps:
    """Two states whose time constants and coupling change at every sample; two sources."""
    rng = np.random.default_rng(0)
    a = np.zeros((N, 2, 2))
    a[:, 0, 0], a[:, 1, 1], a[:, 1, 0] = rng.uniform(0.2, 0.9, (3, N))
    b0, b1 = rng.uniform(0.0, 1.0, (2, N, 2, 2))
    c, d = rng.standard_normal((2, N, 2, 2))
    return Steps(("u", "force"), TS, a, b0, b1, c, d)


def found() -> VaryingInnovations:
    """Of a first-order force, and of an input whose noise is white."""
    spectra = {"force": DisturbanceSpectrum(CORNER)}
    return varying_innovations(steps(), SD, {"u": WHITE, "force": FORCE}, spectra, WEIGHTS)


def moved(of: VaryingInnovations) -> tuple[np.ndarray, np.ndarray]:
    """What first states and each source at each sample move in the outputs, and their covariance.

    (2 N, 2 + 2 N) and (2 + 2 N, 2 + 2 N), the sources of a sample one after the other.
    The first state is that of the filter, and what the white source at the first sample moves.
    """
    s = steps()
    P, by_white = of.process.before, s.b1[0, :, 0]
    start = np.zeros((2, 4))  # what it has in common with itself and with the first sources
    start[:, :2] = P[:2, :2] + WHITE**2 * np.outer(by_white, by_white)
    start[:, 2], start[:, 3] = WHITE**2 * by_white, P[:2, 2]
    lags = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    own = np.zeros((2 + 2 * N, 2 + 2 * N))  # first states, then sources sample by sample
    own[2::2, 2::2] = WHITE**2 * np.eye(N)
    own[3::2, 3::2] = FORCE**2 * np.exp(-CORNER * TS * lags)
    own[:2, :2] = start[:, :2]
    own[:2, 2] = start[:, 2]
    own[:2, 3::2] = np.outer(start[:, 3], np.exp(-CORNER * TS * np.arange(N)))
    own[2:, :2] = own[:2, 2:].T
    x = np.hstack([np.eye(2), np.zeros((2, 2 * N))])
    rows = []
    for k in range(N):
        here = np.zeros((2, 2 + 2 * N))
        here[:, 2 + 2 * k : 4 + 2 * k] = np.eye(2)
        rows.append(s.c[k] @ x + s.d[k] @ here)
        ahead = np.roll(here, 2, axis=1)
        x = s.a[k] @ x + s.b0[k] @ here + s.b1[k] @ ahead
    return np.concatenate(rows), own


def covariance(of: VaryingInnovations) -> np.ndarray:
    """(2 N, 2 N) of the outputs times their weights."""
    gain, own = moved(of)
    whole = gain @ own @ gain.T + np.diag(np.tile(SD**2, N))
    scale = np.tile(WEIGHTS, N)
    return whole * np.outer(scale, scale)


def test_the_sum_of_squares_and_the_determinant_are_those_of_the_whole_record():
    of = found()
    whole = covariance(of)
    r = np.random.default_rng(1).standard_normal((N, 2, 3))
    flat = r.reshape(2 * N, 3)
    e = of.whiten(r).reshape(2 * N, 3)
    assert e.T @ e == pytest.approx(flat.T @ np.linalg.solve(whole, flat), rel=1e-8)
    assert of.log_determinant(N) == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-6)


needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")


@pytest.fixture
def own_recursions() -> Iterator[None]:
    """Recursions that no other test takes."""
    varying.recursion.cache_clear()
    yield
    varying.recursion.cache_clear()


def filtered_by(way: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Take one way of the recursion: machine code, CasADi in blocks (the last not full), NumPy."""
    monkeypatch.setenv("CASID_CACHE", str(folder) if way == "compiled" else "")
    monkeypatch.setattr(machine_code, "OPTIMISED_AFTER", (1, 0, 1, 1))
    monkeypatch.setattr(varying, "BLOCK", 16)
    if way == "numpy":
        monkeypatch.setattr(varying, "WRITTEN_OUT", 0)


WAYS = [pytest.param("compiled", marks=needs_compiler), "interpreted", "numpy"]


@pytest.mark.usefixtures("own_recursions")
@pytest.mark.parametrize("way", WAYS[:2])
def test_a_recursion_that_is_written_out_is_that_of_matrices(
    way: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    with monkeypatch.context() as patch:
        filtered_by("numpy", patch, tmp_path)
        many = found()
    varying.recursion.cache_clear()
    filtered_by(way, monkeypatch, tmp_path)
    few = found()
    assert bool(list(tmp_path.glob("steps/*.so"))) == (way == "compiled")
    r = np.random.default_rng(5).standard_normal((N, 2, 3))
    assert few.whiten(r) == pytest.approx(many.whiten(r), rel=1e-10, abs=1e-12)
    assert few.log_determinant(N) == pytest.approx(many.log_determinant(N), rel=1e-12)


@pytest.mark.usefixtures("own_recursions")
@pytest.mark.parametrize("way", WAYS)
def test_a_variance_below_zero_is_refused(
    way: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    filtered_by(way, monkeypatch, tmp_path)
    process = found().process
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        VaryingInnovations(replace(process, white=-1e6 * process.white))


def test_the_transpose_is_that_of_the_filter():
    of = found()
    every = np.eye(2 * N).reshape(N, 2, 2 * N)
    filtered = of.whiten(every).reshape(2 * N, 2 * N)
    assert of.transposed(every).reshape(2 * N, 2 * N) == pytest.approx(filtered.T, abs=1e-12)


def test_a_part_of_a_record_follows_its_own_part_of_the_path():
    of = found()
    r = np.random.default_rng(2).standard_normal((N, 2, 1))
    part = of.cut(slice(25, N)).whiten(r[25:])
    assert part[-3:] == pytest.approx(of.whiten(r)[-3:], rel=0.02, abs=0.02)
    assert part[-3:] != pytest.approx(of.cut(slice(0, 15)).whiten(r[25:])[-3:], rel=0.02, abs=0.02)


def test_no_columns_are_filtered_to_none():
    of = found()
    assert of.whiten(np.zeros((N, 2, 0))).shape == (N, 2, 0)
    assert of.transposed(np.zeros((N, 2, 0))).shape == (N, 2, 0)


def test_samples_that_are_missing_between_others_count_for_nothing():
    of = found()
    used = np.random.default_rng(3).random((N, 2)) > 0.2
    used[10:15] = False
    there = used.ravel()
    whole = covariance(of)[np.ix_(there, there)]
    r = np.random.default_rng(4).standard_normal((N, 2, 3))
    flat = r.reshape(2 * N, 3)[there]
    partial = PartialVarying(of, used)
    e = partial.whiten(r)
    assert not e[~used].any()
    squares = np.einsum("kic,kid->cd", e, e)
    assert squares == pytest.approx(flat.T @ np.linalg.solve(whole, flat), rel=1e-8)
    assert partial.log_determinant(N) == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-6)
    assert partial.seen(of.whiten(r)) == pytest.approx(e, abs=1e-9)


def test_a_white_source_is_expected_to_be_what_its_covariance_with_the_outputs_says():
    """Also where samples are missing."""
    used = np.random.default_rng(6).random((N, 2)) > 0.2
    whole = found()
    gain, own = moved(whole)
    there = used.ravel()
    scale = np.tile(WEIGHTS, N)
    with_outputs = (own[2::2] @ gain.T * scale)[:, there]
    r = np.random.default_rng(7).standard_normal((N, 2, 1))
    inverse = np.linalg.solve(covariance(whole)[np.ix_(there, there)], r.ravel()[there])
    of = VaryingInnovations(whole.process, used)
    expected = smoothed_sources(of, steps(), {"u": WHITE}, WEIGHTS, r)
    assert expected["u"] == pytest.approx(with_outputs @ inverse, rel=1e-6, abs=1e-9)
