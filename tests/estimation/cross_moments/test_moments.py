"""Cross moments: sums that are exact to rounding, wherever they are cut and whoever adds them."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
import tracemalloc
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import casid.estimation.cross_moments.moments
from casid.data.files import write_text
from casid.data.fir_filter import anti_alias, equiripple
from casid.data.reading.chunks import iter_chunks
from casid.data.reading.record_file import read_record
from casid.data.record import Record
from casid.errors import DataError
from casid.estimation.cross_moments.moments import (
    Accumulator,
    Moments,
    moments,
    of_file,
    of_record,
    weighted,
)
from casid.linear.sampled.lagged_columns import Column, lagged
from tests.support.shared import ROOT

U = 2.0**-53
ONE = Column("1", (("1", 0, 1.0),))


def noise(N: int, *names: str, seed: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.standard_normal(N) for name in names or ("y", "u")}


def stacked(signals: dict[str, np.ndarray], lags: int) -> np.ndarray:
    """(N - lags, m + 1): the rows v_t', written out."""
    N = len(next(iter(signals.values())))
    columns = [x[lags - i : N - i] for x in signals.values() for i in range(lags + 1)]
    return np.column_stack([*columns, np.ones(max(N - lags, 0))])


def gamma(n: float) -> float:
    """Higham (2002), eq. (3.2)."""
    return n * U / (1 - n * U)


def exact(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V'V in rational arithmetic, rounded once, and the sums of magnitudes."""
    rows = [[Fraction(float(x)) for x in row] for row in v]
    m = v.shape[1]
    total = [
        [float(sum((r[i] * r[j] for r in rows), Fraction(0))) for j in range(m)] for i in range(m)
    ]
    return np.array(total), np.abs(v).T @ np.abs(v)


def fed(signals: dict[str, np.ndarray], lags: int, cuts: list[int], **filters) -> Accumulator:
    stream = Accumulator(tuple(signals), lags, constant=True, **filters)
    N = len(next(iter(signals.values())))
    edges = [0, *sorted(c for c in cuts if c <= N), N]
    for a, b in zip(edges, edges[1:], strict=False):
        stream.add({name: x[a:b] for name, x in signals.items()})
    return stream


# ---------------------------------------------------------------------- what they are


@pytest.mark.parametrize(
    ("N", "lags", "nc"),
    [(1, 0, 1), (9, 0, 2), (3, 2, 2), (4, 2, 2), (5, 2, 3), (6, 5, 1), (100, 3, 3), (40_000, 2, 2)],
)
def test_the_gram_matrix_is_that_of_all_lags_of_all_channels(N, lags, nc):
    """Sums of small integers are exact in any order: there is no tolerance."""
    rng = np.random.default_rng(7)
    signals = {f"x{c}": rng.integers(-9, 10, N).astype(float) for c in range(nc)}
    result, v = moments(signals, lags, constant=True), stacked(signals, lags)
    assert np.array_equal(result.total, v.T @ v)
    assert np.array_equal(result.gram, (v.T @ v)[:-1, :-1])
    assert np.array_equal(result.sums, v.sum(axis=0)[:-1])
    assert not result.rest.any()
    assert result.N == N - lags
    without = moments(signals, lags)
    assert np.array_equal(without.gram, result.gram)
    assert without.N == N - lags


def test_entries_that_a_shift_of_time_relates_differ_by_products_at_the_ends():
    """M(i+1, j+1) = M(i, j) + x(L-1-i) z(L-1-j) - x(N-1-i) z(N-1-j), channel by channel."""
    signals, L, N = noise(300), 4, 300
    gram = moments(signals, L).gram
    for a, x in enumerate(signals.values()):
        for b, z in enumerate(signals.values()):
            M = gram[a * (L + 1) : (a + 1) * (L + 1), b * (L + 1) : (b + 1) * (L + 1)]
            i, j = np.meshgrid(np.arange(L), np.arange(L), indexing="ij")
            edges = x[L - 1 - i] * z[L - 1 - j] - x[N - 1 - i] * z[N - 1 - j]
            assert np.allclose(M[1:, 1:], M[:-1, :-1] + edges, rtol=0, atol=gamma(310) * 300)


def test_least_squares_from_moments_is_least_squares_on_the_samples():
    """Phi'Phi theta = Phi'Y; rounding grows by the condition of Phi'Phi, here below 100."""
    signals = noise(2000)
    left = Column("y[t]", (("y", 0, 1.0),))
    columns = (
        *lagged("y", range(1, 3), -1.0),
        Column("u[t] - u[t-2]", (("u", 0, 1.0), ("u", 2, -1.0))),
    )
    result = moments(signals, 2)
    theta = np.linalg.solve(result.between(columns, columns), result.between(columns, [left])[:, 0])
    Phi = np.column_stack([c.samples(signals, 2) for c in columns])
    reference = np.linalg.lstsq(Phi, left.samples(signals, 2), rcond=None)[0]
    assert np.allclose(theta, reference, rtol=0, atol=1e-12)


def test_extended_instruments_are_channels_like_others():
    """min ||Y - Phi theta|| with more instruments than coefficients: (2.42)-(2.43), L = Q = 1."""
    signals = noise(3000, "y", "u", "z")
    signals["u"] += signals["z"]
    left, regressors = lagged("y", range(1)), (*lagged("y", range(1, 3)), *lagged("u", range(2)))
    instruments = lagged("z", range(6))
    result = moments(signals, 5)
    theta = np.linalg.lstsq(
        result.between(instruments, regressors), result.between(instruments, left), rcond=None
    )[0]
    Z, Phi, Y = (
        np.column_stack([c.samples(signals, 5) for c in columns])
        for columns in (instruments, regressors, left)
    )
    reference = np.linalg.lstsq(Z.T @ Phi, Z.T @ Y, rcond=None)[0]
    assert np.allclose(theta, reference, rtol=0, atol=1e-10)


def test_a_constant_is_a_column_too():
    """An offset in the regression: y_t = 0.5 y_{t-1} + 2 without noise is recovered."""
    y = 4.0 + 3.0 * 0.5 ** np.arange(30)
    columns = [*lagged("y", range(1, 2)), ONE]
    result = moments({"y": y}, 1, constant=True)
    Phi_Phi, Phi_Y = (
        result.between(columns, columns),
        result.between(columns, lagged("y", range(1))),
    )
    assert np.linalg.solve(Phi_Phi, Phi_Y)[:, 0] == pytest.approx([0.5, 2.0], rel=1e-11)
    assert Phi_Phi[1, 1] == result.N == 29


def test_a_correlation_depends_on_the_difference_of_the_lags_alone():
    """R_ab(lag) = E a_t b_{t-lag} = R_ba(-lag); shifting both columns changes the ends only."""
    signals = noise(500)
    y, u = Column("y", (("y", 0, 1.0),)), Column("u", (("u", 0, 2.0), ("u", 1, -1.0)))
    result = moments(signals, 4)
    v, w = signals["y"], 2 * signals["u"][1:] - signals["u"][:-1]
    for lag in range(4):
        direct = np.mean(v[4:] * w[3 - lag : 499 - lag])
        assert result.correlation(y, u, lag) == pytest.approx(direct, abs=gamma(500) * 3)
        assert result.correlation(u, y, -lag) == result.correlation(y, u, lag)
    with pytest.raises(DataError, match=r"lag 5.*lags=5"):
        result.correlation(y, u, 4)
    with pytest.raises(DataError, match="Add a stretch"):
        Accumulator(("y", "u"), 1).moments.correlation(y, y)


def test_some_channels_and_fewer_lags_are_a_part_of_the_whole():
    result = moments(noise(300, "y", "u", "w"), 3, constant=True)
    part = result.select(["w", "y"], 1)
    columns = [*lagged("w", range(2)), *lagged("y", range(2)), ONE]
    assert (part.channels, part.lags, part.N) == (("w", "y"), 1, 297)
    assert np.array_equal(part.total, result.between(columns, columns))
    with pytest.raises(DataError, match="lags=5"):
        result.select(lags=5)
    with pytest.raises(DataError, match=r"'v'.*y, u, w"):
        result.select(["v"])


# ---------------------------------------------------------------------- exact wherever they are cut


@settings(max_examples=60)
@given(
    N=st.integers(1, 120),
    lags=st.integers(0, 5),
    cuts=st.lists(st.integers(0, 120), max_size=12),
    filters=st.sampled_from(["none", "fir", "iir", "both"]),
)
def test_chunks_give_what_the_whole_gives_to_the_last_bit(N, lags, cuts, filters):
    """Blocks are counted from the start of the stretch, so every sum is taken in the same order."""
    kinds = {
        "none": {},
        "fir": {"prefilter": equiripple(0.5, 0.01)},
        "iir": {"rational": ([1.0], [1.0, -0.9])},
        "both": {
            "prefilter": anti_alias(2, 0.01),
            "rational": ([1.0, 0.3], [1.0, -1.5, 0.7]),
            "settle": 7,
        },
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(casid.estimation.cross_moments.moments, "BLOCK", 8)
        signals = noise(N, seed=N)
        whole = fed(signals, lags, [], **kinds[filters]).moments
        stream = fed(signals, lags, cuts, **kinds[filters])
        for result in (stream.moments, stream.moments):  # asking changes nothing
            assert np.array_equal(result.total, whole.total)
            assert np.array_equal(result.rest, whole.rest)
        if whole.N:
            again = moments(signals, lags, constant=True, **kinds[filters])
            assert np.array_equal(again.total, whole.total)


@settings(max_examples=40)
@given(
    N=st.integers(1, 60),
    lags=st.integers(0, 3),
    cuts=st.lists(st.integers(0, 60), max_size=6),
    seed=st.integers(0, 2**16),
)
def test_rounding_is_that_of_one_block_however_many_there_are(N, lags, cuts, seed):
    """|error| <= gamma_n sum |v_i v_j|, n = BLOCK + 2 lags + 3, for samples of any size.

    The record is cut into pieces that overlap by `lags` samples, as one would hand them to other
    machines; the pieces' moments add up to the whole's.
    """
    rng = np.random.default_rng(seed)
    signals = {c: rng.standard_normal(N) * 10.0 ** rng.uniform(-8, 8, N) for c in "yu"}
    reference, size = exact(stacked(signals, lags))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(casid.estimation.cross_moments.moments, "BLOCK", 8)
        whole = fed(signals, lags, cuts).moments
        edges = [0, *sorted(c for c in cuts if c <= N), N]
        pieces = sum(
            fed({c: x[max(a - lags, 0) : b] for c, x in signals.items()}, lags, []).moments
            for a, b in zip(edges, edges[1:], strict=False)
            if a >= lags or a == 0
        )
    bound = gamma(8 + 2 * lags + 3) * size
    assert (np.abs(whole.total - reference) <= bound).all()
    assert (np.abs(whole.total + whole.rest - reference) <= bound).all()
    if all(a >= lags or a == 0 for a in edges[:-1]) and 0 not in edges[1:-1]:
        assert (np.abs(pieces.total - reference) <= bound).all()


def test_ten_thousand_blocks_add_without_losing_a_digit(monkeypatch):
    """A large sample, then small ones: block after block is below the last place of the sum."""
    monkeypatch.setattr(casid.estimation.cross_moments.moments, "BLOCK", 8)
    y = np.full(80_000, 1e-9)
    y[0] = 1.0
    expected = math.fsum(y * y)
    assert expected - 1.0 > 7e-14
    for result in (moments({"y": y}, 0), fed({"y": y}, 0, [11, 40_000]).moments):
        assert abs(result.gram[0, 0] - expected) <= gamma(8 + 3) * expected


def test_ten_thousand_moments_add_without_losing_a_digit():
    """Sums of 1 and 10 000 times 1e-17: plain addition keeps 1, the exact sum is 1 + 1e-13."""
    big, small = moments({"y": [1.0]}, 0), moments({"y": [10.0**-8.5]}, 0)
    total = sum([big, *[small] * 10_000])
    assert total.gram[0, 0] == math.fsum([1.0, *[small.gram[0, 0]] * 10_000])
    plain = 1.0
    for _ in range(10_000):
        plain += small.gram[0, 0]
    assert plain == 1.0
    assert total.N == 10_001


def test_moments_add_across_processes():
    """Two fresh processes take a half each (overlapping by the lags) and send back 2 kB."""
    program = (
        "import pickle, sys, numpy as np\n"
        "from casid.estimation.cross_moments.moments import moments\n"
        "a, b = int(sys.argv[1]), int(sys.argv[2])\n"
        "rng = np.random.default_rng(3)\n"
        "x = {c: rng.standard_normal(100_000)[a:b] for c in ('y', 'u')}\n"
        "sys.stdout.buffer.write(pickle.dumps(moments(x, 2, constant=True)))\n"
    )
    sent = [
        subprocess.run(
            [sys.executable, "-c", program, *map(str, limits)],
            cwd=ROOT,
            capture_output=True,
            check=True,
        ).stdout
        for limits in ((0, 50_000), (49_998, 100_000))
    ]
    assert max(map(len, sent)) < 4096
    total, signals = sum(map(pickle.loads, sent)), noise(100_000)
    bound = gamma(casid.estimation.cross_moments.moments.BLOCK + 7) * (
        np.abs(v := stacked(signals, 2)).T @ np.abs(v)
    )
    assert (np.abs(total.total - stacked(signals, 2).T @ stacked(signals, 2)) <= 2 * bound).all()
    assert total.N == 99_998


def test_records_add_in_any_order_to_rounding_of_the_sum():
    """Compensated sums in two orders differ by the last place of the total at most."""
    pieces = [moments(noise(50, seed=k), 2) for k in range(20)]
    forward, backward = sum(pieces), sum(reversed(pieces))
    assert np.allclose(forward.total, backward.total, rtol=2 * U, atol=0)


# ---------------------------------------------------------------------- gaps, filters, memory


def test_a_gap_ends_a_stretch_and_nothing_is_carried_across():
    signals = noise(400)
    parts = [{c: x[cut] for c, x in signals.items()} for cut in np.s_[:150, 150:153, 153:]]
    stream = Accumulator(("y", "u"), 3)
    for part in parts:
        stream.add(part)
        stream.gap()
        stream.gap()
    expected = moments(parts[0], 3) + moments(parts[2], 3)  # the middle is shorter than its lags
    assert np.array_equal(stream.moments.total, expected.total)
    assert stream.moments.N == 150 - 3 + 247 - 3
    stream.clear()
    stream.add(parts[0])
    assert np.array_equal(stream.moments.total, moments(parts[0], 3).total)


def test_missing_samples_of_any_channel_are_gaps():
    signals = noise(400)
    expected = sum(
        moments({c: x[cut] for c, x in signals.items()}, 2, constant=True)
        for cut in np.s_[:100, 101:200, 203:]
    )
    signals["y"][[100, 200]] = np.nan, np.inf
    signals["u"][[201, 202]] = -np.inf, np.nan
    stream = fed(signals, 2, [50, 101, 202, 390])
    assert np.array_equal(stream.moments.total, expected.total)
    marks = {c: ~np.isfinite(x) for c, x in signals.items()}
    record = Record(signals, {"y": "m", "u": "N"}, 0.1, missing=marks)
    assert np.array_equal(of_record(record, 2, constant=True).total, expected.total)
    assert of_record(record, 2, ["u"]).N == 201 - 2 + 197 - 2


def test_a_prefilter_acts_on_all_channels_alike_as_on_the_record():
    """Zero phase, trimmed at both ends; a record filtered beforehand gives the same moments."""
    fir = equiripple(0.5, 0.01)
    record = Record(noise(3000), {"y": "m", "u": "N"}, 0.01)
    result, reference = of_record(record, 2, prefilter=fir), of_record(fir.apply(record), 2)
    assert np.array_equal(result.total, reference.total)
    assert result.N == 3000 - 20 - 2
    with pytest.raises(DataError, match=r"equiripple\(cutoff_hz, Ts=0\.02\)"):
        of_record(Record(noise(100), {"y": "m", "u": "N"}, 0.02), 2, prefilter=fir)


def test_a_rational_prefilter_starts_from_rest_in_each_stretch():
    """1/C(q) with C = 1 - 0.9 q^-1, whose start is left out until it has decayed by 0.9^50."""
    signals = noise(600)
    stream = fed(signals, 1, [100, 350], rational=([1.0], [1.0, -0.9]), settle=50)
    stream.gap()
    stream.add({c: x[:200] for c, x in signals.items()})
    filtered = {c: lfilter([1.0], [1.0, -0.9], x) for c, x in signals.items()}
    expected = sum(
        moments({c: x[50:n] for c, x in filtered.items()}, 1, constant=True) for n in (600, 200)
    )
    assert np.array_equal(stream.moments.total, expected.total)


def test_a_regression_survives_its_prefilter():
    """y(t) = 0.8 y(t-1) + 0.5 u(t-1) from rest holds for filtered signals with the same theta."""
    u = noise(800, "u")["u"]
    y = lfilter([0.0, 0.5], [1.0, -0.8], u)
    columns, left = (*lagged("y", range(1, 2)), *lagged("u", range(1, 2))), lagged("y", range(1))
    for filters in ({"prefilter": equiripple(0.5, 0.01)}, {"rational": ([1.0], [1.0, -0.5])}):
        result = moments({"y": y, "u": u}, 1, **filters)
        theta = np.linalg.solve(result.between(columns, columns), result.between(columns, left))
        assert theta[:, 0] == pytest.approx([0.8, 0.5], rel=1e-10)


def test_an_unstable_prefilter_is_refused_with_its_root():
    with pytest.raises(DataError, match=r"root of modulus 1\.25.*Replace the root z by 1/z"):
        Accumulator(("y",), 1, rational=([1.0], [1.0, -1.25]))
    with pytest.raises(DataError, match="ascending powers"):
        Accumulator(("y",), 1, rational=([1.0], [0.0, 1.0]))


def test_memory_does_not_grow_with_the_number_of_chunks():
    def peak(chunks: int) -> int:
        rng = np.random.default_rng(3)
        stream = Accumulator(("y", "u"), 2, prefilter=equiripple(0.5, 0.01))
        tracemalloc.start()
        for _ in range(chunks):
            stream.add({"y": rng.standard_normal(5000), "u": rng.standard_normal(5000)})
        stream.moments  # noqa: B018
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(2)
    assert peak(80) <= 1.1 * peak(20)


# ---------------------------------------------------------------------- files


def table(path: Path, N: int = 500, Ts: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Write an angle [deg] and a force [kN] to a file; returns both."""
    t, (phi, F) = Ts * np.arange(N), noise(N, "phi", "F").values()
    if path.suffix == ".parquet":
        import pandas as pd

        pd.DataFrame({"t": t, "angle": phi, "force": F}).to_parquet(path)
    else:
        rows = [f"{a:.6f},{b!r},{c!r}" for a, b, c in zip(t, phi.tolist(), F.tolist(), strict=True)]
        write_text(path, "\n".join(["t,angle,force", *rows]) + "\n")
    return phi, F


COLUMNS = {"phi": ("angle", "deg"), "F": ("force", "kN")}


@pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
@pytest.mark.parametrize("chunk", [7, 100, 100_000])
def test_a_file_read_in_chunks_gives_the_moments_of_its_record_in_si(tmp_path, name, chunk):
    phi, F = table(tmp_path / name)
    result = of_file(tmp_path / name, COLUMNS, 3, chunk=chunk)
    record = read_record(tmp_path / name, COLUMNS)
    assert np.array_equal(result.total, of_record(record, 3, ["phi", "F"]).total)
    assert result.gram[0, 0] == pytest.approx(np.sum(np.deg2rad(phi[3:]) ** 2), rel=gamma(600))
    assert result.gram[4, 4] == pytest.approx(1e6 * np.sum(F[3:] ** 2), rel=gamma(600))


@pytest.mark.parametrize("row_group", [50_000, 1_000_000])
def test_a_parquet_file_is_never_in_memory_whole(tmp_path, row_group):
    """8 MB in one row group or in twenty; a buffer of 1 MB, a page and a chunk are held."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "run.parquet"
    columns = pa.table(noise(1_000_000, "y"))
    pq.write_table(columns, path, row_group_size=row_group, use_dictionary=False)
    assert path.stat().st_size > 7e6
    del columns
    before, most = pa.total_allocated_bytes(), 0
    for part in iter_chunks(path, {"y": "y"}, 10_000):
        most = max(most, pa.total_allocated_bytes() - before)
        assert part["y"].size == 10_000
    assert most < 4e6


@pytest.mark.parametrize("chunk", [2, 10, 33, 200, 469, 100_000])
def test_empty_cells_and_rows_left_out_of_a_file_are_gaps(tmp_path, chunk):
    phi, F = table(tmp_path / "run.csv")
    rows = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()
    rows[1 + 100] = rows[1 + 100].rpartition(",")[0] + ","
    write_text(tmp_path / "holes.csv", "\n".join(rows[:201] + rows[231:]) + "\n")
    result = of_file(tmp_path / "holes.csv", COLUMNS, 2, chunk=chunk)
    SI = {"phi": np.deg2rad(phi), "F": 1000 * F}
    expected = sum(
        moments({c: x[cut] for c, x in SI.items()}, 2) for cut in np.s_[:100, 101:200, 230:]
    )
    assert np.allclose(result.total, expected.total, rtol=gamma(500), atol=0)
    assert result.N == 98 + 97 + 268


def test_files_with_a_faulty_clock_or_too_few_samples_are_refused(tmp_path):
    path = tmp_path / "run.csv"
    table(path)
    rows = path.read_text(encoding="utf-8").splitlines()
    for k in range(300, 501):
        rows[k] = f"{0.02 * 300 + 0.021 * (k - 300):.6f}," + rows[k].partition(",")[2]
    write_text(tmp_path / "drift.csv", "\n".join(rows) + "\n")
    with pytest.raises(DataError, match="1 %.*by themselves"):
        of_file(tmp_path / "drift.csv", COLUMNS, 2)
    with pytest.raises(DataError, match=r"run\.csv.*Ts=0\.02"):
        of_file(path, COLUMNS, 2, prefilter=equiripple(0.5, 0.01))
    with pytest.raises(DataError, match="fewer lags"):
        of_file(path, COLUMNS, 600)


def test_saved_moments_are_the_same_when_loaded(tmp_path):
    result = moments(noise(50_000), 3, constant=True)
    path = result.save(tmp_path / "sums.npz")
    again = Moments.load(path)
    assert (again.channels, again.lags, again.N) == (result.channels, result.lags, result.N)
    assert np.array_equal(again.total, result.total)
    assert np.array_equal(again.rest, result.rest)
    assert path.stat().st_size < 8192
    assert [p.name for p in tmp_path.iterdir()] == ["sums.npz"]
    write_text(tmp_path / "other.npz", "no archive")
    with pytest.raises(DataError, match=r"other\.npz.*Moments\.save"):
        Moments.load(tmp_path / "other.npz")
    with pytest.raises(DataError, match=r"Moments\.save"):
        Moments.load(tmp_path / "absent.npz")
    with pytest.raises(DataError, match="name another place"):
        result.save(tmp_path / "absent" / "sums.npz")


def test_moments_cannot_be_changed_and_pickle_small():
    result = moments(noise(100_000), 2, constant=True)
    copy = pickle.loads(data := pickle.dumps(result))
    assert len(data) < 4096
    for x in (result, copy):
        with pytest.raises(ValueError, match="read-only"):
            x.gram[0, 0] = 0.0
    assert repr(copy) == "<Moments of y, u, 1: lags 0 to 2, N = 99998>"


# ---------------------------------------------------------------------- weights


def test_weights_of_one_change_nothing_and_weights_of_zero_leave_samples_out():
    signals = noise(70_000)
    left = [Column("u[t] - u[t-2]", (("u", 0, 1.0), ("u", 2, -1.0))), ONE]
    right = [*lagged("y", range(3))]
    plain = moments(signals, 2, constant=True).between(left, right)
    bound = 2 * gamma(casid.estimation.cross_moments.moments.BLOCK + 7) * 70_000 * 2
    ones = weighted(left, right, signals, np.ones(69_998))
    assert np.allclose(ones, plain, rtol=0, atol=bound)
    kept = np.random.default_rng(4).random(69_998) < 0.7
    Phi, Y = (
        np.column_stack([c.samples(signals | {"1": np.ones(70_000)}, 2) for c in x])
        for x in (left, right)
    )
    some = weighted(left, right, signals, kept.astype(float))
    assert np.allclose(some, Phi[kept].T @ Y[kept], rtol=0, atol=bound)


def test_weights_that_do_not_fit_are_refused():
    signals, y = noise(20), lagged("y", range(3))
    assert weighted(y, y, signals, np.ones(15), start=5).shape == (3, 3)
    with pytest.raises(DataError, match="one weight for each t"):
        weighted(y, y, signals, np.ones(20))
    with pytest.raises(DataError, match="start >= 2"):
        weighted(y, y, signals, np.ones(19), start=1)
    with pytest.raises(DataError, match=r"weights: 1 samples.*k = 7"):
        weighted(y, y, signals, np.where(np.arange(18) == 7, np.nan, 1.0))
    with pytest.raises(DataError, match=r"'w'.*y, u.*Give it"):
        weighted(lagged("w", range(1)), y, signals, np.ones(18))


# ---------------------------------------------------------------------- refusals


def test_moments_of_other_channels_or_lags_do_not_add():
    a = moments(noise(50), 2)
    with pytest.raises(DataError, match=r"lags 0 to 2.*lags 0 to 3.*moments\.select"):
        a + moments(noise(50), 3)
    for other in (moments(noise(50, "u", "y"), 2), moments(noise(50), 2, constant=True)):
        with pytest.raises(DataError, match=r"moments\.select.*compute them alike"):
            a + other
    assert (a + moments(noise(50, "u", "y"), 3).select(["y", "u"], 2)).N == 48 + 47
    with pytest.raises(TypeError):
        a + 1.0


def test_columns_beyond_the_moments_are_refused_with_what_would_hold_them():
    result = moments(noise(50), 2)
    with pytest.raises(DataError, match=r"'1'.*constant=True"):
        result.between([ONE], [ONE])
    with pytest.raises(DataError, match=r"constant=True"):
        result.sums  # noqa: B018
    with pytest.raises(DataError, match=r"y\[t-3\].*lags=4"):
        result.between(lagged("y", range(5)), [ONE])
    with pytest.raises(DataError, match=r"'w'.*y, u.*compute the moments with it"):
        result.between(lagged("w", range(1)), [ONE])


@pytest.mark.parametrize(
    ("signals", "lags", "mend"),
    [
        ({"y": np.ones(3)}, 3, "longer record"),
        ({"y": np.ones(3), "u": np.ones(4)}, 0, "same samples"),
        ({"y": np.ones((3, 1))}, 0, "one number for each sample"),
        ({"y": ["a", "b"]}, 0, "one number for each sample"),
        ({"y": [1.0, np.nan, 3.0, 4.0]}, 1, "k = 1.*Accumulator"),
        ({"y": [1.0, np.inf, 3.0, 4.0]}, 1, "k = 1.*Accumulator"),
        ({"y": [1e200, 1.0, 3.0]}, 1, "scale the signals"),
        ({"y": np.ones(9)}, 1.5, "integer of at least 0"),
        ({"1": np.ones(9)}, 1, "each name once"),
        ({}, 1, "at least one"),
    ],
)
def test_signals_that_have_no_moments_are_refused(signals, lags, mend):
    with pytest.raises(DataError, match=mend):
        moments(signals, lags)


@pytest.mark.filterwarnings("error")
def test_sums_that_overflow_are_refused_and_no_nan_is_handed_on():
    stream = Accumulator(["y"], 1)
    stream.add({"y": [1e200, 1.0, 3.0, -1e200]})
    with pytest.raises(DataError, match="physical range"):
        stream.moments  # noqa: B018
    with pytest.raises(DataError, match="physical range"):
        stream.gap()
    with pytest.raises(DataError, match=r"k = 2.*Accumulator"):
        moments({"y": [1.0, 2.0, np.nan]}, 0, rational=([1.0], [1.0, 0.5]))


def test_a_chunk_without_a_channel_is_refused():
    stream = Accumulator(["y", "u"], 1)
    with pytest.raises(DataError, match=r"no channel 'u'.*holds y, t"):
        stream.add({"y": [1.0], "t": [0.0]})
    with pytest.raises(DataError, match="Give a list"):
        Accumulator("y", 1)
