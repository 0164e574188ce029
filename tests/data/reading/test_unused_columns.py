"""Columns that a problem does not use: which are candidates for a missing input, and why not."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import casid
from casid.errors import DataError
from tests.support.shared import shared

T = np.arange(200) / 10
RNG = np.random.default_rng(4)


def room() -> casid.Problem:
    """A heat capacity and one loss to the outdoor temperature; the sun is not in it."""
    m = casid.Model("room")
    T_i = m.state("T_i", "K")
    P, T_out = m.input("P", "W"), m.input("T_out", "K")
    C = m.parameter("C", "J/K", start=4e6, lower=1e5, upper=1e8)
    H = m.parameter("H", "W/K", start=100.0, lower=1.0, upper=1e3)
    m.balance(T_i, "heat", inertia=C, terms=[P, -H * (T_i - T_out)], unit="W")
    m.output("T_room", T_i, "K")
    channels = {"T_room": "T_Raum [°C]", "P": "P_Heiz in kW", "T_out": "Aussentemp. (°C)"}
    return casid.Problem("room", m, channels=channels)


def cart() -> casid.Problem:
    m = casid.Model("cart")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    m.derivative(x, v)
    F = m.input("F", "N")
    d, mass = m.parameter("d", "N s/m", start=1.0), m.parameter("m", "kg", value=2.0)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v], unit="N")
    m.output("x_meas", x, "m")
    return casid.Problem("cart", m)


@pytest.fixture
def path(tmp_path):
    x, wind = np.sin(T), RNG.standard_normal(T.size)
    columns = {
        "t": T,
        "F [N]": np.sign(np.sin(3 * T + 0.1)),
        "x_meas": x,
        "Wind vorn [kN]": wind,
        "2. Sensor": RNG.standard_normal(T.size),
        "x again [mm]": 1e3 * x + 7,
        "speed": np.gradient(x, T) + 1e-3 * RNG.standard_normal(T.size),
        "second": x + 1e-2 * RNG.standard_normal(T.size),
        "row": np.arange(T.size),
        "flat": np.ones(T.size),
        "holes": np.where(np.arange(T.size) == 5, np.nan, wind**2),
    }
    lines = [";".join([*columns, "note", "void"])]
    for k in range(T.size):
        cells = ["" if np.isnan(v[k]) else repr(float(v[k])) for v in columns.values()]
        lines.append(";".join([*cells, "ok", ""]))
    path = tmp_path / "run.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_numeric_columns_that_move_are_candidates_and_others_are_named_with_the_reason(path):
    e = cart().read(path, mapping={"F": "F [N]"})
    assert dict(e.unused) == {"Wind_vorn": "Wind vorn [kN]", "c_2_Sensor": "2. Sensor"}
    assert e.record.units["Wind_vorn"] == "N"
    assert e.record.units["c_2_Sensor"] == "1"
    said = "\n".join(e.record.provenance)
    assert "column Wind vorn [kN] to Wind_vorn [N]: times 1000; unit from its name" in said
    assert "'Wind vorn [kN]' is not used by the model: a diagnosis tests it" in said
    for column, why in {
        "x again [mm]": "a copy of column 'x_meas', up to scale and offset",
        "speed": "the derivative of column 'x_meas'",
        "second": "all but a copy of column 'x_meas', as another sensor of it would be",
        "row": "a counter or a clock",
        "flat": "constant",
        "holes": "1 of 200 rows have no value",
        "note": "text",
        "void": "empty",
    }.items():
        assert f"column {column!r} is not used: {why}" in said


def test_a_column_is_left_out_on_request_and_a_wrong_name_is_refused(path):
    e = cart().read(path, mapping={"F": "F [N]"}, ignore=["Wind vorn [kN]"])
    assert list(e.unused) == ["c_2_Sensor"]
    assert "column 'Wind vorn [kN]' is not used: left out as requested" in str(e.record)
    with pytest.raises(DataError, match="no column 'Wind' to ignore; name one as .* writes it; "):
        cart().read(path, mapping={"F": "F [N]"}, ignore=["Wind"])


def test_unused_columns_stay_with_the_experiment_through_preparation_and_pickling(path):
    e = cart().read(path, mapping={"F": "F [N]"})
    again = pickle.loads(pickle.dumps(e))
    assert dict(again.unused) == dict(e.unused)
    assert "Wind_vorn" in again.record.decimate(2)


@pytest.mark.slow
def test_the_sun_that_the_model_omits_is_named_first_with_its_size():
    """Truth: an area of 1.2 m^2; balance unit W over the column's W/m^2. Half of the record."""
    source = shared("cases/strangers/room_winter.csv")
    e = room().read(source, window=(0.0, 6e5))
    assert dict(e.unused) == {"Globalstrahlung": "Globalstrahlung W/m2"}
    found = casid.diagnose(room(), e, advise=False)
    cause = found.causes[0]
    assert (cause.kind, cause.where) == ("extra_input", "Globalstrahlung")
    assert "column 'Globalstrahlung W/m2'" in found.sentence
    (size,) = cause.parameters
    assert size.unit == "m^2"
    assert abs(size.value - 1.2) < 1.96 * size.std_error
