"""A diagnosis of records whose noise grows with the reading: a dose that is cleared."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import casid
from casid.estimation.holdout import Split, split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import signals_of
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.sized_noise import with_noise_sizes


def cleared(seed: int, *, share: float = 0.08, M: int = 60) -> casid.Record:
    """Two doses of 100 mg into 10 l, cleared at 0.3 1/h; samples by an assay of `share` noise."""
    rng = np.random.default_rng(seed)
    N, h = 480, 0.05
    doses = np.zeros(N)
    doses[0], doses[240] = 2000.0, 2000.0  # mg/h for one sample of 0.05 h
    c = 0.0
    y = np.empty(N)
    for k in range(N):
        y[k] = c
        for _ in range(20):
            c += h / 20 * (doses[k] / 10 - 0.3 * c)
    y *= 1 + share * rng.standard_normal(N)
    record = casid.Record(
        {"dose": doses / 3.6e9, "c": y * 1e-3}, {"dose": "kg/s", "c": "kg/m^3"}, Ts=180.0
    )
    there = np.zeros(N, dtype=bool)
    there[np.sort(rng.choice(np.arange(1, N), M, replace=False))] = True
    return record.mark_missing("c", ~there)


def problem() -> casid.Problem:
    m = casid.Model("drug")
    c = m.state("c", "mg/l", initial=0.0)
    dose = m.input("dose", "mg/h", hold="zoh", known=True)
    V = m.parameter("V", "l", start=8.0, lower=1.0, upper=100.0)
    k = m.parameter("k", "1/h", start=0.2, lower=0.0, upper=5.0)
    m.balance(c, "mass", inertia=V, terms=[dose, -k * V * c])
    m.output("c", c, "mg/l")
    return casid.Problem("drug", m, starts=1)


def fitted(record: casid.Record) -> tuple[Fit, Split]:
    split = split_records([casid.Experiment(record)], 0.3)
    return fit_model(problem().model, split.fitted, FitSettings(starts=1)), split


SLOW = pytest.mark.slow


@pytest.mark.parametrize("seed", [1, pytest.param(0, marks=SLOW), pytest.param(7, marks=SLOW)])
def test_large_readings_are_no_outliers(seed: int):
    """Sixty samples of an adequate model under noise of 8 %; of one size it had outliers in these.

    An estimate of 8 % from 60 samples has a standard error of 0.7 %.
    """
    found = casid.diagnose(problem(), cleared(seed), hold_out=0.0, advise=False, max_causes=1)
    assert found.verdict == "adequate", found.sentence
    text = found.evidence.noise["c"]
    assert "of the reading" in text
    assert float(text.split("noise ")[1].split(" %")[0]) == pytest.approx(8.0, abs=3 * 0.7)
    assert any("noise of c grows with the reading" in note for note in found.limits.notes)


def test_sizes_are_those_of_the_simulation_and_reach_into_what_is_held_out():
    """Over the RMS size of what is fitted; a stated noise stays as stated."""
    fit, split = fitted(cleared(1))
    sized, names = with_noise_sizes(fit, split)
    assert names == ("c",)
    sizes = sized.whole[0].noise_sizes["c"]
    d = signals_of(problem().model, sized.fitted[0])
    assert d.sizes is not None
    assert np.mean(d.sizes[d.used[:, 0], 0] ** 2) == pytest.approx(1.0)
    assert len(sizes.t) == cleared(1).N
    # Clearance over 2 h from the second dose, in the held-out end: a factor of exp(0.6).
    ratio = (sizes.relative[400] ** 2 - sizes.at_zero**2) / (
        sizes.relative[440] ** 2 - sizes.at_zero**2
    )
    assert np.sqrt(ratio) == pytest.approx(np.exp(fit.values["k"] * 7200), rel=0.01)
    assert with_noise_sizes(fit, split, {"c"}) == (split, ())


def test_errors_and_their_derivatives_count_in_sizes_of_the_noise():
    """Residual and tangent over the size; the criterion without derivatives is the same."""
    fit, split = fitted(cleared(1))
    plain = SimulationError(problem().model, split.fitted, start=fit.values)
    of_sizes = plain.of_records(with_noise_sizes(fit, split)[0].fitted, start=fit.values)
    sizes = of_sizes.data[0].sizes
    x = plain.start
    a, b = plain.simulated(x, 0), of_sizes.simulated(x, 0)
    assert b.residual == pytest.approx(a.residual / sizes)
    assert b.jacobian == pytest.approx(a.jacobian / sizes[:, :, None])
    assert of_sizes.value_alone(x) == pytest.approx(of_sizes.evaluate(x).value, rel=1e-12)


def test_an_estimate_counts_small_readings_as_exactly_as_they_are():
    """A rate of clearance from readings down to 0.3 mg/l: noise of one size hides most of those.

    With log c known to 8 % at 60 instants spread over 0 to 12 h behind each dose (variance 12 h^2,
    once per dose about its own start), k is known to about 0.08 / sqrt(60 * 12) = 0.003 1/h.
    """
    record = cleared(1)
    estimate = casid.identify(problem(), record, intervals="quick")
    assert any("noise of c grows with the reading" in text for text in estimate.warnings)
    error = estimate.parameter("k").std_error
    assert 0.7 * 0.003 < error < 1.3 * 0.003
    assert abs(estimate["k"] - 0.3) < 3 * error
    stated = dataclasses.replace(problem(), noise={"c": 2e-4})
    of_one_size = casid.identify(stated, record, intervals="quick")
    assert of_one_size.parameter("k").std_error > 1.5 * error
