"""The joint moment program of the ship from many random starts, and the family it ends on.

The program is (8.68) of Linder (2017) in the eliminated form: the nine physical parameters (8.62)
between the bounds of Table 8.3, corrected (the table lost the minus signs of K_delta, K_r and
zbar_m). Each record enters through its moments alone, relative to the power of its output:

    V = 1/2 sum_i || W_i (Y_i - Phi_i g(theta_p; case i)) ||^2 / mean y_i^2,  W' W = Z^-1     (1)

How a start is used: it is drawn uniformly between the bounds and handed to Ipopt as it is, which
moves it inwards where it lies within a hundredth of the range to a bound; there is no multistart,
no linear fit and no selection. Ipopt steps until its own test is met or `allowed` iterations are
spent; where that point is no optimum by casid's measure, it goes on from there. A flat direction
keeps Ipopt's own test from being met: points on the family are all optimal, and its barrier
drifts along them.

Some starts have A_2 < 0 (8.18): light hulls that turn about an axis far below them. Every
coefficient has a pole at A_2 = 0, and a few of these runs end beyond it, in the corner of the
bounds where A_2 is most negative, a true local optimum. Their sign is known to be wrong without
the truth: K_delta <= 0 and gamma1 = K_delta/A_2 < 0, which the linear fit sees, leave A_2 > 0. Such
a run is mirrored where it ended, A_x raised until A_2 has the other sign in every record, and goes
on from there (`Ends.mirrored` counts them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from time import process_time
from typing import Any

import numpy as np

from analysis.identifiability_tables.models import ship_family
from analysis.ship_initial_values.records import TS, Integrator, instruments, of_case, record
from casid.arrays import Array
from casid.estimation.cross_moments.moments import moments
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.moments.equations.moment_nlp import Condensed, PhysicalNlp
from casid.estimation.nlp.solution import Solution
from casid.estimation.nlp.solver import Solver
from casid.linear.sampled.difference_equation import DifferenceEquation, difference_equation
from problems.ship import LOAD_CASES, NINE, TABLE_8_2, indirect_model

BOUNDS = {
    "k": (0.0, 100.0),
    "A_x": (0.0, 100.0),
    "d": (0.0, 100.0),
    "K_r": (-10.0, 0.0),
    "K_vdot": (0.0, 10.0),
    "K_delta": (-1.0, 0.0),
    "z_f": (-1.0, 1.0),
    "m": (0.0, 1.0),
    "zbar_m": (-0.5, 0.0),
}
"""Table 8.3 with the minus signs that its lower row lost."""

ONWARD = 200
"""Iterations of a run that goes on from where it stopped."""

ONE_CALIBRATION = ("nominal", "calibration", "loaded")
TWO_CALIBRATIONS = ("nominal", "calibration", "second calibration", "loaded")


@dataclass(frozen=True, slots=True)
class Setting:
    """One program: which records it sees, what is fixed at the truth, how long Ipopt may take."""

    cases: tuple[str, ...] = ONE_CALIBRATION
    fixed: tuple[str, ...] = ()
    allowed: int = 300
    integrator: Integrator = "trapezoidal"
    finer: int = 1  # samples in each 0.02 s
    lifted: bool = False  # the coefficients are variables too, their formulas constraints

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters that are sought."""
        return tuple(n for n in NINE if n not in self.fixed)


@cache
def equation(finer: int = 1) -> DifferenceEquation:
    """(8.57) at 0.02 s / `finer`, derived by casid from the roll subsystem."""
    return difference_equation(indirect_model(), "gyro", TS / finer)


def true_values(case: str) -> dict[str, float]:
    """Every parameter's true value in a load case."""
    return TABLE_8_2 | of_case(case)


def theta(values: Mapping[str, float], finer: int = 1) -> Array:
    """(5,) coefficients of (8.57) at these values of all parameters."""
    e = equation(finer)
    return np.asarray(e.g([values[n] for n in e.parameters])).ravel()


@cache
def equations(case: str, integrator: Integrator = "trapezoidal", finer: int = 1) -> MomentEquations:
    """The moments of one record with the instruments of section 8.6, taken once."""
    signals = record(case, integrator=integrator, finer=finer)
    return MomentEquations.from_moments(
        equation(finer), moments(signals, 18), instruments(), name=case
    )


@cache
def condensed(case: str, integrator: Integrator = "trapezoidal", finer: int = 1) -> Condensed:
    """What (1) sees of a record: five equations."""
    e = equations(case, integrator, finer)
    return Condensed.of(e, e.whitener() / np.sqrt(e.second[0, 0]))


def inertia(values: Mapping[str, float]) -> float:
    """A_2 [kg m^2] of (8.18)."""
    v = values
    z_g, z_m, z_s = (v[n] + v["z_f"] for n in ("zbar_g", "zbar_m", "zbar_s"))
    weights = v["M"] * z_g * (z_g - z_s) + v["m"] * z_m * (z_m - z_s)
    return v["A_x"] + weights - v["K_vdot"] * z_s


class Program:
    """(1) for one setting, built once."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.data = [condensed(c, setting.integrator, setting.finer) for c in setting.cases]
        self.known = [frozenset(LOAD_CASES[c]) for c in setting.cases]
        self.values = [TABLE_8_2 | LOAD_CASES[c] for c in setting.cases]
        model = indirect_model()
        # The solver's unit of a parameter is half its largest value: nothing is known of its size.
        self.parameters = [
            replace(
                model.parameters[n],
                value=None,
                lower=BOUNDS[n][0],
                upper=BOUNDS[n][1],
                start=max(BOUNDS[n], key=abs) / 2,
            )
            for n in setting.free
        ]
        self._programs: dict[int, PhysicalNlp] = {}

    def nlp(self, allowed: int) -> PhysicalNlp:
        """The program with this many iterations."""
        if allowed not in self._programs:
            # A barrier that only falls: the adaptive one sends more runs on detours.
            options: dict[str, Any] = {"ipopt.mu_strategy": "monotone"}
            if allowed == ONWARD:  # Ipopt thinks itself done where the cost is merely small
                options |= {"ipopt.tol": 1e-13, "ipopt.acceptable_iter": 0, "ipopt.mu_init": 1e-6}
            solver = Solver("ipopt", max_iterations=allowed, options=options)
            e = equation(self.setting.finer)
            self._programs[allowed] = PhysicalNlp(
                [e] * len(self.data),
                self.parameters,
                self.known,
                lifted=self.setting.lifted,
                solver=solver,
                name="section 8.6",
            )
        return self._programs[allowed]

    def at(self, x: Sequence[float] | Array) -> list[dict[str, float]]:
        """All parameters of each record, the free ones (n,) at x."""
        found = dict(zip(self.setting.free, map(float, x), strict=True))
        return [
            v | {n: w for n, w in found.items() if n not in known}
            for v, known in zip(self.values, self.known, strict=True)
        ]

    def coefficients(self, x: Sequence[float] | Array) -> Array:
        """(5 records,) what is identifiable: the coefficients of every record at x."""
        return np.concatenate([theta(v, self.setting.finer) for v in self.at(x)])

    @cached_property
    def true_coefficients(self) -> Array:
        """The coefficients of every record at the truth."""
        return np.concatenate([theta(true_values(c), self.setting.finer) for c in self.cases])

    @property
    def cases(self) -> tuple[str, ...]:
        """The records."""
        return self.setting.cases

    def slopes(self, x: Sequence[float] | Array) -> Array:
        """(5 records, n) derivatives of the coefficients by the free parameters."""
        e = equation(self.setting.finer)
        rows = []
        for v, known in zip(self.at(x), self.known, strict=True):
            J = np.asarray(e.jacobian([v[n] for n in e.parameters])[1])
            columns = [J[:, e.parameters.index(n)] * (n not in known) for n in self.setting.free]
            rows.append(np.column_stack(columns))
        return np.vstack(rows)

    def residual(self, x: Sequence[float] | Array) -> Array:
        """(5 records,) the vector whose square is 2 V, less what nothing can fit."""
        parts = np.split(self.coefficients(x), len(self.cases))
        return np.concatenate([d.left - d.right @ t for d, t in zip(self.data, parts, strict=True)])

    def residual_slopes(self, x: Sequence[float] | Array) -> Array:
        """(5 records, n) its derivatives."""
        parts = np.split(self.slopes(x), len(self.cases))
        return np.vstack([-d.right @ J for d, J in zip(self.data, parts, strict=True)])

    def inertias(self, x: Sequence[float] | Array) -> Array:
        """(records,) A_2 of (8.18) at x."""
        return np.array([inertia(v) for v in self.at(x)])

    def solve(self, start: Array) -> tuple[Solution, int, bool]:
        """Where a run from `start` (n,) ends, its iterations, and whether it was mirrored."""
        first = self.nlp(self.setting.allowed)
        solution = first.solve(self.data, self.values, start.tolist(), throw=False)
        spent = solution.iterations
        if not solution.is_converged:
            onward, reached = self.nlp(ONWARD), solution.x[: len(start)]
            solution = onward.solve(self.data, self.values, reached.tolist(), throw=False)
            spent += solution.iterations
        end = solution.x[: len(start)].copy()
        wrong = float(np.min(self.inertias(end)))
        if wrong >= 0 or "A_x" not in self.setting.free or self.setting.lifted:
            return solution, spent, False
        end[self.setting.free.index("A_x")] -= 2 * wrong
        solution = self.nlp(ONWARD).solve(self.data, self.values, end.tolist(), throw=False)
        return solution, spent + solution.iterations, True


@cache
def program(setting: Setting) -> Program:
    """Built once in every process."""
    return Program(setting)


def starts(setting: Setting, n: int, seed: int = 86) -> Array:
    """(n, parameters) uniform within the bounds; those of a parameter that is fixed are dropped."""
    low, high = np.array([BOUNDS[p] for p in NINE]).T
    drawn = np.random.default_rng(seed).uniform(low, high, (n, len(NINE)))
    return drawn[:, [p in setting.free for p in NINE]]


@dataclass(frozen=True, slots=True, eq=False)
class Ends:
    """Where runs ended.

    Attributes
    ----------
    x : (n, parameters), in the order of `setting.free`.
    V : (n,) the cost (1) there.
    distance : (n,) largest error of an identifiable coefficient.
    iterations : (n,); is_optimal : (n,) by casid's measure; status : Ipopt's own word.
    mirrored : (n,) ended beyond the pole A_2 = 0 first.
    seconds : of processor time, of all processes together.
    """

    setting: Setting
    x: Array
    V: Array
    distance: Array
    iterations: Array
    is_optimal: Array
    status: tuple[str, ...]
    mirrored: Array
    seconds: float

    def __getitem__(self, name: str) -> Array:
        if name not in self.setting.free:
            return np.full(len(self.x), TABLE_8_2[name])
        return np.asarray(self.x[:, self.setting.free.index(name)])

    @property
    def nine(self) -> Array:
        """(n, 9) all of `NINE`."""
        return np.column_stack([self[n] for n in NINE])

    def relative_error(self) -> Array:
        """(n,) of the worst of the nine."""
        truth = np.array([TABLE_8_2[n] for n in NINE])
        return np.asarray(np.max(np.abs(self.nine / truth - 1), axis=1))


def _solved(setting: Setting, chosen: Array) -> tuple[list[tuple[Solution, int, bool]], float]:
    """Where runs from these starts end, and the processor time of them all [s]."""
    began = process_time()
    return [program(setting).solve(s) for s in chosen], process_time() - began


def run(setting: Setting, n: int, *, jobs: int = 1, seed: int = 86) -> Ends:
    """Solve from n random starts, all of them."""
    from joblib import Parallel, delayed, parallel_config

    pieces = np.array_split(starts(setting, n, seed), max(1, min(8 * jobs, n)))
    with parallel_config(backend="loky", inner_max_num_threads=1):
        parts = Parallel(n_jobs=jobs)(delayed(_solved)(setting, piece) for piece in pieces)
    solutions, iterations, mirrored = zip(*(r for found, _ in parts for r in found), strict=True)
    p = program(setting)
    x = np.array([s.x[: len(setting.free)] for s in solutions])
    return Ends(
        setting,
        x,
        V=np.array([s.value for s in solutions]),
        distance=np.array([np.max(np.abs(p.coefficients(e) - p.true_coefficients)) for e in x]),
        iterations=np.array(iterations),
        is_optimal=np.array([s.is_converged for s in solutions]),
        status=tuple(s.status for s in solutions),
        mirrored=np.array(mirrored),
        seconds=sum(seconds for _, seconds in parts),
    )


def trust_region(setting: Setting, n: int, seed: int = 86) -> Array:
    """(n, parameters) where scipy's bounded trust-region least squares ends from the same starts.

    A second optimiser, with no barrier that prefers one point of a flat curve to another.
    """
    from scipy.optimize import least_squares

    p = program(setting)
    low, high = np.array([BOUNDS[name] for name in setting.free]).T
    out = []
    for start in starts(setting, n, seed):
        found = least_squares(
            p.residual, start, p.residual_slopes, bounds=(low, high), x_scale=(high - low) / 2,
            ftol=None, xtol=1e-15, gtol=1e-15, max_nfev=400,
        )  # fmt: skip
        out.append(found.x)
    return np.array(out)


# -- the family ------------------------------------------------------------------------------------

SLOPES = {
    "k": -238.0,
    "A_x": -0.0618,
    "d": -1.0335,
    "K_r": 2.5,
    "K_vdot": -19.45,
    "K_delta": 2.025,
    "z_f": 1.0,
    "m": -0.0952,
    "zbar_m": 0.0,
}
"""d/dz_f along the family at the truth."""


def family(z_f: Array) -> dict[str, Array]:
    """The nine parameters that have the data of the truth, by their height of the roll axis (n,).

    With lam = (zbar_c + z_f')/(zbar_c + z_f), all torques scale by lam; what the calibration weight
    would distinguish, it determines only through the ratio that is known beforehand.
    """
    values = TABLE_8_2 | {"zbar_c": LOAD_CASES["calibration"]["zbar_m"]}
    members = ship_family(values, np.asarray(z_f, dtype=np.float64))
    return {name: np.broadcast_to(x, np.shape(z_f)) for name, x in members.items()}


def admissible() -> tuple[float, float]:
    """The heights z_f [m] between which the family lies within the bounds."""
    z = np.linspace(-0.16, 0.1, 260_001)
    members = family(z)
    inside = np.all([(members[n] >= b[0]) & (members[n] <= b[1]) for n, b in BOUNDS.items()], 0)
    return float(z[inside].min()), float(z[inside].max())
