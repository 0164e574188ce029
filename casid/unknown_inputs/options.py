"""What to do about an input that nobody controls: the options of Linder (2017), 7.3, side by side.

(A) the input is known, or measured with noise; (B) it is a state, a random walk, with or without a
measurement of its integral (a speed for an acceleration), or noise of an estimated spectrum; (C) it
is eliminated with an output that it acts on: the indirect model. One call fits a direct model in
each of these ways.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.argument_types import names_wrong_types
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.errors import CasidError, DataError, ModelError
from casid.estimation.estimate import Estimate
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.input_models import (
    as_known,
    as_random_walk,
    as_shaped_noise,
    require_unknown,
)
from casid.estimation.simulation.fit import FitSettings
from casid.identification.grey_box import minimize_prediction_error
from casid.identification.identify import identify
from casid.linear.filtering.noisy_model import White, noise_sources
from casid.model.model import Model
from casid.unknown_inputs.observers.input_estimate import noise_guess
from casid.unknown_inputs.option_comparison import OptionRow, UnknownInputComparison

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


@dataclass(frozen=True, slots=True)
class _Option:
    """What an option needs, and whether it is consistent.

    Attributes
    ----------
    letter : (A), (B) or (C) of 7.3.
    needs : argument that names the channel it cannot do without.
    why : what follows "consistent" or "not consistent", with the names u, y and integral.
    """

    letter: str
    needs: str
    is_consistent: bool
    why: str


_TABLE = {
    KNOWN: _Option(
        "A", "exact", True, ": {u} is exact and the noise white; the bound for the others"
    ),
    AS_EXACT: _Option(
        "A",
        "measured",
        False,
        ": the noise of {u} acts on the model but not on the system (errors in variables); its "
        "gain is drawn to zero, more the noisier it is (Linder 2017, (3.55))",
    ),
    WITH_ERRORS: _Option(
        "A",
        "measured",
        True,
        " if {u} is a random walk and the noises are white; {u} is smoothed, not believed",
    ),
    WALK: _Option(
        "B", "", True, " if {u} is a random walk; it is estimated from the outputs alone"
    ),
    WALK_INTEGRAL: _Option(
        "B",
        "integral",
        True,
        " if {u} is a random walk; its measured integral {integral} keeps slow changes apart from "
        "the model's own",
    ),
    SHAPED: _Option(
        "B",
        "",
        True,
        " if {u} has the spectrum of noise through two poles, whatever its distribution",
    ),
    SIMULATION: _Option(
        "C",
        "",
        False,
        ": {y} is an input with noise, fed back by the system itself (Linder 2017, (7.30)); no "
        "assumption on {u}",
    ),
    PREDICTION: _Option(
        "C",
        "",
        False,
        ": the noise of {y} acts like process noise only where {y} itself is much larger; the loop "
        "has a direct term (Linder 2017, (7.31)). No assumption on {u}",
    ),
}


@names_wrong_types(ModelError)
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
        it acts on. A model without such an output can be compared without these options.
    exact : channel that holds the unknown input without error (a simulation's), for "known".
    measured : channel that holds it with noise; default the one of its own name, where there is.
    integral : channel that holds its integral with noise (a speed where it is an acceleration).
    noise : output or channel -> standard deviation to start from; default a guess from its second
        differences. All are estimated.
    process : process noise that every option has (estimated from its start).
    truth : parameter -> true value, where data are simulated.
    options : which of `OPTIONS`, one or several (default all that the records allow).
    solver : of every fit, a `Solver`.
    progress : called with a line of text at every option.

    Returns
    -------
    UnknownInputComparison
        An option that cannot be fitted keeps its row: its remark says why.

    Raises
    ------
    ModelError
        If the model has no unknown input, or several and none is named; if an option (C) is to be
        fitted and the unknown input acts on no output.
    DataError
        If a channel named here is missing, in `noise` too, or a requested option lacks its own.
    """
    report = progress or (lambda _: None)
    given = [experiments] if isinstance(experiments, Experiment | Record) else list(experiments)
    chosen = [Experiment(e, {}, e.name) if isinstance(e, Record) else e for e in given]
    unknown = _the_unknown(model, unknown)
    if measured is None and all(unknown in e.record for e in chosen) and exact != unknown:
        measured = unknown
    channels = {"exact": exact, "measured": measured, "integral": integral}
    _require_channels(model, chosen, channels, noise)
    wanted = _wanted(options, channels)
    using = _eliminated_with(model, unknown, using, wanted)
    job = _Job(
        model, unknown, chosen, using, channels, dict(noise or {}), noise_sources(process), solver
    )
    names = tuple(p.name for p in model.parameters.values() if not p.is_known)
    names = tuple(n for n in names if not all(n in e.known for e in chosen))
    rows = []
    for option in wanted:
        report(option)
        rows.append(_row(job, option, names, truth or {}))
    return UnknownInputComparison(
        model=model.name,
        unknown=unknown,
        parameters=names,
        units={n: model.parameters[n].unit for n in names},
        truth={n: float(v) for n, v in (truth or {}).items() if n in names},
        outputs=tuple(dict.fromkeys(o for row in rows for o in row.prediction_rms)),
        rows=tuple(rows),
    )


def _require_channels(
    model: Model,
    experiments: Sequence[Experiment],
    channels: Mapping[str, str | None],
    noise: Mapping[str, float] | None,
) -> None:
    """Refuse channels that a record lacks, and noise of neither an output nor a channel."""
    for role, channel in channels.items():
        for e in experiments:
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
        if name not in model.outputs and not any(name in e.record for e in experiments):
            raise DataError(
                f"noise names {name!r}, which is no output of {model.name} and no channel; there "
                f"are {', '.join(model.outputs)} and {', '.join(experiments[0].record.names)}"
            )


def _wanted(
    options: Sequence[str] | str | None, channels: Mapping[str, str | None]
) -> tuple[str, ...]:
    """The options given, or all that have their channel.

    Raises
    ------
    DataError
        If there is no such option, or its channel is not named.
    """
    given = (options,) if isinstance(options, str) else tuple(options or ())
    for option in given:
        if option not in OPTIONS:
            raise DataError(f"no option {option!r}; there are {', '.join(OPTIONS)}")
        needs = _TABLE[option].needs
        if needs and channels[needs] is None:
            raise DataError(
                f"option {option!r} needs a channel: give {needs}='name of the channel'"
            )
    there = [o for o in OPTIONS if not _TABLE[o].needs or channels[_TABLE[o].needs] is not None]
    return given or tuple(there)


@dataclass(frozen=True, slots=True)
class _Job:
    model: Model
    unknown: str
    experiments: list[Experiment]
    using: str
    channels: Mapping[str, str | None]  # "exact", "measured", "integral"
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
            of = (name == self.unknown and self.channels["measured"]) or name
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
    direct = [
        name for i, name in enumerate(e.outputs) if ca.depends_on(e.h[i], model.symbol(unknown))
    ]
    without = [o for o in wanted if o not in (SIMULATION, PREDICTION)]
    if using is None and not direct and len(without) < len(wanted):
        raise ModelError(
            f"{model.name}: {unknown} acts on no output at once, so it cannot be eliminated; leave "
            f"the options (C) out, options={without or [WALK, SHAPED]}, or add a sensor that does"
        )
    return using or [*e.outputs, *direct][-1]


def _row(job: _Job, option: str, names: tuple[str, ...], truth: Mapping[str, float]) -> OptionRow:
    letter, consistent = _TABLE[option].letter, _TABLE[option].is_consistent
    try:
        estimate = _fit(job, option)
    except CasidError as why:
        return OptionRow(option, letter, None, names, {}, {}, False, f"failed: {why}")
    why_so = _TABLE[option].why.format(
        u=job.unknown, y=job.using, integral=job.channels["integral"]
    )
    remark = f"{'' if consistent else 'not '}consistent{why_so}"
    rms: dict[str, float] = {}
    for output in next(iter(estimate.rmse.values())):
        sizes = [by_output[output] for by_output in estimate.rmse.values()]
        rms[output] = float(np.sqrt(np.mean(np.square(sizes))))
    coloured = list(estimate.fit.coloured)
    if consistent and coloured:
        verb = "leaves" if len(coloured) == 1 else "leave"
        remark += f". Here {', '.join(coloured)} {verb} coloured residuals: the condition fails"
    if not estimate.is_converged:
        remark += f". {estimate.status}: not converged"
    error = {n: estimate[n] - truth[n] for n in names if n in truth}
    return OptionRow(option, letter, estimate, names, error, rms, consistent, remark)


def _fit(job: _Job, option: str) -> Estimate:
    if option in (KNOWN, AS_EXACT):
        model = as_known(job.model, job.unknown)
        experiments = job.with_input(job.channels[_TABLE[option].needs])
        noise = job.white(model, experiments)
    elif option in (WITH_ERRORS, WALK, WALK_INTEGRAL):
        record, integral = job.experiments[0].record, job.channels["integral"]
        model, rate = as_random_walk(
            job.model,
            job.unknown,
            measured=option == WITH_ERRORS,
            integral=integral if option == WALK_INTEGRAL else None,
            integral_unit=None if integral is None else record.units[integral],
        )
        experiments = job.with_input(job.channels["measured"] if option == WITH_ERRORS else None)
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
