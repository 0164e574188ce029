"""Two accelerometers on a building: transmissibility, identification, and the force itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import casid
from casid.algebra.rational import Rational
from casid.algebra.transfer_matrix import RationalMatrix, transfer_matrix
from casid.data.record import Record
from casid.errors import ModelError
from casid.linear.linear_model import linearise
from casid.unknown_inputs.indirect.direct_model import direct_model
from casid.unknown_inputs.indirect.indirect_model import indirect_model
from casid.unknown_inputs.indirect.model_reader import direct_model_of
from casid.unknown_inputs.indirect.output_choice import choose_output
from casid.unknown_inputs.indirect.special_cases import special_case
from casid.unknown_inputs.observers.decoupled_observer import decoupled_observer
from casid.unknown_inputs.observers.equivalent_model import existence
from casid.unknown_inputs.observers.input_smoother import reconstruct_input
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem
from problems import sensor_to_sensor as building

Array = np.ndarray[Any, Any]

s = Rational.derivative()
KNOWN = {name: building.TRUE[name] for name in ("k_2", "d_2")}


def from_the_force() -> RationalMatrix:
    """[a_1; a_2] from F, (1)-(3) by hand in exact arithmetic."""
    m_1, k_1, d_1, m_2, k_2, d_2 = (int(v) for v in building.TRUE.values())
    spring = d_2 * s + k_2
    Z = transfer_matrix(
        [[m_1 * s**2 + d_1 * s + k_1 + spring, -spring], [-spring, m_2 * s**2 + spring]]
    )
    rows = tuple((row[0] * s**2,) for row in Z.inverse().rows)
    return RationalMatrix(rows, ("a_1", "a_2"), ("F",))


def test_the_transmissibility_has_none_of_the_shared_dynamics() -> None:
    """Example 3.11, (4) of the problem: the indirect model, the room's and the model's own."""
    G = from_the_force()
    a_1, a_2 = G.select([0], [0]), G.select([1], [0])
    d = direct_model(G_OI=a_2, G_II=a_1)
    assert special_case(d).name == "sensor to sensor (S2SID)"
    found = indirect_model(d).G_OI[0, 0]
    m_2, k_2, d_2 = (int(building.TRUE[n]) for n in ("m_2", "k_2", "d_2"))
    assert found.equals((d_2 * s + k_2) / (m_2 * s**2 + d_2 * s + k_2))
    below, above = linearise(building.indirect_model()).transfer("a_2").evaluate(KNOWN)
    np.testing.assert_allclose(below, [1.0, d_2 / m_2, k_2 / m_2])
    np.testing.assert_allclose(above[0][0], [0.0, d_2 / m_2, k_2 / m_2])


def test_the_upper_floor_is_the_output_because_the_other_way_round_is_improper() -> None:
    choice = choose_output(from_the_force(), measurements=["a_1", "a_2"])
    assert choice.recommended.outputs == ("a_2",)
    assert choice.recommended.inputs == ("a_1",)
    assert "it alone is proper and stable" in choice.reason


RESONANCE = float(np.sqrt(building.TRUE["k_2"] / building.TRUE["m_2"]))  # rad/s, of the upper floor
LINES = (24.0 * 0.005) ** 2 / 12
"""What straight lines between samples cost of a signal at 24 rad/s, the higher resonance."""


def test_the_model_s_values_are_found_without_the_force() -> None:
    """Noise-free: errors of straight lines between samples, of the spring's force at resonance."""
    record = building.simulate(duration=20.0, noise=0.0, seed=5)
    estimate = casid.identify(building.problem, [casid.Experiment(record, {}, "quiet")])
    assert estimate["k_2"] == pytest.approx(KNOWN["k_2"], rel=LINES)
    assert estimate["d_2"] == pytest.approx(KNOWN["d_2"], abs=LINES * KNOWN["k_2"] / RESONANCE)


def test_noisy_records_give_the_values_within_their_standard_errors() -> None:
    """3.5 standard errors; the noise of a_1 biases by less, its power is 7e-5 of the signal's."""
    record = building.simulate(duration=20.0, seed=2)
    estimate = casid.identify(building.problem, [casid.Experiment(record, {}, "noisy")])
    lines = {"k_2": LINES * KNOWN["k_2"], "d_2": LINES * KNOWN["k_2"] / RESONANCE}
    for name in ("k_2", "d_2"):
        sd = next(p.std_error for p in estimate.parameters if p.name == name)
        assert sd is not None
        assert abs(estimate[name] - KNOWN[name]) < 3.5 * sd + lines[name]


def test_the_force_is_smoothed_from_both_accelerometers_but_for_its_slow_part() -> None:
    """Two zeros at s = 0: k_1 x_1 of a slow force is not seen, and the smoother says so."""
    record = building.simulate(duration=10.0, seed=3, with_force=True)
    e = reconstruct_input(
        building.direct_model(),
        record.without("force"),
        values=KNOWN,
        noise={"a_1": building.NOISE, "a_2": building.NOISE},
        start_sd=dict.fromkeys(("x_1", "v_1", "z", "w"), 1e-6),  # at rest
    )
    error, sd = e["F"] - record["force"], e.std_error("F")
    assert np.all(np.abs(error) < 4 * sd)
    assert sd[-1] > 10 * sd[100]  # it drifts
    second = np.ones(200) / 200
    fast = (error - np.convolve(error, second, "same"))[200:-200]
    assert np.std(fast) < 0.06 * np.std(record["force"])
    assert e.units["F"] == "N"


def test_no_observer_is_free_of_the_force_with_accelerometers_alone() -> None:
    """Both sensors see s^2 times a position: two zeros at s = 0, on the edge."""
    found = existence(unknown_input_system(building.direct_model(), values=KNOWN))
    assert not found.exists
    assert "zero s = 0" in found.reason
    np.testing.assert_allclose(np.sort(np.abs(found.unstable)), [0.0, 0.0], atol=1e-5)


def test_positions_of_both_floors_make_an_observer_and_it_follows_the_building() -> None:
    """With the relative position and both velocities measured the force is decoupled."""
    m = building.direct_model()
    m.output("v_1 measured", m.symbol("v_1"), "m/s")
    m.output("z measured", m.symbol("z"), "m")
    outputs = ("v_1 measured", "z measured", "a_1")
    system = unknown_input_system(m, values=KNOWN, outputs=outputs)
    assert not existence(system).exists  # x_1 is seen by nothing but its own spring
    m.output("x_1 measured", m.symbol("x_1"), "m")
    system = unknown_input_system(m, values=KNOWN, outputs=(*outputs, "x_1 measured"))
    observer = decoupled_observer(system, poles=[-20.0, -22.0, -24.0, -26.0])
    t = 0.001 * np.arange(4000)
    motion = _steady(system, 12.0, t)
    y = {n: motion[n] for n in system.outputs}
    seen = observer.run(Record(y, {n: system.units[n] for n in y}, Ts=0.001))
    late = t > 1.5
    for state in system.states:
        error = np.max(np.abs(seen[state] - motion[state])[late])
        assert error < 1e-3 * np.max(np.abs(motion[state]))


def _steady(system: UnknownInputSystem, w: float, t: Array) -> dict[str, Array]:
    """States and outputs under a force of 1 kN at one frequency."""
    x = 1e3 * np.linalg.solve(1j * w * np.eye(system.nx) - system.A, system.E[:, 0])
    y = system.C @ x + 1e3 * system.F[:, 0]
    turn = np.exp(1j * w * t)
    names = (*system.states, *system.outputs)
    return {n: (v * turn).real for n, v in zip(names, (*x, *y), strict=True)}


def test_check_and_identify_run_on_the_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from click.testing import CliRunner

    from casid.cli.main import main

    record = building.simulate(duration=6.0, seed=4, name="run")
    columns = np.column_stack([record.t, record["a_1"], record["a_2"]])
    path = tmp_path / "run.csv"
    np.savetxt(path, columns, delimiter=",", header="t,a_1,a_2", comments="")
    problem = str(Path(building.__file__))
    monkeypatch.chdir(tmp_path)
    checked = CliRunner().invoke(main, ["check", str(path), "--problem", problem])
    assert checked.exit_code == 0, checked.output
    assert "a_1" in checked.output
    fitted = CliRunner().invoke(main, ["identify", problem, str(path)])
    assert fitted.exit_code == 0, fitted.output
    assert "k_2" in fitted.output


def test_the_direct_model_is_read_off_a_casid_model_in_letters_or_numbers() -> None:
    """F eliminated in transfer functions is F eliminated in the model's own equations."""
    half = {"d_2": KNOWN["d_2"]}  # letters take time
    found = indirect_model(direct_model_of(building.direct_model(), using="a_1", values=half))
    assert found.matrix.parameters == ("k_2",)
    numbers = indirect_model(direct_model_of(building.direct_model(), using="a_1", values=KNOWN))
    m_2, k_2, d_2 = (int(building.TRUE[n]) for n in ("m_2", "k_2", "d_2"))
    expected = (d_2 * s + k_2) / (m_2 * s**2 + d_2 * s + k_2)
    w = np.array([1.0, 12.0, 30.0])
    np.testing.assert_allclose(
        numbers.G_OI.frequency_response(w)[:, 0, 0], expected.frequency_response(w), rtol=1e-9
    )
    assert numbers.require_usable() is numbers
    assert found.confounding_noise == ("noise of a_1",)
    with pytest.raises(ModelError, match="has no output 'a_3'; did you mean"):
        direct_model_of(building.direct_model(), using="a_3")
    with pytest.raises(ModelError, match="an indirect model has none left"):
        direct_model_of(building.indirect_model(), using="a_2")
