"""One system written in any units and in SI: the same fit, error bars and verdict, converted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import casid
from casid.identification.profile_interval import profile
from casid.model.units import difference_from_si, from_si, to_si

TS = 0.02
TRUTH = {"m": 2.0, "d": 8.0, "k": 900.0}
SI = {"x": "m", "v": "m/s", "F": "N", "m": "kg", "d": "N s/m", "k": "N/m"}
OTHERS = {
    "x": ["m", "mm", "cm"],
    "v": ["m/s", "mm/ms", "km/h"],
    "F": ["N", "mN", "kN"],
    "m": ["kg", "gram", "t"],
    "d": ["N s/m", "N s/mm", "N ms/mm"],
    "k": ["N/m", "N/mm", "kN/m"],
}


@cache
def record(friction: float = 0.0) -> casid.Record:
    """Mass, damper and spring by SciPy, SI; the force held between the samples."""
    rng = np.random.default_rng(3)
    F = np.repeat(rng.uniform(-30.0, 30.0, 50), 12)
    state, x = np.array([0.01, 0.0]), np.empty(F.size)

    def slope(_: float, s: np.ndarray, force: float) -> list[float]:
        dry = friction * np.tanh(s[1] / 0.01)
        return [s[1], (force - TRUTH["d"] * s[1] - TRUTH["k"] * s[0] - dry) / TRUTH["m"]]

    for i, force in enumerate(F):
        x[i] = state[0]
        state = solve_ivp(slope, (0.0, TS), state, args=(force,), rtol=1e-8, atol=1e-10).y[:, -1]
    x += 2e-4 * rng.standard_normal(x.size)
    return casid.Record({"x": x, "F": F}, {"x": "m", "F": "N"}, TS, name="run")


def problem(units: dict[str, str]) -> casid.Problem:
    """The same system with every number in the given units."""

    def number(name: str, si: float) -> float:
        return float(from_si(si, units[name]))

    m = casid.Model("mass")
    x = m.state("q", units["x"], start=number("x", 0.002), upper=number("x", 0.5))
    v = m.state("v", units["v"], lower=number("v", -9.0))
    F = m.input("F", units["F"], hold="zoh", known=True)
    mass = m.parameter("m", units["m"], start=number("m", 1.0), upper=number("m", 50.0))
    d = m.parameter("d", units["d"], start=number("d", 3.0), lower=0.0)
    k = m.parameter("k", units["k"], start=number("k", 500.0), lower=number("k", 1.0))
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("x", x, units["x"])
    return casid.Problem("mass", m, noise={"x": float(difference_from_si(2e-4, units["x"]))})


@cache
def in_si_units() -> casid.Estimate:
    return casid.identify(problem(SI), record())


def in_si(values: float, unit: str) -> float:
    return float(to_si(values, unit))


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(units=st.fixed_dictionaries({n: st.sampled_from(u) for n, u in OTHERS.items()}))
def test_the_fit_and_its_error_bars_are_those_in_si_converted(units):
    found = casid.identify(problem(units), record())
    for row in (*found.parameters, *found.initial_states):
        name = {"q(0)": "x", "v(0)": "v"}.get(row.name, row.name)
        reference = in_si_units().parameter(row.name)
        assert row.unit == units[name]
        assert in_si(row.value, row.unit) == pytest.approx(reference.value, rel=1e-5, abs=1e-8)
        assert row.std_error is not None
        assert reference.std_error is not None
        error = row.std_error * in_si(1.0, row.unit)
        assert error == pytest.approx(reference.std_error, rel=1e-3)
    scale = np.array([in_si(1.0, found.parameter(n).unit) for n in found.covariance_names])
    assert found.covariance * np.outer(scale, scale) == pytest.approx(
        in_si_units().covariance, rel=1e-2, abs=1e-12
    )
    rmse = found.rmse["run"]["x"] * in_si(1.0, units["x"])
    assert rmse == pytest.approx(in_si_units().rmse["run"]["x"], rel=1e-6)
    view = found.records[0]
    assert view.output_units == (units["x"],)
    assert in_si(float(view.measured[7, 0]), units["x"]) == pytest.approx(record()["x"][7])


def test_an_estimate_goes_to_si_and_back():
    units = {n: u[1] for n, u in OTHERS.items()}
    found = casid.identify(problem(units), record())
    there = found.in_si()
    assert [p.unit for p in there.parameters] == [SI[p.name] for p in there.parameters]
    back = there.in_units(problem(units).model.declared_units)
    for p, q in zip(back.parameters, found.parameters, strict=True):
        assert (p.value, p.unit) == (pytest.approx(q.value), q.unit)


def test_the_fitted_model_takes_and_gives_numbers_in_the_declared_units():
    units = {n: u[1] for n, u in OTHERS.items()}
    found = casid.identify(problem(units), record())
    model = found.model
    assert model.values == {p.name: pytest.approx(p.value) for p in found.parameters}
    assert model.initial_states == {n: pytest.approx(found[f"{n}(0)"]) for n in ("q", "v")}
    values, start = {"m": 2.0, "d": 8.0, "k": 900.0}, {"q": 5e-3, "v": 0.1}
    pushed = in_si_units().model.simulate({"F": np.ones(300)}, start, known=values)
    force = np.full(300, from_si(1.0, units["F"]))
    values = model.model.in_declared_units(values)
    for x0 in ({"q": 5.0, "v": 0.1}, [5.0, 0.1]):  # mm and mm/ms
        run = model.simulate({"F": force}, x0, known=values)
        assert run["x"] == pytest.approx(pushed["x"], rel=1e-9, abs=1e-12)
    expected = model.predict(record(), known=values)
    assert model.residuals(record(), known=values)["x"] == pytest.approx(
        record()["x"] - expected["x"], abs=1e-12
    )


def test_an_estimate_from_moments_and_its_prior_are_in_the_declared_units():
    units = {n: u[1] for n, u in OTHERS.items()}
    run, stage = casid.Experiment(record()), [casid.StageSpec(("d", "k"))]
    kilograms = casid.Prior({"m": 2.0}, {"m": 0.1})
    expected = casid.multistage(problem(SI), run, stage, prior=kilograms)
    grams = casid.Prior({"m": 2000.0}, {"m": 100.0})
    found = casid.multistage(problem(units), run, stage, prior=grams)
    for name in ("d", "k"):
        unit = units[name]
        assert found.parameter(name).unit == unit
        assert in_si(found[name], unit) == pytest.approx(expected[name], rel=1e-6)
        assert in_si(found.std_error(name), unit) == pytest.approx(expected.std_error(name))
        assert found.parameter(name).std_error == pytest.approx(found.std_error(name))
    np.testing.assert_allclose(
        np.sqrt(np.diag(found.covariance)), [found.std_error(n) for n in found.names]
    )
    interval = profile(found, "k")
    assert interval.lower < found["k"] < interval.upper
    assert in_si(interval.lower, units["k"]) == pytest.approx(
        profile(expected, "k").lower, rel=1e-4
    )


def test_known_values_and_starts_are_in_the_declared_units():
    units = {n: u[1] for n, u in OTHERS.items()}
    stated = problem(units)
    run = casid.Experiment(record(), {"m": 2000.0})  # gram
    assert stated.model.unit_of("m") == "gram"
    found = casid.identify(stated, run, start={"k": 0.8, "q(0)": 10.0})
    assert found["k"] == pytest.approx(in_si_units()["k"] / 1e3, rel=0.02)
    known = casid.identify(stated.with_known({"m": 2000.0}), record())
    assert known["k"] == pytest.approx(found["k"], rel=1e-6)
    assert known["m"] == 2000.0


@pytest.mark.slow
def test_the_verdict_is_that_in_si_and_its_numbers_are_converted():
    units = {n: u[1] for n, u in OTHERS.items()}
    rubbed = record(friction=2.5)
    reference = casid.diagnose(problem(SI), rubbed, advise=False)
    found = casid.diagnose(problem(units), rubbed, advise=False)
    assert found.verdict == reference.verdict == "deficient"
    assert [(c.kind, c.where) for c in found.causes] == [
        (c.kind, c.where) for c in reference.causes
    ]
    size, expected = found.causes[0].parameters[0], reference.causes[0].parameters[0]
    assert in_si(size.value, size.unit) == pytest.approx(expected.value, rel=1e-3)
    for label in ("baseline_rmse", "extended_rmse", "noise_floor"):
        mine = found.held_out[label]["x"]
        assert mine * 1e-3 == pytest.approx(reference.held_out[label]["x"], rel=1e-3)
    assert {m.name: m.unit for m in found.moved}.items() <= units.items()
    text = found.sentence + " ".join(found.noise.values())
    assert " mm" in text
    assert " m " not in f"{text} ".replace(".", " ")


def test_noise_of_a_channel_beside_the_model_is_in_its_unit():
    units = SI | {"x": "mm"}
    stated = replace(problem(units), recorded={"temperature": "degC"})
    assert stated.noise_in_si({"x": 0.1, "temperature": 0.5}) == pytest.approx(
        {"x": 1e-4, "temperature": 0.5}  # a difference of temperature: K
    )
    marked = replace(stated, recorded={"ref": "mm/s^2"}, noise={"ref": 2.0})
    assert marked.in_si().noise == pytest.approx({"ref": 2e-3})


def test_practical_identifiability_takes_values_and_noise_in_the_declared_units():
    units = {n: u[1] for n, u in OTHERS.items()}
    at = {"m": 2.0, "d": 8.0, "k": 900.0, "q(0)": 0.01, "v(0)": 0.0}
    stated = problem(units)
    names = {"q(0)": "x", "v(0)": "v"}
    converted = {n: float(from_si(v, units[names.get(n, n)])) for n, v in at.items()}
    reference = casid.practical_identifiability(problem(SI), record(), at=at, noise={"x": 1e-4})
    found = casid.practical_identifiability(stated, record(), at=converted, noise={"x": 0.1})
    for mine, theirs in zip(found.parameters, reference.parameters, strict=True):
        assert mine.std_error == pytest.approx(theirs.std_error, rel=1e-6)
        assert mine.unit == theirs.unit  # SI
