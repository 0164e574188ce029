"""One force in two or three balances, from the cross-spectra of the residuals that it leaves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import casid
from casid.arrays import Array
from casid.estimation.disturbances.common_disturbance import CommonSearch, name_of_common
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum, Part
from casid.estimation.noise.joined_sources import joined_steps
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.source_spectra import SourceSpectra
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.noise.varying_steps import Steps
from casid.estimation.noise.whittle_scoring import of_spectra
from casid.estimation.simulation.fit import FitSettings, fit_model

TS, N, SD, CORNER = 0.1, 3000, 0.002, 0.5
RATES = {"a": 1.0, "b": 0.4, "c": 0.15}


def chain(zones: str) -> casid.Model:
    """Stores side by side, x' = -k x + 0.3 (x of the next one - x) + force."""
    m = casid.Model("chain")
    states = [m.state(f"x_{z}", "m") for z in zones]
    for i, (z, x) in enumerate(zip(zones, states, strict=True)):
        k = m.constant(f"k_{z}", RATES[z], "1/s")
        near = [states[j] for j in (i - 1, i + 1) if 0 <= j < len(zones)]
        terms = [-k * x, *(0.3 * (other - x) for other in near)]
        m.balance(x, z, inertia=1, terms=terms, unit="m/s")
        m.output(f"y_{z}", x, "m")
    return m


def coloured(rng: np.random.Generator, n: int, step: float) -> Array:
    pole = np.exp(-CORNER * step)
    drawn = rng.standard_normal(n + 500) * np.sqrt(1 - pole**2)
    return np.asarray(lfilter([1.0], [1.0, -pole], drawn)[500:])


def noise_of(forces: Array, zones: str = "ab", missing: float = 0.0):
    """The noise found in a record that these forces (5 N, zones) move, each held a fifth of TS."""
    rng, n = np.random.default_rng(0), len(zones)
    a = -np.diag([RATES[z] for z in zones])
    for i in range(n):
        for j in (i - 1, i + 1):
            if 0 <= j < n:
                a[i, j] += 0.3
                a[i, i] -= 0.3
    step = expm(np.block([[a, np.eye(n)], [np.zeros((n, 2 * n))]]) * TS / 5)[:n]
    x, rows = np.zeros(n), []
    for force in forces:
        rows.append(x)
        x = step[:, :n] @ x + step[:, n:] @ force
    y = np.array(rows)[::5] + SD * rng.standard_normal((N, n))
    channels = {f"y_{z}": y[:, i] for i, z in enumerate(zones)}
    record = casid.Record(channels, dict.fromkeys(channels, "m"), Ts=TS)
    if missing:
        record = record.mark_missing("y_a", rng.random(N) < missing)
    fit = fit_model(chain(zones), [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    white = estimate_noise(fit.criterion, fit.x)
    return fit, with_disturbance_spectra(white, fit.criterion, fit.x)


def common(noise: NoiseModel) -> DisturbanceSpectrum | None:
    return next((s for s in noise.spectra.values() if s.parts), None)


@pytest.mark.parametrize(("ratio", "missing"), [(0.6, 0.0), (-1.5, 0.0), (0.6, 0.05)])
def test_one_force_in_two_balances_has_its_ratio_and_size(ratio, missing):
    """Beside forces of a third of its size, independent and white, in either balance."""
    rng = np.random.default_rng(1)
    force = 0.1 * coloured(rng, 5 * N, TS / 5)
    own = 0.03 * np.repeat(rng.standard_normal((N, 2)), 5, axis=0)
    _, noise = noise_of(force[:, None] * [1.0, ratio] + own, missing=missing)
    found = common(noise)
    assert found is not None
    assert [p.place for p in found.parts] == ["a", "b"]
    assert found.parts[0].ratio == 1.0
    assert 0.0 < found.parts[1].error < 0.1 * abs(ratio)
    assert found.parts[1].ratio == pytest.approx(ratio, abs=3 * found.parts[1].error)
    assert found.frequency == pytest.approx(CORNER, rel=0.4)  # of 24 of its periods
    name = name_of_common(found.parts)
    assert noise.source_sd[name] == pytest.approx(0.1, rel=0.25)
    assert (name,) in noise.alike


def test_independent_forces_of_one_spectrum_are_not_one_force():
    rng = np.random.default_rng(2)
    forces = np.column_stack([coloured(rng, 5 * N, TS / 5) for _ in range(2)])
    _, noise = noise_of(0.1 * forces)
    assert noise.spectra
    assert common(noise) is None


def test_one_force_may_act_in_three_balances():
    rng = np.random.default_rng(3)
    ratios = [1.0, -0.7, 0.5]
    _, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * ratios, "abc")
    found = common(noise)
    assert found is not None
    parts = {p.place: p.ratio / found.parts[0].ratio for p in found.parts}
    assert parts.keys() == {"a", "b", "c"}
    size = parts["a"]
    assert [parts[z] / size for z in "abc"] == pytest.approx(ratios, rel=0.1)


def test_a_force_that_was_found_nearby_keeps_its_places_and_has_its_ratio_anew():
    rng = np.random.default_rng(1)
    fit, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * [1.0, 0.6])
    (name,) = noise.spectra
    off = dataclasses.replace(noise.spectra[name], parts=(Part("a", 1.0), Part("b", 0.75)))
    white = estimate_noise(fit.criterion, fit.x)
    again = with_disturbance_spectra(white, fit.criterion, fit.x, near={name: off})
    (found,) = again.spectra.values()
    assert found.parts[1].ratio == pytest.approx(noise.spectra[name].parts[1].ratio, rel=1e-2)
    assert again.source_sd[name] == pytest.approx(noise.source_sd[name], rel=2e-2)
    apart = with_disturbance_spectra(white, fit.criterion, fit.x, has_common=False)
    assert apart.spectra
    assert common(apart) is None


def test_the_ratio_of_a_common_force_keeps_its_error_where_only_its_spectrum_is_sought():
    rng = np.random.default_rng(1)
    fit, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * [1.0, 0.6])
    (name,) = noise.spectra
    outputs, sizes = fit.criterion.outputs, (noise.output_sd, noise.source_sd)
    of = SourceSpectra(outputs, *sizes, noise.spectra, ({}, {}))
    _, _, spectra = of.read(of.start)
    assert spectra[name].parts[1].error == noise.spectra[name].parts[1].error > 0.0


def test_a_common_force_that_comes_to_nothing_in_its_search_is_none(
    monkeypatch: pytest.MonkeyPatch,
):
    """What is left of it may be likelier, with fewer spectra; it is widened no further."""
    rng = np.random.default_rng(1)
    fit, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * [1.0, 0.6])
    white = estimate_noise(fit.criterion, fit.x)
    residual = fit.criterion.simulated(fit.x, 0).residual
    search = CommonSearch(white, [residual], [TS], list(fit.criterion.outputs), "ab", ({}, {}))
    apart = dataclasses.replace(white, spectra={"a": DisturbanceSpectrum(0.4)})
    nothing = dataclasses.replace(
        search.fitted(white.output_sd, white.source_sd, {}), criterion=-np.inf
    )
    monkeypatch.setattr(CommonSearch, "_best_of_pair", lambda *_: nothing)
    assert search.best(apart) is None


def test_its_residuals_are_white_and_independent_under_its_noise_alone():
    """What it moves in two outputs is coherent: independent forces leave that in them."""
    rng = np.random.default_rng(4)
    fit, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * [1.0, 0.6])
    criterion = fit.criterion
    white = estimate_noise(criterion, fit.x)
    apart = with_disturbance_spectra(white, criterion, fit.x, has_common=False)
    residual = criterion.simulated(fit.x, 0).residual * criterion.weights
    for of, is_independent in ((noise, True), (apart, False)):
        left = of.whiten(residual[:, :, None], 0)[:, :, 0]
        correlation = np.corrcoef(left.T)[0, 1]
        assert (abs(correlation) < 4 / np.sqrt(N)) == is_independent


def test_the_gradient_and_the_slopes_are_those_of_the_likelihood():
    rng = np.random.default_rng(5)
    fit, noise = noise_of(0.1 * coloured(rng, 5 * N, TS / 5)[:, None] * [1.0, 0.6])
    white = estimate_noise(fit.criterion, fit.x)
    residual = fit.criterion.simulated(fit.x, 0).residual
    search = CommonSearch(white, [residual], [TS], list(fit.criterion.outputs), "ab", ({}, {}))
    ((power, count, r),) = search._seen
    shape = DisturbanceSpectrum(0.4, 0.3, parts=(Part("a", 1.0), Part("b", 0.5)))
    sd = {"a": 0.01, "b": 0.02, "a and b": 0.1}
    of = SourceSpectra(fit.criterion.outputs, noise.output_sd, sd, {"a and b": shape}, ({}, {}))
    assert [e.kind for e in of.entries].count("ratio") == 1

    def value(phi: Array) -> float:
        at = of_spectra(phi, *of.at(phi, r, TS), count, power)
        assert at is not None
        return at.value

    at = of_spectra(of.start, *of.at(of.start, r, TS), count, power)
    assert at is not None
    for k in range(len(of.start)):
        h = np.zeros(len(of.start))
        h[k] = 1e-5
        slope = (value(of.start + h) - value(of.start - h)) / 2e-5
        assert at.gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-2)


def test_a_source_that_enters_several_places_enters_by_the_sum_of_its_parts():
    rng = np.random.default_rng(6)
    b0, b1, d = (rng.standard_normal((4, rows, 2)) for rows in (3, 3, 1))
    steps = Steps(("a", "b"), TS, np.zeros((4, 3, 3)), b0, b1, np.zeros((4, 1, 3)), d)
    shape = DisturbanceSpectrum(1.0, parts=(Part("a", 1.0), Part("b", -2.0)))
    both = joined_steps(steps, {"a and b": shape, "a": DisturbanceSpectrum(2.0)})
    assert both.sources == ("a", "b", "a and b")
    for before, after in ((b0, both.b0), (b1, both.b1), (d, both.d)):
        assert np.allclose(after[:, :, 2], before[:, :, 0] - 2.0 * before[:, :, 1])
