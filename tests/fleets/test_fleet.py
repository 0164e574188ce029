"""A fleet: every record has a row, errors are controlled over all, and nothing is done twice."""

from __future__ import annotations

import errno
import json
import shutil
import sys
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import casid
from casid.campaigns import parquet_parts as parts
from casid.cli.main import main
from casid.errors import DataError
from tests.support.fleet_records import (
    CRASHING,
    ENDLESS,
    HUNGRY,
    samples,
    write_fleet,
    write_problem,
    write_record,
)

LABELS = "{asset}_{time}.csv"
TABLES = ("causes.parquet", "parameters.parquet", "fleet.json")


@pytest.fixture(scope="module")
def heaters(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two heaters with four records each; the first lacks an offset in its last two."""
    folder = tmp_path_factory.mktemp("heaters")
    write_problem(folder)
    write_fleet(folder)
    return folder


def run(folder: Path, out: Path | None, **options: object) -> casid.Fleet:
    options.setdefault("asset", LABELS)
    found = casid.fleet(folder / "heater.py", folder / "records", out=out, **options)
    if out is not None:
        found.write(out)
    return found


@pytest.fixture(scope="module")
def done(heaters: Path) -> casid.Fleet:
    return run(heaters, heaters / "out")


def contents(out: Path, ignored: tuple[str, ...] = ("new",)) -> list[object]:
    """The tables bit for bit, and the findings without how many records this call has done."""
    found: list[object] = [(out / name).read_bytes() for name in TABLES[:2]]
    content = json.loads((out / "fleet.json").read_text())
    return [*found, {k: v for k, v in content.items() if k not in ignored}]


@pytest.mark.slow
def test_a_lasting_cause_is_one_finding_with_its_onset(done: casid.Fleet) -> None:
    assert done.assets == ("heater0", "heater1")
    assert set(done.records["stage"]) <= {"screened", "searched"}
    (finding,) = done.findings
    assert finding.asset == "heater0"
    assert finding.kind in ("offset", "sensor_bias")
    assert finding.onset == (2.0, 3.0)
    assert finding.is_lasting
    assert finding.is_present
    assert done.discoveries == 2
    assert done.discoveries_e == 2
    # Of 0.1 K that the offset adds, in the unit of the balance.
    assert abs(finding.size) == pytest.approx(0.1, rel=0.2)


def test_the_table_has_a_row_a_record_and_cause(done: casid.Fleet, heaters: Path) -> None:
    table = pd.read_parquet(heaters / "out" / "causes.parquet")
    assert sorted(table["record"]) == sorted(p.name for p in (heaters / "records").iterdir())
    found = table[table["kind"].notna()]
    assert list(found["asset"]) == ["heater0", "heater0"]
    assert (found["p_cause"] < 1e-6).all()
    assert (found["gain_held_out"] > 0).all()
    assert table["e_value"][table["kind"].isna()].to_numpy() == pytest.approx(0.5, abs=1e-5)
    parameters = pd.read_parquet(heaters / "out" / "parameters.parquet")
    assert set(parameters["parameter"]) == {"T", "K"}
    gain = parameters[parameters["parameter"] == "K"].groupby("asset")["value"].mean()
    assert gain["heater1"] == pytest.approx(2.1, abs=0.01)


def test_the_parameters_differ_between_the_assets(done: casid.Fleet) -> None:
    (gain,) = [e for e in done.effects if e.name == "K"]
    own = {a.asset: a for a in gain.assets}
    assert own["heater0"].mean == pytest.approx(2.0, abs=0.02)
    assert own["heater1"].mean == pytest.approx(2.1, abs=0.02)
    assert gain.between == pytest.approx(0.07, abs=0.05)  # of two values 0.1 apart


def test_the_same_call_again_does_nothing_and_changes_nothing(
    done: casid.Fleet, heaters: Path
) -> None:
    before = contents(heaters / "out")
    again = run(heaters, heaters / "out")
    assert again.new == 0
    assert contents(heaters / "out") == before


@pytest.mark.slow
def test_the_table_is_the_same_on_two_processes(done: casid.Fleet, heaters: Path) -> None:
    with joblib.parallel_config(n_jobs=2):
        run(heaters, heaters / "two")
    assert contents(heaters / "two") == contents(heaters / "out")


@pytest.mark.slow
def test_the_table_is_the_same_on_a_cluster_of_two_processes(
    done: casid.Fleet, heaters: Path
) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        command = [
            *("fleet", str(heaters / "heater.py"), str(heaters / "records"), "--asset", LABELS),
            *("--engine", "dask", "--scheduler", cluster.scheduler_address),
            *("--out", str(heaters / "dask"), "--quiet", "--json"),
        ]
        result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["discoveries"] == {"benjamini_hochberg": 2, "e_bh": 2}
    assert contents(heaters / "dask") == contents(heaters / "out")


@pytest.mark.slow
def test_records_that_arrive_are_added_without_doing_the_old_again(
    done: casid.Fleet, heaters: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "stream"
    folder.mkdir()
    write_problem(folder)
    late = {"heater0_4.csv", "heater1_4.csv"}
    shutil.copytree(heaters / "records", folder / "records")
    for name in late:
        (folder / "records" / name).rename(folder / name)
    first = run(folder, folder / "out")
    assert first.discoveries == 1
    rows = first.records.set_index("record")
    for name in late:
        (folder / name).rename(folder / "records" / name)
    second = run(folder, folder / "out")
    assert (second.new, len(second.records)) == (2, 8)
    again = second.records.set_index("record").loc[rows.index]
    for column in ("p", "alarm", "alarm_level", "causes", "parameters"):
        assert list(again[column]) == list(rows[column])  # no alarm is ever taken back
    (finding,) = second.findings
    assert len(finding.records) == 2


@pytest.mark.slow
def test_records_that_cannot_be_done_are_rows_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rubbish, an endless simulation, one that takes all memory, a crash; then a good one."""
    monkeypatch.setenv("CASID_TIME_FACTOR", "10")
    write_problem(tmp_path)
    records = tmp_path / "records"
    for name, first in (("1", ENDLESS), ("2", HUNGRY), ("3", CRASHING), ("5", None)):
        write_record(records / f"a_{name}.csv", samples(5, first=first))
    (records / "a_4.csv").write_text("rubbish")
    found = run(tmp_path, tmp_path / "out", budget=0.5, memory=400.0, screen=False)
    why = found.refusals
    assert why["a_1.csv"] == "it took more than its budget of 0.5 s"
    assert why["a_3.csv"].endswith("a crash in compiled code")
    assert why["a_4.csv"].startswith("it cannot be read")
    if sys.platform == "linux":
        assert why["a_2.csv"] == "it needed more memory than its budget of 400 MB"
    assert set(why) == {f"a_{i}.csv" for i in (1, 2, 3, 4)}
    assert list(found.records["verdict"])[-1] == "adequate"
    assert found.records["p"].tolist() == [1.0] * 5


@pytest.mark.slow
def test_a_term_of_the_wrong_sign_is_the_reason_of_a_refused_record(tmp_path: Path) -> None:
    path = write_problem(tmp_path)
    path.write_text(path.read_text().replace("terms=[-y, K * u]", "terms=[y, K * u]"))
    write_record(tmp_path / "records" / "a_1.csv", samples(1))
    found = run(tmp_path, tmp_path / "out")
    assert list(found.records["stage"]) == ["refused"]
    assert "the term y in the heat balance probably has the wrong sign" in found.refusals["a_1.csv"]
    assert found.to_json()["refusals"] == found.refusals


@pytest.mark.slow
def test_a_full_disk_is_told_and_nothing_is_lost(
    done: casid.Fleet, heaters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, left = parts._write, [1]  # file of rows that still has room

    def full(path: Path, content: bytes) -> None:
        is_of_records = path.suffix == ".parquet" and "records" in path.parts[-3:]
        left[0] -= is_of_records
        if left[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(parts, "_write", full)
        with pytest.raises(DataError, match=r"the disk is full; \d+ runs are kept there"):
            run(heaters, tmp_path / "out")
    again = run(heaters, tmp_path / "out")
    assert 0 < again.new < 8
    assert contents(tmp_path / "out") == contents(heaters / "out")


@pytest.mark.slow
def test_a_record_that_was_changed_is_refused(heaters: Path, tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    shutil.copy(heaters / "records" / "heater0_1.csv", tmp_path / "records")
    write_problem(tmp_path)
    run(tmp_path, tmp_path / "out")
    write_record(tmp_path / "records" / "heater0_1.csv", samples(99))
    with pytest.raises(DataError, match=r"heater0_1\.csv was changed after it was done"):
        run(tmp_path, tmp_path / "out")


def test_another_fleet_is_not_continued(done: casid.Fleet, heaters: Path) -> None:
    with pytest.raises(DataError, match=r"level is 0\.05 there and 0\.1 now"):
        run(heaters, heaters / "out", level=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"asset": "{ship}_*.csv"}, "is a pattern without {asset}"),
        ({"level": 2.0}, "no rate between 0 and 1"),
        ({"budget": 0.0}, "positive number"),
        ({"without": ["ofset"]}, "did you mean 'offset'"),
    ],
)
def test_options_that_mean_nothing_are_refused(
    heaters: Path, tmp_path: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        run(heaters, tmp_path / "out", **options)
    with pytest.raises(DataError, match="no such record"):
        casid.fleet(heaters / "heater.py", "nothing/*.csv", out=tmp_path / "out")


def test_the_page_and_the_terminal_name_the_finding(done: casid.Fleet, heaters: Path) -> None:
    text = str(done)
    assert "heater0" in text
    assert "2 deficient records at a false discovery rate of 0.05" in text
    page = (heaters / "out" / "report.html").read_text()
    assert "lasting, still there" in page
    assert "e-BH: nothing is assumed" in page
    assert len(page) < 3e6


@pytest.mark.slow
def test_records_that_decide_nothing_are_listed_with_the_reason(tmp_path: Path) -> None:
    write_problem(tmp_path)
    still = samples(5)
    still["y"][:] = 1.0
    for n in (1, 2):
        write_record(tmp_path / "records" / f"a_{n}.csv", still)
    found = run(tmp_path, tmp_path / "out")
    assert set(found.undecided) == {"a_1.csv", "a_2.csv"}
    assert found.records["p"].tolist() == [1.0, 1.0]
    assert "2 records, a_1.csv the first: y is constant" in " ".join(str(found).split())
    assert json.loads((tmp_path / "out" / "fleet.json").read_text())["undecided"] == 2


@pytest.mark.slow
def test_a_channel_that_is_ignored_is_no_candidate(tmp_path: Path) -> None:
    write_problem(tmp_path)
    rng = np.random.default_rng(3)
    data = samples(5, offset=0.0)
    data["sun"] = rng.standard_normal(len(data["t"]))
    data["y"] = data["y"] + 0.2 * data["sun"]
    write_record(tmp_path / "records" / "a_1.csv", data)
    open_ = run(tmp_path, None, screen=False)
    left_out = run(tmp_path, None, screen=False, ignore=["sun"])
    assert "sun" in open_.records["causes"][0]
    assert "sun" not in left_out.records["causes"][0]
