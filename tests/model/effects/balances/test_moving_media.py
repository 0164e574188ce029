"""Wind and currents: drag goes with the speed through the medium, not over ground.

The records come from a Runge-Kutta integration of 90 v' = F - 5 - 0.4 (v - w) |v - w| written here.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.errors import ModelError
from casid.model.effects.balances.moving_media import moving_media_of, moving_medium
from casid.model.effects.clock_effects import at_instant, medium_step
from casid.model.effects.names import effect_words

MASS, ROLL, DRAG, NOISE = 90.0, 5.0, 0.4, 0.02  # kg, N, N s^2/m^2, m/s
TS, N, SUBSTEPS = 0.5, 1200, 5


def rider() -> casid.Problem:
    """A cyclist whose speed over ground is measured."""
    m = casid.Model("rider")
    v, F = m.state("v", "m/s", start=6.0), m.input("F", "N", hold="zoh", known=True)
    mass = m.constant("m", MASS, "kg")
    k, roll = m.parameter("k", "N s^2/m^2", start=0.3), m.parameter("roll", "N", start=8.0)
    m.balance(v, "traction", inertia=mass, terms=[F, -roll, -k * ca.fabs(v) * v])
    m.output("speed", v, "m/s")
    return casid.Problem("rider", m)


def record(wind: np.ndarray, seed: int = 4) -> casid.Record:
    """Under forces held for 20 s, in a wind (N,) held within each sample, positive from behind."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(5.0, 60.0, N // 40), 40)
    v, h, out = 6.0, TS / SUBSTEPS, np.empty(N)

    def slope(v: float, F: float, w: float) -> float:
        return (F - ROLL - DRAG * (v - w) * abs(v - w)) / MASS

    for n, (F, w) in enumerate(zip(force.tolist(), wind.tolist(), strict=True)):
        out[n] = v
        for _ in range(SUBSTEPS):
            a = slope(v, F, w)
            b = slope(v + h / 2 * a, F, w)
            c = slope(v + h / 2 * b, F, w)
            v += h / 6 * (a + 2 * b + 2 * c + slope(v + h * c, F, w))
    speed = out + NOISE * rng.standard_normal(N)
    return casid.Record({"F": force, "speed": speed}, {"F": "N", "speed": "m/s"}, TS)


def test_drag_goes_with_the_speed_through_the_medium():
    model = rider().model
    (effect,) = moving_media_of(model)
    extended, (w,) = effect.extended(model)
    e = extended.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    values = {"m": MASS, "k": DRAG, "roll": ROLL, w: -3.0}
    found = float(f([6.0], [20.0], [values[n] for n in e.parameters]))
    assert found == pytest.approx((20.0 - ROLL - DRAG * 9.0**2) / MASS, rel=1e-12)


def test_in_two_dimensions_the_medium_moves_in_the_drag_of_both():
    """d |(u, v)| u and d |(u, v)| v: a current along u changes both; M v r is no drag."""
    m = casid.Model("hull")
    u, v = m.state("u", "m/s", start=1.0), m.state("v", "m/s")
    d, r = m.parameter("d", "N s^2/m^2", start=3.0), m.input("r", "rad/s", known=True)
    M, size = m.constant("M", 10.0, "kg"), ca.sqrt(u**2 + v**2 + 1e-9)
    m.balance(u, "surge", inertia=M, terms=[-d * size * u, M * v * r])
    m.balance(v, "sway", inertia=M, terms=[-d * size * v, -M * u * r])
    m.output("y", u, "m/s")
    effect = moving_medium(m, "surge")
    assert effect is not None
    extended, (w,) = effect.extended(m)
    e = extended.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    values = {"d": 3.0, "M": 10.0, w: 0.5}
    found = np.ravel(f([1.5, 0.7], [0.2], [values[n] for n in e.parameters]))
    through = np.array([1.0, 0.7])
    true = -3.0 * np.hypot(*through) * through / 10.0 + [0.7 * 0.2, -1.5 * 0.2]
    assert found == pytest.approx(true, rel=1e-8)


@pytest.mark.parametrize(
    "resistance",
    [
        pytest.param(lambda v: 2.0 * v, id="in proportion, where a wind is a constant force"),
        pytest.param(lambda v: 2.0 * ca.tanh(v / 0.1), id="dry friction, smoothed"),
        pytest.param(lambda v: 2.0 + 0.1 * v**2, id="with a part that stays at rest"),
    ],
)
def test_a_resistance_that_does_not_grow_faster_than_the_speed_or_end_at_rest_has_no_medium(
    resistance,
):
    m = casid.Model("cart")
    v, c = m.state("v", "m/s"), m.parameter("c", "1", start=1.0)
    M = m.constant("M", 1.0, "kg")
    m.balance(v, "traction", inertia=M, terms=[-c * resistance(v)], unit="N")
    m.output("y", v, "m/s")
    assert moving_medium(m, "traction") is None
    with pytest.raises(ModelError, match="no drag in the traction balance"):
        medium_step(m, "traction", 3.0)


def test_a_wind_that_rises_is_placed_at_other_instants_as_one_that_lasts_for_a_while():
    model = rider().model
    step = medium_step(model, "traction", 100.0)
    assert "constant wind or current sets in during the record" in step.description
    words = effect_words(*step.key, description=step.description)
    assert words == "constant wind or current in the traction balance (step)"
    moved = at_instant(step, model, 120.0, 180.0)
    assert (moved.key, moved.variant, moved.end) == (step.key, 120.0, 180.0)
    assert moved.description.endswith("for a while")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("begin", "end", "wind"),
    [(0.0, None, -4.0), (310.0, None, -3.0), (200.0, 290.0, 3.0)],
    ids=["all the time", "rises", "for a while"],
)
def test_a_wind_is_named_with_its_speed(begin, end, wind):
    """Within four standard errors; the instants within two samples."""
    t = np.arange(N) * TS
    course = wind * ((t >= begin) & (t < (end or np.inf)))
    (cause,) = casid.diagnose(rider(), record(course), starts=1, advise=False).causes
    assert (cause.kind, cause.where) == ("offset", "traction")
    assert "wind or current" in cause.sentence
    w, *instants = cause.parameters
    assert abs(w.value - wind) < 4 * w.std_error
    for found, true in zip(instants, (begin, end), strict=False):
        assert 0.0 < found.std_error < TS
        assert abs(found.value - true) < 4 * found.std_error
