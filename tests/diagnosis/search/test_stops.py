"""The position of a stop is one that can be measured, in the coordinate of the model."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.rounds import Search, strongest_of_each
from casid.diagnosis.verdict.cause import Cause
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.contact_effects import end_stop
from casid.report.numbers import estimated_texts

TS, N, MASS, DAMPING, STIFFNESS, STOP = 0.05, 1000, 2.0, 0.8, 9.0, 40.0  # SI


def slide() -> casid.Problem:
    """A sprung slide that is driven; nothing limits its motion."""
    m = casid.Model("slide")
    F = m.input("F", "N", known=True)
    x, v = m.state("x", "m"), m.state("v", "m/s")
    mass = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0, upper=20.0)
    k = m.constant("k", STIFFNESS, "N/m")
    m.derivative(x, v)
    m.balance(v, "slide", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("slide", m)


def record(lower: float, upper: float) -> casid.Record:
    """Runge-Kutta with a tenth of the sample time; soft stops at both positions."""
    rng, h = np.random.default_rng(0), TS / 10
    t = np.arange(N) * TS
    w, phase = np.linspace(0.5, 6.0, 25), rng.uniform(0, 2 * np.pi, 25)
    F = 0.7 * np.cos(np.outer(t, w) + phase).sum(axis=1)

    def slope(s: np.ndarray, force: float) -> np.ndarray:
        stop = STOP * (max(lower - s[0], 0.0) - max(s[0] - upper, 0.0))
        return np.array([s[1], (force - DAMPING * s[1] - STIFFNESS * s[0] + stop) / MASS])

    s, x = np.zeros(2), np.empty(N)
    for k in range(N):
        x[k] = s[0]
        for j in range(10):
            f = [np.interp(t[k] + (j + c) * h, t, F) for c in (0.0, 0.5, 1.0)]
            k1 = slope(s, f[0])
            k2 = slope(s + 0.5 * h * k1, f[1])
            k3 = slope(s + 0.5 * h * k2, f[1])
            k4 = slope(s + h * k3, f[2])
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    x = x + 0.003 * rng.standard_normal(N)
    return casid.Record({"F": F, "position": x}, {"F": "N", "position": "m"}, Ts=TS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stops", "says"),
    [
        ({"limit": 0.08}, "where x is above limit"),  # passed over nearly half of the motion
        ({"limit_lower": -0.3, "limit_upper": 0.45}, "where x is below limit_lower or above"),
    ],
)
def test_a_stop_is_found_at_its_position(stops: dict[str, float], says: str) -> None:
    lower, upper = stops.get("limit_lower", -np.inf), stops.get("limit_upper", stops.get("limit"))
    assert upper is not None
    found = casid.diagnose(slide(), record(lower, upper), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("end_stop", "slide")]
    cause = found.causes[0]
    assert says in cause.description
    sizes = {p.name: p for p in cause.parameters}
    for name, true in {"k_stop": STOP, **stops}.items():
        error = sizes[name].std_error
        assert error is not None
        assert sizes[name].value == pytest.approx(true, abs=3 * error), name


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_score_of_an_overflow_promises_what_it_explains_at_work_most_of_the_time(seed) -> None:
    """A tank that runs over above 1 m, its median level, and that short floods fill to 2 to 3 m."""
    m = casid.Model("tank")
    level, inflow = m.state("level", "m", start=1.0), m.input("inflow", "m^3/s", hold="zoh")
    area = m.parameter("area", "m^2", start=2.0, lower=0.1, upper=50.0)
    k = m.parameter("k", "m^2/s", start=0.01, lower=1e-4, upper=1.0)
    m.balance(level, "tank", inertia=area, terms=[inflow, -k * level], unit="m^3/s")
    m.output("gauge", level, "m")
    experiments = [casid.Experiment(floods(seed))]
    search = Search(Weighing(experiments), {})
    at = search.weighing.weigh(m, fit_model(m, experiments, casid.FitSettings(starts=1)))
    score = strongest_of_each(search.table(at, []).tested)["end_stop", "tank"]
    (found,) = search.refits_of(at, [score])
    assert score.unrobust > 2 / 3 * found.gain
    assert found.fit.values["limit"] == pytest.approx(1.0, abs=GAUGE)


GAUGE = 0.01  # noise [m]


def floods(seed: int) -> casid.Record:
    """An area of 3 m^2, an outlet of 0.02 m^2/s, and 0.05 m^2/s over the rim, by Euler's steps."""
    rng, parts, step = np.random.default_rng(seed), 20, 10.0
    inflow = np.repeat(0.02 * np.exp(0.7 * rng.standard_normal(120)), 10)
    h, level = 1.0, np.empty(inflow.size)
    for i, flow in enumerate(inflow):
        level[i] = h
        for _ in range(parts):
            h += step / parts * (flow - 0.02 * h - 0.05 * max(h - 1.0, 0.0)) / 3.0
    gauge = level + GAUGE * rng.standard_normal(level.size)
    units = {"inflow": "m^3/s", "gauge": "m"}
    return casid.Record({"inflow": inflow, "gauge": gauge}, units, Ts=step)


def stopped_too_late() -> casid.Model:
    """The slide with a stop that is searched from 0.14 on."""
    model = slide().model
    effect = end_stop(model, "slide", "upper", middle=0.3, reach=0.2, width=1e-3)
    assert effect is not None
    return effect.extend(model).with_unknown("k_stop", "limit", k_stop=STOP, limit=0.3)


def test_a_stop_at_the_end_of_its_search_has_an_interval_that_is_open_there() -> None:
    """The search ends at 0.14, the stop acts from 0.08 on: all that is found is "at most 0.14".

    The interval reaches 1.645 standard errors into the range searched, here of a few millimetres.
    """
    estimate = casid.identify(stopped_too_late(), record(-np.inf, 0.08), intervals="quick")
    found = estimate.parameter("limit")
    assert found.value == pytest.approx(0.14)
    assert found.std_error is None
    assert found.interval_kind == "one-sided"
    assert found.interval is not None
    assert found.interval[0] == -np.inf
    assert 0.14 < found.interval[1] < 0.16
    cause = Cause("end_stop", "slide", 1e-9, (found,))
    said = cause.to_json()["parameters"]["limit"]
    assert said["interval"] == [None, found.interval[1]]
    assert said["std_error"] is None
    assert estimated_texts(found)[2] == f"at most {found.interval[1]:.4g}"
    assert f"95 % at most {found.interval[1]:.4g}" in str(estimate)
    shown = found.in_unit("mm")
    assert estimated_texts(shown)[2] == f"at most {1e3 * found.interval[1]:.4g}"


def test_the_profile_of_a_stop_is_open_where_its_search_ends() -> None:
    """Nothing was searched beyond: the end of the search is no end of the interval."""
    estimate = casid.identify(stopped_too_late(), record(-np.inf, 0.08))
    found = estimate.parameter("limit")
    assert found.interval_kind == "profile"
    assert found.interval is not None
    assert found.interval[0] == -np.inf
    assert 0.14 < found.interval[1] < 0.16
    assert estimated_texts(found)[2] == f"at most {found.interval[1]:.4g} (profile)"
