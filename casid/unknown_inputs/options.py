"""What to do about an input that nobody controls: the options of Linder (2017), 7.3, side by side.

(A) the input is known, or measured with noise; (B) it is a state, a random walk, with or without a
measurement of its integral (a speed for an acceleration), or noise of an estimated spectrum; (C) it
is eliminated with an output that feels it, which leaves the indirect model. One call fits a direct
model in each of these ways.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.data.problem import Problem
from casid.data.record import Experiment, Record
from casid.errors import CasidError, DataError, ModelError
from casid.estimation.estimate import Estimate
from casid.estimation.nlp.nlp import Solver
from casid.estimation.prediction_error.input_models import (
    as_known,
    as_random_walk,
    as_shaped_noise,
    require_unknown,
)
from casid.estimation.simulation.fit import FitSettings
from casid.identification.grey_box import minimize_prediction_error
from casid.identification.identify import identify
from casid.linear.noisy_model import White, noise_sources
from casid.model.model import Model
from casid.unknown_inputs.observers.input_estimate import noise_guess

KNOWN = "known"
AS_EXACT = "measured, taken as exact"
WITH_ERRORS = "measured, with errors in it"
WALK = "random walk"
WALK_INTEGRAL = "random walk, integral measured"
SHAPED = "shaped noise"
SIMULATION = "eliminated, simulation error"
PREDICTION = "eliminated, prediction error"
OPTIONS = (KNOWN, AS_EXACT, WITH_ERRORS, WALK, WALK_INTEGRAL, SHAPED, SIMULATION, PREDICTION)
"""The options in the order of 7.3: (A) the first three, (B) three, (C) two."""

WIDTH = 110
"""Characters that a line of the table may have."""

_LETTER = dict(zip(OPTIONS, "AAABBBCC", strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class OptionRow:
    """One option: what it estimates, how well it predicts, and whether it can be trusted."""

    option: str
    letter: str  # (A), (B) or (C) of 7.3
    estimate: Estimate | None  # None where the option failed: `remark` says why
    parameters: tuple[str, ...]
    error: Mapping[str, float]  # parameter -> estimate minus truth, empty where no truth is given
    prediction_rms: Mapping[str, float]  # output -> rms of the one-step prediction error
    is_consistent: bool
    remark: str

    def value(self, name: str) -> float:
        """The estimate of a parameter; NaN where the option failed."""
        return float("nan") if self.estimate is None else self.estimate[name]

    def std_error(self, name: str) -> float:
        """Its standard error; NaN where there is none."""
        found = None if self.estimate is None else self.estimate.parameter(name).std_error
        return float("nan") if found is None else found


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of at most `WIDTH` characters: columns that do not fit follow in a table below."""
    widths = [max(len(r[i]) for r in [heads, *rows]) for i in range(len(heads))]
    blocks: list[list[int]] = [[0]]
    for i in range(1, len(heads)):
        if heads[i] == "error":
            continue  # stands beside its parameter
        columns = [i, i + 1] if heads[i + 1 : i + 2] == ["error"] else [i]
        used = sum(2 + widths[k] for k in [*blocks[-1], *columns]) - 2
        if used > WIDTH and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1] += columns
    lines: list[str] = []
    for block in blocks:
        lines += [""] if lines else []
        for cells in [heads, *rows]:
            rest = [cells[k].rjust(widths[k]) for k in block[1:]]
            lines.append("  ".join([cells[0].ljust(widths[0]), *rest]))
    return lines


@dataclass(frozen=True, slots=True, eq=False)
class UnknownInputComparison:
    """The options for one unknown input on the same records."""

    model: str
    unknown: str
    parameters: tuple[str, ...]
    units: Mapping[str, str]
    truth: Mapping[str, float]
    outputs: tuple[str, ...]
    rows: tuple[OptionRow, ...]

    def __getitem__(self, option: str) -> OptionRow:
        """The row of an option, by its name."""
        for row in self.rows:
            if row.option == option:
                return row
        raise KeyError(f"no option {option!r}; there are {', '.join(r.option for r in self.rows)}")

    def cells(self) -> tuple[list[str], list[list[str]]]:
        """Heads and rows of the table, as text."""
        heads = ["option"]
        for name in self.parameters:
            heads.append(f"{name} [{self.units[name]}]")
            if name in self.truth:
                heads.append("error")
        heads += [f"rms {o}" for o in self.outputs]
        rows = []
        for row in self.rows:
            cells = [f"({row.letter}) {row.option}"]
            for name in self.parameters:
                value, sd = row.value(name), row.std_error(name)
                spread = "(at bound)" if np.isnan(sd) else f"+- {sd:.2g}"
                cells.append("--" if np.isnan(value) else f"{value:.5g} {spread}")
                if name in self.truth:
                    cells.append(f"{row.error[name]:+.2g}" if name in row.error else "--")
            for output in self.outputs:
                rms = row.prediction_rms.get(output)
                cells.append("--" if rms is None else f"{rms:.4g}")
            rows.append(cells)
        return heads, rows

    def __repr__(self) -> str:
        return f"<UnknownInputComparison {self.model}/{self.unknown}: {len(self.rows)} options>"

    def __str__(self) -> str:
        heads, rows = self.cells()
        lines = [f"Options for the unknown input {self.unknown} of {self.model}"]
        if self.truth:
            known = ", ".join(
                f"{n} = {self.truth[n]:g}" for n in self.parameters if n in self.truth
            )
            lines.append(f"  truth {known}")
        lines += ["", *_table(heads, rows), ""]
        lines += [f"({r.letter}) {r.option}: {r.remark}" for r in self.rows]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        heads, rows = self.cells()
        head = "".join(f"<th>{html.escape(h)}</th>" for h in [*heads, "remark"])
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in [*cells, row.remark]) + "</tr>"
            for cells, row in zip(rows, self.rows, strict=True)
        )
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def compare_unknown_input_options(
    model: Model,
    experiments: Sequence[Experiment | Record] | Experiment | Record,
    *,
    unknown: str | None = None,
    using: str | None = None,
    exact: str | None = None,
    measured: str | None = None,
    integral: str | None = None,
    noise: Mapping[str, float] | None = None,
    process: Sequence[White] | White = (),
    truth: Mapping[str, float] | None = None,
    options: Sequence[str] | str | None = None,
    solver: Solver | None = None,
    progress: Callable[[str], None] | None = None,
) -> UnknownInputComparison:
    """Fit a direct model in every way that its records allow; one row an option.

    Parameters
    ----------
    model : direct, with one unknown input (`unknown`, where it has several); other inputs recorded.
    experiments : records with the model's outputs, and the channels named below.
    using : the output to eliminate the unknown input with, options (C); default the last that
        feels it. A model without such an output can be compared without these options.
    exact : channel that holds the unknown input without error (a simulation's), for "known".
    measured : channel that holds it with noise; default the one of its own name, where there is.
    integral : channel that holds its integral with noise (a speed where it is an acceleration).
    noise : output or channel -> standard deviation to start from; default a guess from its second
        differences. All are estimated.
    process : process noise that every option has (estimated from its start).
    truth : parameter -> true value, where data are simulated.
    options : which of `OPTIONS`, one or several (default all that the records allow).

    Returns
    -------
    UnknownInputComparison
        An option that cannot be fitted keeps its row: its remark says why.

    Raises
    ------
    ModelError
        If the model has no unknown input, or several and none is named; if an option (C) is to be
        fitted and no output feels the unknown input.
    DataError
        If a channel named here is missing, in `noise` too, or an option asked for lacks its own.
    """
    say = progress or (lambda _: None)
    given = [experiments] if isinstance(experiments, Experiment | Record) else list(experiments)
    chosen = [Experiment(e, {}, e.name) if isinstance(e, Record) else e for e in given]
    unknown = _the_unknown(model, unknown)
    if measured is None and all(unknown in e.record for e in chosen) and exact != unknown:
        measured = unknown
    channels = {"exact": exact, "measured": measured, "integral": integral}
    for role, channel in channels.items():
        for e in chosen:
            if channel is not None and channel not in e.record:
                raise DataError(
                    f"{e.name}: no channel {channel!r} for {role}; it has "
                    f"{', '.join(e.record.names)}"
                )
    if not isinstance(noise, Mapping | None):
        raise DataError(
            f"noise is a {type(noise).__name__}; give a mapping from output or channel to standard "
            f"deviation, noise={{{next(iter(model.outputs))!r}: 0.01}}; process noise is process="
        )
    for name in noise or {}:
        if name not in model.outputs and not any(name in e.record for e in chosen):
            raise DataError(
                f"noise names {name!r}, which is no output of {model.name} and no channel; there "
                f"are {', '.join(model.outputs)} and {', '.join(chosen[0].record.names)}"
            )
    needs = {KNOWN: exact, AS_EXACT: measured, WITH_ERRORS: measured, WALK_INTEGRAL: integral}
    words = {KNOWN: "exact", AS_EXACT: "measured", WITH_ERRORS: "measured"}
    asked = (options,) if isinstance(options, str) else tuple(options or ())
    for option in asked:
        if option not in OPTIONS:
            raise DataError(f"no option {option!r}; there are {', '.join(OPTIONS)}")
        if option in needs and needs[option] is None:
            raise DataError(
                f"option {option!r} needs a channel: give "
                f"{words.get(option, 'integral')}='name of the channel'"
            )
    wanted = asked or tuple(o for o in OPTIONS if o not in needs or needs[o] is not None)
    job = _Job(
        model,
        unknown,
        chosen,
        _eliminated_with(model, unknown, using, wanted),
        exact,
        measured,
        integral,
        dict(noise or {}),
        noise_sources(process),
        solver,
    )
    rows = []
    names = tuple(p.name for p in model.parameters.values() if not p.is_known)
    names = tuple(n for n in names if not all(n in e.known for e in chosen))
    for option in wanted:
        say(option)
        rows.append(_row(job, option, names, truth or {}))
    outputs = tuple(dict.fromkeys(o for row in rows for o in row.prediction_rms))
    return UnknownInputComparison(
        model=model.name,
        unknown=unknown,
        parameters=names,
        units={n: model.parameters[n].unit for n in names},
        truth={n: float(v) for n, v in (truth or {}).items() if n in names},
        outputs=outputs,
        rows=tuple(rows),
    )


@dataclass(frozen=True, slots=True)
class _Job:
    model: Model
    unknown: str
    experiments: list[Experiment]
    using: str
    exact: str | None
    measured: str | None
    integral: str | None
    noise: dict[str, float]
    process: tuple[White, ...]
    solver: Solver | None

    def with_input(self, channel: str | None) -> list[Experiment]:
        """The experiments, the unknown input's own channel being a copy of `channel`."""
        if channel is None or channel == self.unknown:
            return self.experiments
        out = []
        for e in self.experiments:
            r = e.record.without(self.unknown) if self.unknown in e.record else e.record
            r = r.with_channel(self.unknown, e.record[channel], e.record.units[channel])
            out.append(Experiment(r, e.known, e.name))
        return out

    def white(self, model: Model, experiments: Sequence[Experiment]) -> list[White]:
        """The noise of every output, and the process noise that all options have."""
        sources = []
        for name in model.outputs:
            of = self.measured if name == self.unknown and self.measured else name
            guess = max(noise_guess(e.record[name]) for e in experiments)
            sources.append(White(name, self.noise.get(of, guess)))
        return [*sources, *self.process]

    def roughness(self) -> float:
        """A start for the sd of the random walk's noise: its output's spread a second."""
        return max(float(np.std(e.record[self.using])) for e in self.experiments) or 1.0


def _the_unknown(model: Model, unknown: str | None) -> str:
    names = [n for n, i in model.inputs.items() if i.kind == "unknown"]
    if not names:
        raise ModelError(
            f"{model.name} has no unknown input to compare options for; give the direct model, "
            "before eliminate, with the input as model.unknown_input(name, unit)"
        )
    if unknown is None and len(names) == 1:
        return names[0]
    if unknown is None and len(names) > 1:
        raise ModelError(
            f"{model.name} has several unknown inputs ({', '.join(names)}); say which with unknown="
        )
    require_unknown(model, unknown or "")
    return str(unknown)


def _eliminated_with(model: Model, unknown: str, using: str | None, wanted: Sequence[str]) -> str:
    """The output that the unknown input is eliminated with; the last where none has to be."""
    import casadi as ca

    if using is not None and using not in model.outputs:
        raise ModelError(
            f"{model.name}: using={using!r} is not an output; name one of "
            f"{', '.join(model.outputs)}"
        )
    e = model.explicit()
    felt = [
        name for i, name in enumerate(e.outputs) if ca.depends_on(e.h[i], model.symbol(unknown))
    ]
    without = [o for o in wanted if o not in (SIMULATION, PREDICTION)]
    if using is None and not felt and len(without) < len(wanted):
        raise ModelError(
            f"{model.name}: no output feels {unknown} at once, so it cannot be eliminated; leave "
            f"the options (C) out, options={without or [WALK, SHAPED]}, or add a sensor that does"
        )
    return using or [*e.outputs, *felt][-1]


def _row(job: _Job, option: str, names: tuple[str, ...], truth: Mapping[str, float]) -> OptionRow:
    consistent, remark = _judgement(job, option)
    try:
        estimate = _fit(job, option)
    except CasidError as why:
        return OptionRow(option, _LETTER[option], None, names, {}, {}, False, f"failed: {why}")
    rms: dict[str, float] = {}
    for output in next(iter(estimate.rmse.values())):
        sizes = [by_output[output] for by_output in estimate.rmse.values()]
        rms[output] = float(np.sqrt(np.mean(np.square(sizes))))
    coloured = [name for name, said in estimate.whiteness.items() if "coloured" in said]
    if consistent and coloured:
        verb = "leaves" if len(coloured) == 1 else "leave"
        remark += f". Here {', '.join(coloured)} {verb} coloured residuals: the condition fails"
    if not estimate.is_converged:
        remark += f". {estimate.status}: not converged"
    error = {n: estimate[n] - truth[n] for n in names if n in truth}
    return OptionRow(option, _LETTER[option], estimate, names, error, rms, consistent, remark)


def _fit(job: _Job, option: str) -> Estimate:
    if option in (KNOWN, AS_EXACT):
        model = as_known(job.model, job.unknown)
        experiments = job.with_input(job.exact if option == KNOWN else job.measured)
        noise = job.white(model, experiments)
    elif option in (WITH_ERRORS, WALK, WALK_INTEGRAL):
        record = job.experiments[0].record
        model, rate = as_random_walk(
            job.model,
            job.unknown,
            measured=option == WITH_ERRORS,
            integral=job.integral if option == WALK_INTEGRAL else None,
            integral_unit=None if job.integral is None else record.units[job.integral],
        )
        experiments = job.with_input(job.measured if option == WITH_ERRORS else None)
        noise = [*job.white(model, experiments), White(rate, job.roughness())]
    elif option == SHAPED:
        return _fit_shaped(job)
    else:
        model = job.model.eliminate(job.unknown, using=job.using)
        experiments = job.experiments
        if option == SIMULATION:
            problem = Problem(name=model.name, model=model)
            settings = FitSettings(starts=1, solver=job.solver)
            return identify(problem, experiments, settings=settings)
        noise = job.white(model, experiments)
        if not job.process:
            level = max(w.sd for w in noise)
            noise += [White(b, level, held=True) for b in model.balances]
    return minimize_prediction_error(
        model, experiments, noise, solver=job.solver, throw=False
    ).estimate


def _fit_shaped(job: _Job) -> Estimate:
    """From the fit as a random walk, which is easy: from afar the two poles wander off."""
    walk, rate = as_random_walk(job.model, job.unknown)
    easy = minimize_prediction_error(
        walk,
        job.experiments,
        [*job.white(walk, job.experiments), White(rate, job.roughness())],
        solver=job.solver,
        throw=False,
    )
    model, source = as_shaped_noise(job.model, job.unknown)
    start = {p.name: p.value for p in easy.estimate.parameters if p.name in model.parameters}
    # Well above its poles, shaped noise is a walk of psd / (2 zeta w)^2.
    w = model.parameters[f"w of {job.unknown}"].start
    noise = [
        n if n.is_known else replace(n, sd=max(easy.noise[n.where][0], 0.1 * n.sd))
        for n in job.white(model, job.experiments)
    ]
    noise.append(White(source, 2 * w * easy.noise[rate][0]))
    return minimize_prediction_error(
        model,
        job.experiments,
        noise,
        start={k: v for k, v in start.items() if not model.parameters[k].is_known},
        solver=job.solver,
        throw=False,
    ).estimate


def _judgement(job: _Job, option: str) -> tuple[bool, str]:
    """Whether an option is consistent, and why."""
    u, y = job.unknown, job.using
    return {
        KNOWN: (True, f"consistent: {u} is exact and the noise white; the bound for the others"),
        AS_EXACT: (
            False,
            f"not consistent: the noise of {u} acts on the model but not on the system "
            "(errors in variables); its gain is drawn to zero, more the noisier it is (Linder "
            "2017, (3.55))",
        ),
        WITH_ERRORS: (
            True,
            f"consistent if {u} is a random walk and the noises are white; {u} is smoothed, not "
            "believed",
        ),
        WALK: (
            True,
            f"consistent if {u} is a random walk; the outputs alone tell what it was",
        ),
        WALK_INTEGRAL: (
            True,
            f"consistent if {u} is a random walk; its measured integral {job.integral} keeps slow "
            "changes apart from the model's own",
        ),
        SHAPED: (
            True,
            f"consistent if {u} has the spectrum of noise through two poles, whatever its "
            "distribution",
        ),
        SIMULATION: (
            False,
            f"not consistent: {y} is an input with noise, fed back by the system itself (Linder "
            f"2017, (7.30)); no assumption on {u}",
        ),
        PREDICTION: (
            False,
            f"not consistent: the noise of {y} acts like process noise only where {y} itself is "
            f"much larger; the loop has a direct term (Linder 2017, (7.31)). No assumption on {u}",
        ),
    }[option]
