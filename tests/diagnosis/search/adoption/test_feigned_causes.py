"""A reference that predicts a noisy input is no cause, unless it acts itself."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import wald
from casid.diagnosis.search.adoption.feigned_causes import without_feigned
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.refusals import FEIGNED
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import ROUNDS
from casid.estimation.errors_in_variables.removal import without_input_noise
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.balances.balance_effects import cubic_stiffness, extra_input

ONCE = FitSettings(starts=1)
TS, N, HARDENING = 0.1, 2000, 0.3


def spring() -> casid.Model:
    m = casid.Model("spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh")
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0)
    k = m.parameter("k", "N/m", start=2.0, lower=0.1)
    m.derivative(x, v)
    M = m.parameter("M", "kg", start=1.2, lower=0.1)
    m.balance(v, "forces", inertia=M, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return m


def record(acts: float) -> casid.Record:
    """A hardening spring; the force sensor is noisy, and follows a reference by a lag."""
    rng = np.random.default_rng(4)
    ref = np.repeat(1.2 * rng.standard_normal(N // 10), 10)
    share = 1 - np.exp(-TS / 0.8)
    force = lfilter([0.0, share], [1.0, share - 1.0], ref)

    def motion(t: float, s: np.ndarray) -> tuple[float, float]:
        i = min(int(t / TS), N - 1)
        x, v = s
        return v, force[i] + acts * ref[i] - 0.5 * v - 1.5 * x - HARDENING * x**3

    t = TS * np.arange(N)
    x = solve_ivp(motion, (0.0, t[-1]), [0.2, 0.0], t_eval=t, max_step=TS / 2, rtol=1e-8).y[0]
    return casid.Record(
        {
            "F": force + 0.3 * rng.standard_normal(N),
            "position": x + 0.003 * rng.standard_normal(N),
            "ref": ref,
        },
        {"F": "N", "position": "m", "ref": "N"},
        Ts=TS,
    )


@pytest.mark.parametrize(("acts", "is_cause"), [(0.0, False), (0.2, True)])
def test_what_only_the_bias_of_noise_on_an_input_makes_significant_is_no_cause(
    acts: float, is_cause: bool
) -> None:
    model = spring()
    split = split_records([casid.Experiment(record(acts), {}, "run")], 0.3)
    base, weighing = fit_model(model, split.fitted, ONCE), Weighing(split.fitted)
    search, at = Search(weighing, {"ref": "N"}), weighing.weigh(model, base)
    refine = Refinement(search, split, ONCE, base.criterion.weights, at, base)
    law = search.refitting.refit(at, cubic_stiffness(model, "forces"), HARDENING)
    assert law is not None
    beside = weighing.weigh(law.model, law.fit)
    channel = search.refitting.refit(beside, extra_input(law.model, "forces", "ref", "N"), 0.1)
    assert channel is not None
    placed, fit = refine.with_causes([law, channel], channel.fit)
    causes = [Adopted(c, 0.0, (), at) for c in placed]
    found = refine.reweighed(Adoption((), at, fit), causes, fit)
    assert abs(wald(fit, "b_ref")) > ROUNDS.backward_wald  # significant, by least squares

    correct = partial(without_input_noise, known={})
    left, corrected = without_feigned(refine, found, correct(fit), correct)

    kinds = [a.candidate.effect.kind for a in left.adopted]
    assert kinds == ["cubic_stiffness", *["extra_input"] * is_cause]
    assert [why for _, why in search.refused] == [FEIGNED] * (not is_cause)
    assert corrected.covariance is not None
    i = corrected.fit.criterion.names.index("k_3")
    miss = abs(corrected.fit.values["k_3"] - HARDENING)
    assert miss < 3 * np.sqrt(corrected.covariance[i, i])
