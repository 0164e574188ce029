"""Along a known motion the sensitivities are those of the steps that were taken."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.compiler import compiler
from casid.estimation.simulation.integration import simulator, wide_tangents
from casid.estimation.simulation.integration.simulator import Simulator
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.catalogue import catalogue
from casid.model.effects.channels.channel_effects import sensor_lag
from casid.model.effects.effect import Sizes, extend_all

TS = 0.05


def carriage() -> casid.Model:
    """Two masses, a held command and a recorded force, a sensor that adds a rate."""
    m = casid.Model("carriage")
    x, v, w = m.state("x", "m"), m.state("v", "m/s"), m.state("w", "m/s")
    pull, push = m.input("pull", "N", hold="zoh"), m.input("push", "N")
    k, d = m.parameter("k", "N/m", start=20.0), m.parameter("d", "N s/m", start=0.8)
    m.derivative(x, v - w)
    m.balance(v, "front", inertia=1.5, terms=[-k * x, -d * v, pull])
    m.balance(w, "rear", inertia=1.0, terms=[k * x, -d * w, push])
    m.output("reach", x + 0.1 * v, "m")
    m.output("speed", v, "m/s")
    return m


def every_effect() -> tuple[casid.Model, list[str], dict[str, float]]:
    """The carriage with all effects that are tested by their tangents, and their first parameters.

    Last those that are held at zero, which keep states of their own from acting.
    """
    sizes = Sizes(
        {"x": 0.5, "v": 1.0, "w": 1.0},
        {"reach": 1.0, "speed": 2.0},
        (0.0, 4.0),
        0.5,
        Ts=TS,
        ranges={"x": (-1.0, 1.0), "v": (-2.0, 2.0), "w": (-2.0, 2.0)},
    )
    effects = [e for e in catalogue(carriage(), sizes, {}) if e.test == "score"]
    model, names = extend_all(carriage(), effects)
    return model, names, {n: 0.0 for n, e in zip(names, effects, strict=True) if e.has_states}


def test_where_nothing_steps_tangents_have_a_column_for_every_unknown(monkeypatch):
    """A state that is held from acting has one of zeros, also of the values before a step.

    By the steps themselves and along the known motion, of which one gave fewer columns.
    """
    m = casid.Model("store and a part of it")
    x, q, push = m.state("x", "m"), m.state("q", "m"), m.input("push", "m/s", hold="zoh")
    share = m.parameter("share", "1/s", start=0.0)
    m.derivative(x, push - 0.3 * x + share * q)
    m.derivative(q, x - q)
    m.output("level", x, "m")
    N = 12
    for width in (np.inf, 0):
        monkeypatch.setattr(simulator, "WIDE", width)
        s = Simulator(m, TS, ["share"], pinned={"share": 0.0})
        run = s.sensitivities(np.ones((N, 1)), np.zeros(1), np.full(2, 0.1))
        assert run.dy.shape == (N, 1, 3)
        assert run.dbefore.shape == (N, 0, 3)
        assert not run.dy[:, :, 2].any()


@pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")
@pytest.mark.parametrize("hold", ["zoh", "foh", "bandlimited"])
def test_machine_code_goes_through_the_same_steps(monkeypatch, tmp_path, hold):
    """In another order of sums: rounding grows with the 160 steps by which each tangent goes.

    An output that steps where a held input does is late behind its lag, and a state that is held
    from acting has no tangents of its own.
    """
    m = casid.Model("store and a part of it")
    x, q, w = m.state("x", "m"), m.state("q", "m"), m.state("w", "m")
    push = m.input("push", "m/s", hold=hold)
    share, rate = m.parameter("share", "1/s", start=0.0), m.parameter("rate", "1/s", start=0.3)
    m.derivative(x, push - rate * x**3 + share * q)
    m.derivative(q, x - q)
    m.derivative(w, ca.sin(x) - rate * w)
    m.output("level", x + 0.2 * push, "m")
    m.output("far", w, "m")
    m = m.extend(sensor_lag(m, "level", 0.5))
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    monkeypatch.setattr(simulator, "WIDE", 0)
    u = np.random.default_rng(5).normal(size=(80, 1))
    runs = []
    for least in (np.inf, 0):
        monkeypatch.setattr(wide_tangents, "LEAST", least)
        s = Simulator(m, TS, list(m.parameters), substeps=2, pinned={"share": 0.0})
        p = np.array([m.parameters[n].start or 0.1 for n in s.equations.parameters])
        runs.append(s.sensitivities(u, p, np.full(s.nx, 0.1)))
    assert list(tmp_path.glob("steps/loop/*.so"))
    by_arrays, compiled = runs
    assert by_arrays.dbefore.shape[1] == (hold == "zoh")
    for name in ("dy", "dbefore", "dx_end"):
        one, other = getattr(by_arrays, name), getattr(compiled, name)
        assert np.any(one) or not one.size
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(("substeps", "at_a_time"), [(1, 2_000_000), (3, 1)])
def test_tangents_of_a_whole_catalogue_are_those_of_one_step(monkeypatch, substeps, at_a_time):
    """Both differentiate the same steps: delays, holds and sensors between them as well.

    Rounding grows with the 80 steps by which each tangent goes; 1e-11 of the largest is far above.
    """
    model, names, pinned = every_effect()
    assert len(names) > 60
    rng = np.random.default_rng(3)
    free, N = ["k", "d", *names], 80
    u = rng.normal(size=(N, len(model.inputs)))
    monkeypatch.setattr(wide_tangents, "NUMBERS", at_a_time)
    runs = []
    for width in (np.inf, 0):
        monkeypatch.setattr(simulator, "WIDE", width)
        s = Simulator(model, TS, free, substeps=substeps, pinned=pinned)
        p = np.array([model.parameters[n].nominal for n in s.equations.parameters])
        x0 = np.full(s.nx, 0.1)
        runs.append(s.sensitivities(u, p, x0, after=u[0]))
    step, known = runs
    assert known.y == pytest.approx(step.y, abs=1e-13)
    assert known.before == pytest.approx(step.before, abs=1e-13)
    for one, other in (
        (step.dy, known.dy),
        (step.dbefore, known.dbefore),
        (step.dx_end[None], known.dx_end[None]),
    ):
        largest = np.abs(one).max(axis=(0, 1), initial=0.0)
        assert other.shape == one.shape
        assert np.all(np.abs(other - one) <= 1e-11 * (1.0 + largest))


@pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")
def test_steps_for_many_short_records_are_compiled_with_the_first(monkeypatch, tmp_path):
    """One of 60 samples is not worth it. The columns are the same, with no bounds from a fit."""
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    monkeypatch.setattr(simulator, "WIDE", 0)
    model = carriage().extend(sensor_lag(carriage(), "speed", 0.5))
    rng = np.random.default_rng(3)
    units = {"pull": "N", "push": "N", "reach": "m", "speed": "m/s"}
    record = casid.Record({name: rng.normal(size=60) for name in units}, units, Ts=TS)
    criterion = SimulationError(model, [casid.Experiment(record)])
    compiled = [list(tmp_path.glob("steps/loop/*.so"))]
    of = []
    for each in (criterion, criterion.for_columns().of_records(criterion.experiments)):
        of.append(each.columns(each.start, 0))
        compiled.append(list(tmp_path.glob("steps/loop/*.so")))
    assert [len(found) for found in compiled] == [0, 0, 1]
    for one, other in zip(*of, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-10, atol=1e-12)
