"""A problem file from a file of measurements: every template fits its own kind of system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.data.templates.new_problem import TEMPLATES
from casid.estimation.simulation.fit import FitSettings, fit_model
from tests.support.template_systems import SYSTEMS


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_template_fits_a_file_of_its_system_as_it_is_written(name: str, tmp_path: Path) -> None:
    """The truth lies within four standard errors; SciPy simulated it."""
    system = SYSTEMS[name]
    data = system.write(tmp_path / "run 1.csv")
    written = casid.new_problem(data, system.template, tmp_path / "run.py", known=system.known)
    assert max(map(len, written.text.splitlines())) <= 100
    problem = casid.load_problem(tmp_path / "run.py")
    estimate = casid.identify(problem, problem.read(data))
    for name, truth in system.truth.items():
        found = estimate.parameter(name)
        assert found.std_error is not None
        assert abs(found.value - truth) < 4 * found.std_error, name
        assert found.std_error < 0.1 * abs(truth), name


def test_every_template_has_a_system_that_tests_it() -> None:
    assert {system.template for system in SYSTEMS.values()} == set(TEMPLATES)


def written_for(folder: Path, header: str, *columns: np.ndarray) -> Path:
    """A file of these columns."""
    path = folder / "run.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def waves(n: int, N: int = 200) -> list[np.ndarray]:
    """(N,) time stamps and `n` signals that move."""
    t = 0.1 * np.arange(N)
    return [t, *(np.sin((1 + 0.3 * k) * t) for k in range(n))]


def test_columns_are_matched_by_unit_and_name_and_the_others_are_recorded(tmp_path: Path) -> None:
    header = "time [s],T_out (degC),sun [W/m^2],T_room [degC],heater [kW],spare [V]"
    data = written_for(tmp_path, header, *waves(4), np.zeros(200))
    found = casid.new_problem(data, "thermal")
    assert found.channels == {
        "temperature": "'T_room [degC]' [degC]",
        "ambient": "'T_out (degC)' [degC]",
        "power": "'heater [kW]' [kW]",
    }
    assert found.recorded == {"sun": "'sun [W/m^2]' [W/m^2]"}
    assert found.left_out == {"spare [V]": "it is constant"}
    assert found.path is None


def test_what_is_a_guess_is_marked_and_listed_with_its_line(tmp_path: Path) -> None:
    data = written_for(tmp_path, "time [s],voltage [V],current,angle [deg]", *waves(3))
    found = casid.new_problem(data, "dc-motor", tmp_path / "motor.py")
    lines = (tmp_path / "motor.py").read_text(encoding="utf-8").splitlines()
    assert all("# CHECK: " in lines[n - 1] for n in found.checks)
    text = "\n".join(found.checks.values())
    assert "the file gives no unit; taken as A" in text
    assert "turns of the rotor for one of the shaft; put in its value" in text
    assert all(f"line {n}: {what}" in str(found) for n, what in found.checks.items())


def test_a_speed_in_1_per_min_is_taken_as_revolutions_to_be_checked(tmp_path: Path) -> None:
    data = written_for(tmp_path, "time [s],push [N],n [1/min],m [KN]", *waves(3))
    found = casid.new_problem(data, "free", tmp_path / "free.py")
    text = (tmp_path / "free.py").read_text(encoding="utf-8")
    assert '"n": "n [1/min]:rpm"' in text
    checks = "\n".join(found.checks.values())
    assert "the file's unit '1/min' is ambiguous; taken as rpm" in checks
    assert "the file's unit 'KN' cannot be read; taken as 1" in checks
    assert "gives no unit" not in checks


def test_a_guessed_time_constant_can_be_simulated_at_any_sample_time(tmp_path: Path) -> None:
    """Days between the samples: a guess of seconds would make every fit diverge at its start."""
    rng = np.random.default_rng(5)
    rows = [
        f"{86400 * k},{rng.standard_normal():.3f},{5 + rng.standard_normal():.3f}"
        for k in range(60)
    ]
    data = tmp_path / "daily.csv"
    data.write_text("\n".join(["t [s],push [N],n [m]", *rows]) + "\n")
    found = casid.new_problem(data, "free", tmp_path / "daily.py")
    assert any("time constant of n; the start is a guess" in c for c in found.checks.values())
    problem = casid.load_problem(tmp_path / "daily.py")
    start = problem.model.parameters["tau_n"].start
    assert start == pytest.approx(20 * 86400, rel=0.05)  # two digits
    estimate = casid.identify(problem, problem.read(data))
    assert np.isfinite(estimate["tau_n"])


def test_the_user_names_what_is_guessed_wrong(tmp_path: Path) -> None:
    data = written_for(tmp_path, "time [s],a [m],b [m],push [N]", *waves(3))
    assert casid.new_problem(data, "mass-spring-damper").channels["position"] == "'a [m]' [m]"
    found = casid.new_problem(data, "mass-spring-damper", mapping={"position": "b [m]:mm"})
    assert found.channels["position"] == "'b [m]' [mm]"
    assert '"position": "b [m]:mm"' in found.text


def heated(header: str, folder: Path, *, jitter: float = 0.0) -> Path:
    """A box at 20 degC that a switch heats towards 80 in 400 s, which the record does not reach."""
    N = 120
    on = (np.arange(N) >= 10).astype(float)
    fan = (np.arange(N) >= 5).astype(float)
    t = 3.0 * np.arange(N) + jitter * np.random.default_rng(1).uniform(-1, 1, N)
    box = 20 + 60 * (1 - np.exp(-np.maximum(3.0 * (np.arange(N) - 10), 0) / 400))
    return written_for(folder, header, t, fan, on, box)


def test_a_switch_is_known_and_the_duty_of_a_heater_whose_power_is_there_not_sought(
    tmp_path: Path,
) -> None:
    data = heated("time [s],fan_on,heater_on,T [degC]", tmp_path)
    power = casid.new_problem(data, "thermal", mapping={"power": "heater_on"})
    assert set(power.channels) == {"temperature", "power"}
    assert power.recorded == {"fan_on": "'fan_on' [1]"}
    duty = casid.new_problem(data, "thermal", tmp_path / "box.py")
    assert duty.channels["duty"] == "'heater_on' [1]"
    assert 'm.input("duty", "1", hold="zoh", known=True)' in duty.text
    casid.load_problem(tmp_path / "box.py")


def test_surroundings_that_a_record_does_not_show_start_at_its_coldest_to_be_checked(
    tmp_path: Path,
) -> None:
    """A straight rise under a heater put them at four times the hottest temperature."""
    t = 3.0 * np.arange(120)
    box = 25 + 0.1 * np.maximum(t - 30, 0) ** 1.05
    data = written_for(tmp_path, "time [s],heater_on,T [degC]", t, (t > 30).astype(float), box)
    found = casid.new_problem(data, "thermal", known={"P_max": 120.0})
    assert 'm.parameter("T_a", "degC", start=25, lower=-100, upper=2000)' in found.text
    assert any(
        "temperature of the surroundings; the start is a guess" in c for c in found.checks.values()
    )


def test_a_clock_that_identify_reads_as_even_is_not_to_be_resampled(tmp_path: Path) -> None:
    data = heated("time [s],fan_on,heater_on,T [degC]", tmp_path, jitter=0.1)
    found = casid.new_problem(data, "thermal", tmp_path / "box.py")
    assert "--resample" not in str(found)
    assert casid.load_problem(tmp_path / "box.py").read(data).record.N == 120


def test_a_column_that_counts_rows_is_no_signal_unless_its_unit_is_given(tmp_path: Path) -> None:
    """2, 4, 6 ... under `n` was the speed of a motor."""
    t, u, angle = waves(2)
    count = 38.0 + 2 * np.arange(200)
    data = written_for(tmp_path, "time [s],n,u,theta", t, count, u, angle)
    found = casid.new_problem(data, "dc-motor")
    assert set(found.channels) == {"voltage", "angle"}
    assert found.left_out["n"].startswith("it counts rows, in steps of 2")
    with pytest.raises(casid.DataError, match="'n' cannot be speed: it counts rows.*n:UNIT"):
        casid.new_problem(data, "dc-motor", mapping={"speed": "n"})
    ramp = casid.new_problem(data, "dc-motor", mapping={"speed": "n:rpm"})
    assert ramp.channels["speed"] == "'n' [rpm]"


def test_a_unit_behind_the_word_in_is_kept(tmp_path: Path) -> None:
    """14 cm of water were 14 inch centimetres, and 14 m by the advice of the refusal."""
    t, x = waves(1)
    data = written_for(tmp_path, "t (in sec),h(t) (in cm)", t, 14 + x)
    found = casid.new_problem(data, "tank", mapping={"level": "h(t) (in cm)"})
    assert found.channels["level"] == "'h(t) (in cm)' [cm]"


def test_a_signal_of_steps_is_taken_as_held(tmp_path: Path) -> None:
    t, x = waves(1)
    stepped = np.repeat(np.random.default_rng(1).standard_normal(20), 10)
    data = written_for(tmp_path, "t,force [N],x [m]", t, stepped, x)
    assert 'm.input("force", "N", hold="zoh")' in casid.new_problem(data, "mass-spring-damper").text
    data = written_for(tmp_path, "t,force [N],x [m]", t, np.cos(t), x)
    assert 'm.input("force", "N", hold="foh")' in casid.new_problem(data, "mass-spring-damper").text


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"template": "dc-moter"}, "no template 'dc-moter'; did you mean 'dc-motor'"),
        ({"template": "thermal"}, r"no column for temperature \(K\) among .*--map temperature="),
        ({"mapping": {"angel": "x [m]"}}, "no signal 'angel'"),
        (
            {"template": "mass-spring-damper", "mapping": {"force": "y [m]"}},
            "no column 'y .m.' for force; did you mean 'x .m.'",
        ),
        (
            {"template": "mass-spring-damper", "mapping": {"force": "x [m]"}},
            r"'x \[m\]' \[m\] is no force \[N\].* its numbers are in, as in force=x \[m\]:UNIT",
        ),
        (
            {"template": "mass-spring-damper", "known": {"m": 2.0}},
            "no parameter 'm' for this file; did you mean 'M'",
        ),
        ({"out": "problem.txt"}, "a name that ends with .py"),
    ],
)
def test_a_wrong_request_is_refused_with_the_remedy(
    tmp_path: Path, options: dict[str, object], what: str
) -> None:
    data = written_for(tmp_path, "t,x [m]", *waves(1))
    with pytest.raises(casid.DataError, match=what):
        casid.new_problem(data, **options)  # type: ignore[arg-type]


def test_a_file_without_time_stamps_is_refused(tmp_path: Path) -> None:
    data = written_for(tmp_path, "voltage [V],angle [deg]", *waves(2)[1:])
    with pytest.raises(casid.DataError, match=r"no time column .*--map t=COLUMN"):
        casid.new_problem(data, "dc-motor")


def test_a_problem_file_that_exists_is_kept(tmp_path: Path) -> None:
    data = written_for(tmp_path, "t,x [m]", *waves(1))
    out = tmp_path / "mine.py"
    out.write_text("# an hour of work\n")
    with pytest.raises(casid.DataError, match="exists; name another file with --out, or add --fo"):
        casid.new_problem(data, out=out)
    assert out.read_text() == "# an hour of work\n"
    casid.new_problem(data, out=out, force=True)
    assert "casid.Model" in out.read_text()


def test_names_of_columns_become_names_of_python(tmp_path: Path) -> None:
    header = "time [s],in,Motor: Öl-Temp. 2 [degC],2nd,m"
    data = written_for(tmp_path, header, *waves(4))
    found = casid.new_problem(data, "free", tmp_path / "odd.py")
    assert list(found.channels) == ["in_", "Motor_Oel_Temp_2", "x_2nd", "m_"]
    problem = casid.load_problem(tmp_path / "odd.py")
    assert set(problem.read(data).record) == set(found.channels)


def test_what_the_user_says_of_the_file_stands_in_the_problem(tmp_path: Path) -> None:
    """A file without time stamps is read by every later command with the sample time given here."""
    data = written_for(tmp_path, "x [m],y [m]", *waves(2)[1:])
    form = casid.FileFormat(Ts=0.1)
    found = casid.new_problem(data, "free", tmp_path / "run.py", form=form)
    assert "form=casid.FileFormat(Ts=0.1)," in found.text
    assert casid.load_problem(tmp_path / "run.py").read(data).record.Ts == pytest.approx(0.1)


def test_a_column_with_one_cell_of_text_is_named_where_its_signal_is_missing(tmp_path):
    """A logger writes ERR into one of a hundred cells of the speed."""
    rows = [f"{10 * i};{i % 7};{'ERR' if i == 50 else 100 + i}" for i in range(100)]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["Zeit [ms];Spannung [V];Drehzahl [rpm]", *rows]) + "\n")
    with pytest.raises(
        casid.DataError, match=r"'Drehzahl \[rpm\]' is left out.*line 52: 'ERR'.*--missi"
    ):
        casid.new_problem(file, "dc-motor")
    form = casid.FileFormat(missing=("ERR",))
    new = casid.new_problem(file, "dc-motor", known={"R": 1.0, "K": 0.1, "N": 1.0}, form=form)
    assert "speed" in new.channels


@pytest.mark.parametrize(
    ("template", "header", "sizes", "suggestion"),
    [
        ("thermal", "t,Ph,Ti,Ta,Th", (3e3, 20.0, 5.0, 60.0), 'temperature="Ti":degC'),
        ("thermal", "t,Ph,Ti,Ta,Th", (3e3, 293.0, 278.0, 333.0), 'temperature="Ti":K'),
        ("thermal", "t,Ph,Ti,Ta,Th", (3e3, 200.5, 278.0, 333.0), 'temperature="Ti":UNIT'),
        ("dc-motor", "t,pwm,rpm", (255.0, 700.0), 'voltage="pwm":UNIT'),
    ],
)
def test_the_likeliest_column_is_suggested_with_a_unit_that_its_values_fit(
    tmp_path: Path, template: str, header: str, sizes: tuple[float, ...], suggestion: str
) -> None:
    """Numbers that fit either unit leave it to the user; a column that has a part is none."""
    t, *more = waves(len(sizes))
    columns = [size + wave for size, wave in zip(sizes, more, strict=True)]
    data = written_for(tmp_path, header, t, *columns)
    with pytest.raises(casid.DataError) as refused:
        casid.new_problem(data, template)
    assert f"for example --map {suggestion}, or take" in str(refused.value)


def test_a_gain_from_an_input_whose_unit_is_a_product_has_a_unit_of_one_reading(tmp_path: Path):
    """A file with a torque in N·m and a speed in rpm was refused: `rpm/N·m`."""
    data = written_for(tmp_path, "t (s),torque (N·m),speed (rpm)", *waves(2))
    found = casid.new_problem(data, "free", tmp_path / "run.py")
    assert '"rpm/(N' in found.text or "rad" in found.text
    assert casid.load_problem(tmp_path / "run.py").model.outputs


def heater(tmp_path: Path, unit: str, zero: float) -> Path:
    """A lump of 230 J/K that loses 1.2 W/K to surroundings of 22 degC; its sensor lags by 30 s."""
    t = np.arange(380.0)
    power = 50 + 50 * np.sin(2 * np.pi * t / 300)
    lump, sensor, T = 22.0, 22.0, np.empty(t.size)
    for k, heat in enumerate(power):
        T[k] = sensor
        lump += (heat - 1.2 * (lump - 22.0)) / 230.0
        sensor += (lump - sensor) / 30.0
    T += zero + 0.05 * np.random.default_rng(1).standard_normal(t.size)
    return written_for(tmp_path, f"time [s],P [W],T1{unit}", t, power, T)


@pytest.mark.parametrize(
    ("unit", "zero", "taken"), [("", 0.0, "degC"), ("", 273.15, "K"), (" [K]", 273.15, "K")]
)
def test_a_temperature_without_a_unit_has_the_one_that_its_numbers_fit(
    tmp_path: Path, unit: str, zero: float, taken: str
) -> None:
    """From 22 upwards is no absolute temperature: a law of T^4 or T_a in K would be far off."""
    new = casid.new_problem(heater(tmp_path, unit, zero), "thermal")
    assert new.channels["temperature"] == f"'T1{unit}' [{taken}]"
    doubt = f"the file gives no unit; taken as {taken}"
    assert (doubt in "\n".join(new.checks.values())) is (not unit)


def test_surroundings_that_a_record_does_not_show_end_at_a_bound(tmp_path: Path) -> None:
    """Ever colder with ever less loss is a constant heat flow: without an end, no minimum."""
    data = heater(tmp_path, " [K]", 273.15)
    new = casid.new_problem(data, "thermal", tmp_path / "lump.py")
    assert 'T_a = m.parameter("T_a", "K", start=295, lower=173, upper=2273)' in new.text
    problem = casid.load_problem(tmp_path / "lump.py")
    fit = fit_model(problem.model, [problem.read(data)], FitSettings(starts=1))
    assert fit.values["T_a"] == pytest.approx(173, abs=0.1)
    assert fit.solution.at_lower == ("T_a",)


def test_a_column_computed_from_another_is_no_signal_of_its_own(tmp_path: Path) -> None:
    """Of a rudder angle, its negative and the same in rad, the gains would not be separable."""
    t, rudder, heading = waves(2)
    columns = (rudder, -rudder, np.radians(rudder) + 0.1, heading)
    data = written_for(tmp_path, "time [s],rudder,-rudder,delta [rad],heading", t, *columns)
    found = casid.new_problem(data, "free")
    assert set(found.channels) == {"delta", "heading"}  # the one that has a unit
    copy = "it is 'delta [rad]' on another scale"
    assert found.left_out == {"rudder": copy, "-rudder": copy}
    found = casid.new_problem(data, "free", mapping={"rudder": "rudder:deg"})
    assert found.left_out == dict.fromkeys(
        ("-rudder", "delta [rad]"), "it is 'rudder' on another scale"
    )


def test_that_lags_are_placeholders_is_the_first_step_that_is_printed(tmp_path: Path) -> None:
    """The lags of `free` simulate any file, and are a model of none; a template's equations are."""
    data = written_for(tmp_path, "time [s],F [N],x [m]", *waves(2))
    steps = str(casid.new_problem(data, "free", tmp_path / "rig.py")).partition("next:\n")[2]
    assert steps.startswith("  put your own equations in place of the lags in ")
    assert "or begin with those of a template: --as mass-spring-damper, " in steps
    assert "of the lags" not in str(casid.new_problem(data, "mass-spring-damper"))
