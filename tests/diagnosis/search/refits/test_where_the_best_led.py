"""Where the fit without any cause is far away, what brings one cause back brings others back, too.

The drive train of a wind turbine integrates: nothing in the model resists that its two speeds
change together. A bearing that drags slows them down to what heavy wheels would do, and the fit of
the model as it is makes its wheels thirty times as heavy.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.candidates import found_values
from casid.diagnosis.search.refits import joint_refit
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.search.rounds import Search, shortlist
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.fit import FitSettings, fit_model

TS, RATIO = 0.02, 80.0
ROTOR, GENERATOR = 3.2e6, 65.0  # kg m^2
STIFFNESS, DAMPING, DRAG = 2.4e8, 3e5, 4.0  # N m/rad, N m s/rad, N m s/rad
NOISE = np.array([4e-4, 0.04])  # rad/s


def driven(drag: float, seed: int) -> casid.Record:
    """120 s, exact for held torques: a gusty one, and one by which a controller holds the speed."""
    A = np.array(
        [
            [0.0, 1.0, -1 / RATIO],
            [-STIFFNESS / ROTOR, -DAMPING / ROTOR, DAMPING / RATIO / ROTOR],
            [
                STIFFNESS / RATIO / GENERATOR,
                DAMPING / RATIO / GENERATOR,
                -DAMPING / RATIO**2 / GENERATOR - drag / GENERATOR,
            ],
        ]
    )
    B = np.array([[0.0, 0.0], [1 / ROTOR, 0.0], [0.0, -1 / GENERATOR]])
    step = expm(TS * np.block([[A, B], [np.zeros((2, 5))]]))
    rng, N = np.random.default_rng(seed), 6000
    f = np.fft.rfftfreq(N, TS)
    lines = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    lines[(f < 0.02) | (f > 1.5)] = 0.0
    gusts = np.fft.irfft(lines, N)
    wind = 1.1e6 + 2.4e5 * gusts / gusts.std()
    x, brake, columns = np.array([0.005, 1.6, 1.6 * RATIO]), 1.1e6 / RATIO, np.empty((N, 4))
    for k in range(N):
        brake += TS / 0.3 * (1.1e6 / RATIO + 90 * (x[2] - 1.6 * RATIO) - brake)
        columns[k] = wind[k], brake, *(x[1:] + NOISE * rng.standard_normal(2))
        x = (step @ np.array([*x, wind[k], brake]))[:3]
    units = {"wind": "N m", "brake": "N m", "rotor": "rad/s", "generator": "rad/s"}
    return casid.Record(dict(zip(units, columns.T, strict=True)), units, Ts=TS)


def drive_train() -> casid.Model:
    m = casid.Model("drive train")
    twist = m.state("twist", "rad")
    slow, fast = m.state("slow", "rad/s", start=1.6), m.state("fast", "rad/s", start=128.0)
    wind, brake = (m.input(n, "N m", hold="zoh", known=True) for n in ("wind", "brake"))
    Jr = m.parameter("Jr", "kg m^2", start=2e6, lower=1e5, upper=1e8)
    Jg = m.parameter("Jg", "kg m^2", start=100.0, lower=5.0, upper=1e3)
    K = m.parameter("K", "N m/rad", start=1.5e8, lower=1e6, upper=5e9)
    B = m.parameter("B", "N m s/rad", start=1e5, lower=0.0, upper=5e6)
    slip = slow - fast / RATIO
    m.derivative(twist, slip)
    m.balance(slow, "rotor", inertia=Jr, terms=[wind, -K * twist, -B * slip])
    m.balance(fast, "generator", inertia=Jg, terms=[(K * twist + B * slip) / RATIO, -brake])
    m.output("rotor", slow, "rad/s")
    m.output("generator", fast, "rad/s")
    return m


def test_a_drag_is_found_from_where_the_gain_of_the_brake_led():
    """Either slows the train down; from the far fit one finds the way back, and one does not."""
    experiments = [casid.Experiment(driven(DRAG, seed=2))]
    fit = fit_model(drive_train(), experiments, FitSettings(starts=1), throw=False)
    weighing = Weighing(experiments)
    at = weighing.weigh(fit.criterion.model, fit)
    assert at.fit.values["Jr"] > 30 * ROTOR
    refitting, found = Refitting(weighing), {}
    for s in shortlist(at, Search(weighing, {}).table(at, [])):
        if s.effect.key in (("sensor_scale", "brake"), ("unknown", "generator: fast")):
            c = refitting.refit(at, s.effect, s.step, starts=s.starts)
            found[s.effect.kind] = replace(c, score=s)
    gain, drag = found["sensor_scale"], found["unknown"]
    assert error_over_noise(drag.fit, at.noise) > 10.0
    assert drag.gain < gain.gain
    kept, drag = refitting.from_where_best_led(at, [gain, drag])
    assert kept is gain
    assert drag.gain > gain.gain
    assert drag.score is found["unknown"].score
    assert found_values(drag)["c_fast"] == pytest.approx(DRAG, rel=0.01)


@pytest.mark.parametrize(("error", "tried"), [(2.0, ["hold"]), (50.0, ["hold", "offset"])])
def test_what_is_there_or_not_is_sought_from_there_though_the_model_is_near(
    monkeypatch: pytest.MonkeyPatch, error: float, tried: list[str]
) -> None:
    """A delay grows from zero and takes the parameters along; a hold moves them at once."""
    gains = {"time_delay": 75.0, "hold": 17.0, "offset": 60.0, "sensor_bias": 20.0}
    found = [
        SimpleNamespace(effect=SimpleNamespace(kind=kind), gain=gain, fit=None)
        for kind, gain in gains.items()
    ]
    again = []
    monkeypatch.setattr(joint_refit, "error_over_noise", lambda fit, noise: error)
    monkeypatch.setattr(
        Refitting, "_from_another", lambda self, at, c, best: again.append((c, best)) or c
    )
    at = SimpleNamespace(fit=None, noise=None)
    assert Refitting(weighing=None).from_where_best_led(at, found) == found
    assert [c.effect.kind for c, _ in again] == tried
    assert all(best is found[0] for _, best in again)
