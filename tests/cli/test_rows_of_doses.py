"""Files of doses, in which a row may stand close to another one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import casid
from casid.cli.request import read_experiment, source_of


def test_a_channel_recorded_beside_has_no_hole_where_a_dose_has_a_row_more(tmp_path: Path) -> None:
    """Two rows at one place leave the held input a row of its own behind them."""
    m = casid.Model("one compartment")
    c, rate = m.state("c", "mg/L"), m.input("rate", "mg/h", hold="zoh", known=True)
    k = m.parameter("k", "1/h", start=0.3)
    m.balance(c, "plasma", inertia=m.constant("V", 10.0, "L"), terms=[rate, -k * 10e-3 * c])
    m.output("c", c, "mg/L")
    cells: dict[float, str] = {}
    for begin in np.arange(0.0, 72.0, 6.0):
        cells |= {begin + 0.013: "100,", begin + 1.017: "0,"}
        cells |= {begin + d: ("100" if d < 1 else "0") + ",5" for d in (0.5, 2.0, 3.1, 4.3)}
    cells |= {begin + 1.009: "100,7" for begin in (12.0, 30.0, 48.0)}
    rows = [f"{t:.4f},{cells[t]},{70 + 0.1 * i:g}" for i, t in enumerate(sorted(cells))]
    path = tmp_path / "fed.csv"
    path.write_text("\n".join(["time [h],rate [mg/h],c [mg/L],mass [kg]", *rows]) + "\n")
    channels = {"rate": "rate [mg/h]", "c": "c [mg/L]", "mass": "mass [kg]"}
    problem = casid.Problem("plasma", m, channels=channels, recorded={"mass": "kg"})
    record = read_experiment(problem, source_of(str(path)), {}).record
    assert "mass" in record
    assert (~record.is_missing("rate")).sum() > (~record.is_missing("mass")).sum()
