"""NIST StRD nonlinear regression: certified parameters and standard errors of 27 sets.

    python -m analysis.nist [--quick] [--out DIR]

Source: NIST Statistical Reference Datasets, nonlinear regression (certified to 11 digits). Digits
are -log10 of the largest relative error over the parameters of a set, at most 11. Targets: from
start 2 all sets to 6 digits in the parameters and 4 in the standard errors (3 for Lanczos1, whose
residual is rounding: rss 1e-25 of data near 1); from start 1 at least 26 of 27.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from analysis.common.runner import Run, Study, shared_folder
from analysis.common.targets import Target
from casid.arrays import Array
from casid.errors import CasidError
from casid.estimation.nlp.solver import Solver
from casid.estimation.regression.regression import regress
from casid.estimation.regression.regression_estimate import RegressionEstimate
from casid.model.expressions import parse

STARTS = ("start1", "start2")
PARAMETER_DIGITS = 6.0
ERROR_DIGITS = 4.0
LANCZOS1_ERROR_DIGITS = 3.0
SETS_FROM_START_1 = 26


@dataclass(frozen=True)
class Case:
    """One set: model, data and certified answer."""

    name: str
    level: str
    model: str  # "response ~ prediction"
    data: dict[str, Array]
    starts: dict[str, dict[str, float]]
    certified: dict[str, float]
    std_errors: dict[str, float]
    rss: float
    residual_sd: float

    @property
    def error_digits(self) -> float:
        """Digits wanted of the standard errors."""
        return LANCZOS1_ERROR_DIGITS if self.name == "Lanczos1" else ERROR_DIGITS

    def fit(self, start: str, solver: Solver | None = None) -> RegressionEstimate:
        """casid's estimate from one of NIST's two starts."""
        return regress(self.model, self.data, self.starts[start], solver=solver)

    def fit_scipy(self, start: str) -> tuple[Array, bool]:
        """MINPACK's Levenberg-Marquardt with the exact Jacobian: (theta, success)."""
        from scipy.optimize import least_squares

        theta0 = list(self.starts[start].values())
        residual, jacobian = self._residual
        with np.errstate(all="ignore"):
            try:
                result = least_squares(
                    residual, theta0, jac=jacobian, method="lm", x_scale="jac",
                    xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=2000,
                )  # fmt: skip
            except ValueError:  # not finite at the start
                return np.full(len(theta0), np.nan), False
        return np.asarray(result.x), bool(result.success)

    @cached_property
    def _residual(self) -> tuple[Any, Any]:
        theta = ca.SX.sym("theta", len(self.certified))
        symbols = dict(zip(self.certified, ca.vertsplit(theta), strict=True))
        columns = {name: ca.SX.sym(name) for name in self.data}
        left, right = (parse(s, {**symbols, **columns}) for s in self.model.split("~"))
        row = ca.vertcat(*columns.values())
        one = ca.Function("r", [theta, row], [right - left, ca.jacobian(right - left, theta).T])
        table = np.array(list(self.data.values()))
        every = one.map("r_all", "serial", table.shape[1], [0], [])
        return (
            lambda p: np.array(every(p, table)[0]).ravel(),
            lambda p: np.array(every(p, table)[1]).T,
        )


def read_model(lines: Sequence[str]) -> str:
    """NIST's model lines as ``response ~ prediction``: without the error term and "pi = ..."."""
    text = " ".join(line for line in lines if not line.startswith("pi"))
    response, prediction = text.split("=", 1)
    prediction = re.sub(r"[+]\s*e\s*$", "", prediction)
    return f"{response.strip()} ~ {prediction.strip()}"


def cases(folder: Path) -> Iterator[Case]:
    """All sets of the folder that holds ``nist_strd_nonlinear.json``, in its order."""
    sets = json.loads((folder / "nist_strd_nonlinear.json").read_text())["sets"]
    for name, entry in sets.items():
        with (folder / f"{name}.csv").open(encoding="utf-8") as file:
            columns = file.readline().strip().split(",")
            table = np.loadtxt(file, delimiter=",")
        parameters: dict[str, dict[str, float]] = entry["parameters"]
        yield Case(
            name=name,
            level=entry["difficulty"].split()[0],
            model=read_model(entry["model_lines"]),
            data=dict(zip(columns, table.T, strict=True)),
            starts={s: {p: v[s] for p, v in parameters.items()} for s in STARTS},
            certified={p: v["certified"] for p, v in parameters.items()},
            std_errors={p: v["std"] for p, v in parameters.items()},
            rss=entry["rss"],
            residual_sd=entry["residual_sd"],
        )


def digits(values: Sequence[float] | Array, certified: Sequence[float]) -> float:
    """-log10 of the largest relative error, within 0 and 11."""
    error = np.max(np.abs(np.asarray(values) / np.asarray(certified) - 1.0))
    return float(np.clip(-np.log10(max(error, 1e-11)), 0.0, 11.0)) if np.isfinite(error) else 0.0


@dataclass(frozen=True)
class Row:
    """One set from one start, as printed."""

    set: str
    level: str
    start: str
    parameter_digits: float
    error_digits: float
    error_target: float
    iterations: int
    hessian: str
    status: str
    sqpmethod_digits: float | None = None
    scipy_digits: float | None = None

    @property
    def is_met(self) -> bool:
        return self.parameter_digits >= PARAMETER_DIGITS and self.error_digits >= self.error_target


def measure(case: Case, start: str, *, compare: bool = False) -> Row:
    """Fit one set from one start; a refusal becomes a row of zero digits with its message."""
    wanted = list(case.certified.values())
    others: dict[str, Any] = {}
    if compare:
        others["scipy_digits"] = digits(case.fit_scipy(start)[0], wanted)
        try:
            others["sqpmethod_digits"] = digits(case.fit(start, Solver("sqpmethod")).values, wanted)
        except CasidError:
            others["sqpmethod_digits"] = 0.0
    try:
        fit = case.fit(start)
        reached = digits(fit.values, wanted)
        of_errors = digits(fit.std_errors, list(case.std_errors.values()))
        how = fit.iterations, fit.hessian, fit.status
    except CasidError as error:
        reached, of_errors, how = 0.0, 0.0, (0, "", str(error))
    return Row(case.name, case.level, start, reached, of_errors, case.error_digits, *how, **others)


def table(rows: Sequence[Row]) -> str:
    """The rows as text, targets beside the numbers."""
    lines = [
        "set       level    start   digits of b (>= 6)  of s.e. (target)  iterations  Hessian kept"
        "  sqpmethod  scipy lm  status"
    ]
    for r in rows:
        sqp, lm = (
            f"{d:.1f}" if d is not None else "--" for d in (r.sqpmethod_digits, r.scipy_digits)
        )
        lines.append(
            f"{r.set:9} {r.level:7}  {r.start}  {r.parameter_digits:18.1f}  {r.error_digits:9.2f} "
            f"(>= {r.error_target:.0f})  {r.iterations:10}  {r.hessian:12}  {sqp:>9}  {lm:>8}  "
            f"{r.status}{'' if r.is_met else '   MISSED'}"
        )
    return "\n".join(lines)


def measured(run: Run) -> Iterator[Target]:
    """Print the table; a target for each of NIST's two starts."""
    every = list(cases(shared_folder("data/nist_strd_nonlinear")))
    rows = [measure(c, start, compare=not run.quick) for start in STARTS for c in every]
    print(table(rows))
    for start, wanted in zip(STARTS, (SETS_FROM_START_1, len(every)), strict=True):
        of_start = [r for r in rows if r.start == start]
        met = sum(r.is_met for r in of_start)
        found = f"{met} of {len(every)} sets"
        yield Target(f"{start}: certified digits", found, f">= {wanted}", met >= wanted)
        for name in ("sqpmethod", "scipy"):
            others = [getattr(r, f"{name}_digits") for r in of_start]
            if None not in others:
                reached = sum(d >= PARAMETER_DIGITS for d in others)
                print(f"  {name}: {reached} of {len(every)} sets to 6 digits (compared, no target)")
    run.output.table("nist", [asdict(r) | {"is_met": r.is_met} for r in rows])


STUDY = Study(
    measured, quick="leave out the other solvers", out="folder for nist.csv and targets.json"
)
