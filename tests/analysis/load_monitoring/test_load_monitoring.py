"""The study of load monitoring: its sea, its calibration, and one load that comes aboard."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.load_monitoring import study
from analysis.load_monitoring.records import (
    ABOARD,
    HS,
    PERIOD,
    TS,
    Calibration,
    calibrate,
    calm_path,
    spectrum,
    wave_forces,
)
from casid.estimation.cross_moments.gram import Moments
from problems import ship
from problems.ship_simulator.waves import G, WaveLoads, variance


@pytest.fixture(scope="module")
def calibrated() -> tuple[Calibration, list[Moments]]:
    found = calibrate()
    return found, found.stream([(ABOARD, 1200.0 + study.SETTLE)], seed=11)


def test_a_zigzag_in_calm_water_repeats_itself() -> None:
    """The advance of a period is along the mean heading, by symmetry of port and starboard."""
    path = calm_path()
    assert path.x.size == round(PERIOD / TS) + 1
    assert path.psi[-1] == pytest.approx(path.psi[0], abs=1e-6)
    course = math.atan2(path.y[-1], path.x[-1])
    assert course == pytest.approx(float(path.psi[:-1].mean()), abs=1e-6)


def test_pieces_of_one_sea_fit_together() -> None:
    whole = wave_forces(0, 40, seed=3)
    pieces = [wave_forces(0, 25, seed=3), wave_forces(25, 15, seed=3)]
    assert np.concatenate(pieces) == pytest.approx(whole, abs=1e-12)


def test_one_set_of_waves_fades_into_the_next_without_a_step() -> None:
    """Steps of the torque between samples are nowhere much larger than elsewhere."""
    K = wave_forces(25, 10, seed=3)[:, 2]
    steps = np.abs(np.diff(K))
    edge = 5 * round(PERIOD / TS) - 1
    assert steps[edge] < 5.0 * float(np.sqrt(np.mean(steps**2)))


def test_the_slope_of_the_sea_has_the_variance_of_its_spectrum() -> None:
    """Var of the roll torque at beta = 90 deg: c_K^2 int kappa^2 exp(-2 kappa depth) S dw.

    The heading swings by +-50 deg, so the mean of sin^2 of the angle to the waves comes on top.
    Gaussian amplitudes: 6 sets of 200 waves, of which some 60 carry the slope: 15 % is 3 sigma.
    """
    loads, own = WaveLoads(), spectrum()
    K = wave_forces(0, 180, seed=4, beta=math.pi / 2)[:, 2]

    def slope(w: np.ndarray) -> np.ndarray:
        kappa = w**2 / G
        return np.asarray(kappa**2 * np.exp(-2.0 * kappa * loads.depth) * own(w))

    path = calm_path()
    sine = np.sin(math.pi / 2 + path.psi[:-1].mean() - path.psi[:-1])
    wanted = loads.c_K**2 * variance(slope, (0.5 * own.w0, 3.0 * own.w0)) * np.mean(sine**2)
    assert np.var(K) == pytest.approx(wanted, rel=0.15)
    assert 4.0 * math.sqrt(variance(own, (0.1, 100.0))) == pytest.approx(0.988 * HS, rel=2e-3)


def test_the_margin_and_GM_are_those_of_the_ship() -> None:
    """(k + S g) of the roll subsystem over the weight is the slope of GZ at zero heel."""
    for added in (0.0, 0.2, 0.6):
        load = study.with_more(added)
        values = {**ship.TABLE_8_2, "m": load.m, "zbar_m": load.zbar_m}
        wanted = study.truth(load)
        assert study.metacentric_height(values) == pytest.approx(wanted["GM"], rel=1e-9)
        assert study.margin(values) == pytest.approx(wanted["k + S g"], rel=1e-9)


@pytest.mark.slow
def test_the_height_of_the_axis_costs_k_its_certainty_as_the_family_says(
    calibrated: tuple[Calibration, list[Moments]],
) -> None:
    """Along the family of equivalent parameters dk/dz_f = -238 N/rad at the truth (section 8.6)."""
    known = calibrated[0].known
    names, covariance = tuple(known.values), known.matrix()
    k, z_f = names.index("k"), names.index("z_f")
    assert covariance[k, z_f] / covariance[z_f, z_f] == pytest.approx(-238.0, rel=0.05)


@pytest.mark.slow
def test_a_load_of_one_percent_is_noticed_within_five_minutes(
    calibrated: tuple[Calibration, list[Moments]],
) -> None:
    """0.2 kg on 22 kg; no alarm in the 20 minutes before, where 0.003 are expected."""
    found, reference = calibrated
    legs = [(ABOARD, study.BEFORE + study.SETTLE), (study.with_more(0.2), 300.0)]
    watched = study.watched(found, reference, legs, seed=100)
    assert [a.kind for a in watched.alarms] == ["change"]
    alarm = watched.alarms[0]
    assert study.BEFORE < alarm.time <= study.BEFORE + 300.0
    before, after = study.truth(ABOARD), study.truth(study.with_more(0.2))
    last = watched.status[-1]
    for name in ("m", "k + S g", "GM"):
        # three standard errors, so that one seed in 400 fails for one name
        assert alarm.before[name].value == pytest.approx(
            before[name], abs=3.0 * alarm.before[name].std_error
        )
        assert last[name].value == pytest.approx(after[name], abs=3.0 * last[name].std_error)
    # the margin itself moves by 0.39 N m/rad, more than its interval
    assert alarm.before["k + S g"].value - last["k + S g"].value > 0.25


def test_alarms_at_another_rate_wait_until_the_detector_has_learnt() -> None:
    times = PERIOD * np.arange(100.0)
    p = np.ones(100)
    p[[10, 11, 50]] = 1e-6
    assert study.alarm_times((times, p), 1e-3) == [200.0, 1000.0]
    assert study.alarm_times((times, p), 1e-9) == []
