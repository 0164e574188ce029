"""Estimators ask the exact rank before they start: they refuse, or say what it rests on."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.errors import IdentifiabilityError
from casid.estimation.moments.stages.stage import Stage
from casid.identifiability import requirement
from casid.identifiability.combinations import family
from casid.identifiability.requirement import require_identifiable
from casid.identification.grey_box import minimize_prediction_error
from casid.linear.filtering.noisy_model import White
from problems import pendulum, ship

TS = 0.1


@pytest.fixture
def no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever simulates or solves fails the test."""

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("something was fitted")

    for name in ("diagnosis.evidence.baseline", "identification.simulated"):
        monkeypatch.setattr(f"casid.{name}.fit_model", forbidden)
    monkeypatch.setattr(Stage, "fit", forbidden)
    monkeypatch.setattr("casadi.nlpsol", forbidden)
    # The closed form is a matter of seconds; on a slow machine it is still what is tested here.
    monkeypatch.setattr(requirement, "FAMILIES_LIMIT", 120.0)


# -- the pendulum, its two inertias free -----------------------------------------------------------


def two_inertias() -> casid.Model:
    return pendulum.indirect_model().with_known(m=0.0).with_unknown(I_xm=0.01)


def swing() -> list[casid.Experiment]:
    return [casid.Experiment(pendulum.simulate(duration=3.0), {}, "swing")]


PENDULUM = ["k", "d", "I_x", "I_xm"]
ESTIMATORS = {
    "identify": lambda: casid.identify(two_inertias(), swing()),
    "diagnose": lambda: casid.diagnose(casid.Problem("pendulum", two_inertias()), swing()),
    "least squares": lambda: casid.least_squares(two_inertias(), swing()),
    "instrumental variables": lambda: casid.instrumental_variables(
        two_inertias(), swing(), casid.Instruments("ref")
    ),
    "multistage": lambda: casid.multistage(
        two_inertias(), swing(), [casid.StageSpec(PENDULUM)], casid.Instruments("ref")
    ),
}


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_two_inertias_are_refused_by_their_sum_before_anything_is_fitted(estimator, no_fit):
    """Table 7.1 (a): I_x and I_xm enter as I_x + I_xm; one of them has to be known."""
    with pytest.raises(IdentifiabilityError) as refusal:
        ESTIMATORS[estimator]()
    text = str(refusal.value)
    assert "rank 5 of 6" in text
    assert "whatever is recorded in swing" in text
    assert "I_x and I_xm are not separately identifiable, but I_x + I_xm" in text
    assert "give one of them a known value" in text
    assert "casid.assess_identifiability" in text


def test_what_a_later_stage_cannot_tell_is_refused_before_the_first(no_fit):
    """k and d are told by the first stage, the inertias by none."""
    model = two_inertias()
    records = [
        casid.Experiment(swing()[0].record, {"I_x": 0.1385, "I_xm": 0.0}, "built"),
        casid.Experiment(swing()[0].record, {}, "loaded"),
    ]
    stages = [
        casid.StageSpec(["k", "d"], records=["built"]),
        casid.StageSpec(["I_x", "I_xm"], records=["loaded"]),
    ]
    with pytest.raises(IdentifiabilityError, match=r"recorded in loaded.*I_x \+ I_xm"):
        casid.multistage(model, records, stages, casid.Instruments("ref"))


def test_a_known_inertia_mends_the_pendulum():
    told = require_identifiable(two_inertias().with_known(I_xm=0.0), swing())
    assert told == "all parameters (rank 5 of 5, a proof)"
    assert require_identifiable(two_inertias(), swing(), free=["k", "d", "I_x"]) == told


# -- the ship --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_nine_parameters_of_the_ship_are_refused_with_what_does_not_change(no_fit):
    """Rank 14 of 15: the calibration gives one equation, not two (Linder 2017, section 8.4)."""
    records = ship.experiments(duration=1.0)
    with pytest.raises(IdentifiabilityError) as refusal:
        casid.identify(ship.nine_parameters(), records)
    text = str(refusal.value)
    assert "rank 14 of 15" in text
    assert "nominal, calibration, loaded" in text
    named = text[text.index("loaded. ") : text.index(" are not separately identifiable")]
    for name in ("k", "A_x", "d", "K_r", "K_vdot", "K_delta", "z_f", "m"):
        assert f" {name}" in named
    assert "zbar_m" not in named  # the height of the load is told
    for invariant in ("K_delta/d", "K_r/d", "(z_f + zbar_m_calibration)/d"):
        assert invariant in text
    assert "give one of them a known value" in text


@pytest.mark.slow
def test_records_without_their_load_case_are_refused_with_how_to_name_it(no_fit):
    """One record of a problem with load cases, none named: of eight parameters it tells five."""
    (e,) = ship.experiments(("loaded",), duration=1.0)
    bare = casid.Experiment(e.record, {}, "run")
    lines = []
    with pytest.raises(IdentifiabilityError) as refusal:
        casid.diagnose(ship.problem, bare, progress=lines.append)
    text = str(refusal.value)
    assert "give 3 of them a known value (such as k, A_x and d)" in text
    assert "has load cases (nominal, calibration, second calibration, loaded)" in text
    assert "nominal=a.csv calibration=b.csv 'second calibration=c.csv' loaded=d.csv" in text
    assert "problem.read(path, case='nominal')" in text
    assert [line.partition(":")[0] for line in lines] == ["rank 7 of 10"]
    for name in ("loaded", "nominal:run"):  # named, or known by what the case knows
        named = casid.Experiment(e.record, {}, name)
        assert requirement.unnamed_cases(ship.problem, [named]) == ""
    known = casid.Experiment(e.record, ship.LOAD_CASES["calibration"], "run")
    assert requirement.unnamed_cases(ship.problem, [known]) == ""


@pytest.mark.slow
def test_three_families_of_a_bare_record_are_integrated_without_large_formulas(monkeypatch):
    """Sympy factors none of over `LARGEST` operations: one of 708 takes minutes."""
    sizes = []
    neat = family.neat
    monkeypatch.setattr(family, "neat", lambda e, by: sizes.append(e.count_ops()) or neat(e, by))
    (e,) = ship.experiments(("loaded",), duration=1.0)
    found = requirement.unidentifiable_families(ship.problem.model, [e])
    assert [f.is_closed for f in found] == [True, True, False]
    assert found[2].formulas  # what is found of the third all the same
    assert max(sizes) <= family.LARGEST


def test_a_second_calibration_mends_the_ship():
    cases = ("nominal", "calibration", "second calibration", "loaded")
    records = ship.experiments(cases, duration=1.0)
    told = require_identifiable(ship.two_calibrations().model, records)
    assert told == "all parameters (rank 17 of 17, a proof)"


def test_of_a_group_with_two_freedoms_only_what_stays_in_both_is_called_told():
    """x' = b u - (p + q + r) x: p + q stays where p and q are traded, but it is not told."""
    m = casid.Model("sum")
    x, u = m.state("x", "m"), m.input("u", "m/s", hold="zoh")
    p, q, r = (m.parameter(n, "1/s", start=1.0) for n in "pqr")
    m.derivative(x, m.parameter("b", "1", start=1.0) * u - (p + q + r) * x)
    m.output("y", x, "m")
    records = [casid.Experiment(e.record, {}, e.name) for e in both()]
    with pytest.raises(IdentifiabilityError) as refusal:
        require_identifiable(m, records)
    assert "p, q and r are not separately identifiable, but p + q + r" in str(refusal.value)
    assert "give 2 of them a known value" in str(refusal.value)


# -- a force on a mass: two load cases tell both ---------------------------------------------------


def push(force=lambda u: u) -> casid.Model:
    """(m + load) v' = F u from rest: one load case tells F / m."""
    m = casid.Model("push")
    v = m.state("v", "m/s", initial=0.0)
    u = m.input("u", "1", hold="zoh")
    F = m.parameter("F", "N", start=1.0, lower=0.1, upper=10.0)
    mass = m.parameter("m", "kg", start=1.0, lower=0.1, upper=10.0)
    load = m.parameter("load", "kg", value=0.0)
    m.derivative(v, F * force(u) / (mass + load))
    m.output("y", v, "m/s")
    return m


def pushed(load: float, name: str, *, noise: float = 0.01) -> casid.Experiment:
    """F = 2 N, m = 1.5 kg: v is exactly a sum of held inputs."""
    rng = np.random.default_rng(len(name))
    u = rng.standard_normal(200)
    v = np.concatenate([[0.0], np.cumsum(TS * 2.0 * u / (1.5 + load))[:-1]])
    channels = {"u": u, "y": v + noise * rng.standard_normal(200)}
    record = casid.Record(channels, {"u": "1", "y": "m/s"}, Ts=TS, name=name)
    return casid.Experiment(record, {"load": load}, name)


def both() -> list[casid.Experiment]:
    return [pushed(0.0, "bare"), pushed(1.0, "laden")]


def test_one_load_case_tells_a_ratio_and_two_tell_both_parameters():
    """The force-mass ambiguity (section 7.1), and a known load that resolves it."""
    with pytest.raises(
        IdentifiabilityError,
        match="F and m are not separately identifiable, but m/F",
    ):
        casid.identify(push(), both()[:1])
    estimate = casid.identify(push(), both(), settings=casid.FitSettings(starts=1))
    assert estimate.identifiability.structural == "all parameters (rank 2 of 2, a proof)"
    assert estimate.to_json()["identifiability"]["structural"].startswith("all parameters")
    # 200 samples of a random walk in noise of 0.01: errors of a per cent at the most
    assert estimate["F"] == pytest.approx(2.0, rel=0.05)
    assert estimate["m"] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize(
    ("own", "named"),
    [("m", "F, m of bare and m of laden"), ("F", "F of bare, m and F of laden")],
)
def test_a_parameter_of_each_experiments_own_counts_once_for_each(own, named, no_fit):
    """Two masses and a force from two ratios: the known load helps no more."""
    with pytest.raises(IdentifiabilityError) as refusal:
        casid.identify(push(), both(), settings=casid.FitSettings(own=[own]))
    assert "rank 2 of 3" in str(refusal.value)
    assert f"{named} are not separately identifiable" in str(refusal.value)


def test_an_offset_of_each_experiments_own_is_told():
    m = casid.Model("offset")
    v, u = m.state("v", "m/s", initial=0.0), m.input("u", "1", hold="zoh")
    a = m.parameter("a", "m/s^2", start=1.0)
    m.derivative(v, a * u)
    m.output("y", v + m.parameter("b", "m/s", start=0.1), "m/s")
    records = [casid.Experiment(e.record, {}, e.name) for e in both()]
    told = require_identifiable(m, records, own=["b"])
    assert told == "all parameters (rank 3 of 3, a proof)"  # a and two b


def test_constraints_may_tell_what_the_records_do_not():
    """F/m = 4/3 from the record and F = 2 from the constraint: nobody asks the rank without it."""
    settings = casid.FitSettings(starts=1, constraints=[lambda p: p["F"] - 2.0])
    estimate = casid.identify(push(), both()[:1], settings=settings)
    assert estimate.identifiability.structural == "not checked, as there are constraints"
    assert estimate["F"] == pytest.approx(2.0)
    assert estimate["m"] == pytest.approx(1.5, rel=0.05)


def test_a_model_that_is_not_decided_is_fitted_all_the_same():
    """fmin has no rational differential equation; the estimate says that the rank is open."""
    model = push(lambda u: ca.fmin(u, 50.0))  # never active
    estimate = casid.identify(model, both(), settings=casid.FitSettings(starts=1))
    assert estimate.identifiability.structural.startswith("not decided: ")
    assert "fmin" in estimate.identifiability.structural
    assert estimate["m"] == pytest.approx(1.5, rel=0.05)


def test_samples_play_no_part_in_what_any_data_could_tell():
    """An input at rest is a poor record, not a poor model: the second rank says so, and why."""
    still = casid.Experiment(both()[0].record.with_channel("u", np.zeros(200), "1"), {}, "still")
    experiments = [still, both()[1]]
    told = require_identifiable(push(), experiments)
    assert told == "all parameters (rank 2 of 2, a proof)"
    with pytest.raises(IdentifiabilityError, match="Input u of still is constant") as refusal:
        casid.identify(push(), experiments)
    assert "whatever is recorded" not in str(refusal.value)


def test_out_of_time_is_not_decided_and_never_a_refusal(monkeypatch):
    monkeypatch.setattr(requirement, "TIME_LIMIT", 1e-9)
    told = require_identifiable(ship.nine_parameters().model, ship.experiments(duration=1.0))
    assert told == "not decided within 1e-09 s"


def test_without_time_for_a_closed_form_the_refusal_names_the_group_alone(monkeypatch):
    def slow(*_: object, **__: object) -> None:
        raise IdentifiabilityError("no closed form in time")

    monkeypatch.setattr(requirement, "families", slow)
    with pytest.raises(
        IdentifiabilityError, match="F and m are not separately identifiable: give one"
    ):
        require_identifiable(push(), both()[:1])


# -- prediction errors: noise that drives a state may tell more ------------------------------------


def driven(gain: float | None = None) -> casid.Model:
    """x' = -a x + b u + w, y = c x: without w only b c is told."""
    m = casid.Model("lag")
    x, u = m.state("x", "m"), m.input("u", "N", hold="zoh")
    w = m.unknown_input("w", "N")
    a = m.parameter("a", "1/s", start=1.0, lower=1e-3)
    b = m.parameter("b", "m/(N s)", start=1.5)
    c = m.parameter("c", "1", start=1.0, value=gain)
    m.derivative(x, -a * x + b * u + w * m.constant("one", 1.0, "m/(N s)"))
    m.output("y", c * x, "m")
    return m


def lag(N: int = 600, Ts: float = 0.2) -> casid.Record:
    """a = 1.5, b = 2, c = 1, w of spectral density 0.5, sampled exactly."""
    rng = np.random.default_rng(1)
    F = np.exp(-1.5 * Ts)
    u, w, x = rng.standard_normal(N), rng.standard_normal(N), np.zeros(N)
    spread = np.sqrt(0.5 * (1 - F**2) / 3)
    for t in range(N - 1):
        x[t + 1] = F * x[t] + (1 - F) / 1.5 * 2.0 * u[t] + spread * w[t]
    y = x + 0.45 * rng.standard_normal(N)
    return casid.Record({"u": u, "y": y}, {"u": "N", "y": "m"}, Ts=Ts, name="lag")


def test_process_noise_of_known_size_tells_a_gain_and_the_estimate_says_what_it_rests_on():
    """The size of c w is seen, and that of w is known: prediction errors warn and do not refuse."""
    noise = [White("y", 0.45), White("w", 0.5**0.5, is_known=True)]
    found = minimize_prediction_error(driven(), lag(), noise).estimate
    structural = found.identifiability.structural
    assert structural.startswith("without process noise: ")
    assert "b and c are not separately identifiable, but b*c" in structural
    assert found.identifiability.rank == found.identifiability.unknowns
    for name, truth in {"a": 1.5, "b": 2.0, "c": 1.0}.items():
        assert abs(found[name] - truth) < 4 * found.parameter(name).std_error


def test_process_noise_is_taken_at_its_mean_where_the_rest_is_told():
    noise = [White("y", 0.45), White("w", 0.7)]
    found = minimize_prediction_error(driven(gain=1.0), lag(), noise).estimate
    assert found.identifiability.structural == "all parameters (rank 3 of 3, a proof)"


@pytest.mark.parametrize("given", [{}, {"initial": 90.0}])
def test_a_refusal_names_the_initial_value_that_determines_the_rest(given):
    """A cell's voltage is a parabola of its charge, and no output says from where it began."""
    m = casid.Model("cell")
    charge, drawn = m.state("charge", "%", **given), m.input("I", "A", known=True)
    Q, R = m.constant("Q", 2.5, "A h"), m.parameter("R", "mohm", start=30.0)
    E = [m.parameter(f"E_{i}", "V", start=1.0) for i in range(3)]
    m.balance(charge, "cell", inertia=Q, terms=[-drawn])
    m.output("U", E[0] + E[1] * charge + E[2] * charge**2 - R * drawn, "V")
    record = casid.Record({"I": np.ones(50), "U": np.ones(50)}, {"I": "A", "U": "V"}, Ts=1.0)
    runs = [casid.Experiment(record, {}, "run")]
    if given:
        assert require_identifiable(m, runs).startswith("all parameters")
        return
    with pytest.raises(IdentifiabilityError, match=r"m.state\('charge', ..., initial=...\)"):
        require_identifiable(m, runs)


def test_no_initial_value_is_named_that_determines_nothing():
    """Two inertias move together from wherever they begin."""
    with pytest.raises(IdentifiabilityError) as refused:
        require_identifiable(two_inertias(), swing())
    assert "initial value" not in str(refused.value)
