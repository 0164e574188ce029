"""A slow force where the throughput varies is a disturbance, and no function of the flow."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.residual.residual_tests import NOISE, residual_tests
from casid.diagnosis.evidence.whitening import prewhitening
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from tests.support import ventilated_room

TS, N = 30.0, 1000
VOLUME, RATE = 2e-3, 1.3e-3


def vessel() -> casid.Model:
    """What flows in is converted at a rate; substrate and product are measured."""
    m = casid.Model("vessel")
    s, p = m.state("s", "mol/m^3"), m.state("p", "mol/m^3")
    feed = m.input("feed", "mol/m^3", hold="zoh", known=True)
    flow = m.input("flow", "m^3/s", hold="zoh", known=True)
    volume = m.constant("V", VOLUME, "m^3")
    k = m.parameter("k", "1/s", start=1e-3, lower=0.0, upper=0.1)
    m.balance(s, "substrate", inertia=volume, terms=[flow * (feed - s), -k * volume * s])
    m.balance(p, "product", inertia=volume, terms=[-flow * p, k * volume * s])
    m.output("s", s, "mol/m^3")
    m.output("p", p, "mol/m^3")
    return m


def record(seed: int, flows: tuple[float, float]) -> casid.Record:
    """Steps of feed and flow, and a leak of substrate that wanders over a quarter of an hour."""
    rng = np.random.default_rng(seed)
    feed = np.repeat(rng.uniform(4.0, 24.0, N // 50), 50)
    flow = np.repeat(rng.uniform(*flows, N // 40), 40) / 60e3
    share = np.exp(-TS / 900.0)
    force, x, out = 0.0, np.array([6.0, 4.0]), np.empty((N, 2))
    for i in range(N):
        out[i] = x
        out_by = flow[i] / VOLUME
        step = TS / 10
        for _ in range(10):
            r = RATE * x[0]
            x = x + step * np.array([out_by * (feed[i] - x[0]) - r + force, r - out_by * x[1]])
        force = share * force + 8e-4 * np.sqrt(1 - share**2) * rng.standard_normal()
    out += 0.08 * rng.standard_normal(out.shape)
    columns = {"feed": feed, "flow": flow, "s": out[:, 0], "p": out[:, 1]}
    units = {"feed": "mol/m^3", "flow": "m^3/s", "s": "mol/m^3", "p": "mol/m^3"}
    return casid.Record(columns, units, Ts=TS)


def under_disturbance(flows: tuple[float, float]) -> tuple[Weighted, list[casid.Experiment]]:
    experiments = [casid.Experiment(record(3, flows), {}, "r")]
    criterion = SimulationError(vessel(), experiments)
    fit = minimize_simulation_error(criterion)
    return Weighing(experiments).with_disturbances().weigh(fit.criterion.model, fit), experiments


def test_the_residual_under_a_response_that_varies_is_white():
    """By the average response it was none, and passed for a function of what changed it."""
    at, experiments = under_disturbance((0.06, 0.30))
    assert "substrate" in at.noise.spectra
    tests = residual_tests(at, experiments, alpha=0.01)
    assert tests.verdict == NOISE
    assert tests.p_spectrum > 0.01
    k = (at.unbiased or at.fit).values["k"]
    assert k == pytest.approx(RATE, rel=0.03)


def test_held_out_parts_of_a_record_are_whitened_by_the_average_response():
    """Their path is another one, of perhaps as many samples."""
    at, _ = under_disturbance((0.06, 0.30))
    assert at.noise.varying
    assert not at.noise.averaged().varying
    assert not at.noise.quiet({}).varying


def test_a_response_that_hardly_varies_stays_the_average():
    at, _ = under_disturbance((0.175, 0.185))
    assert "substrate" in at.noise.spectra
    assert not at.noise.varying


def test_noise_of_an_input_that_is_multiplied_is_no_force_that_comes_and_goes():
    """By the average response a force in its balance fits as well; along the path it does not."""
    for seed in range(3):
        experiments = [casid.Experiment(ventilated_room.record(seed), {}, "r")]
        criterion = SimulationError(ventilated_room.model(), experiments)
        fit = minimize_simulation_error(criterion)
        weighing = Weighing(experiments).with_disturbances()
        at = weighing.weigh(fit.criterion.model, fit)
        assert at.noise.varying
        assert at.noise.source_sd["room"] == 0.0
        # The floor of 1440 samples has a standard error of 4 %, steps leave 2 %.
        assert at.noise.source_sd["supply"] * 3600 == pytest.approx(
            ventilated_room.NOISE, rel=3 * 0.04 + 0.02
        )
        tests = residual_tests(at, experiments, alpha=0.01)
        assert tests.verdict == NOISE


@pytest.mark.parametrize(("length", "varying"), [(26.0, 0), (24.0, 9)])
def test_far_from_the_root_without_bias_the_noise_is_that_of_an_average_response(
    monkeypatch, length, varying
):
    """Beyond 25 standard errors nothing is linear, and the noise there is estimated again.

    A filter along the record is most of what that estimate costs. The search is given up after
    nine steps that come no nearer, here of nought, whose lengths are pretended.
    """
    experiments = [casid.Experiment(record(3, (1.0, 3.0)), {}, "r")]
    model = vessel()
    model.inputs["feed"] = dataclasses.replace(model.inputs["feed"], kind="measured")
    fit = minimize_simulation_error(SimulationError(model, experiments))
    weighing, counted = Weighing(experiments, known_noise={"feed": 0.1}), []
    found = dataclasses.replace(weighing.estimated(fit), input_sd={"feed": 0.1})
    monkeypatch.setattr(
        prewhitening,
        "step_without_bias",
        lambda criterion, x, *_, **__: SimpleNamespace(x=x, length=length, value=np.inf),
    )
    own = prewhitening.with_varying_response

    def counting(*args, **settings):
        counted.append(args)
        return own(*args, **settings)

    monkeypatch.setattr(prewhitening, "with_varying_response", counting)
    assert weighing._without_bias(found) is None
    assert len(counted) == varying
