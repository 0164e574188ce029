"""One run of the simulation study 7.5.1: draw the records, estimate, and say how sure.

Approach 7.1 of Linder (2017) in two stages, I_x and d from the nominal record under (7.41), then m
and z_m from the loaded one under (7.47):

- ``ls``: constrained least squares;
- ``iv``: instrumental variables with casid's default weighting. The instruments are simulated with
  the run's least-squares estimate: biased, but near enough, and one pass is spared;
- ``identity``: instrumental variables with Q = I, four lags of yhat and of ashat each, as far as
  the thesis gives; it begins with four lags of the reference and refines three times.

Instruments take F_delta(s) = 1/(0.1 s + 1), where the records have 1/(0.2 s + 1).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any, Literal

import numpy as np

from analysis.pendulum_study.records import INSTRUMENT_LAG, PendulumRecords
from casid.arrays import Array
from casid.estimation.cross_moments.column_products import column_products
from casid.estimation.moments.equations.moment_covariance import moment_covariance
from casid.estimation.moments.equations.parts import Part, parts_of
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.propagation import Propagated, propagate
from casid.estimation.moments.stages.stage import Stage, StageFit
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.identification.moment_estimators import Reusable
from casid.identification.profile_interval import profile
from problems.pendulum import TABLE_7_2, indirect_model

Estimator = Literal["ls", "iv", "identity"]
FREE = ("I_x", "d", "m", "z_m")
THETA = ("a1", "a2", "b0")
STAGES = (StageSpec(("I_x", "d"), ("nominal",)), StageSpec(("m", "z_m"), ("loaded",)))
STARTS = {"I_x": 0.15, "d": 0.1, "m": 0.1, "z_m": -0.2}
LAG = ReferenceFilter.lag(INSTRUMENT_LAG)
AS_GIVEN = Instruments(
    "ref", LAG, initial="reference", n_delta0=4, n_delta=0, n_y=4, n_u=4, reduce=False
)
SETTINGS: dict[Estimator, tuple[Instruments | None, MomentSettings]] = {
    "ls": (None, MomentSettings(form="linear", solver="null space")),
    "iv": (
        Instruments("ref", LAG),
        MomentSettings(form="linear", iterations=0, solver="null space"),
    ),
    "identity": (
        AS_GIVEN,
        MomentSettings(form="linear", weighting="identity", iterations=3, solver="null space"),
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Staged:
    """Both stages of one estimator on one run."""

    stages: tuple[StageFit, StageFit]

    @property
    def values(self) -> Array:
        """(4,) in the order of `FREE`."""
        return np.concatenate([st.theta_p for st in self.stages])

    @property
    def thetas(self) -> Array:
        """(6,) a1, a2, b0 of both stages."""
        return np.concatenate([st.thetas[0] for st in self.stages])

    @property
    def is_at_bound(self) -> bool:
        """True if a parameter stands at the wall of its box."""
        return any(st.solution.at_lower or st.solution.at_upper for st in self.stages)

    def propagated(self) -> Propagated:
        """Covariances, with the first stage's error in the second and without."""
        return propagate(self.stages)


class Bench:
    """The records of one amplitude with the estimators' programs, built once for many runs."""

    def __init__(self, study: PendulumRecords) -> None:
        self.study = study
        self.model = indirect_model().with_unknown(**STARTS).with_known(k=TABLE_7_2["k"])
        self._parts = dict(
            zip(study.cases, parts_of(self.model, study.experiments(0)), strict=True)
        )
        loops: dict[float, Any] = {}
        self._stages = {
            name: [
                Stage(
                    self.model,
                    [part],
                    spec.free,
                    settings,
                    instruments,
                    loops=loops,
                    name=f"{name}, {case}",
                )
                for spec, (case, part) in zip(STAGES, self._parts.items(), strict=True)
            ]
            for name, (instruments, settings) in SETTINGS.items()
        }

    def parts(self, records: Mapping[str, Mapping[str, Array]]) -> dict[str, Part]:
        """The regressions of a run; the arrays stay those of `records`."""
        return {
            case: replace(
                part, signals={c: records[case][c] for c in part.signals}, channels=records[case]
            )
            for case, part in self._parts.items()
        }

    def estimate(
        self, records: Mapping[str, Mapping[str, Array]], estimators: Sequence[Estimator]
    ) -> dict[Estimator, Staged]:
        """What each estimator finds; `iv` begins from `ls`, which is always done."""
        parts = self.parts(records)
        done: dict[Estimator, Staged] = {"ls": self._staged("ls", parts, None)}
        for name in estimators:
            if name != "ls":
                done[name] = self._staged(name, parts, done["ls"] if name == "iv" else None)
        return done

    def _staged(self, name: Estimator, parts: Mapping[str, Part], start: Staged | None) -> Staged:
        fits: list[StageFit] = []
        values: dict[str, float] = {}
        for i, (stage, case) in enumerate(zip(self._stages[name], self.study.cases, strict=True)):
            part = parts[case]
            at = {**part.values, **{k: v for k, v in values.items() if k not in part.known}}
            first = None if start is None else start.stages[i].theta_p
            fits.append(stage.fit([part], [at], first, check=False))
            values |= dict(zip(stage.free, fits[-1].theta_p.tolist(), strict=True))
        return Staged((fits[0], fits[1]))

    def noise_free(self, estimators: Sequence[Estimator]) -> dict[Estimator, Array]:
        """(4,) what each estimator finds in the filtered signals without noise."""
        return {k: e.values for k, e in self.estimate(self.study.clean, estimators).items()}

    def moments(self, found: Staged, parts: Mapping[str, Part]) -> None:
        """The bare sums that least squares and one set of instruments need, for the floor."""
        for fit, part in zip(found.stages, parts.values(), strict=True):
            e = fit.equations[0]
            phi = (e.equation.left, *e.equation.columns)
            signals = {**e.signals, **part.signals}
            start = e.start
            column_products(phi, phi, part.signals, start)
            signals = {k: v[len(v) - e.N - start :] for k, v in signals.items()}
            column_products(e.instruments, phi, signals, start)
            column_products(e.instruments, e.instruments, signals, start)


@functools.lru_cache(maxsize=2)
def bench(amplitude: float, N: int, seed: int, noise: float) -> Bench:
    """The bench of these settings, once a process."""
    return Bench(PendulumRecords(amplitude, N=N, seed=seed, noise=noise))


@dataclass(frozen=True)
class Runs:
    """What a campaign calls: the results of one run as a row.

    Attributes
    ----------
    amplitude, N, seed, noise : of `analysis.pendulum_study.records.PendulumRecords`.
    estimators : which; intervals are computed for all but `ls`.
    every : intervals in every run whose number is a multiple of this, NaN in the others.
    """

    amplitude: float
    N: int = 150_000
    seed: int = 1
    noise: float = 0.01
    estimators: tuple[Estimator, ...] = ("ls", "iv")
    every: int = 1

    @property
    def bench(self) -> Bench:
        """Records and programs, shared by all runs of a process."""
        return bench(self.amplitude, self.N, self.seed, self.noise)

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, Any]:
        """Estimates, standard errors (propagated, and by the stage alone), linear parameters."""
        own = self.bench
        records = own.study.draw(own.study.generator(seed))
        has_intervals = int(seed.spawn_key[-1]) % self.every == 0
        return row_of(own.estimate(records, self.estimators), has_intervals)


def row_of(found: Mapping[Estimator, Staged], has_intervals: bool) -> dict[str, Any]:
    """One flat row: `iv.m`, `iv.m.std_error`, `iv.m.own`, `iv.b0.loaded`, `iv.at_bound`, ..."""
    row: dict[str, Any] = {}
    for name, staged in found.items():
        row |= {f"{name}.{p}": float(v) for p, v in zip(FREE, staged.values, strict=True)}
        names = [f"{t}.{case}" for case in PendulumRecords.cases for t in THETA]
        row |= {f"{name}.{t}": float(v) for t, v in zip(names, staged.thetas, strict=True)}
        row[f"{name}.at_bound"] = staged.is_at_bound
        if name == "ls":
            continue
        wide, own, p_value = np.full(4, np.nan), np.full(4, np.nan), np.nan
        if has_intervals:
            p = staged.propagated()
            wide, own = np.sqrt(np.diag(p.covariance)), np.sqrt(np.diag(p.own))
            p_value = p.p_value
        for parameter, a, b in zip(FREE, wide.tolist(), own.tolist(), strict=True):
            row |= {f"{name}.{parameter}.std_error": a, f"{name}.{parameter}.own": b}
        row[f"{name}.p_value"] = p_value
    return row


def sampled(found: Staged, rng: np.random.Generator, draws: int) -> Array:
    """The estimator on resampled moments, (draws, 4): what Figure 7.15 does for the rig.

    The mean of instrument times error is normal, whatever follows; each draw goes through both
    stages, so that the curvature of (7.38) and the first stage's error are in the result.
    """
    noise, equations = [], []
    for fit in found.stages:
        e = fit.equations[0]
        covariance = moment_covariance([e], [fit.thetas[0]], [fit.parts[0].record])
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        noise.append(rng.standard_normal((draws, len(values))) @ root.T)
        equations.append((e, e.Phi @ fit.thetas[0]))
    out = np.empty((draws, len(FREE)))
    for k in range(draws):
        given: dict[str, float] = {}
        row: list[float] = []
        for fit, (e, left), errors in zip(found.stages, equations, noise, strict=True):
            at = {**fit.values[0]}
            at |= {q: v for q, v in given.items() if q not in fit.parts[0].known}
            theta_p, _, _ = fit.stage.programs.solve(
                [replace(e, Y=left + errors[k])], fit.roots, [at], fit.theta_p
            )
            given |= dict(zip(fit.free, theta_p.tolist(), strict=True))
            row += theta_p.tolist()
        out[k] = row
    return out


@dataclass(frozen=True)
class Profiles:
    """What a campaign calls for intervals that follow the curved map, one run a row.

    By profile for the default weighting, by sampling for Q = I, the delta method beside both.
    """

    amplitude: float
    N: int = 150_000
    seed: int = 1
    noise: float = 0.01
    draws: int = 300

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, Any]:
        """Ends of the 95 % intervals of m and z_m."""
        own = bench(self.amplitude, self.N, self.seed, self.noise)
        estimate = _reusable()(own.study.experiments(seed))
        identity = own.estimate(own.study._drawn, ("identity",))["identity"]
        errors = np.sqrt(np.diag(identity.propagated().covariance))
        drawn = sampled(identity, np.random.default_rng(seed), self.draws)
        row: dict[str, Any] = {}
        for i, name in enumerate(FREE[2:], start=2):
            p = profile(estimate, name)
            row |= {f"{name}.lower": p.lower, f"{name}.upper": p.upper}
            for key, value, error in (
                ("delta", estimate[name], estimate.std_error(name)),
                ("identity.delta", float(identity.values[i]), float(errors[i])),
            ):
                row |= {f"{name}.{key}.lower": value - 1.96 * error}
                row |= {f"{name}.{key}.upper": value + 1.96 * error}
            low, high = np.quantile(drawn[:, i], [0.025, 0.975]).tolist()
            row |= {f"{name}.sampled.lower": low, f"{name}.sampled.upper": high}
        return row


@functools.cache
def _reusable() -> Reusable:
    model = indirect_model().with_unknown(**STARTS).with_known(k=TABLE_7_2["k"])
    settings = MomentSettings(form="linear", iterations=1)
    return Reusable(model, STAGES, Instruments("ref", LAG), settings=settings)


# -- the floor -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Floor:
    """What a campaign calls for time and memory: the bare work and the whole run in turn.

    The bare work is what no estimator can do without: normals into reused buffers, the filter, the
    sums of products for least squares and one set of instruments; by the very code of the study.
    """

    runs: Runs

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, float]:
        """Processor time: ms a run of both, ns a normal and a filter tap; peak memory."""
        import resource

        own = self.runs.bench
        study = own.study
        records = study.draw(study.generator(seed))
        parts = own.parts(records)
        found = own.estimate(records, ("iv",))["iv"]
        t = [process_time()]
        rng = study.generator(seed)
        for case, drawn in study._drawn.items():
            for channel in ("gyro", "accel"):
                rng.standard_normal(out=study._filter.input)
                t.append(process_time())
                study._filter(drawn[channel], study.clean[case][channel])
                t.append(process_time())
        own.moments(found, parts)
        t.append(process_time())
        self.runs(seed)
        t.append(process_time())
        step = np.diff(t)
        normals, taps = len(study._filter.input), len(study.low_pass.taps) * study.N
        return {
            "floor_ms": 1e3 * float(step[:9].sum()),
            "moments_ms": 1e3 * float(step[8]),
            "run_ms": 1e3 * float(step[9]),
            "ns_normal": 1e9 * float(np.median(step[0:8:2])) / normals,
            "ns_tap": 1e9 * float(np.median(step[1:8:2])) / taps,
            "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
