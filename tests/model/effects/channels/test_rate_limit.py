"""Commands whose actuator moves at no more than a rate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.command_rates import command_rates
from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.simulation.channels.rate_limits import (
    change_with_rate,
    rate_limited,
    through_limit,
)
from casid.estimation.simulation.channels.sample_lines import delayed_lines, lines_of
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError
from tests.support.fitted_models import driven_mass, fitted_model

Ts, TAU = 0.1, 2.0


def steps(N: int = 600, seed: int = 3) -> np.ndarray:
    """Levels held for 3 s each."""
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, N // 30), 30)


def tank(*, known: bool = True) -> casid.Model:
    """A level that follows a valve, tau dh/dt = u - h."""
    m = casid.Model("valve and tank")
    h, u = m.state("h", "m"), m.input("u", "m", known=known, hold="zoh")
    m.derivative(h, (u - h) / m.parameter("tau", "s", start=1.5, lower=0.1, upper=20.0))
    m.output("level", h, "m")
    return m


def level(command: np.ndarray, kind: str = "none", size: float = 0.0, seed: int = 1) -> np.ndarray:
    """The level by steps of a 200th of a sample behind an actuator, measured with noise of 2 mm."""
    fine = 200
    late = round(size / Ts) if kind == "delay" else 0
    u = np.concatenate([np.full(late, command[0]), command])[: len(command)]
    out, h, p, dt = np.empty(len(u)), 0.0, float(u[0]), Ts / fine
    decay, lag = np.exp(-dt / TAU), np.exp(-dt / size) if kind == "lag" else 0.0
    for k, now in enumerate(u.tolist()):
        out[k] = h
        for _ in range(fine):
            before = p
            if kind == "rate":
                p += min(max(now - p, -size * dt), size * dt)
            else:
                p = now + lag * (p - now)
            h = decay * h + (1 - decay) * (0.5 * (before + p) if kind == "rate" else p)
    return out + 0.002 * np.random.default_rng(seed).standard_normal(len(u))


def by_small_steps(lines: np.ndarray, most: float, fine: int = 2000) -> np.ndarray:
    """Start, and the line with the mean and first moment, of an actuator in every sample."""
    p, out = lines[0, 1], []
    middle = (np.arange(fine) + 0.5) / fine
    for begin, end in lines[:, 1:]:
        path = [p]
        for share in (np.arange(fine) + 1) / fine:
            p += float(np.clip(begin + (end - begin) * share - p, -most / fine, most / fine))
            path.append(p)
        course = 0.5 * (np.array(path[1:]) + np.array(path[:-1]))
        tilt = 12 * np.mean((middle - 0.5) * course)
        out.append([path[0], course.mean() - 0.5 * tilt, course.mean() + 0.5 * tilt])
    return np.array(out)


def command_of(what: str) -> np.ndarray:
    u = 0.5 * np.cumsum(np.random.default_rng(0).standard_normal(40))
    return delayed_lines(u, 1.3, "zoh")[0] if what == "late" else lines_of(u, what)  # type: ignore


@pytest.mark.parametrize("what", ["zoh", "foh", "late"])
@pytest.mark.parametrize("most", [0.05, 0.3, 1.0])
def test_the_line_in_a_sample_is_that_of_the_actuator(what: str, most: float):
    """Small steps reach the command up to one step late, a 2000th of a sample's largest change."""
    lines = command_of(what)
    found = rate_limited(lines, most)
    assert found.lines == pytest.approx(by_small_steps(lines, most), abs=most / 1000)
    h = 1e-6
    up, down = (rate_limited(lines, most + s * h).lines for s in (1, -1))
    assert change_with_rate(lines, found) == pytest.approx((up - down) / (2 * h), abs=1e-6)


@pytest.mark.parametrize("what", ["zoh", "foh"])
@pytest.mark.parametrize("most", [0.05, 0.3, 1.0])
def test_tangents_of_the_command_pass_where_the_actuator_is_on_it(what: str, most: float):
    lines, rng, h = command_of(what), np.random.default_rng(1), 1e-6
    given = lines_of(rng.standard_normal(len(lines)), what)  # type: ignore[arg-type]
    (found,) = through_limit(lines, rate_limited(lines, most), {"c": given}).values()
    up, down = (rate_limited(lines + s * h * given, most).lines for s in (1, -1))
    assert found == pytest.approx((up - down) / (2 * h), abs=1e-6)


def test_a_command_that_is_slow_enough_acts_as_it_is():
    lines = lines_of(np.sin(0.1 * np.arange(100)), "foh")
    found = rate_limited(lines, 0.1)
    assert found.tracks.all()
    assert found.lines == pytest.approx(lines, abs=1e-15)


def criterion(share: float, rate: float, command: np.ndarray) -> SimulationError:
    effect = casid.rate_limit(tank(), "u", rate)
    model, names = effect.extended(tank(), starts={"rate_limited_u": share})
    zero = np.zeros(len(command))
    record = casid.Record({"u": command, "level": zero}, {"u": "m", "level": "m"}, Ts=Ts)
    start = {"tau": TAU, "h": 0.0, "h(0)": 0.0, **dict(zip(names, (share, rate), strict=True))}
    return SimulationError(
        model, [casid.Experiment(record, {}, "r")], weights=np.ones(1), start=start
    )


def test_the_model_is_the_limit_of_none_and_its_score_the_limit_itself():
    """The level is linear in the command: its sensitivity to the share is what the limit does."""
    command, rate = steps(), 0.3
    null, limited = criterion(0.0, rate, command), criterion(1.0, rate, command)
    (y0, *_), (y1, *_) = (c.simulate(c.start, 0) for c in (null, limited))
    share = null.simulated(null.start, 0).jacobian[:, 0, null.names.index("rate_limited_u")]
    assert y0[:, 0] + share == pytest.approx(y1[:, 0], abs=1e-9)
    assert "rate_u" not in null.names
    exact = level(command, "rate", rate) - level(command)
    assert y1[:, 0] - y0[:, 0] == pytest.approx(exact, abs=1e-4)


def test_the_sensitivity_to_the_rate_is_its_derivative():
    c = criterion(1.0, 0.3, steps())
    i, h, up = c.names.index("rate_u"), 1e-6, c.start.copy()
    up[i] += h
    slope = (c.simulate(up, 0)[0] - c.simulate(c.start, 0)[0])[:, 0] / h
    assert c.simulated(c.start, 0).jacobian[:, 0, i] == pytest.approx(slope, abs=1e-4)
    assert np.max(np.abs(slope)) > 0.5


def rates_of(column: np.ndarray, noise: float = 0.0) -> dict[str, object]:
    shape = (len(column), 1)
    data = Signals(
        "r", np.arange(len(column)) * Ts, column[:, None], np.zeros(shape), np.ones(shape), Ts, {}
    )
    return dict(command_rates(tank(), [data], {"u": noise}))


def test_rates_are_searched_where_a_command_is_faster_and_slower_than_them():
    """Steps of up to 2 m each 3 s: a slower actuator than 0.1 m/s hardly moves."""
    found = rates_of(steps())["u"]
    assert len(found.felt) >= 3
    assert all(0.02 < r < found.largest for r in found.felt)
    assert rates_of(np.ones(100)) == {}
    # A ramp up and down is no faster at one time than at another.
    assert len(rates_of(np.abs(np.arange(400) % 200 - 100.0))["u"].felt) <= 2
    # The noise of the sensor of a measured command needs a faster actuator than its steps do.
    assert rates_of(steps(), noise=1.0) == {}


def test_the_unit_of_a_rate_is_that_of_its_command_a_second():
    m = casid.Model("rudder")
    r, d = m.state("r", "deg/s"), m.input("rudder", "deg", known=True, hold="zoh")
    m.derivative(r, d / 10.0**2)
    m.output("rate", r, "deg/s")
    extended, names = casid.rate_limit(m, "rudder", 0.05).extended(m, starts={})
    assert extended.unit_of(names[1]) == "deg/s"
    assert extended.parameters[names[1]].unit == "rad/s"


def test_a_largest_rate_is_refused_twice_and_of_a_band_limited_command():
    once = tank().extend(casid.rate_limit(tank(), "u", 0.3))
    with pytest.raises(ModelError, match="has a largest rate already; extend the model before"):
        casid.rate_limit(once, "u", 0.3)
    m = casid.Model("smooth")
    x, u = m.state("x", "m"), m.input("u", "m", known=True, hold="bandlimited")
    m.derivative(x, (u - x) / 2.0)
    m.output("y", x, "m")
    with pytest.raises(ModelError, match="band-limited between its samples"):
        casid.rate_limit(m, "u", 0.3)


def record_of(kind: str, size: float, seed: int = 1) -> casid.Record:
    command = steps(1200, seed)
    measured = level(command, kind, size, seed)
    return casid.Record({"u": command, "level": measured}, {"u": "m", "level": "m"}, Ts=Ts)


@pytest.mark.slow
def test_a_valve_that_takes_its_time_is_named_with_its_rate():
    found = casid.diagnose(
        casid.Problem("tank", tank()), record_of("rate", 0.4), starts=1, advise=False
    )
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("actuator_saturation", "u")
    (rate,) = [p for p in cause.parameters if p.name == "rate_u"]
    assert rate.unit == "m/s"
    assert abs(rate.value - 0.4) < 4 * rate.std_error
    assert rate.std_error < 0.02
    assert cause.sentence.startswith("the actuator of u moves at no more than 0.4")
    assert cause.words == "rate limit of the actuator of u"
    assert found.model is not None
    assert found.model.values["rate_limited_u"] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "named"),
    [
        ("none", 0.0, []),
        ("lag", 0.5, ["actuator_lag"]),
        ("delay", 0.5, ["time_delay"]),
    ],
)
def test_a_lag_and_a_dead_time_keep_their_names(kind: str, size: float, named: list[str]):
    found = casid.diagnose(
        casid.Problem("tank", tank()), record_of(kind, size, 2), starts=1, advise=False
    )
    assert [c.kind for c in found.causes] == named


def limited_mass() -> FittedModel:
    """A mass on a spring whose force rises by 2 N/s at most."""
    return fitted_model(
        casid.Problem("mass", driven_mass()),
        [lambda m: casid.rate_limit(m, "force", 2.0)],
        {"d": 1.0, "k": 40.0, "rate_limited_force": 1.0, "rate_force": 2.0},
        x0=(0.0, 0.0),
        Ts=0.05,
        N=200,
        substeps=4,
    )


def test_a_problem_file_has_the_largest_rate(tmp_path: Path):
    fitted = limited_mass()
    problem = casid.load_problem(fitted.to_problem_file(tmp_path / "problem.py"))
    text = (tmp_path / "problem.py").read_text()
    assert 'casid.rate_limit(model, "force", rate=2)' in text
    assert "with_known(rate_limited_force=1)" in text
    assert problem.model.stages == fitted.model.stages


def position(fitted: FittedModel, command: np.ndarray) -> np.ndarray:
    """Of the mass under a force, as the fitted model has it."""
    run = fitted.simulate({"force": command}, {"x": 0.0, "v": 0.0})
    return np.asarray(run["position"])


def test_the_equations_have_an_actuator_that_goes_to_its_command():
    """It follows within a tenth of a sample, 0.01 N of 2 N/s: 0.25 mm of 40 N/m, doubled by v."""
    fitted = limited_mass()
    command = np.repeat([0.0, 1.5, -1.0, 0.5], 50)
    function, x, found = fitted.to_casadi(), np.zeros(3), []
    for u in command:
        step = function(x=x, u=u, u_next=u, t=0.0)
        found.append(float(step["y"]))
        x = np.array(step["x_next"]).ravel()
    wanted = position(fitted, command)
    assert np.array(found) == pytest.approx(wanted, abs=5e-4)
    model = fitted.model.with_si_values({"rate_limited_force": 0.0})
    assert np.max(np.abs(wanted - position(replace(fitted, model=model), command))) > 5e-3
