"""A sign flip is a scale of -1: suspected where the parameters cannot follow, and mended."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.identification import FitSettings
from casid.report import estimate_page
from casid.wrong_signs import WrongSign, better_by_chance, negated, wrong_sign
from problems import pendulum, roll_decay, ship

ONE = FitSettings(starts=1)


def pendulum_record(seed: int = 3) -> list[casid.Experiment]:
    return [casid.Experiment(pendulum.simulate(duration=10.0, seed=seed), {}, "run")]


def ship_records(seed: int = 1) -> list[casid.Experiment]:
    return ship.experiments(duration=8.0, seed=seed)


def suspected(problem: casid.Problem, records: list[casid.Experiment]) -> WrongSign | None:
    return wrong_sign(problem.model, records, ONE)


@pytest.mark.parametrize("channel", ["gyro", "accel"])
def test_one_input_and_one_output_share_the_suspicion(channel: str) -> None:
    """A linear model with zero at rest: -y from u is y from -u, so either sensor may be turned."""
    found = suspected(pendulum.problem, negated(pendulum_record(), channel))
    assert found is not None
    assert found.channel == "gyro"
    assert set(found.rivals) == {"accel"}
    assert found.after["gyro"] < 0.5 * found.before["gyro"]
    assert "scale of -1" in str(found)


@pytest.mark.parametrize("channel", ["r", "accel"])
def test_the_yaw_gyro_and_the_accelerometer_of_a_ship_are_named(channel: str) -> None:
    found = suspected(ship.problem, negated(ship_records(), channel))
    assert found is not None
    assert found.channel == channel
    assert not found.rivals
    assert f"-record[{channel!r}]" in found.mend


def test_the_mend_of_the_message_ends_the_suspicion() -> None:
    """With both: the record's channel replaced, and a derived channel in the problem file."""
    (wrong,) = negated(pendulum_record(), "accel")
    (found,) = [suspected(pendulum.problem, [wrong])]
    assert found is not None
    record = wrong.record
    line = found.mend.split("in Python ")[1].split(";")[0]
    mended = eval(line, {"record": record})
    assert suspected(pendulum.problem, [casid.Experiment(mended, {}, "mended")]) is None
    code = found.mend.split("in the problem file ")[1].split(", the file's")[0]
    derived = eval(f"dict({code})", {"casid": casid})["derived"]
    turned = record.with_channel("gyro_recorded", record["gyro"], "rad/s").without("gyro")
    model = pendulum.problem.model
    file = casid.Problem("mended", model, channels={"gyro_recorded": "gyro"}, derived=derived)
    assert suspected(file, [file.experiment(turned)]) is None


@pytest.mark.parametrize("seed", range(4))
def test_right_signs_are_not_suspected(seed: int) -> None:
    """At alpha = 0.05 and half the power: none of 12 records, three problems, one with drag."""
    dragged = pendulum.simulate(duration=20.0, d_2=0.4, seed=seed)
    assert suspected(pendulum.problem, pendulum_record(seed)) is None
    assert suspected(pendulum.problem, [casid.Experiment(dragged, {}, "drag")]) is None
    assert suspected(ship.problem, ship_records(seed)) is None


def test_signs_that_the_model_does_not_see_are_not_suspected() -> None:
    """A free decay has no input: negated, it is the decay from the other side."""
    records = roll_decay.problem.examples()
    for channel in roll_decay.problem.model.outputs:
        assert suspected(roll_decay.problem, negated(records, channel)) is None


def test_the_comparison_of_errors_has_its_level() -> None:
    """Equal errors: one-sided 5 % in 400 draws, within 3.5 binomial standard deviations (3.8 %)."""
    rng = np.random.default_rng(5)
    hits = [better_by_chance(rng.standard_normal(300)) < 0.05 for _ in range(400)]
    assert abs(np.mean(hits) - 0.05) < 3.5 * np.sqrt(0.05 * 0.95 / 400)


def test_a_diagnosis_names_the_sign_first_and_goes_on_with_it_mended(tmp_path: Path) -> None:
    """Drag under a turned accelerometer: both are found, and the gain is measured held out."""
    record = pendulum.simulate(duration=25.0, d_2=0.4)
    wrong = negated([casid.Experiment(record, {}, "run")], "accel")
    found = casid.diagnose(pendulum.problem, wrong, starts=1, max_causes=1)
    first = found.to_json()["causes"][0]
    assert (first["kind"], first["where"]) == ("sensor_scale", "gyro")
    assert first["parameters"]["scale"]["value"] == -1.0
    assert [a["where"] for a in first["alternatives"]] == ["accel"]
    assert [c.kind for c in found.causes[1:]] == ["quadratic_damping"]
    assert found.verdict == "deficient"
    assert "wrong sign" in str(found).splitlines()[1]
    assert "-record['gyro']" in found.advice
    after, before = (found.held_out[k]["gyro"] for k in ("extended_rmse", "baseline_rmse"))
    assert after < 0.2 * before
    # The figures show the record mended, and the baseline turned with it.
    view = found.records[0]
    assert view.extended is not None
    assert np.corrcoef(view.measured[:, 0], view.extended[:, 0])[0, 1] > 0.9
    page = found.write(tmp_path).read_text(encoding="utf-8")
    assert "wrong sign" in page.split('class="sentence"')[1][:200]


def test_an_estimate_carries_the_suspicion_at_its_top() -> None:
    wrong = negated(pendulum_record(), "gyro")
    settings = FitSettings(starts=1, substeps=1, solver=casid.Solver(max_iterations=100))
    found = casid.identify(pendulum.problem, wrong, settings=settings)
    assert "wrong sign" in str(found).splitlines()[1]
    assert "wrong sign" in found.to_json()["suspects"][0]
    assert "wrong sign" in estimate_page(found)


def test_an_estimate_from_right_signs_has_no_suspects() -> None:
    found = casid.identify(pendulum.problem, pendulum_record(), settings=ONE)
    assert found.suspects == ()
