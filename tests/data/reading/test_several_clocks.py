"""Channels with clocks of their own: time columns side by side, rows of one channel each."""

from __future__ import annotations

from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.data.reading.clocks.absent_rows import SHORT, even_clock
from casid.errors import DataError

SPAN = 40.0  # s
TRUE = {"d": 0.8, "k": 40.0}
SIGMA = 0.003  # m
A = np.array([[0.0, 1.0], [-TRUE["k"], -TRUE["d"]]])


def clocks(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Instants of a force, even, and of a position, later, slower and jittered."""
    rng = np.random.default_rng(seed)
    slow = np.arange(0.013, SPAN - 1, 0.05)
    return np.arange(0.0, SPAN, 0.02), np.sort(slow + 0.004 * rng.standard_normal(slow.size))


def motion(force: np.ndarray, t_force: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Position of a mass of 1 kg on a spring at instants t; the force joined by lines; from rest.

    Between neighbours of the union of all instants the force is one line, and the answer exact.
    """
    every = np.unique(np.concatenate([t_force, t]))
    u, out, x = np.interp(every, t_force, force), np.empty(every.size), np.zeros(2)
    for i, now in enumerate(every):
        out[i] = x[0]
        if i == every.size - 1:
            break
        dt = every[i + 1] - now
        whole = np.zeros((4, 4))
        whole[:2, :2], whole[1, 2], whole[2, 3] = A, 1.0, 1.0
        x = (expm(dt * whole) @ [*x, u[i], (u[i + 1] - u[i]) / dt])[:2]
    return out[np.searchsorted(every, t)]


def signals(seed: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    t_force, t = clocks(seed)
    force = np.interp(t_force, np.arange(0, SPAN + 1, 0.5), rng.uniform(-5, 5, 82))
    x = motion(force, t_force, t) + SIGMA * rng.standard_normal(t.size)
    return {"F": (t_force, force), "x": (t, x)}


def model() -> casid.Model:
    m = casid.Model("mass")
    x, v, F = m.state("x", "m"), m.state("v", "m/s"), m.input("F", "N", known=True)
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0)
    k = m.parameter("k", "N/m", start=35.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 1.0, "kg"), terms=[F, -d * v, -k * x], unit="N")
    m.output("x", x, "m")
    return m


def side_by_side(path: Path, named: tuple[str, ...]) -> Path:
    """Every channel behind its time column, as long as it is."""
    columns = [c for pair in signals().values() for c in pair]
    rows = zip_longest(*(map(repr, c.tolist()) for c in columns), fillvalue="")
    path.write_text("\n".join([",".join(named), *(",".join(row) for row in rows)]) + "\n")
    return path


def rows_of_their_own(path: Path) -> Path:
    """One time column, a row for every sample of either channel."""
    (t_F, F), (t_x, x) = signals().values()
    rows = [(t, f"{t!r},{f!r},") for t, f in zip(t_F.tolist(), F.tolist(), strict=True)]
    rows += [(t, f"{t!r},,{p!r}") for t, p in zip(t_x.tolist(), x.tolist(), strict=True)]
    path.write_text("\n".join(["t,F,x", *(text for _, text in sorted(rows))]) + "\n")
    return path


def require_as_measured(record: casid.Record) -> None:
    """Every sample is there, at its own instant to within a tenth of its channel's interval."""
    for name, (t, values) in signals().items():
        there = ~record.is_missing(name)
        assert np.array_equal(record[name][there], values)
        assert np.abs(record.t[there] - t).max() <= 0.1 * np.median(np.diff(t)) * (1 + 1e-9)


@pytest.mark.parametrize(
    "named",
    [("t_F [s]", "F", "t_x [s]", "x"), ("time", "F", "time", "x"), ("F time", "F", "x time", "x")],
    ids=", ".join,
)
def test_channels_with_time_columns_of_their_own_are_one_record(tmp_path, named):
    path = side_by_side(tmp_path / "run.csv", named)
    record = casid.Problem("mass", model()).read(path).record
    require_as_measured(record)
    assert any("2 clocks: F at the 2000 instants" in line for line in record.provenance)
    report = casid.check(path)
    assert report.is_usable
    texts = [f.text for f in report.findings if f.channel == "x"]
    assert any("a clock of its own" in text for text in texts)
    noise = next(c.noise for c in report.channels if c.name == "x")
    # The highest fifth of a spectrum of 780 samples, five segments of 64: 2 of 40 lines of 10
    # degrees of freedom each in its median; the position moves by 0.1 m below 2 Hz of 10.
    assert noise == pytest.approx(SIGMA, rel=0.4)


def test_rows_that_hold_one_channel_each_are_one_record(tmp_path):
    """Also where two of them share a stamp."""
    path = rows_of_their_own(tmp_path / "run.csv")
    require_as_measured(casid.Problem("mass", model()).read(path).record)
    text = path.read_text().replace("0.02,", "0.02,,1.0\n0.02,", 1)
    path.write_text(text)
    record = casid.Problem("mass", model()).read(path).record
    k = int(round(0.02 / record.Ts))
    assert record["x"][k] == 1.0
    assert record["F"][k] == signals()["F"][1][1]


def test_signals_with_time_vectors_are_one_record():
    record = casid.Record.from_signals(signals(), {"F": "N", "x": "m"}, name="run")
    require_as_measured(record)


def test_samples_of_one_place_are_its_mean():
    """Two values within a tenth of the usual interval: nothing tells their instants apart."""
    t = np.append(0.1 * np.arange(100), 5.0001)
    order = np.argsort(t)
    y = np.ones(101)
    y[100] = 3.0
    record = casid.Record.from_signals({"y": (t[order], y[order])}, {"y": "m"})
    k = int(round(5.0 / record.Ts))
    assert record["y"][k] == 2.0
    assert int((~record.is_missing("y")).sum()) == 100


def test_stamps_a_few_hundredths_off_an_even_clock_are_read_as_even():
    """They are within the tenth of an interval that absent rows and finer clocks are allowed."""
    rng = np.random.default_rng(3)
    t = 0.02 * np.arange(500) + 0.02 * 0.05 * rng.uniform(-1, 1, 500)
    record = casid.Record.from_signals({"y": (t, np.sin(t))}, {"y": "m"})
    assert record.N == 500
    assert not record.missing
    assert "the stamps run unevenly" in record.provenance[-1]


def test_clocks_that_count_from_different_instants_are_refused(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{0.1 * k},{k},{1000 + 0.1 * k},{k}" for k in range(50)]
    path.write_text("\n".join(["t_F,F,t_x,x", *rows]) + "\n")
    with pytest.raises(DataError, match=r"'t_F' from 0 to 4.9 s and 't_x' .* do not overlap"):
        casid.Problem("mass", model()).read(path)


def test_a_time_column_that_is_named_is_the_clock_of_all(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{0.1 * k},{k},{0.2 + 0.1 * k},{k}" for k in range(50)]
    path.write_text("\n".join(["t_F,F,t_x,x", *rows]) + "\n")
    problem = casid.Problem("mass", model(), time="t_F")
    record = problem.read(path).record
    assert record.N == 50
    assert not record.missing


@pytest.mark.parametrize(
    ("x", "complaint"),
    [
        (([0.0, 1.0], [1.0, 2.0, 3.0]), r"times of shape \(2,\) and values of shape \(3,\)"),
        (([0.0, 2.0, 1.0], [1.0, 2.0, 3.0]), "times of x do not increase"),
    ],
)
def test_signals_that_are_none_are_refused(x, complaint):
    with pytest.raises(DataError, match=complaint):
        casid.Record.from_signals({"x": x}, {"x": "m"})


def test_a_fit_of_two_clocks_has_honest_error_bars():
    """A position that is sampled later and unevenly: the truth is within 3.5 standard errors.

    An instant is off by 2 ms rms at 0.7 m/s or less: 1.4 mm beside 3 mm of noise, without a mean.
    """
    record = casid.Record.from_signals(signals(), {"F": "N", "x": "m"})
    estimate = casid.identify(casid.Problem("mass", model(), starts=1), record)
    for name, true in TRUE.items():
        p = estimate.parameter(name)
        assert p.std_error < 0.01 * true
        assert abs(p.value - true) < 3.5 * p.std_error


def test_stamps_noted_at_random_have_a_clock_that_tells_them_apart():
    """Sixty instants at random over a day: of all intervals, exp(-1) are longer than the mean.

    A step of the median interval over 20 is 1/29 of the mean: 3.4 % of the stamps are nearer on
    average, more than a twentieth in one record of ten; of these nine tenths have one with 4000.
    """
    found = [
        even_clock(np.sort(np.r_[0.0, np.random.default_rng(seed).uniform(0, 1e5, 59)]))
        for seed in range(60)
    ]
    assert sum(clock is None for clock in found) <= 2
    assert max(clock.N for clock in found if clock is not None) <= SHORT + 1
