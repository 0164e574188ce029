"""The static examples of Linder (2017), chapter 3 and Example 4.2, through the general machinery.

    python -m analysis.static_examples [--quick] [--out DIR] [--runs N]

- Every estimator of Examples 3.1-3.10 and 4.2: symbolic limit and covariance, beside the closed
  form of the thesis (errata applied), and beside a Monte Carlo.
- The remedies side by side on the benchmark, with the number of samples each needs.
- Figure 3.5: where measuring the unknown input with errors beats neglecting it, in variance and in
  mean square error, with the thresholds 1.618 and 0.618, and for other numbers.
- The same comparison for a dynamic system.

Targets are the closed forms themselves; Monte Carlo distances are in its own standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import brentq

from analysis.common.output import Output
from analysis.common.runner import Run, Study, runs
from analysis.common.targets import Target, near
from analysis.static_examples.figures import UNIT, figure_3_5, pair
from analysis.static_examples.formulas import FORMS, TRUTH, ClosedForm
from analysis.static_examples.runs import beside_theory, draws
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedies import compare_remedies
from problems.static_input import VALUES, signals

SAMPLE = {**VALUES, "a1": 0.5, "a2": 1.2}
PRINTED: dict[tuple[str, str], float] = {
    ("3.8 two stages, first known, beta = 0", "bK"): 1.0230,
    ("3.8 two stages, first estimated, beta = 0", "bK"): 0.9174,
    ("3.9 errors in variables, LS", "bK"): 0.565771,
    ("3.9 errors in variables, LS", "bU"): 0.325156,
    ("3.10 errors in variables, IV", "bK"): 0.9174,
    ("3.10 errors in variables, IV", "bU"): 0.926667,
    ("3.3 neglect, LS", "bK"): 0.655875,
}
"""Variances of the numeric sample, evaluated from the closed forms to six digits."""


def difference(form: ClosedForm, found: Asymptotics) -> Any:
    """Sum of the differences between computed and closed form; 0 where they agree."""
    put = {sp.Symbol(k): v for k, v in form.special.items()}
    left = [found[n] - v for n, v in form.limit.items()]
    for (n, m), v in form.covariance.items():
        left.append(found.covariance[found.names.index(n), found.names.index(m)] - v)
    return sum(abs(sp.simplify(sp.sympify(e).subs(put))) for e in left)


def examples(out: Output, runs: int) -> Iterator[Target]:
    """Formulas beside formulas, numbers beside numbers."""
    system = signals().with_signals({"delta1 + delta2": "delta1 + delta2"})
    rows: list[dict[str, Any]] = []
    worst = {"limit": 0.0, "variance": 0.0}
    count, N = 0, 1000
    for form in FORMS:
        at = system.at(form.special) if form.special else system
        found = regression_limit(at, form.regression)
        left = difference(form, found)
        yield Target(f"{form.example}: minus {form.equations}", str(left), "0", left == 0)
        sample = {k: float(v) for k, v in {**SAMPLE, **form.special}.items()}
        numbers = found.at({k: v for k, v in sample.items() if k not in form.special})
        simulated = beside_theory(form, numbers, draws(sample, runs, N), sample["alpha"])
        for i, name in enumerate(found.names):
            P = numbers.variance(name)
            mean, variance = simulated.mean[i], simulated.sd[i] ** 2
            row = {"example": form.example, "coefficient": name}
            row |= {"formula of the limit": found[name], "formula of N var": found.variance(name)}
            row |= {"limit": numbers[name], "N var": P}
            row |= {"Monte Carlo mean": mean, "Monte Carlo N var": variance}
            row |= {"mean off [s.e.]": simulated.mean_off[i]}
            rows.append(row | {"variance off [s.e.]": simulated.variance_off[i]})
            print(
                f"    {name}: limit {numbers[name]:.5f} (simulated {mean:.5f}), N var "
                f"{P:.5f} ({variance:.5f})"
            )
            worst["limit"] = max(worst["limit"], abs(simulated.mean_off[i]))
            worst["variance"] = max(worst["variance"], abs(simulated.variance_off[i]))
            count += 1
            if (form.example, name) in PRINTED:
                wanted = PRINTED[form.example, name]
                yield near(f"{form.example}: N var of {name}", P, wanted, 2e-6, "")
    out.table("examples", rows)
    # The largest of so many normal distances stays below this in 99 of 100 studies.
    limit = math.sqrt(2) * float(sp.erfinv(1 - 0.01 / count))
    for what, found_off in worst.items():
        text = f"{found_off:.2f} s.e. of {runs} runs"
        what = f"Monte Carlo, farthest {what} of {count}"
        yield Target(what, text, f"<= {limit:.2f}", found_off <= limit)


def remedies(out: Output) -> Iterator[Target]:
    """The benchmark's remedies, symbolic and numeric, beta = 0 and not."""
    compared = compare_remedies(
        signals().at({"beta": 0}), "y_O", {"bK": "u_K", "bU": "u_U"}, "u_U", TRUTH,
        known=["delta1", "delta2"], approximations={"u_U": "u_hat"},
        explain=[["delta2"], ["delta1", "delta2"]], measured={"u_U": "y_U"},
        eliminated={"u_U": "u_I"}, accuracy=0.05,
    )  # fmt: skip
    print(compared, "\n")
    numbers = compared.at({k: v for k, v in SAMPLE.items() if k != "beta"})
    print(numbers, "\n")
    out.table("remedies_in_letters", compared.table())
    out.table("remedies", numbers.table())
    out.figure("remedies", numbers.plot())
    known = numbers["predict from y_U, first stage known"].variance("bK")
    estimated = numbers["predict from y_U, two-stage"].variance("bK")
    wanted = (0.3 + 0.64 * 0.4) / (0.3 + 0.64 * 0.5)
    yield near("two stages: variance estimated / known, E-4", estimated / known, wanted, 1e-9, "")
    with_loop = compare_remedies(
        signals().at(SAMPLE), "y_O", {"bK": "u_K", "bU": "u_U"}, "u_U",
        {"bK": SAMPLE["bK"], "bU": SAMPLE["bU"]}, known=["delta1", "delta2"], explain=[],
        measured={"u_U": "y_U"}, accuracy=0.05,
    )  # fmt: skip
    print(with_loop, "\n")
    best = with_loop.best("bK")
    found = "none" if best is None else best.remedy
    # tau_u moves u_K: a prediction without it is biased, (3.49), instruments are not.
    yield Target("beta = 0.4: best for bK", found, "measure y_U, IV", found == "measure y_U, IV")


def maps(out: Output, points: int) -> Iterator[Target]:
    """Figure 3.5 and its thresholds."""
    s, le = np.linspace(0.02, 2.5, points), np.linspace(0.02, 6.0, points)
    for name, values in (
        ("figure_3_5", UNIT),
        ("figure_3_5_sample", {k: float(SAMPLE[k]) for k in UNIT}),
    ):
        drawn, figure = figure_3_5(values, s, le)
        out.figure(name, figure)
        X, Y = np.meshgrid(s, le)
        C1 = values["alpha"] ** 2 * values["lO"] * values["l1"]
        C2, C3 = values["bU"] ** 2, values["alpha"] ** 2 * values["bU"] ** 2 * values["l1"]
        closed = C1 * X - C2 * X**3 + Y * (C1 + C3 * X - C2 * X**2)
        off = int(np.sum((closed < 0) != (drawn.variance < 0)))
        yield Target(f"{name}: points off (3.58)", f"{off} of {X.size}", "0", off == 0)
        if values is UNIT:
            area = [float(np.mean(drawn.regions == k)) for k in range(4)]
            print(f"    shares of the map: neither {area[0]:.3f}, variance {area[1]:.3f}, "
                  f"mean square error {area[2]:.3f}, both {area[3]:.3f}")  # fmt: skip
    measuring, neglecting = pair()
    put = {sp.Symbol(k): v for k, v in UNIT.items()}
    S, E = sp.symbols("s le")
    variance = (measuring.variance("bK") - neglecting.variance("bK")).subs(put)
    amse = sp.simplify((measuring.amse("bK") - neglecting.amse("bK")).subs(put))
    left = sp.simplify(amse + (S**2 + S - 1) / (S + E))
    yield Target("AMSE difference + (s^2 + s - 1)/(s + le)", str(left), "0", left == 0)
    far = sp.lambdify(S, sp.limit(E * variance, E, sp.oo))  # its sign for a useless sensor
    golden = brentq(far, 1.2, 2.0, xtol=1e-14)
    yield near("variance: better for every le above s", golden, (1 + 5**0.5) / 2, 1e-9, "")
    for noise in (0.1, 10.0):
        root = brentq(sp.lambdify(S, amse.subs(E, noise)), 0.3, 1.0, xtol=1e-14)
        yield near(f"AMSE, le = {noise:g}: better above s", root, (5**0.5 - 1) / 2, 1e-9, "")


def with_a_slow_input() -> LinearSignals:
    """A module with an unknown input whose slow part nobody commands; a noisy sensor of it."""
    return LinearSignals.of(
        {
            "u_K": {"r": 1, "w": ([0, 0.6], [1, -0.7])},
            "u_U": {"r": ([0, 0.5], [1]), "w": ([1], [1, -0.8]), "d": 1},
            "y": {"u_K": ([0, 1.0, 0.5], [1]), "u_U": ([0, -0.7], [1]), "tau": ([1, 0.4], [1])},
            "y_U": {"u_U": 1, "e": 1},
        },
        {"r": 1.0, "w": 0.3, "d": 0.4, "tau": 0.2, "e": 0.2},
        Ts=0.1,
    )


def dynamic(out: Output) -> Iterator[Target]:
    """The same comparison for a dynamic system with an autocorrelated unknown input."""
    system = with_a_slow_input()
    compared = compare_remedies(
        system, "y", {"b1": ("u_K", 1), "b2": ("u_K", 2), "c1": ("u_U", 1)}, "u_U",
        {"b1": 1.0, "b2": 0.5, "c1": -0.7}, known=[*lags("r", 1, 3), ("d", 1)], explain=[],
        measured={"u_U": "y_U"}, accuracy=0.03, N=2000,
    )  # fmt: skip
    print(compared, "\n")
    out.table("dynamic", compared.table())
    out.figure("dynamic", compared.plot())
    bias = compared["measure y_U, IV"].bias("c1")
    yield Target("dynamic: bias of instruments in c1", f"{bias:.1e}", "0", abs(bias) < 1e-9)


def study(run: Run) -> Iterator[Target]:
    """All parts in turn."""
    yield from examples(run.output, run.runs(4000, quick=1000))
    yield from remedies(run.output)
    yield from maps(run.output, 101 if run.quick else 301)
    yield from dynamic(run.output)


STUDY = Study(study, quick="fewer runs, a coarser map", options=runs(4000, quick=1000))
