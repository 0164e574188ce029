"""Units that stand in the name of a column, or are given for it."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.data.quality import check
from casid.data.reading.columns import ColumnSpec
from casid.data.reading.header_units import header_unit
from casid.data.reading.name_endings import name_ending
from casid.data.reading.record_file import read_record
from casid.errors import DataError, UnitError
from tests.support.text_tables import T, rows


def test_a_file_is_read_in_si_units_with_its_history(csv):
    path = csv(rows(T, np.full(50, 180.0), T))
    record = read_record(path)
    assert record.names == ("phi_deg", "force_N")
    assert record["phi_deg"][0] == pytest.approx(np.pi)
    assert dict(record.units) == {"phi_deg": "rad", "force_N": "N"}
    assert record.Ts == pytest.approx(0.1, rel=1e-14)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"sha256 {digest}" in record.provenance[0]
    step = "column phi_deg [deg] to phi_deg [rad]: times 0.0174532925; unit from its name"
    assert step in record.provenance


def test_a_name_that_is_a_unit_itself_may_be_in_another_unit(csv):
    """As a product of units, tonne inch second and metre inch kilogram, they named no quantity."""
    path = csv("t in ms,m in kg,h in cm,V in V\n0,1,100,3\n500,2,200,4\n1000,3,300,5\n")
    record = read_record(path)
    assert record.Ts == pytest.approx(0.5)
    assert dict(record.units) == {"m in kg": "kg", "h in cm": "m", "V in V": "V"}
    assert record["h in cm"].tolist() == [1.0, 2.0, 3.0]


def test_a_unit_that_a_column_s_name_ends_in_stands_once(csv):
    record = read_record(csv(rows(np.arange(9.0), header="Zeit [s],u [V],kraft_N")))
    said = "; ".join(record.provenance)
    assert "time column Zeit [s];" in said
    assert "column u [V] to u [V];" in said
    assert "column kraft_N [N] to kraft_N [N];" in said


def test_columns_are_mapped_with_their_own_units(csv):
    path = csv(rows(T, np.full(50, 180.0), np.full(50, 2.0), header="t,roll,pull"))
    record = read_record(
        path, {"phi": ColumnSpec("roll", "deg", "rad"), "f": ("pull", "kN", "N"), "g": "pull"}
    )
    assert record["phi"][3] == pytest.approx(np.pi)
    assert record["f"][3] == 2000.0
    assert record.units["g"] == "1"


@pytest.mark.parametrize(
    ("column", "unit"),
    [("phi_rad", "rad"), ("q_meas_m", "m"), ("u_V", "V"), ("p_degps", "degps"), ("n_rpm", "rpm"),
     ("v [m/s]", "m/s"), ("u (V)", "V"), ("x_g", None), ("x_bar", None), ("a_s", None),
     ("x_min", None), ("y", None), ("x []", "1"), ("u_ms", None), ("T [degC]", "degC"),
     ("u [Volt]", "V"), ("v (Meters per Second)", "m/s"), ("M in Newton metre", "N m"),
     ("p [Kilopascal]", "kPa"), ("T [Degree Celsius]", "degC"), ("m [Pound]", None),
     ("x_Second", None), ("x_Bar", None), ("h (in cm)", "cm"), ("h(t) (in cm)", "cm"),
     ("h(t) [mm]", "mm"), ("t (in sec)", "sec"), ("h (in)", "in"), ("h (in in)", "in"),
     ("P [in W (mean)]", None), ("M (in lbf)", None), ("phi [deg] (filtered)", "deg")],
)  # fmt: skip
def test_the_ending_of_a_name_gives_the_unit_where_it_has_one_reading(column, unit):
    found = header_unit(column)
    assert (found.unit if found else None) == unit


@given(
    name=st.sampled_from(["v", "pitch_rate", "q_in", "T_2"]),
    above=st.sampled_from(["deg", "m", "m3", "m^3", "kg", "N*m", "kN", "J", "m²", "rad"]),
    below=st.sampled_from(["s", "min", "h", "s^2", "s²", "ms"]),
)
def test_a_quotient_behind_the_last_underscore_is_one_unit(name, above, below):
    """A name ends at its last underscore: what stands behind a slash is a part of a unit."""
    found = header_unit(f"{name}_{above}/{below}")
    assert found is not None
    assert (found.unit, found.stem) == (f"{above}/{below}", name)


@pytest.mark.parametrize(
    ("column", "unit", "stem"),
    [("T_N*m", "N*m", "T"), ("A_m²", "m²", "A"), ("a_m^2", "m^2", "a"), ("Q_kJ/kg", "kJ/kg", "Q"),
     ("n_1/min", None, "n"), ("q_l/min", "l/min", "q"), ("i_a/mA", "mA", "i_a"),
     ("T_in/degC", "degC", "T_in"), ("u_d/V", "V", "u_d"), ("x_1/m", "m", "x_1"),
     ("dp_dt/Pa", "Pa", "dp_dt")],
)  # fmt: skip
def test_a_compound_ending_is_a_unit_and_an_index_before_a_slash_is_none(column, unit, stem):
    """n_1/min has two readings, as n [1/min] has; an index before a unit stays in the name."""
    found = header_unit(column)
    assert found is not None
    assert (found.unit, found.stem) == (unit, stem)


@pytest.mark.parametrize("name", ["q", "H(t)", "omega_1"])
@pytest.mark.parametrize("unit", ["deg/s", "m/s^2", "N m"])
@pytest.mark.parametrize("between", ["/", " / ", " /"])
def test_a_quotient_of_quantity_and_compound_unit_has_brackets_around_the_unit(name, unit, between):
    """ISO 80000-1 writes the heading of a column as q/(deg/s): the slash is no part of the name."""
    found = header_unit(f"{name}{between}({unit})")
    assert found is not None
    assert (found.unit, found.stem, found.is_sure) == (unit, name, True)


@pytest.mark.parametrize("unit", ["W/m^2", "degC", "km/h", "l/min", "m³/h", "Meter per second"])
@pytest.mark.parametrize("between", [" in ", ", in "])
def test_the_word_in_between_name_and_unit_belongs_to_neither(unit, between):
    """Also where the unit is a quotient, whose slash alone would tell it from the name."""
    found = header_unit(f"solar radiation{between}{unit}")
    assert found is not None
    assert (found.text, found.stem, found.is_sure) == (unit, "solar radiation", True)


def test_units_that_do_not_match_or_are_ambiguous_are_refused_with_channel_and_column(csv):
    path = csv(rows(T))
    with pytest.raises(UnitError, match="channel phi from column 'force_N'.*'kN' measures"):
        read_record(path, {"phi": ("force_N", "kN", "rad")})
    with pytest.raises(UnitError, match=r"channel f .*ambiguous.*nmi \(nautical mile\).*nanometre"):
        read_record(path, {"f": ("force_N", "nm", "m")})
    with pytest.raises(DataError, match=r"Give \(column, unit in the file, SI target\)"):
        read_record(path, {"f": ("a", "b", "c", "d")})


@pytest.mark.parametrize(
    ("given", "target", "size"),
    [("g", "m/s^2", 9.80665), ("g", "kg", 1e-3), ("KN", "N", 1e3), ("F", "K", 5 / 9),
     ("mg", "m/s^2", 9.80665e-3), ("mg", "kg", 1e-6), ("mG", "m/s^2", 9.80665e-3)],
)  # fmt: skip
def test_of_two_readings_of_a_given_unit_the_one_that_fits_the_model_is_taken(
    csv, given, target, size
):
    record = read_record(csv(rows(T)), {"f": ("force_N", given, target)})
    plain = read_record(csv(rows(T)), {"f": ("force_N", "1", "1")})
    np.testing.assert_allclose(np.diff(record["f"]), size * np.diff(plain["f"]), atol=1e-9)


def test_a_thousandth_of_g_is_the_reading_of_mg_where_the_model_has_an_acceleration(csv):
    path = csv("t,ACCX [mg],dose [mg]\n0,100,100\n1,200,200\n2,300,300\n")
    record = read_record(
        path, {"a": ColumnSpec("ACCX [mg]", target="m/s^2"), "m": ColumnSpec("dose [mg]")}
    )
    assert record["a"] == pytest.approx([0.980665, 1.96133, 2.941995])
    assert record["m"] == pytest.approx([1e-4, 2e-4, 3e-4])
    with pytest.raises(UnitError, match="'mg' measures kg, but 'rad'"):
        read_record(path, {"a": ColumnSpec("ACCX [mg]", target="rad")})


def test_a_unit_in_brackets_is_the_file_s_word_and_an_ending_only_a_hint(csv):
    path = csv(rows(T, header="t,pull [KN],f_deg"))
    with pytest.raises(UnitError, match="ambiguous.*Write which"):
        read_record(path)
    record = read_record(path, {"f": ColumnSpec("f_deg", target="N")})
    assert record["f"][0] == 1.0
    path = csv(rows(T, header="t,pull [deg],f"))
    with pytest.raises(UnitError, match="'deg' measures 1, but 'N'"):
        read_record(path, {"f": ColumnSpec("pull [deg]", target="N")})
    assert read_record(path, {"f": ("pull [deg]", "N", "N")}).units["f"] == "N"


@pytest.mark.parametrize(
    ("header", "given", "severity", "words"),
    [("P [W]", "kW", "warning", "in kW, the unit given, though the file states W: .* 1000 times"),
     ("P [degC]", "K", "warning", "the file states degC. Leave the unit out, as in --map 'P=P"),
     ("P [deg]", "N", "warning", "the file states deg"),
     ("P_deg", "rad", "note", "its name ends with deg: its numbers count 57.2958 times"),
     ("P_deg", "N", "", ""), ("P [W]", "J/s", "", ""), ("P [KN]", "kN", "", ""),
     ("P", "kW", "", "")],
)  # fmt: skip
def test_a_unit_other_than_the_one_that_the_file_states_is_reported(
    csv, header, given, severity, words
):
    path, columns = csv(rows(T, header=f"t,{header},f")), {"P": (header, given)}
    reported = [f for f in check(path, columns).findings if "the unit given" in f.text]
    assert [f.severity for f in reported] == ([severity] if severity else [])
    assert all(re.search(words, str(f)) for f in reported)
    remarks = [s for s in read_record(path, columns).provenance if "the unit given" in s]
    assert len(remarks) == len(reported)


def test_a_unit_of_time_other_than_the_one_that_the_file_states_is_reported(csv):
    found = check(csv(rows(T, header="t [s],y,f")), time=ColumnSpec("t [s]", "min"))
    (finding,) = [f for f in found.findings if f.channel == "t"]
    assert "though the file states s: its numbers count 60 times as much" in finding.text


@pytest.mark.parametrize(
    ("column", "target", "sizes"),
    [
        ("a_hub_g", "m/s^2", [9.80665]),
        ("F_KN", "N", [1e3]),
        ("T_F", "K", [5 / 9]),
        ("wind kt", "m/s", [1852 / 3600]),
        ("Temp C", "K", [1.0]),
        ("range_nm", "m", [1852.0, 1e-9]),
        ("x_in", "m", [0.0254]),
        ("h_foot", "m", [0.3048]),
        ("age_d", "s", [86400.0]),
        ("V_l", "m^3", [1e-3]),
        ("m_ton", "kg", [1e3]),
        ("V_gal", "m^3", [231 * 0.0254**3, 4.54609e-3]),
        ("q_gpm", "m^3/s", [231 * 0.0254**3 / 60, 4.54609e-3 / 60]),
        ("TempC", "K", [1.0]),
    ],
)
def test_an_ending_that_may_be_a_unit_or_an_index_is_settled_by_the_user(
    csv, column, target, sizes
):
    """The acceleration of the ground, or one in g: nothing in the file says which."""
    path = csv(rows(T, header=f"t,{column},other"))
    found = name_ending(column, target)
    assert found is not None
    assert found.is_doubtful
    ending, units = found.text, found.units
    with pytest.raises(UnitError, match=rf"'{ending}' at the end of its name may mean") as caught:
        read_record(path, {"y": ColumnSpec(column, target=target)})
    plain = read_record(path, {"y": (column, target, target)})
    for unit, size in zip(units, sizes, strict=True):
        assert f"y={column}:{unit}" in str(caught.value)
        record = read_record(path, {"y": (column, unit, target)})
        np.testing.assert_allclose(np.diff(record["y"]), size * np.diff(plain["y"]), atol=1e-12)


def test_an_ending_is_that_of_the_name_without_the_number_of_a_repeated_one(csv):
    path = csv(rows(T, header="t,a_g,a_g"))
    with pytest.raises(UnitError, match=r"'g' at the end of its name may mean g0.*a_g#3:g0"):
        read_record(path, {"a": ColumnSpec("a_g#3", target="m/s^2")})


@pytest.mark.parametrize(
    ("column", "target"),
    [("T_C", "degC"), ("v_g", "m/s"), ("T_in", "K"), ("q_S", "m^3/s"), ("force_N", "N"),
     ("acc_m_s2", "m/s^2"), ("i_m_s", "A"), ("x_m_s", "m"), ("motor.T", "N m"), ("p_min", "Pa"),
     ("phi_cal", "rad"), ("forceN", "N")],
)  # fmt: skip
def test_an_ending_of_another_quantity_or_of_the_model_s_own_unit_leaves_no_doubt(column, target):
    """In the same unit either way, or a word, or an index alone."""
    assert name_ending(column, target) is None


@pytest.mark.parametrize(
    ("column", "target", "size"),
    [("p_bar", "Pa", 1e5), ("p_oil_psi", "Pa", 6894.757293168361), ("level_percent", "1", 0.01),
     ("valve_pct", "1", 0.01), ("delay_ms", "s", 1e-3), ("m_grams", "kg", 1e-3),
     ("h_feet", "m", 0.3048), ("h_inches", "m", 0.0254), ("P_hp", "W", 745.6998715822702),
     ("w_degs", "rad/s", np.pi / 180), ("M_Nmm", "N m", 1e-3), ("a_ms2", "ft/s^2", 1 / 0.3048),
     ("gyro_deg_s", "rad/s", np.pi / 180), ("acc_x_m_s2", "ft/s^2", 1 / 0.3048),
     ("q_l_min", "m^3/s", 1e-3 / 60), ("q_m3_h", "m^3/s", 1 / 3600), ("v_km_h", "m/s", 1 / 3.6),
     ("M_kN_m", "N m", 1e3), ("k_kN_m", "N/m", 1e3), ("rho_g_cm3", "kg/m^3", 1e3),
     ("rate_deg_per_s", "rad/s", np.pi / 180), ("heat_kW_m2_K", "W/(m^2 K)", 1e3),
     ("gyro.deg_s", "rad/s", np.pi / 180), ("yaw-rate deg s", "rad/s", np.pi / 180),
     ("angle.deg", "rad", np.pi / 180), ("angleDeg", "rad", np.pi / 180),
     ("pressureBar", "Pa", 1e5), ("PressureKPa", "Pa", 1e3), ("motorSpeedRPM", "rad/s", np.pi / 30),
     ("carSpeedKmh", "m/s", 1 / 3.6)],
)  # fmt: skip
def test_an_ending_is_the_unit_where_the_model_wants_its_quantity(csv, column, target, size):
    """In the model's unit, where the file names another one, all numbers were wrong by a factor."""
    path = csv(rows(T, header=f"t,{column},other"))
    record = read_record(path, {"y": ColumnSpec(column, target=target)})
    plain = read_record(path, {"y": (column, target, target)})
    np.testing.assert_allclose(np.diff(record["y"]), size * np.diff(plain["y"]), rtol=1e-9)
    assert "unit from its name" in "; ".join(record.provenance)


@pytest.mark.parametrize(
    ("column", "unit", "stem"),
    [("gyro_deg_s", "deg/s", "gyro"), ("acc_m_s2", "m/s2", "acc"), ("q_l_min", "l/min", "q"),
     ("q_in_m3_h", "m3/h", "q_in"), ("rho_kg_m3", "kg/m3", "rho"), ("E_W_m2", "W/m2", "E"),
     ("c_mol_l", "mol/l", "c"), ("turn_deg_per_s", "deg/s", "turn"), ("a_ms2", "m/s^2", "a"),
     ("speed_meters_per_second", "meters/second", "speed")],
)  # fmt: skip
def test_an_underscore_is_the_slash_of_a_rate_or_a_density(column, unit, stem):
    """Not the last word alone, a second to the square or a volume."""
    found = header_unit(column)
    assert found is not None
    assert (found.unit, found.stem, found.is_sure) == (unit, stem, False)


@pytest.mark.parametrize("column", ["torque_N_m", "J_kg_m2", "charge_mA_h", "F_N_s"])
def test_words_that_may_be_a_product_or_a_quotient_are_no_unit_of_their_last_word(column):
    assert header_unit(column) is None


@pytest.mark.parametrize(
    ("column", "unit"), [("i_d_A", "A"), ("T_min_K", "K"), ("x_m_mm", "mm"), ("u_s_V", "V")]
)
def test_an_index_before_a_unit_is_no_part_of_it(column, unit):
    found = header_unit(column)
    assert found is not None
    assert found.unit == unit
