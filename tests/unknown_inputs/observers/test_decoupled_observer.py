"""Observers that do not see an unknown input: (3.69)-(3.74) of Linder (2017)."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.model.model import Model
from casid.unknown_inputs.observers.decoupled_observer import decoupled_observer
from casid.unknown_inputs.observers.equivalent_model import (
    equivalent_model,
    existence,
    unrecoverable_inputs,
)
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem
from problems import pendulum

Array = np.ndarray[Any, Any]
SEEDS = st.integers(0, 10**6)


def random_system(
    seed: int, n: int = 4, nk: int = 1, nu: int = 2, ny: int = 4, rank_F: int = 1, Ts: float = 1.0
) -> UnknownInputSystem:
    """A generic stable system, F of the given rank."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.8 / np.max(np.abs(np.linalg.eigvals(A)))
    if Ts == 0:
        A = A - np.eye(n)
    F = rng.standard_normal((ny, rank_F)) @ rng.standard_normal((rank_F, nu))
    B, E, C, D = (rng.standard_normal(s) for s in ((n, nk), (n, nu), (ny, n), (ny, nk)))
    return UnknownInputSystem(A, B, E, C, D, F, Ts)


def simulated(s: UnknownInputSystem, u: Array, unknown: Array, x0: Array) -> tuple[Record, Array]:
    """Record and states (N, nx) of a discrete-time system."""
    x, states, y = x0, [], []
    for k, w in zip(u, unknown, strict=True):
        states.append(x)
        y.append(s.C @ x + s.D @ k + s.F @ w)
        x = s.A @ x + s.B @ k + s.E @ w
    columns = dict(zip(s.outputs, np.array(y).T, strict=True))
    columns |= dict(zip(s.known, u.T, strict=True))
    return Record(columns, dict.fromkeys(columns, "1"), Ts=s.Ts), np.array(states)


# -- the equivalent model (3.70) -------------------------------------------------------------------


@given(seed=SEEDS, rank_F=st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_the_equivalent_model_3_70_holds_along_every_motion(seed: int, rank_F: int) -> None:
    """(3.72) is an identity in x, u_K and u_U, generic F of any rank; E-6: ybar = (I - F F+) y."""
    s = random_system(seed, rank_F=rank_F)
    m = equivalent_model(s)
    assert m.is_exact
    rng = np.random.default_rng(seed)
    x, u, u_next, w, w_next = (rng.standard_normal(k) for k in (4, 1, 1, 2, 2))
    after = s.A @ x + s.B @ u + s.E @ w
    y, y_next = s.C @ x + s.D @ u + s.F @ w, s.C @ after + s.D @ u_next + s.F @ w_next
    claimed = m.A @ x + m.B1 @ u + m.B2 @ u_next + m.G1 @ y + m.G2 @ y_next
    size = 1 + np.linalg.norm(m.A) + np.linalg.norm(m.G1) + np.linalg.norm(m.G2)
    np.testing.assert_allclose(claimed, after, atol=1e-12 * size * (1 + np.linalg.norm(y_next)))
    np.testing.assert_allclose(m.P_y @ y, m.C @ x + m.D @ u, atol=1e-12 * (1 + np.linalg.norm(y)))


def test_example_3_12_the_mean_of_two_measurements_takes_the_unknown_input_away() -> None:
    """F = [1; 1]: F+ = [.5 .5], xdot = (A - E F+ C) x + E F+ y, ybar = (y1 - y2) [.5; -.5]."""
    A, E = np.array([[0.0, 1.0], [-2.0, -3.0]]), np.array([[0.0], [1.0]])
    C, F = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([[1.0], [1.0]])
    empty = np.zeros((2, 0))
    s = UnknownInputSystem(A, empty, E, C, empty, F)
    m = equivalent_model(s)
    half = np.array([[0.5, 0.5]])
    np.testing.assert_allclose(m.A, A - E @ half @ C, atol=1e-15)
    np.testing.assert_allclose(m.G1, E @ half, atol=1e-15)
    np.testing.assert_array_equal(m.G2, np.zeros((2, 2)))  # no derivative of y
    np.testing.assert_allclose(m.P_y, [[0.5, -0.5], [-0.5, 0.5]], atol=1e-15)
    np.testing.assert_allclose(m.C, m.P_y @ C, atol=1e-15)


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.3, 2.9])
def test_a_matrix_that_vanishes_in_algebra_is_not_inverted(angle: float) -> None:
    """T-7: with F of full column rank Pu = 0, in numbers 1e-16, whose pseudo-inverse is 1e16."""
    rng = np.random.default_rng(5)
    F = np.array([[np.cos(angle)], [np.sin(angle)], [0.3]])
    s = UnknownInputSystem(
        rng.standard_normal((3, 3)),
        np.zeros((3, 0)),
        rng.standard_normal((3, 1)),
        rng.standard_normal((3, 3)),
        np.zeros((3, 0)),
        F,
    )
    m = equivalent_model(s)
    assert np.max(np.abs(m.G2)) < 1e-12
    assert m.is_exact


# -- existence -------------------------------------------------------------------------------------


@given(seed=SEEDS, zero=st.floats(-3.0, 3.0))
@settings(max_examples=40, deadline=None)
def test_the_observer_exists_iff_the_rank_test_3_71_holds(seed: int, zero: float) -> None:
    """Given the matching condition: (Abar, Cbar) detectable iff no zero with Re s >= 0."""
    assume(abs(zero) > 0.05)
    rng = np.random.default_rng(seed)
    n = 3
    T, x0 = rng.standard_normal((n, n)), rng.standard_normal(n)
    assume(np.linalg.cond(T) < 50)
    # A zero put there: a state direction x0 with A x0 + E u0 = zero x0, C x0 + F u0 = 0, u0 = 1.
    E, F = rng.standard_normal((n, 1)), rng.standard_normal((2, 1))
    A, C = rng.standard_normal((n, n)), rng.standard_normal((2, n))
    back = x0 / (x0 @ x0)
    A = A + np.outer(zero * x0 - E[:, 0] - A @ x0, back)
    C = C + np.outer(-F[:, 0] - C @ x0, back)
    empty = np.zeros((n, 0))
    found = existence(UnknownInputSystem(A, empty, E, C, np.zeros((2, 0)), F))
    assert np.min(np.abs(found.zeros.values - zero)) < 1e-6
    assert found.exists == (not any(z.real >= 0 for z in found.zeros.values))
    # What (Abar, Cbar) does not observe are the zeros, no more and no less.
    np.testing.assert_allclose(
        np.sort_complex(found.fixed_poles), np.sort_complex(found.zeros.values), atol=1e-6
    )
    P = np.block([[A - zero * np.eye(n), E], [C, F]])
    assert np.linalg.matrix_rank(P, tol=1e-8) < n + 1  # (3.71) fails there


@given(
    seed=SEEDS,
    rank_F=st.integers(0, 2),
    ny=st.integers(2, 3),
    powers=st.tuples(*[st.integers(-8, 8)] * 3),
)
@settings(max_examples=40, deadline=None)
def test_units_do_not_decide_whether_an_observer_exists(
    seed: int, rank_F: int, ny: int, powers: tuple[int, int, int]
) -> None:
    """An unknown input in other units, an output, time: zeros and verdict stay (time scales them).

    Two inputs and two outputs, where zeros there are, or three, where there are none.
    """
    s = random_system(seed, rank_F=rank_F, ny=ny, Ts=0.0)
    in_, out, clock = (10.0**p for p in powers)
    clock = clock ** (1 / 4)
    E, F = s.E * [in_, 1.0], s.F * [in_, 1.0]
    rows = np.array([[out], *[[1.0]] * (ny - 1)])
    t = UnknownInputSystem(
        clock * s.A, clock * s.B, clock * E, rows * s.C, rows * s.D, rows * F, 0.0
    )
    one, other = existence(s), existence(t)
    assert other.model.is_exact == one.model.is_exact
    assert len(other.zeros.values) == len(one.zeros.values)
    np.testing.assert_allclose(
        np.sort_complex(other.zeros.values / clock),
        np.sort_complex(one.zeros.values),
        atol=1e-5 * (1 + np.max(np.abs(one.zeros.values), initial=0.0)),
    )
    assert other.exists == one.exists


def test_the_refusal_names_the_unstable_zero_and_where_it_is() -> None:
    """y = (s - 2)/((s + 1)(s + 3)) u: zero at +2; a second output without it mends it."""
    A, E = np.array([[0.0, 1.0], [-3.0, -4.0]]), np.array([[0.0], [1.0]])
    sys = control.StateSpace(
        A, E, [[-2.0, 1.0]], [[0.0]], inputs=["force"], outputs=["y"], states=["pos", "vel"]
    )
    with pytest.raises(ModelError, match=r"zero s = 2 \(2 rad/s\), along vel, pos") as refusal:
        decoupled_observer(sys, "force", poles=[-1, -2])
    assert "Add an output that sees them" in str(refusal.value)
    more = control.StateSpace(
        A, E, [[-2.0, 1.0], [0.0, 1.0]], np.zeros((2, 1)), inputs=["force"], outputs=["y", "speed"]
    )
    assert existence(unknown_input_system(more, "force")).exists


def test_the_rank_test_alone_does_not_make_an_observer() -> None:
    """Position of a mass, force unknown: no zeros, so (3.71) holds, but the force needs y''."""
    sys = control.StateSpace(
        [[0.0, 1.0], [0.0, 0.0]],
        [[0.0], [1.0]],
        [[1.0, 0.0]],
        [[0.0]],
        inputs=["force"],
        outputs=["position"],
        states=["x", "v"],
    )
    s = unknown_input_system(sys, "force")
    found = existence(s)
    assert found.zeros.values.size == 0
    assert not found.exists
    with pytest.raises(ModelError, match="moves v, but neither position nor the first") as refusal:
        decoupled_observer(s, poles=[-1, -2])
    assert "Measure a signal nearer" in str(refusal.value)
    both = UnknownInputSystem(s.A, s.B, s.E, np.eye(2), np.zeros((2, 0)), np.zeros((2, 1)))
    assert existence(both).exists  # the velocity mends it


def test_inputs_that_no_output_tells_apart_are_named() -> None:
    """u1 and u2 act alike, u3 is on its own: the first two cannot be recovered."""
    rng = np.random.default_rng(2)
    E = rng.standard_normal((3, 3))
    E[:, 1] = 2 * E[:, 0]
    s = UnknownInputSystem(
        -np.eye(3), np.zeros((3, 0)), E, np.eye(3), np.zeros((3, 0)), np.zeros((3, 3))
    )
    assert unrecoverable_inputs(s) == ("u1", "u2")
    assert existence(s).exists  # the states can be observed all the same
    few = UnknownInputSystem(
        s.A - np.diag([0.0, 1.0, 2.0]),
        s.B,
        rng.standard_normal((3, 3)),
        s.C[:2],
        np.zeros((2, 0)),
        s.F[:2],
    )
    with pytest.raises(ModelError, match="u1, u2, u3 cannot be distinguished") as refusal:
        decoupled_observer(few, poles=[-1, -2, -3])
    assert "Add an output" in str(refusal.value)


# -- the observer ----------------------------------------------------------------------------------


@given(seed=SEEDS, rank_F=st.integers(0, 2))
@settings(max_examples=25, deadline=None)
def test_the_error_does_not_see_the_unknown_input(seed: int, rank_F: int) -> None:
    """Two unknown inputs, one a thousand times the other: the same error to rounding."""
    s = random_system(seed, rank_F=rank_F)
    found = existence(s)
    assume(found.exists)
    observer = decoupled_observer(s, poles=[0.5, 0.4, -0.3, 0.2])
    rng = np.random.default_rng(seed)
    u, w, x0 = rng.standard_normal((60, 1)), rng.standard_normal((60, 2)), rng.standard_normal(4)
    errors = []
    for unknown in (0 * w, 1e3 * w):
        record, x = simulated(s, u, unknown, x0)
        errors.append(x - observer.run(record).x)
    gain = 1 + sum(np.linalg.norm(m) for m in observer.matrices)
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-11 * 1e3 * gain**2)


def test_the_error_dies_out_as_the_placed_poles_have_it() -> None:
    s = random_system(3, rank_F=1)
    poles = np.array([0.6, 0.5, 0.2, 0.1])
    observer = decoupled_observer(s, poles=poles)
    np.testing.assert_allclose(np.sort(observer.poles.real), np.sort(poles), atol=1e-8)
    rng = np.random.default_rng(1)
    record, x = simulated(s, rng.standard_normal((40, 1)), rng.standard_normal((40, 2)), np.ones(4))
    error = x - observer.run(record).x
    norm = np.linalg.norm(error, axis=1)
    assert norm[30] / norm[20] == pytest.approx(0.6**10, rel=0.05)  # (.5/.6)^20 = 2.6 % is left
    told = {f"x{i + 1}": 1.0 for i in range(4)}
    np.testing.assert_allclose(observer.run(record, x0=told).x, x, atol=1e-10)


def test_poles_that_no_gain_moves_are_the_stable_zeros() -> None:
    """One output, one unknown input that it feels at once: everything is a zero."""
    s = random_system(4, n=3, nk=1, nu=1, ny=1, rank_F=1)
    assert not existence(s).exists  # and some are unstable
    A = s.A + s.E @ s.C / s.F  # u = -C x / F hides the state, which then obeys the old, stable A
    s = UnknownInputSystem(A, s.B, s.E, s.C, s.D, s.F, s.Ts)
    observer = decoupled_observer(s, poles=[])
    np.testing.assert_allclose(
        np.sort_complex(observer.poles), np.sort_complex(existence(s).zeros.values), atol=1e-9
    )
    with pytest.raises(ModelError, match="1 poles given, but 0 can be placed; z = "):
        decoupled_observer(s, poles=[0.5])


def test_a_continuous_observer_on_a_record_has_an_error_of_the_second_order_in_ts() -> None:
    """Its equation is sampled exactly; straight lines between samples miss the curvature."""
    A, E = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [1.0]])
    C = np.array([[0.0, 1.0], [1.0, 0.0]])
    s = UnknownInputSystem(A, np.zeros((2, 0)), E, C, np.zeros((2, 0)), np.zeros((2, 1)))
    observer = decoupled_observer(s, poles=[-2.0, -3.0])
    w = 1.7  # unknown input cos(w t) in the steady state
    x = np.linalg.solve(1j * w * np.eye(2) - A, E[:, 0])
    worst = []
    for Ts in (0.1, 0.05):
        t = np.arange(0.0, 20.0, Ts)
        true = (x[None, :] * np.exp(1j * w * t)[:, None]).real
        y = true @ C.T
        record = Record({"y1": y[:, 0], "y2": y[:, 1]}, {"y1": "1", "y2": "1"}, Ts=Ts)
        late = t > 10
        worst.append(np.max(np.abs(observer.run(record).x - true)[late]))
    assert worst[1] < 0.02 * np.max(np.abs(x))
    assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.15)  # second order


def test_a_sampled_observer_is_exact_where_the_unknown_input_is_held() -> None:
    A, E = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [1.0]])
    C = np.array([[0.0, 1.0], [1.0, 0.0]])
    s = UnknownInputSystem(
        A, E, E, C, np.zeros((2, 1)), np.zeros((2, 1)), holds={"k1": "zoh"}
    ).sampled(0.1)
    observer = decoupled_observer(s, poles=[0.5, 0.6])
    rng = np.random.default_rng(0)
    record, x = simulated(
        s, rng.standard_normal((200, 1)), rng.standard_normal((200, 1)), np.ones(2)
    )
    np.testing.assert_allclose(observer.run(record).x[100:], x[100:], atol=1e-12)


def test_the_pendulum_s_angle_is_observed_though_the_cart_s_acceleration_is_not() -> None:
    """Example 3.12's kind: the accelerometer feels a_y at once, and takes its place. Nonlinear
    motion, straight lines between samples: 1e-3 of the largest angle."""
    reference = pendulum.telegraph(2000, 0.01, amplitude=0.3, rng=np.random.default_rng(1))
    record = pendulum.simulate(ref=reference, noise=0.0)
    values = {name: pendulum.TABLE_7_2[name] for name in ("k", "d", "I_x")}
    phi = pendulum.motion(reference, 0.01, 5, m=0.0, d_2=0.0, **values)[0]
    observer = decoupled_observer(pendulum.linear_model(), poles=[-3.0, -4.0], values=values)
    error = observer.run(record, x0={"phi": 0.1})["phi"] - phi
    assert np.max(np.abs(error[:10])) > 0.09
    assert np.max(np.abs(error[600:])) < 1e-3 * np.max(np.abs(phi))


def test_the_gain_of_least_variance_has_the_variance_it_states_and_none_is_smaller() -> None:
    """Ensemble of noise realisations; sd of a sample variance over M draws: sqrt(2 / M)."""
    s = random_system(8, rank_F=1)
    noise = {"y1": 0.1, "y2": 0.3, "y3": 0.2, "y4": 0.1}
    process = 0.01 * np.eye(4)
    best = decoupled_observer(s, noise=noise, process=process)
    placed = decoupled_observer(s, poles=[0.5, 0.4, -0.3, 0.2])
    rng = np.random.default_rng(3)
    sd = np.array(list(noise.values()))
    M, N = 1500, 60
    x = np.zeros((M, 4))
    z = {"best": np.zeros((M, 4)), "placed": np.zeros((M, 4))}
    observers = {"best": best.matrices, "placed": placed.matrices}
    hat: dict[str, Array] = {}
    for _ in range(N):
        w = rng.standard_normal((M, 2))
        y = x @ s.C.T + w @ s.F.T + sd * rng.standard_normal((M, 4))
        v = np.hstack([np.zeros((M, 1)), y])
        now = x
        for name, (A, B, C, D) in observers.items():
            hat[name] = z[name] @ C.T + v @ D.T
            z[name] = z[name] @ A.T + v @ B.T
        x = x @ s.A.T + w @ s.E.T + 0.1 * rng.standard_normal((M, 4))
    variance = {name: np.mean((now - h) ** 2, axis=0) for name, h in hat.items()}
    assert best.covariance is not None
    np.testing.assert_allclose(
        variance["best"], np.diag(best.covariance), rtol=3.5 * np.sqrt(2 / M)
    )
    assert np.all(variance["best"] < variance["placed"] * (1 + 3.5 * np.sqrt(2 / M)))


def test_a_model_names_its_unknown_input_itself() -> None:
    m = Model("mass on a spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    push, force = m.input("push", "N"), m.unknown_input("force", "N")
    k = m.parameter("k", "N/m")
    m.derivative(x, v)
    m.balance(v, "force", inertia=2.0, terms=[-k * x, push, force])
    m.output("speed", v, "m/s")
    m.output("place", x, "m")
    s = unknown_input_system(m, values={"k": 8.0})
    assert (s.known, s.unknown, s.outputs) == (("push",), ("force",), ("speed", "place"))
    np.testing.assert_allclose(s.E, [[0.0], [0.5]])
    observer = decoupled_observer(m, poles=[-1.0, -2.0], values={"k": 8.0})
    assert observer.to_control().input_labels == ["push", "speed", "place"]
    same = s.to_control()
    again = unknown_input_system(same, "force")
    np.testing.assert_array_equal(again.A, s.A)
    record = Record(
        {n: np.zeros(5) for n in ("push", "speed", "place")},
        {"push": "N", "speed": "m/s", "place": "rad"},
        Ts=0.1,
    )
    with pytest.raises(DataError, match="place is in rad, mass on a spring has it in m"):
        observer.run(record)


# -- bad input -------------------------------------------------------------------------------------


def test_what_is_asked_wrongly_is_refused_with_its_mend() -> None:
    s = random_system(1)
    with pytest.raises(ModelError, match=r"give either poles=\[...\] \(4 of them\)"):
        decoupled_observer(s)
    with pytest.raises(ModelError, match=r"not all stable; give \|z\| < 1"):
        decoupled_observer(s, poles=[0.5, 0.4, 0.3, 1.5])
    with pytest.raises(ModelError, match="complex ones in conjugate pairs"):
        decoupled_observer(s, poles=[0.5 + 0.1j, 0.4, 0.3, 0.2])
    with pytest.raises(ModelError, match="no noise of y2"):
        decoupled_observer(s, noise={"y1": 1.0, "y3": 1.0, "y4": 1.0})
    slow = random_system(1, Ts=0.0)
    with pytest.raises(ModelError, match=r"sample it first, system.sampled\(Ts\)"):
        decoupled_observer(slow, noise=dict.fromkeys(slow.outputs, 1.0))
    sys = control.StateSpace(-1, 1, 1, 0)
    with pytest.raises(ModelError, match="which input is unknown"):
        decoupled_observer(sys, poles=[])
    named = control.StateSpace(-1, 1, 1, 0, inputs=["force"])
    with pytest.raises(ModelError, match="has no input 'forse'; did you mean 'force'"):
        decoupled_observer(named, "forse", poles=[])
    with pytest.raises(ModelError, match="give dt in seconds"):
        unknown_input_system(control.StateSpace(-1, 1, 1, 0, True), "u[0]")
    with pytest.raises(ModelError, match=r"B is \(3, 1\), but 2 states.*need \(2, 1\)"):
        UnknownInputSystem(
            np.eye(2),
            np.zeros((3, 1)),
            np.ones((2, 1)),
            np.eye(2),
            np.zeros((2, 1)),
            np.ones((2, 1)),
        )


def test_records_that_do_not_fit_are_refused_with_their_mend() -> None:
    s = random_system(1)
    observer = decoupled_observer(s, poles=[0.5, 0.4, -0.3, 0.2])
    record, _ = simulated(s, np.zeros((9, 1)), np.zeros((9, 2)), np.ones(4))
    with pytest.raises(DataError, match="no channel 'y4'.*record.rename"):
        observer.run(record.without("y4"))
    mask = np.arange(9) == 4
    with pytest.raises(DataError, match="y2 is missing at sample 4.*record.filled"):
        observer.run(record.mark_missing("y2", mask))
    with pytest.raises(DataError, match="known input k1 has missing samples"):
        observer.run(record.mark_missing("k1", mask))
    other = Record(dict(record.channels), dict(record.units), Ts=2.0)
    with pytest.raises(DataError, match="Ts = 2 s, but system is sampled with 1 s; resample"):
        observer.run(other)
    with pytest.raises(DataError, match="has no state 'z'"):
        observer.run(record, x0={"z": 1.0})
