"""Couplings, losses and falling gains are named beside the terms that a model has.

The records come from a Runge-Kutta integration written here.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import casid

Array = np.ndarray


def integrated(
    slope: Callable[[Array, Array], Array], x: Array, inputs: Array, Ts: float, substeps: int = 10
) -> Array:
    """(N, n) states at the samples under inputs (N, m) that are held between them."""
    h, path = Ts / substeps, np.empty((len(inputs), len(x)))
    for k, u in enumerate(inputs):
        path[k] = x
        for _ in range(substeps):
            k1 = slope(x, u)
            k2 = slope(x + 0.5 * h * k1, u)
            k3 = slope(x + 0.5 * h * k2, u)
            k4 = slope(x + h * k3, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return path


def held(rng: np.random.Generator, low: float, high: float, each: int, N: int) -> Array:
    """(N,) random values, each held for so many samples."""
    return np.repeat(rng.uniform(low, high, -(-N // each)), each)[:N]


def only_cause(found: casid.Diagnosis, kind: str, where: str, size: float) -> None:
    """One cause, of this size within four of its standard errors."""
    assert [(c.kind, c.where) for c in found.causes] == [(kind, where)]
    p = found.causes[0].parameters[0]
    assert p.std_error is not None
    assert p.value == pytest.approx(size, abs=4 * p.std_error)


# -- two rotors on a beam: each also turns the other axis -----------------------------------------


def beam() -> casid.Problem:
    m = casid.Model("beam")
    main = m.input("main", "V", hold="zoh", known=True)
    tail = m.input("tail", "V", hold="zoh", known=True)
    theta, q = m.state("theta", "rad"), m.state("q", "rad/s")
    psi, r = m.state("psi", "rad"), m.state("r", "rad/s")
    k_1 = m.parameter("k_1", "N m/V", start=0.3, lower=0.01)
    k_2 = m.parameter("k_2", "N m/V", start=0.2, lower=0.01)
    mgl = m.parameter("mgl", "N m", start=1.0, lower=0.01)
    d_p = m.parameter("d_p", "N m s/rad", start=0.03, lower=0.0)
    d_y = m.parameter("d_y", "N m s/rad", start=0.03, lower=0.0)
    k_y = m.parameter("k_y", "N m/rad", start=0.2, lower=0.0)
    m.derivative(theta, q)
    m.derivative(psi, r)
    m.balance(q, "pitch", inertia=0.09, terms=[k_1 * main, -mgl * ca.sin(theta), -d_p * q])
    m.balance(r, "yaw", inertia=0.05, terms=[k_2 * tail, -d_y * r, -k_y * psi])
    m.output("pitch_angle", theta, "rad")
    m.output("yaw_angle", psi, "rad")
    return casid.Problem("beam", m)


@pytest.mark.slow
@pytest.mark.parametrize(("into_pitch", "into_yaw"), [(0.06, 0.0), (0.0, 0.06)])
def test_an_input_that_acts_in_a_second_balance_is_a_further_input_there(
    into_pitch: float, into_yaw: float
) -> None:
    rng = np.random.default_rng(3)
    N = 800
    u = np.column_stack([held(rng, -1.0, 1.0, 40, N), held(rng, -1.0, 1.0, 40, N)])

    def slope(x: Array, u: Array) -> Array:
        theta, q, psi, r = x
        pitch = 0.45 * u[0] + into_pitch * u[1] - 1.4 * np.sin(theta) - 0.06 * q
        yaw = 0.3 * u[1] + into_yaw * u[0] - 0.05 * r - 0.25 * psi
        return np.array([q, pitch / 0.09, r, yaw / 0.05])

    x = integrated(slope, np.zeros(4), u, 0.02)
    noise = 1e-3 * rng.standard_normal((N, 2))
    record = casid.Record(
        {"main": u[:, 0], "tail": u[:, 1]}
        | {"pitch_angle": x[:, 0] + noise[:, 0], "yaw_angle": x[:, 2] + noise[:, 1]},
        {"main": "V", "tail": "V", "pitch_angle": "rad", "yaw_angle": "rad"},
        Ts=0.02,
    )
    found = casid.diagnose(beam(), record, advise=False)
    only_cause(found, "extra_input", "tail" if into_pitch else "main", 0.06)
    balance = "pitch" if into_pitch else "yaw"
    assert f"{balance} balance, too" in found.causes[0].sentence


# -- a receiver of air: a compressor fills it, a valve empties it ---------------------------------

CAPACITY, FLOW, VALVE, OUTSIDE = 4.76e-6, 2.5e-3, 2.2e-9, 1.013e5  # kg/Pa, kg/s, kg/(s Pa), Pa


def receiver() -> casid.Problem:
    m = casid.Model("receiver")
    speed = m.input("speed", "1", hold="zoh", known=True)
    opening = m.input("opening", "1", hold="zoh", known=True)
    p = m.state("p", "bar")
    C = m.parameter("C", "kg/Pa", value=CAPACITY)
    w = m.parameter("w_c", "kg/s", start=2e-3, lower=1e-5)
    k = m.parameter("k_v", "kg/(s Pa)", start=1e-9, lower=1e-12)
    m.balance(p, "mass", inertia=C, terms=[w * speed, -k * opening * p], unit="kg/s")
    m.output("pressure", p, "bar")
    return casid.Problem("receiver", m)


def filled(*, leak: float = 0.0, falls: float = 0.0) -> casid.Record:
    """25 min: a leak to the air outside [kg/(s Pa)], a flow that falls with pressure [1/bar]."""
    rng = np.random.default_rng(5)
    u = np.column_stack([held(rng, 0.0, 1.0, 50, 1500), held(rng, 0.0, 1.0, 40, 1500)])

    def slope(x: Array, u: Array) -> Array:
        (p,) = x
        flow = FLOW * (1.0 - falls * (p - 3e5) / 1e5)
        return np.array([flow * u[0] - VALVE * u[1] * p - leak * (p - OUTSIDE)]) / CAPACITY

    p = integrated(slope, np.array([4e5]), u, 1.0)[:, 0]
    return casid.Record(
        {"speed": u[:, 0], "opening": u[:, 1], "pressure": p + 1.5e3 * rng.standard_normal(1500)},
        {"speed": "1", "opening": "1", "pressure": "Pa"},
        Ts=1.0,
    )


@pytest.mark.slow
def test_a_leak_is_a_loss_or_a_valve_that_never_closes() -> None:
    """To a vacuum, c p and k_v b p, the two would be one and the same."""
    found = casid.diagnose(receiver(), filled(leak=1.6e-9), advise=False)
    (cause,) = found.causes
    one_of = {(cause.kind, cause.where), *((a.kind, a.where) for a in cause.alternatives)}
    assert one_of == {("unknown", "mass"), ("sensor_bias", "opening")}
    before, after = (found.held_out[k]["pressure"] for k in ("baseline_rmse", "extended_rmse"))
    assert after < 0.3 * before


@pytest.mark.slow
def test_the_flow_of_a_compressor_falls_with_the_pressure() -> None:
    """w_c + s (p - mean): s is 8 % of the flow at 3 bar for every bar."""
    found = casid.diagnose(receiver(), filled(falls=0.08), advise=False)
    only_cause(found, "scheduled_parameter", "w_c~p", -0.08 * FLOW)
    assert found.causes[0].parameters[0].unit == "kg/(s bar)"


# -- two stirred sides of a heat exchanger --------------------------------------------------------


@pytest.mark.slow
def test_a_pump_that_gives_more_than_it_is_told_has_a_gain_error() -> None:
    """The record is the flow over 1 + s, 1 + s = 1 / 1.1."""
    rc, V_h, V_c, UA, N = 4.18e6, 2e-3, 3e-3, 320.0, 1000
    m = casid.Model("exchanger")
    names = {"F_hot": "m^3/s", "F_cold": "m^3/s", "T_hot": "K", "T_cold": "K"}
    hot, cold, T_hot, T_cold = (
        m.input(n, unit, hold="zoh", known=True) for n, unit in names.items()
    )
    h, c = m.state("T_h", "K"), m.state("T_c", "K")
    v_h = m.parameter("V_h", "m^3", start=1e-3, lower=1e-5)
    v_c = m.parameter("V_c", "m^3", start=2e-3, lower=1e-5)
    ua = m.parameter("UA", "W/K", start=200.0, lower=1.0)
    hot_side, cold_side = [rc * hot * (T_hot - h)], [rc * cold * (T_cold - c)]
    m.balance(h, "hot", inertia=rc * v_h, terms=[*hot_side, -ua * (h - c)], unit="W")
    m.balance(c, "cold", inertia=rc * v_c, terms=[*cold_side, ua * (h - c)], unit="W")
    m.output("hot_out", h, "K")
    m.output("cold_out", c, "K")

    rng = np.random.default_rng(7)
    ranges = [(3e-5, 15e-5, 40), (3e-5, 20e-5, 35), (325.0, 341.0, 120), (285.0, 291.0, 110)]
    u = np.column_stack([held(rng, *each, N) for each in ranges])

    def slope(x: Array, u: Array) -> Array:
        passed = UA * (x[0] - x[1])
        one = 1.1 * u[0] * rc * (u[2] - x[0]) - passed
        other = u[1] * rc * (u[3] - x[1]) + passed
        return np.array([one / (rc * V_h), other / (rc * V_c)])

    y = integrated(slope, np.array([318.0, 298.0]), u, 5.0)
    y = y + 0.05 * rng.standard_normal((N, 2))
    columns = {**dict(zip(names, u.T, strict=True)), "hot_out": y[:, 0], "cold_out": y[:, 1]}
    record = casid.Record(columns, {**names, "hot_out": "K", "cold_out": "K"}, Ts=5.0)
    found = casid.diagnose(casid.Problem("exchanger", m), record, advise=False)
    only_cause(found, "sensor_scale", "F_hot", 1 / 1.1 - 1)


# -- a chemostat whose cells use sugar to stay alive ----------------------------------------------


def chemostat() -> casid.Problem:
    m = casid.Model("chemostat")
    X = m.state("X", "gram/L", start=5.0, lower=0.0)
    S = m.state("S", "gram/L", start=1.0, lower=0.0)
    D = m.input("D", "1/h", hold="zoh", known=True)
    mu = m.parameter("mu", "1/h", start=0.3, lower=0.05, upper=1.0)
    K = m.parameter("K", "gram/L", start=0.5, lower=0.01, upper=10.0)
    Y = m.parameter("Y", "1", start=0.45, lower=0.1, upper=1.0)
    growth = mu * S / (K + S) * X
    m.balance(X, "biomass", inertia=1, terms=[growth, -D * X], unit="gram/(L h)")
    feed = m.constant("S_f", 10.0, "gram/L")
    m.balance(S, "sugar", inertia=1, terms=[-growth / Y, D * (feed - S)], unit="gram/(L h)")
    m.output("cells", X, "gram/L")
    m.output("rest", S, "gram/L")
    return casid.Problem("chemostat", m, starts=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "maintenance", "death"), [("sugar", 0.03, 0.0), ("biomass", 0.0, 0.01)]
)
def test_what_cells_use_beside_growth_and_what_dies_are_in_proportion_to_them(
    where: str, maintenance: float, death: float
) -> None:
    """Maintenance in g of sugar an hour for each g of cells (Pirt 1965), and death in 1/h.

    Without cells there is no growth: their loss has no level of rest but zero.
    """
    rng, N, Ts = np.random.default_rng(3), 400, 0.5

    def slope(x: Array, u: Array) -> Array:
        cells, sugar = x
        growth = 0.35 * sugar / (0.6 + sugar) * cells
        uptake = growth / 0.5 + maintenance * cells
        return np.array([growth - (u[0] + death) * cells, -uptake + u[0] * (10.0 - sugar)])

    # Two batches in one record: the cells grow from a fiftieth, and are diluted again.
    D = np.where((np.arange(N) % 200 > 120) & (np.arange(N) < 200), 0.33, 0.0)
    D += np.where(np.arange(N) % 200 < 120, held(rng, 0.0, 0.1, 20, N), 0.0)
    path = integrated(slope, np.array([0.1, 9.0]), D[:, None], Ts)
    noisy = path + 0.03 * rng.standard_normal(path.shape)
    channels = {"D": D / 3600.0, "cells": noisy[:, 0], "rest": noisy[:, 1]}
    units = {"D": "1/s", "cells": "kg/m^3", "rest": "kg/m^3"}
    record = casid.Record(channels, units, Ts=3600.0 * Ts)
    found = casid.diagnose(chemostat(), record, advise=False)
    only_cause(found, "unknown", where, maintenance + death)
    assert [(p.name, p.unit) for p in found.causes[0].parameters] == [("c_X", "1/h")]
