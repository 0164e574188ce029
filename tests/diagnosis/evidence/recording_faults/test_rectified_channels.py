"""A channel that shows sizes is found where the model as it is fits next to nothing of it.

J w' = K u - d w with a tachometer that shows |w|, by exact steps of a held voltage.
"""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.baseline import Baseline, fit_baseline
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.holdout import split_records
from casid.model.effects.channels.sensor_effects import rectified, sensor_effects_of
from casid.model.effects.effect import Sizes

J, K, D = 2e-3, 0.06, 2.5e-3  # kg m^2, N m/V, N m s/rad
TS, NOISE = 0.02, 0.5  # s, rad/s


def drive() -> casid.Problem:
    m = casid.Model("drive")
    w, u = m.state("omega", "rad/s"), m.input("u", "V", hold="zoh", known=True)
    k = m.parameter("K", "N m/V", start=0.04, lower=1e-4, upper=1.0)
    d = m.parameter("d", "N m s/rad", start=2e-3, lower=0.0, upper=0.1)
    m.balance(w, "torque", inertia=m.constant("J", J, "kg m^2"), terms=[k * u, -d * w])
    m.output("w", w, "rad/s")
    return casid.Problem("drive", m)


def record(shown: str, *, first: float = 0.0, N: int = 800) -> casid.Record:
    """What the tachometer makes of the speed: the size, the speed, or no reverse."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-10.0, 10.0, N // 40), 40)
    w, decay = np.empty(N), np.exp(-D * TS / J)
    w[0] = first
    for n in range(N - 1):
        w[n + 1] = K / D * u[n] + (w[n] - K / D * u[n]) * decay
    show = {"size": np.abs, "speed": np.copy, "forward": lambda w: np.maximum(w, 0.0)}[shown]
    y = show(w) + NOISE * rng.standard_normal(N)
    return casid.Record({"u": u, "w": y}, {"u": "V", "w": "rad/s"}, TS)


def baseline(shown: str, *, first: float = 0.0, without: tuple[str, ...] = ()) -> Baseline:
    settings = DiagnosisSettings(without=without, fit=casid.FitSettings(starts=1))
    split = split_records([casid.Experiment(record(shown, first=first))], 0.3)
    return fit_baseline(drive(), split, settings)


@pytest.mark.parametrize("first", [0.0, pytest.param(-80.0, marks=pytest.mark.slow)])
def test_a_tachometer_without_a_sign_is_found_before_anything_else(first: float) -> None:
    """Whichever way it turns when the record begins: its size does not say."""
    found = baseline("size", first=first)
    assert found.rectified is not None
    assert found.rectified.channel == "w"
    assert found.rectified.p_value < 1e-4
    assert not found.why_undecided
    values, before = found.fit.values, found.reported_fit.values
    # Of 560 samples: a percent of K is 2 rad/s in a speed of 140 rad/s.
    assert values["K"] == pytest.approx(K, rel=2e-3)
    assert values["d"] == pytest.approx(D, rel=4e-3)
    assert before["K"] < 0.1 * K
    assert found.start.noise.output_sd == pytest.approx([NOISE], rel=0.1)


@pytest.mark.parametrize("shown", ["speed", "forward"])
def test_what_is_cut_off_or_has_its_sign_shows_no_sizes(shown: str) -> None:
    """A sensor that shows nothing of the reverse is as far from the size as from the speed."""
    assert baseline(shown).rectified is None


def test_without_the_kind_no_channel_shows_sizes() -> None:
    assert baseline("size", without=("rectified",)).rectified is None


def test_noise_may_take_a_size_below_zero_and_a_size_has_none_of_its_own() -> None:
    model = drive().model

    def kinds(of: casid.Model, low: float) -> list[str]:
        sizes = Sizes({}, {}, (0.0, 1.0), 1.0, readings={"w": (low, 200.0)})
        return [e.kind for e in sensor_effects_of(of, sizes)]

    assert "rectified" in kinds(model, -2.0)
    assert "rectified" not in kinds(model, -50.0)
    assert "rectified" not in kinds(model, 50.0)  # the size of what changes its sign comes to zero
    assert "rectified" not in kinds(model.extend(rectified(model, "w")), -2.0)


@pytest.mark.slow
def test_a_tachometer_without_a_sign_is_the_cause_and_the_parameters_are_right() -> None:
    found = casid.diagnose(drive(), record("size", N=1600), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("rectified", "w")]
    assert [(p.name, p.value) for p in found.causes[0].parameters] == [("rectified_w", 1.0)]
    assert "shows the absolute value" in found.sentence
    assert found.extended is not None
    for name, value in (("K", K), ("d", D)):
        p = found.extended.parameter(name)
        assert p.std_error is not None
        assert abs(p.value - value) < 4 * p.std_error < 0.01 * value
    assert found.held_out["extended_rmse"]["w"] == pytest.approx(NOISE, rel=0.1)
    assert found.held_out["baseline_rmse"]["w"] > 10.0
    fitted = found.model
    assert [c.kind for c in fitted.causes] == ["rectified"]
    simulated = fitted.simulate(record("size"))
    assert np.std(simulated["w"] - record("size")["w"]) == pytest.approx(NOISE, rel=0.1)
