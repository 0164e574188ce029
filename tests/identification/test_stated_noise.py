"""The noise that a problem states of an input, against the floor of its channel."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.noise.noise_floor import floor_error
from casid.identification.problem_notes import notes_on_stated_noise

SD, N, TS = 0.12, 1000, 0.05  # m/s^2, samples, s


def problem(stated: float | None) -> casid.Problem:
    """A pendulum below a support, whose acceleration a noisy sensor measures."""
    m = casid.Model("pendulum below a support")
    angle, rate = m.state("angle", "rad"), m.state("rate", "rad/s")
    acc = m.input("acc", "m/s^2")
    length = m.parameter("L", "m", start=1.0, lower=0.1, upper=10.0)
    m.derivative(angle, rate)
    m.balance(rate, "swing", inertia=length, terms=[-9.81 * angle, -acc])
    m.output("phi", angle, "deg")
    return casid.Problem("pendulum", m, starts=1, noise={} if stated is None else {"acc": stated})


def experiment(acc: np.ndarray) -> casid.Experiment:
    columns = {"acc": acc, "phi": np.zeros(len(acc))}
    return casid.Experiment(casid.Record(columns, {"acc": "m/s^2", "phi": "rad"}, Ts=TS))


def slow() -> np.ndarray:
    """A motion whose highest frequency is a tenth of Nyquist."""
    t = TS * np.arange(N)
    return np.sin(2 * np.pi * 0.4 * t) + np.sin(2 * np.pi * 1.0 * t)


def noisy() -> np.ndarray:
    return slow() + SD * np.random.default_rng(3).standard_normal(N)


@pytest.mark.parametrize(
    ("stated", "count"), [(0.02, 1), (SD, 0), (2 * SD, 0), (0.0, 0), (None, 0)]
)
def test_a_channel_that_scatters_by_more_than_is_stated_of_it_is_noted(stated, count):
    """Its floor is known to some per cent, and one of a sixth is far below it.

    An input that is stated to have no noise is exact by the word of the user.
    """
    assert len(notes_on_stated_noise(problem(stated), [experiment(noisy())])) == count


def test_the_note_gives_both_sizes_and_what_to_state():
    """The variance of a floor has a relative standard error of `floor_error`."""
    (note,) = notes_on_stated_noise(problem(0.02), [experiment(noisy())])
    shown = float(note.partition("as noise of ")[2].split()[0])  # m/s^2
    assert abs(shown**2 / SD**2 - 1) < 3.5 * floor_error([N])
    assert "20 mm/s^2 is stated" in note
    assert note.endswith("to have it estimated")


def test_a_command_that_is_held_has_no_noise_however_its_steps_scatter():
    held = np.repeat(np.random.default_rng(4).standard_normal(N // 10), 10)
    assert not notes_on_stated_noise(problem(0.02), [experiment(held)])


def test_identify_gives_the_note_beside_its_estimate():
    true, phi = slow(), np.zeros(N)
    x, h = np.zeros(2), TS / 20
    for k in range(N - 1):
        phi[k] = x[0]
        for i in range(20):
            acc = true[k] + (true[k + 1] - true[k]) * i / 20
            x[1] += h * (-9.81 * x[0] - acc)
            x[0] += h * x[1]
    phi += 1e-3 * np.random.default_rng(5).standard_normal(N)
    record = casid.Record({"acc": noisy(), "phi": phi}, {"acc": "m/s^2", "phi": "rad"}, Ts=TS)
    estimate = casid.identify(problem(0.02), record, intervals="quick")
    assert any("is stated" in note for note in estimate.warnings)


def test_identify_with_a_disturbance_gives_the_note_as_well():
    """What is doubtful in a problem does not depend on the criterion of the estimate."""
    rng, x, h = np.random.default_rng(5), np.zeros(2), TS / 10
    acc, phi = np.repeat(rng.standard_normal(N // 10), 10), np.zeros(N)
    for k in range(N):
        phi[k] = x[0] + 1e-3 * rng.standard_normal()
        push = 0.3 * rng.standard_normal()  # of one sample, in the motion alone
        for _ in range(10):
            x[1] += h * (-9.81 * x[0] - acc[k] - push)
            x[0] += h * x[1]
    measured = acc + SD * rng.standard_normal(N)
    columns, units = {"acc": measured, "phi": phi}, {"acc": "m/s^2", "phi": "rad"}
    record = casid.Record(columns, units, Ts=TS)
    estimate = casid.identify(problem(0.02), record, disturbances="swing:white", intervals="quick")
    assert any("is stated" in w for w in estimate.warnings)
