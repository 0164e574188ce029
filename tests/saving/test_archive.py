"""What is saved comes back: every number, the page, and a model that simulates to the last bit."""

from __future__ import annotations

import copy
import json
import pickle
import zipfile
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import casid
from casid.model.clock_signals import StepAt
from casid.model.declarations import Input
from casid.model.effects.channels.delays import time_delay
from casid.saving.archive import VERSION
from casid.saving.plain_values import CHANGED, MOVED, class_at
from problems import pendulum
from tests.estimation.fitted.test_fitted_model import record
from tests.report.golden_results import assessment
from tests.support import samples
from tests.support.fitted_models import driven_mass

GOLDEN = Path(__file__).parent / "golden"


@pytest.fixture(scope="module")
def estimate() -> casid.Estimate:
    plain = driven_mass()
    extended = time_delay(plain, "position", 0.2).extend(plain, starts={"delay_position": 0.03})
    return casid.identify(casid.Problem("oscillator", extended, starts=1), record())


RESULTS = {
    "estimate": samples.estimate,
    "diagnosis": samples.rich,
    "hostile names": samples.hostile,
    "undecided": samples.undecided,
    "assessment": assessment,
}


@pytest.mark.parametrize("kind", RESULTS)
@pytest.mark.parametrize("place", ["result.casid", "result"])
def test_a_result_comes_back_with_every_number_and_text(kind, place, tmp_path):
    result = RESULTS[kind]()
    again = casid.load(result.save(tmp_path / place))
    assert type(again) is type(result)
    assert json.dumps(again.to_json()) == json.dumps(result.to_json())  # NaN is NaN
    assert str(again) == str(result)
    assert repr(again) == repr(result)


def test_the_page_of_a_loaded_diagnosis_is_the_same_byte_for_byte(tmp_path):
    result = samples.rich()
    again = casid.load(result.save(tmp_path / "rich.casid"))
    assert again.write(tmp_path / "a").read_bytes() == result.write(tmp_path / "b").read_bytes()


@pytest.mark.parametrize("kind", RESULTS)
def test_results_pickle_and_copy(kind):
    result = RESULTS[kind]()
    for again in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result), copy.copy(result)):
        assert str(again) == str(result)


def test_a_loaded_model_simulates_to_the_last_bit_as_it_did(estimate, tmp_path):
    loaded = casid.load(estimate.save(tmp_path / "run.casid")).model
    pickled = pickle.loads(pickle.dumps(estimate)).model
    alone = casid.load(estimate.model.save(tmp_path / "model.casid"))
    before = estimate.model.simulate(record())
    for model in (loaded, pickled, alone, copy.deepcopy(estimate.model)):
        after = model.simulate(record())
        assert after.names == before.names
        assert all(np.array_equal(after[name], before[name]) for name in before)
        assert model.model.stages == estimate.model.model.stages
        # Symbols and expressions belong together: the model can be extended.
        extended = model.model.with_unknown("k")
        assert casid.identify(extended, record())["k"] == pytest.approx(estimate["k"], rel=1e-6)


def test_the_same_result_makes_the_same_file(tmp_path):
    first = samples.deficient().save(tmp_path / "a.casid")
    assert first.read_bytes() == samples.deficient().save(tmp_path / "b.casid").read_bytes()


def test_long_arrays_are_columns_of_parquet_tables(estimate, tmp_path):
    import pandas as pd

    folder = estimate.save(tmp_path / "run")
    table = pd.read_parquet(folder / "arrays_400.parquet")
    assert np.array_equal(table["records.0.measured[0]"], estimate.records[0].measured[:, 0])
    assert json.loads((folder / "result.json").read_text())["schema"] == "casid.saved/1"


def changed(path: Path, target: Path, **values: object) -> Path:
    """A saved file with another content of `result.json`."""
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    content = json.loads(members["result.json"]) | values
    members["result.json"] = json.dumps(content).encode()
    with zipfile.ZipFile(target, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
    return target


def test_what_cannot_be_read_is_refused_with_the_reason(tmp_path):
    path = samples.estimate().save(tmp_path / "run.casid")
    data, bad = path.read_bytes(), tmp_path / "bad.casid"
    with pytest.raises(casid.DataError, match="does not exist; give the path"):
        casid.load(tmp_path / "none.casid")
    bad.write_bytes(data[: len(data) // 2])
    with pytest.raises(casid.DataError, match=r"bad\.casid: no result of casid, or damaged"):
        casid.load(bad)
    bad.write_text("t,y\n0,1\n")
    with pytest.raises(casid.DataError, match="give a file that save"):
        casid.load(bad)
    with pytest.raises(casid.DataError, match="saved by a later casid .*reads up to casid.saved/1"):
        casid.load(changed(path, bad, schema="casid.saved/2"))
    with pytest.raises(casid.DataError, match="has schema 'casid.estimate/1', not"):
        casid.load(changed(path, bad, schema="casid.estimate/1"))
    with pytest.raises(casid.DataError, match="names 'os.path.Popen', which is no result"):
        casid.load(changed(path, bad, content={"$class": "os.path.Popen", "fields": {}}))
    unknown = {"$class": "estimation.estimate.Origin", "fields": {"colour": "red"}}
    with pytest.raises(casid.DataError, match="has colour, which this version of casid does not"):
        casid.load(changed(path, bad, content=unknown))
    torn = {"$array": "gone", "shape": [3], "dtype": "float64"}
    with pytest.raises(casid.DataError, match=r"damaged \(KeyError"):
        casid.load(changed(path, bad, content=torn))
    with pytest.raises(casid.DataError, match="the folder holds no result.json"):
        casid.load(tmp_path)


def test_a_function_of_the_users_own_is_refused_with_its_place(estimate, tmp_path):
    model = estimate.model.model.copy()
    model.add_input(Input("chirp", "N", "generated", "foh", lambda t: t))
    mine = replace(estimate.model, model=model)
    with pytest.raises(casid.DataError, match=r"model\.inputs\.chirp\.signal holds the function"):
        mine.save(tmp_path / "run.casid")
    assert not list(tmp_path.iterdir())


def test_a_problem_of_a_file_is_pickled_with_the_functions_of_its_file():
    problem = casid.load_problem(Path(pendulum.__file__))
    known = problem.with_known({"k": 12.0})
    again = pickle.loads(pickle.dumps(known))
    assert again.model.parameters["k"].value == 12.0
    assert dict(again.channels) == dict(problem.channels)
    first, second = again.examples()[0].record, problem.examples()[0].record
    assert np.array_equal(first["gyro"], second["gyro"])


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.casid")), ids=lambda path: path.stem)
def test_files_of_every_version_are_read_and_their_models_simulate_as_they_did(path):
    """The simulation of the fit is in the file beside the model; machines round differently."""
    loaded = casid.load(path)
    (view,) = loaded.records
    assert [s.kind for s in loaded.model.model.stages] == ["delay"]
    simulated = loaded.model.simulate(record(N=100))
    assert simulated["position"] == pytest.approx(view.baseline[:, 0], rel=1e-12, abs=1e-15)
    assert loaded.model.model.inputs["step at 1 s"].signal == StepAt(1.0)
    assert loaded["k"] == pytest.approx(50.0, rel=0.05)


def test_there_is_a_saved_file_of_this_version():
    assert (GOLDEN / f"estimate_{VERSION}.casid").exists()
    assert (GOLDEN / f"fields_{VERSION}.json").exists()


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.json")), ids=lambda path: path.stem)
def test_classes_find_again_what_was_saved_and_need_no_more(path):
    """A class that moved is in `MOVED`, and a field that is added has a default value."""
    for place, saved in json.loads(path.read_text(encoding="utf-8")).items():
        kind = class_at(MOVED.get(place, place))
        if not is_dataclass(kind) or place in CHANGED:
            continue
        now = [f for f in fields(kind) if f.init]
        needed = {f.name for f in now if f.default is MISSING and f.default_factory is MISSING}
        assert needed <= set(saved), f"{place}: give {needed - set(saved)} a default value"
        assert set(saved) <= {f.name for f in now}, f"{place}: a saved field is gone"


def test_a_result_is_not_saved_beside_that_of_a_command_which_would_be_read_instead(tmp_path):
    folder = tmp_path / "reports"
    samples.estimate().save(folder / "result.casid")
    with pytest.raises(casid.DataError, match="holds the result of a command.*name another folder"):
        samples.deficient().save(folder)
    other = tmp_path / "other"
    samples.estimate().save(other)
    assert casid.load(samples.deficient().save(other)).problem == samples.deficient().problem
