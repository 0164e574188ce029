"""Every available solver on the thesis's estimation problems: convergence, time, failures.

    python -m analysis.solver_comparison [--quick] [--out DIR]

The pendulum of Linder (2017), Table 7.2, nominal and loaded, instrumental variables.

- Multi-stage (Approach 7.1): least squares in theta under one linear constraint, (7.41) with I_x
  and d unknown, then (7.47) with m and z_m unknown. Convex, with a closed form.
- Joint (Approach 7.2): I_x, d, k, m, z_m from both records at once, theta = g(theta_p) put in
  (eliminated) or kept as equality constraints (lifted). One optimum.
- The same joint problem with the moments as they are added up, theta' G theta - 2 c' theta + r, a
  small difference of large terms, in place of their square root ||R theta - z||^2 + rest.
- Two constraints that contradict each other.
- Simulation error of the pendulum, a criterion that is no CasADi expression.

Targets: agreement with the reference to 1e-7 relative, or the reason why not, in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from analysis.common.figures import Chart
from analysis.common.output import Output
from analysis.common.runner import Run, Study
from analysis.common.targets import Target
from analysis.pendulum_study.records import INSTRUMENT_LAG, TS, PendulumRecords
from casid.estimation.moments.equations.moment_nlp import Condensed, LinearNlp, PhysicalNlp
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.stage import StageFit
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.estimation.nlp.comparison_table import SolverComparison
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solver_comparison import compare_solvers
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.moment_estimators import instrumental_variables, multistage
from problems.pendulum import TABLE_7_2, indirect_model
from problems.pendulum import experiments as simulated

TOLERANCE = 1e-7
HOUSE = "ipopt + Newton"
EXACT_HESSIAN = (HOUSE, "ipopt", "sqpmethod/qrqp", "sqpmethod/daqp")
"""Solvers without an excuse: second derivatives are exact."""

APPROXIMATE = ("blocksqp", "alpaqa", "scipy/SLSQP")
"""Solvers that build their own Hessian: even a convex program may take them too long."""

FLAT = 1e-10
"""What solvers of the simulation error may differ by in the criterion, relative."""

STARTS = {"I_x": 0.15, "d": 0.09, "k": 9.0, "m": 0.1, "z_m": -0.2}


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One program with its data, and who has to arrive."""

    key: str
    title: str
    nlp: Nlp
    values: Mapping[str, Any]
    start: Sequence[float] | None
    must_agree: Sequence[str]
    all_agree: bool = False  # convex: every solver that runs with an exact Hessian
    expected: Mapping[str, float] | None = None  # of an independent solution


def condensed(fit: StageFit) -> list[Condensed]:
    """The square roots of a stage's weighted moments."""
    return [Condensed.of(e, root) for e, root in zip(fit.equations, fit.roots, strict=True)]


def linear_case(key: str, fit: StageFit, B: Sequence[float], b: float, equation: str) -> Case:
    """A stage in theta alone, under one linear constraint that was derived on paper."""
    program = LinearNlp(fit.stage.equations, 1, name=f"{', '.join(fit.free)} under {equation}")
    values = program.parameters(condensed(fit), np.array([B]), np.array([b]))
    names = [f"{c}#0" for c in fit.stage.equations[0].coefficients]
    return Case(
        key,
        f"multi-stage: {', '.join(fit.free)} from linear least squares under {equation}",
        program.nlp,
        values,
        None,
        EXACT_HESSIAN,
        all_agree=True,
        expected=dict(zip(names, fit.thetas[0].tolist(), strict=True)),
    )


def physical_case(key: str, fit: StageFit, *, is_lifted: bool) -> Case:
    """The joint program, eliminated or lifted."""
    form = "lifted" if is_lifted else "eliminated"
    stage = fit.stage
    program = PhysicalNlp(
        stage.equations, stage.parameters, stage.known, lifted=is_lifted, name=f"joint, {form}"
    )
    at_start = np.array([STARTS[name] for name in fit.free])
    start = at_start.tolist()
    if is_lifted:
        start += stage.programs.map.theta(at_start, fit.values).tolist()
    values = program.parameters(condensed(fit), fit.values)
    expected = dict(zip(fit.free, fit.theta_p.tolist(), strict=True))
    title = f"joint: {', '.join(fit.free)} from both records, {form}"
    # Lifted, theta is a variable with a curvature 1e10 times that of the load, and tolerances are
    # relative to the steepest direction: 1e-11 of it is 1e-6 of the load. Newton steps go on.
    must = (HOUSE,) if is_lifted else EXACT_HESSIAN
    return Case(key, title, program.nlp, values, start, must, expected=expected)


def summed_case(key: str, fit: StageFit) -> Case:
    """The joint program, eliminated, with Gram matrices for data."""
    nlp = Nlp("joint, eliminated, summed moments")
    p = {q.name: nlp.variable(q.name, q.start, lower=q.lower, upper=q.upper) for q in
         fit.stage.parameters}  # fmt: skip
    total: Any = 0
    values: dict[str, Any] = {}
    for k, (e, known, data, fixed) in enumerate(
        zip(fit.stage.equations, fit.values, condensed(fit), fit.stage.known, strict=True)
    ):
        n = len(e.coefficients)
        G, c, r = nlp.parameter(f"G{k}", n, n), nlp.parameter(f"c{k}", n), nlp.parameter(f"r{k}")
        theta = e.g(
            ca.vertcat(*[p[q] if q in p and q not in fixed else known[q] for q in e.parameters])
        )
        total += (ca.bilin(G, theta, theta) - 2 * ca.dot(c, theta) + r) / 2
        values |= {
            f"G{k}": data.right.T @ data.right,
            f"c{k}": data.right.T @ data.left,
            f"r{k}": data.left @ data.left + data.rest,
        }
    nlp.minimize(total)
    start = [STARTS[name] for name in fit.free]
    title = "joint, eliminated, from moments as they are added up: values cancel"
    return Case(key, title, nlp, values, start, EXACT_HESSIAN)


def impossible_case(fit: StageFit) -> Case:
    """Stage two with (7.41) for two different stiffnesses at once."""
    program = LinearNlp(fit.stage.equations, 2, name="two stiffnesses at once")
    S, k = TABLE_7_2["M"] * TABLE_7_2["z_g"], TABLE_7_2["k"]
    B = np.array([[-S / k, -S / k, -2 * TS], [-S / k, -S / k, -2 * TS]])
    values = program.parameters(condensed(fit), B, np.array([S / k, 1.1 * S / k]))
    title = "two constraints that contradict each other: (7.41) for k and for k/1.1"
    return Case("impossible", title, program.nlp, values, None, ())


def simulation_case(duration: float) -> Case:
    """Simulation error of a nominal record: value, gradient and Gauss-Newton matrix in one pass."""
    experiment = simulated(duration=duration, seed=3)[0]
    criterion = SimulationError(indirect_model(), [experiment])
    nlp = Nlp("simulation error")
    for v in criterion.variables:
        nlp.variable(v.name, v.start, lower=v.lower, upper=v.upper, scale=v.scale)
    nlp.minimize(criterion)
    title = f"simulation error of {duration:g} s: {', '.join(v.name for v in criterion.variables)}"
    return Case("simulation_error", title, nlp, {}, criterion.start.tolist(), ("ipopt",))


def cases(*, quick: bool) -> Iterator[Case]:
    """The problems, one after the other."""
    records = PendulumRecords(0.3, N=20_000 if quick else 150_000, seed=1).experiments()
    instruments = Instruments("ref", ReferenceFilter.lag(INSTRUMENT_LAG))
    model = indirect_model()
    staged = multistage(
        model.with_known(k=TABLE_7_2["k"]).with_unknown(
            **{name: STARTS[name] for name in ("I_x", "d", "m", "z_m")}
        ),
        records,
        [StageSpec(["I_x", "d"], ["nominal"]), StageSpec(["m", "z_m"], ["loaded"])],
        instruments,
    )
    second, third = staged.stages
    S, k = TABLE_7_2["M"] * TABLE_7_2["z_g"], TABLE_7_2["k"]
    yield linear_case("stage_2", second, [-S / k, -S / k, -2 * TS], S / k, "(7.41)")
    ratio = staged["d"] / k
    yield linear_case("stage_3", third, [ratio, ratio + TS, 0.0], TS - ratio, "(7.47)")
    joint = instrumental_variables(
        model.with_unknown(**STARTS), records, instruments, settings=MomentSettings()
    ).stages[0]
    yield physical_case("joint_eliminated", joint, is_lifted=False)
    yield physical_case("joint_lifted", joint, is_lifted=True)
    yield summed_case("joint_summed", joint)
    yield impossible_case(second)
    yield simulation_case(20.0 if quick else 120.0)


def judge(case: Case, found: SolverComparison) -> Iterator[Target]:
    """The targets of one case."""
    ran = [row for row in found.rows if row.x is not None]
    if case.key == "impossible":
        violations = [row.violation for row in ran]
        yield Target(
            f"{case.key}: solvers that say so",
            f"{sum('contradict' in row.reason for row in ran)} of {len(ran)}",
            "all",
            not found.is_feasible and min(violations) > 0,
        )
        return
    wanted = list(case.must_agree)
    if case.all_agree:
        wanted = [row.solver for row in ran if row.solver not in APPROXIMATE]
    missed = [name for name in wanted if not found[name].agrees]
    yield Target(
        f"{case.key}: {len(wanted)} solvers agree to {TOLERANCE:g}",
        f"missed: {', '.join(missed)}" if missed else "all",
        "all",
        not missed,
    )
    if case.key == "simulation_error":
        near = ("ipopt", "sqpmethod/qrqp", "sqpmethod/daqp", "scipy/trust-constr", "scipy/SLSQP")
        off = max(abs(found[n].objective / found.objective - 1) for n in near)
        what = f"{case.key}: criterion of {len(near)} solvers"
        yield Target(what, f"within {off:.1e}", f"<= {FLAT:g}", off <= FLAT)
    silent = [row.solver for row in found.rows if not row.agrees and not row.reason]
    missing = len(found.rows) - len(found.agreeing)
    text = ", ".join(silent) or f"{missing} of {missing}"
    yield Target(f"{case.key}: those that miss say why", text, "all", not silent)
    if case.expected is not None and found.reference is not None:
        at = dict(zip(found.names, found.reference.tolist(), strict=True))
        off = max(abs(at[n] - v) / abs(v) for n, v in case.expected.items())
        what = f"{case.key}: reference against the estimator"
        yield Target(what, f"{off:.1e}", f"<= {TOLERANCE:g}", off <= TOLERANCE)


def forms_agree(results: Mapping[str, SolverComparison]) -> Iterator[Target]:
    """Eliminated, lifted and summed programs have one optimum."""
    base = results["joint_eliminated"]
    assert base.reference is not None
    for key in ("joint_lifted", "joint_summed"):
        other = results[key].reference
        assert other is not None
        n = len(base.reference)
        off = float(np.max(np.abs(other[:n] - base.reference) / np.abs(base.reference)))
        yield Target(
            f"{key}: optimum against eliminated", f"{off:.1e}", f"<= {TOLERANCE:g}", off <= 1e-7
        )


def overview(results: Mapping[str, SolverComparison]) -> str:
    """Distance to the reference, solver by problem; "--" where a solver did not run."""
    solvers = list(dict.fromkeys(row.solver for r in results.values() for row in r.rows))
    width = max(len(s) for s in solvers)
    lines = [" " * width + "".join(f"  {key[:16]:>16}" for key in results)]
    for solver in solvers:
        cells = []
        for r in results.values():
            row = next((row for row in r.rows if row.solver == solver), None)
            shown = "--"
            if row is not None and row.x is not None:
                distance = f"{row.distance:.0e}" if np.isfinite(row.distance) else "infeasible"
                shown = f"{distance}{' ' if row.agrees else '*'} {1e3 * row.seconds:6.1f}"
            cells.append(f"  {shown:>16}")
        lines.append(f"{solver:<{width}}" + "".join(cells))
    lines.append("distance (relative; * above 1e-7 or infeasible) and time of one solve [ms]")
    return "\n".join(lines)


def figure(results: Mapping[str, SolverComparison]) -> Any:
    """Distance to the reference for each solver (Plotly), one colour a problem."""
    chart = Chart("Solvers on the estimation problems of section 7.5.1")
    for key, r in results.items():
        rows = [row for row in r.rows if row.x is not None and np.isfinite(row.distance)]
        if rows:
            x, y = [row.solver for row in rows], [max(row.distance, 1e-16) for row in rows]
            chart.points(x, y, key, hovertext=[row.reason or row.status for row in rows])
    chart.figure.add_hline(y=TOLERANCE, line_dash="dash", annotation_text="agreement")
    chart.x_axis("solver")
    distance = "largest relative distance to the reference"
    chart.y_axis(distance, type="log", exponentformat="power")
    return chart.figure


def write(out: Output, results: Mapping[str, SolverComparison], titles: Mapping[str, str]) -> None:
    """Tables (text, CSV, JSON) and figures of all problems."""
    assert out.folder is not None
    figures = Output(out.folder / "figures")
    for key, r in results.items():
        (out.folder / f"{key}.txt").write_text(f"{titles[key]}\n{r}\n", encoding="utf-8")
        figures.figure(key, r.plot())
    figures.figure("overview", figure(results))
    out.json("solvers", {key: r.to_json() | {"title": titles[key]} for key, r in results.items()})
    rows = [(key, row.to_json()) for key, r in results.items() for row in r.rows]
    plain = [{n: v for n, v in row.items() if n != "x"} for _, row in rows]
    out.table("solvers", [{"problem": k} | p for (k, _), p in zip(rows, plain, strict=True)])


def study(run: Run) -> Iterator[Target]:
    """Print each comparison and the overview; the targets of all."""
    results: dict[str, SolverComparison] = {}
    titles: dict[str, str] = {}
    targets: list[Target] = []
    for case in cases(quick=run.quick):
        found = compare_solvers(case.nlp, case.values, start=case.start, tolerance=TOLERANCE)
        results[case.key], titles[case.key] = found, case.title
        print(f"\n{case.title}\n{found}", flush=True)
        targets += judge(case, found)
    targets += forms_agree(results)
    print(f"\n{overview(results)}\n")
    yield from targets
    if run.folder is not None:
        write(run.output, results, titles)


STUDY = Study(study, quick="records of 20 000 samples", out="folder for tables and figures")
