"""A stop has a corner; without one, it is a spring that hardens."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.search.refits.soft_stops import is_soft_stop, without_soft_stops
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.contact_effects import end_stop

TS, N, MASS, DAMPING, STIFFNESS, LIMIT, NOISE = 0.05, 1000, 2.0, 0.8, 9.0, 0.7, 1e-3  # SI


def slide() -> casid.Problem:
    """A sprung slide that is driven; nothing limits its motion."""
    m = casid.Model("slide")
    F = m.input("F", "N", known=True)
    x, v = m.state("x", "m"), m.state("v", "m/s")
    mass = m.constant("m", MASS, "kg")
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0, upper=20.0)
    k = m.parameter("k", "N/m", start=8.0, lower=0.0, upper=50.0)
    m.derivative(x, v)
    m.balance(v, "slide", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("slide", m, noise={"position": NOISE})


def record(added: Callable[[float], float]) -> casid.Record:
    """Runge-Kutta with a fifth of the sample time; the spring pulls by `added` more."""
    rng, h = np.random.default_rng(0), TS / 5
    t = np.arange(N) * TS
    w, phase = np.linspace(0.5, 6.0, 25), rng.uniform(0, 2 * np.pi, 25)
    F = 0.7 * np.cos(np.outer(t, w) + phase).sum(axis=1)
    fine = np.interp(np.arange(10 * N) * h / 2, t, F)

    def slope(s: np.ndarray, force: float) -> np.ndarray:
        pull = STIFFNESS * s[0] + added(float(s[0]))
        return np.array([s[1], (force - DAMPING * s[1] - pull) / MASS])

    s, x = np.zeros(2), np.empty(N)
    for k in range(5 * N):
        if k % 5 == 0:
            x[k // 5] = s[0]
        f = [fine[min(2 * k + j, 10 * N - 1)] for j in (0, 1, 2)]
        k1 = slope(s, f[0])
        k2 = slope(s + 0.5 * h * k1, f[1])
        k3 = slope(s + 0.5 * h * k2, f[1])
        k4 = slope(s + h * k3, f[2])
        s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    x = x + NOISE * rng.standard_normal(N)
    return casid.Record({"F": F, "position": x}, {"F": "N", "position": "m"}, Ts=TS)


def stop(x: float) -> float:
    """A spring of a twentieth of the slide's, which begins at a corner."""
    return 0.05 * STIFFNESS * float(np.sign(x)) * max(abs(x) - LIMIT, 0.0)


def arm(x: float) -> float:
    """As stiff in the end, but gradually so: k (sqrt(x^2 + L^2) - L) sign(x)."""
    return 0.05 * STIFFNESS * float(np.sign(x)) * (np.hypot(x, LIMIT) - LIMIT)


def weighed(added: Callable[[float], float]) -> tuple[Refitting, Weighted]:
    model, data = slide().model, [casid.Experiment(record(added))]
    weighing = Weighing(data, {"position": NOISE})
    fit = fit_model(model, data, casid.FitSettings(starts=1))
    return Refitting(weighing), weighing.weigh(model, fit)


@pytest.mark.parametrize(("added", "has_corner"), [(stop, True), (arm, False)])
def test_a_stop_that_is_softer_than_the_spring_beside_it_has_a_corner(
    added: Callable[[float], float], has_corner: bool
) -> None:
    """Rounded over a tenth of where it begins, a stop is less likely; a spring is likelier."""
    refitting, at = weighed(added)
    effect = end_stop(at.model, "slide", "symmetric", 0.0, 1.2, 1e-3)
    assert effect is not None
    found = refitting.refit(at, effect, 0.3)
    assert found is not None
    assert is_soft_stop(at, found)
    kept = without_soft_stops(refitting, at, [found], lambda _: None)
    assert (kept == [found]) is has_corner


@pytest.mark.slow
@pytest.mark.parametrize(("added", "is_stop"), [(stop, True), (arm, False)])
def test_a_soft_stop_is_named_and_a_spring_that_hardens_is_none(
    added: Callable[[float], float], is_stop: bool
) -> None:
    found = casid.diagnose(slide(), record(added), advise=False)
    named = {c.kind for c in found.causes} | {a.kind for c in found.causes for a in c.alternatives}
    assert ("end_stop" in named) is is_stop
    if is_stop:
        (cause,) = found.causes
        sizes = {p.name: p for p in cause.parameters}
        for name, true in {"k_stop": 0.05 * STIFFNESS, "limit": LIMIT}.items():
            error = sizes[name].std_error
            assert error is not None
            assert sizes[name].value == pytest.approx(true, abs=3 * error), name


@pytest.mark.parametrize(("stiffness", "is_soft"), [(0.89, True), (0.91, False)])
def test_a_stop_is_soft_below_a_tenth_of_the_spring_beside_it(
    stiffness: float, is_soft: bool
) -> None:
    """The spring has 9 N/m."""
    _, at = weighed(stop)
    effect = end_stop(at.model, "slide", "symmetric", 0.0, 0.5, 0.01)
    assert effect is not None
    values = {**at.fit.values, "k": STIFFNESS, "k_stop": stiffness, "limit": LIMIT}
    found = SimpleNamespace(effect=effect, names=("k_stop", "limit"))
    found.fit = SimpleNamespace(values=values)
    assert is_soft_stop(at, found) is is_soft
