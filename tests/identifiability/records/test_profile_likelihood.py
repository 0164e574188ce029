"""Profile likelihoods are parabolas, bends, half-open valleys and flats where theory says so."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import chi2

import casid
from casid.errors import DataError, ModelError
from casid.identifiability.records.practical import practical_identifiability
from casid.identifiability.records.profile_likelihood import profile_likelihood
from tests.support.excited_models import decay, inputs, integrator, regressor

ONE = casid.FitSettings(starts=1, substeps=1)


def measured(model_and_record, y, noise: float, seed: int = 3):
    model, record = model_and_record
    rng = np.random.default_rng(seed)
    return model, record.with_channel("y", y + noise * rng.standard_normal(record.N), "m")


def exponential(T: float, *, p: float = 0.5, noise: float = 0.05, gains: int = 1):
    model, record = decay(T=T, gains=gains)
    return measured((model, record), 2.0**gains * np.exp(-p * record.t), noise)


def test_the_profile_of_a_linear_model_is_the_parabola_of_its_standard_error():
    """Deviance ((c - a_hat) / s)^2, s^2 from (Phi'Phi)^-1 sigma^2: the interval is a_hat +- z s."""
    record, sigma = inputs(), 0.3
    Phi = regressor(record)
    model, record = measured((integrator(), record), Phi @ [2.0, -3.0], sigma)
    r = profile_likelihood(model, record, noise={"y": sigma}, settings=ONE)
    theta = np.linalg.lstsq(Phi, record["y"], rcond=None)[0]
    sd = sigma * np.sqrt(np.diag(np.linalg.inv(Phi.T @ Phi)))
    z = np.sqrt(chi2.ppf(0.95, 1))
    for p, centre, s in zip(r, theta, sd, strict=True):
        assert p.kind == "identifiable"
        assert p.best == pytest.approx(centre, rel=1e-6)
        assert (p.lower, p.upper) == pytest.approx((centre - z * s, centre + z * s), abs=1e-3 * s)
        np.testing.assert_allclose(p.deviance, ((p.grid - centre) / s) ** 2, atol=1e-4)
        # the other parameter moves along: the path is the regression of the rest
        other = 1 - r.names.index(p.name)
        slope = -(Phi[:, other] @ Phi[:, 1 - other]) / (Phi[:, other] @ Phi[:, other])
        expected = theta[other] + slope * (p.grid - centre)
        np.testing.assert_allclose(p.path[:, other], expected, atol=1e-3 * sd[other])


def test_profiles_are_shown_in_the_units_that_the_model_declares_and_kept_in_si():
    m = casid.Model("decay")
    x, tau = m.state("x", "m", start=1.0), m.parameter("tau", "min", start=0.1, lower=0.01)
    m.derivative(x, -x / tau)
    m.output("y", x, "mm")
    _, record = exponential(6.0, p=0.1)
    found = profile_likelihood(m, record, noise={"y": 50.0}, settings=ONE)
    p = found["tau"]
    assert p.shown == pytest.approx((p.best / 60, p.lower / 60, p.upper / 60))
    shown = str(found)
    assert f"tau  {p.best / 60:.6g} min  {p.lower / 60:.6g} to {p.upper / 60:.6g}" in shown
    assert "noise  y 50 mm" in shown
    (panel,) = found.plot().data
    np.testing.assert_allclose(panel.x, p.grid / 60)
    assert found.plot().layout.xaxis.title.text == "tau [min]"
    content = found.to_json()["profiles"][0]
    assert (content["unit"], content["best"]) == ("s", p.best)


def test_a_wider_confidence_gives_a_wider_interval():
    model, record = exponential(6.0)
    narrow, wide = (
        profile_likelihood(model, record, ["p"], confidence=c, noise={"y": 0.05}, settings=ONE)["p"]
        for c in (0.68, 0.99)
    )
    assert wide.lower < narrow.lower < narrow.best < narrow.upper < wide.upper
    assert narrow.threshold == pytest.approx(chi2.ppf(0.68, 1))


def test_what_no_data_will_tell_has_a_flat_profile():
    """y = g1 g2 x: the other gain makes up for every value of the first (Raue et al. 2009)."""
    model, record = exponential(6.0, gains=2)
    r = profile_likelihood(model, record, ["g1", "p"], noise={"y": 0.05}, settings=ONE)
    g = r["g1"]
    assert g.kind == "flat"
    product = g.path[:, r.names.index("g1")] * g.path[:, r.names.index("g2")]
    inside = g.path[:, r.names.index("g2")] < 49.9  # its bound
    np.testing.assert_allclose(product[inside], product[0], rtol=1e-4)
    assert g.deviance[inside].max() < 1e-3
    assert r["p"].kind == "identifiable"
    practical = practical_identifiability(model, record, noise={"y": 0.05})
    assert practical["g1"].verdict == "not seen by this record"


def test_what_a_short_record_hardly_tells_has_an_open_interval():
    """Identifiable by structure, and practically not: the interval of p reaches its bound at 0."""
    model, record = exponential(0.6, noise=0.5)
    r = profile_likelihood(model, record, ["p"], noise={"y": 0.5}, settings=ONE)["p"]
    assert r.kind == "practically non-identifiable"
    assert r.lower == -np.inf
    assert r.grid[0] == 0.0
    assert "open below" in r.note
    assert r.deviance.max() > 1e-2  # it is no flat
    verdict = practical_identifiability(model, record, noise={"y": 0.5})["p"].verdict
    assert verdict == "poorly determined"
    enough = profile_likelihood(*exponential(20.0, noise=0.2), ["p"], noise={"y": 0.2})["p"]
    assert enough.kind == "identifiable"


def test_an_exact_interval_of_one_parameter_is_found_where_the_model_is_curved():
    """One unknown, so the profile is the deviance itself: its roots by bisection."""
    from scipy.optimize import brentq

    model, record = exponential(3.0, noise=0.3)
    model = model.with_known(g1=2.0)
    r = profile_likelihood(model, record, noise={"y": 0.3}, settings=ONE)["p"]

    def deviance(p: float) -> float:
        e = record["y"] - 2.0 * np.exp(-p * record.t)
        best = record["y"] - 2.0 * np.exp(-r.best * record.t)
        return float((e @ e - best @ best) / 0.3**2 - r.threshold)

    # the end points are left when the deviance is within 1 % of the threshold: 0.5 % of the half
    assert r.lower == pytest.approx(brentq(deviance, 0.0, r.best), abs=0.01 * (r.best - r.lower))
    assert r.upper == pytest.approx(brentq(deviance, r.best, 5.0), abs=0.01 * (r.upper - r.best))
    assert r.upper - r.best > 1.02 * (r.best - r.lower)  # no parabola


def test_the_figure_shows_the_threshold_and_escapes_names():
    r = profile_likelihood(*exponential(6.0), noise={"y": 0.05}, settings=ONE)
    figure = r.plot()
    assert len(figure.data) == 2
    assert "identifiable" in figure.layout.meta["caption"]
    assert any(s.y0 == pytest.approx(chi2.ppf(0.95, 1)) for s in figure.layout.shapes)


def test_the_result_is_plain_json_with_none_for_an_open_end():
    model, record = exponential(0.6, noise=0.5)
    r = profile_likelihood(model, record, ["p"], noise={"y": 0.5}, settings=ONE)
    content = json.loads(json.dumps(r.to_json(), allow_nan=False))
    assert content["profiles"][0]["lower"] is None
    assert content["profiles"][0]["kind"] == "practically non-identifiable"
    assert "The interval assumes" in str(r)


def test_refusals_say_what_to_do():
    model, record = exponential(6.0)
    with pytest.raises(ModelError, match=r"no such unknown; unknown are p, g1"):
        profile_likelihood(model, record, ["g"], settings=ONE)
    with pytest.raises(DataError, match="give at least 3 points"):
        profile_likelihood(model, record, points=1)
    with pytest.raises(DataError, match="use segments=1"):
        profile_likelihood(model, record, settings=casid.FitSettings(segments=4))
