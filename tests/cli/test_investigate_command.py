"""The command `casid investigate`: a record at a time, until no tie is left."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import casid
from casid.cli.main import main

PROBLEM = """
import casid

m = casid.Model("store")
x, u = m.state("x", "m", initial=0.0), m.input("u", "N", hold="zoh")
c, k = m.parameter("c", "N s/m", start=1.0), m.parameter("k", "N/m", start=2.0)
m.balance(x, "force", inertia=c, terms=[-k * x, u])
m.output("y", x, "m")
problem = casid.Problem("store", m, noise={"y": 0.01})
"""
SMALL = ["--duration", "12", "--intervals", "24", "--candidates", "12", "--starts", "1"]


def bench(u: np.ndarray, seed: int, path: Path) -> str:
    """A force that grows with the cube of the state, by Euler steps of 5 ms."""
    rng, x, rows = np.random.default_rng(seed), 0.0, ["t,u,y", "s,N,m"]
    for k, now in enumerate(u.tolist()):
        rows.append(f"{k / 10},{now},{x + 0.01 * rng.standard_normal()}")
        for _ in range(20):
            x += 0.005 * (now - 2.0 * x - x**3)
    path.write_text("\n".join(rows) + "\n")
    return str(path)


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["investigate", *arguments])
    return int(ended.value.code or 0)


@pytest.mark.slow
def test_a_tie_is_broken_in_two_calls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = tmp_path / "store.py"
    problem.write_text(PROBLEM)
    levels = np.random.default_rng(3).uniform(-1, 1, 20)
    first = bench(np.repeat(levels, 10), 1, tmp_path / "first.csv")
    common = ["--limit", "u=-3:3", *SMALL, "--json", "--quiet"]
    assert run(str(problem), first, *common, "--out", str(tmp_path / "one")) == 0
    one = json.loads(capsys.readouterr().out)
    assert not one["is_decided"]
    assert one == json.loads((tmp_path / "one" / "investigation.json").read_text())
    designed = casid.read_record(tmp_path / "one" / "input.csv")
    assert float(designed.Ts) == 0.1
    second = bench(designed["u"], 2, tmp_path / "second.csv")
    assert run(str(problem), first, second, *common, "--out", str(tmp_path / "two")) == 0
    two = json.loads(capsys.readouterr().out)
    assert two["is_decided"]
    assert [c["kind"] for c in two["diagnoses"][0]["causes"]] == ["cubic_damping"]
    assert not (tmp_path / "two" / "input.csv").exists()
    assert "decided" in (tmp_path / "two" / "report.html").read_text(encoding="utf-8")


def test_whole_records_are_not_held_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = tmp_path / "store.py"
    problem.write_text(PROBLEM)
    record = bench(np.ones(40), 1, tmp_path / "a.csv")
    other = bench(np.ones(40), 2, tmp_path / "b.csv")
    arguments = [str(problem), record, "--hold-out", other, "--limit", "u=-3:3", *SMALL]
    assert run(*arguments, "--out", str(tmp_path / "out")) == 2
    assert "holds a share of each out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
