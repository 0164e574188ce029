"""Texts and pages show the units that a model declares."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import casid
from casid.estimation.fitted.simulation_inputs import starting_model
from casid.identifiability.records.reference_excitation import record_excitation
from casid.presentation import present


@pytest.fixture(scope="module")
def problem() -> casid.Problem:
    """A lift: what flows into an elastic hose and a cylinder raises a mass."""
    m = casid.Model("lift")
    Q = m.input("Q", "l/min", hold="foh")
    v, p = m.state("v", "mm/s", initial=0.0), m.state("p", "bar", initial=0.0)
    A, d = m.constant("A", 20.0, "cm^2"), m.parameter("d", "N s/m", start=5e3, lower=0.0)
    C = m.parameter("C", "cm^3/bar", start=1.0, lower=0.01)
    m.balance(v, "force", inertia=m.constant("M", 700.0, "kg"), terms=[A * p, -d * v])
    m.balance(p, "flow", inertia=C, terms=[Q, -A * v])
    m.output("pressure", p, "bar")
    return casid.Problem(
        "lift",
        m,
        channels={"Q": "Volumenstrom [l/min]"},
        recorded={"oil": "degC"},
        load_cases={"full": {"C": 2.0}},
        noise={"pressure": 0.1},
        starts=1,
    )


@pytest.fixture(scope="module")
def record(problem: casid.Problem) -> casid.Record:
    rng = np.random.default_rng(2)
    flow = np.repeat(rng.uniform(-5.0, 5.0, 40), 10) / 6e4
    channels = {"Q": flow, "pressure": np.zeros(400), "oil": 310.0 + rng.normal(size=400)}
    blank = casid.Record(channels, {"Q": "m^3/s", "pressure": "Pa", "oil": "K"}, Ts=0.02)
    ideal = starting_model(problem, casid.Experiment(blank)).simulate(blank)["pressure"]
    return blank.with_channel("pressure", ideal + 1e4 * rng.normal(size=400), "Pa")


def test_excitation_is_in_declared_units_and_joint_for_the_inputs_of_the_model(problem, record):
    """Whether the oil's temperature moves with the flow is no question of the model's inputs."""
    (found,) = record_excitation(problem, record)
    text = str(found)
    rms = 6e4 * np.sqrt(np.mean(record["Q"] ** 2))
    assert f"(rms {rms:.3g} l/min)" in text
    assert re.search(r"oil .*\(rms 310 K\)", text)  # no zero of an amplitude in degrees Celsius
    assert "jointly" not in text
    assert found.signals.together == ("Q",)
    assert found.to_json()["signals"]["channels"][0]["unit"] == "m^3/s"


def test_the_first_table_of_an_identifiability_page_is_in_declared_units(problem, record):
    page = present(casid.assess_identifiability(problem, record), "page")
    cells = re.sub(r"<[^>]+>|\s+", " ", page)
    assert re.search(r" C +identifiable +1 +0\.\d+ +[\d.]+ % +cm\S+/bar", cells)


def test_a_comparison_of_models_is_printed_in_declared_units(problem, record):
    model = casid.identify(problem, record, intervals="quick").model
    found = model.compare(record)
    rms_bar = found.rmse[next(iter(found.rmse))]["pressure"] / 1e5
    assert "rms [bar]" in str(found)
    assert f"{rms_bar:.4g}" in str(found)
    assert found.units == ("Pa",)
    assert np.nanmax(np.abs(found.plot().data[0].y)) < 1e3


def test_a_problem_is_printed_with_its_channels_parameters_and_load_cases(problem):
    lines = [line.split() for line in str(problem).splitlines()]
    assert ["Q", "input", "l/min", "Volumenstrom", "[l/min]"] in lines
    assert ["pressure", "output", "bar", "pressure", "0.1"] in lines
    assert ["oil", "recorded", "beside", "degC", "oil"] in lines
    assert ["C", "cm^3/bar", "1", "start", "at", "least", "0.01"] in lines
    assert ["full", "C", "2", "cm^3/bar"] in lines
    assert repr(problem).startswith("<Problem lift: <Model lift")
    bare = str(dataclasses.replace(problem, load_cases={}))
    assert "load case" not in bare
