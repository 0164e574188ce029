"""Estimates and what belongs to them, as documents."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from casid.campaigns.monte_carlo import MonteCarlo
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.fitted.model_comparison import ModelComparison
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.reconciliation import Reconciled
from casid.estimation.regression.regression_estimate import RegressionEstimate
from casid.identification.grey_box import Prediction
from casid.identification.iterative_joint_instruments import IterativeJoint
from casid.model.quantities import count_text, p_statement
from casid.model.units import difference_from_si
from casid.report.document import Document, Labelled, Table, labelled
from casid.report.numbers import interval_lines, interval_text, is_half_open
from casid.report.texts.moments import black_box_document, convergence_document
from casid.report.verdicts import judged_estimate, judged_study, status_words
from casid.time_limit import out_of_time_text

_WIDEST, _LONGEST = 100, 14  # of a printed study, and of a parameter with its unit in it


def estimate_document(estimate: Estimate) -> Document:
    """Status, parameters with their errors, what is identifiable, fit, and what the errors rest on.

    Warnings that spoil the numbers stand before them.
    """
    e, i = estimate, estimate.identifiability
    judged = judged_estimate(e)
    status = (
        f"{status_words(e)} in {count_text(e.iterations, 'iteration')}; largest scaled gradient "
        f"{e.scaled_gradient:.0e}; {e.starts_agreeing} of {e.starts_tried} starts agree"
    )
    rows = [
        (
            p.name,
            p.unit,
            f"{p.value:.6g}",
            "--" if p.std_error is None else f"{p.std_error:.2g}",
            "" if p.start is None else f"{p.start:.6g}",
            _note(p),
        )
        for p in (*e.parameters, *e.initial_states)
    ]
    head = ("parameter", "unit", "estimate", "std. error", "start", "note")
    seen = "all" if i.rank == i.unknowns else i.undetermined
    identifiable = (
        f"{seen} (rank {i.rank} of {i.unknowns} at the estimate; smallest singular value "
        f"{i.smallest_singular_value:.2g}, scaled)"
    )
    return Document(
        f"Estimate of {e.problem} from {', '.join(e.rmse)}, {e.method}",
        [
            ("verdict", f"{judged.word}: {judged.sentence}"),
            *(("SUSPECT", s) for s in e.suspects),
            ("status", status),
            Table(head, rows, numbers=(2, 3, 4), widths=(18, 16, 13, 13, 13)),
            ("identifiable", identifiable),
            *_fit_lines(e),
            *(("residuals", f"{k}: {v}") for k, v in e.whiteness.items()),
            ("error bars", e.assumes),
            *((f"{name} ", text) for name, text in e.evidence.items()),
            *(("intervals", line) for line in interval_lines(e)),
            *(("WARNING", w) for w in e.warnings),
        ],
    )


def _note(p: Estimated) -> str:
    """What is to be said of a row: an interval that is not the normal one, a bound, known."""
    within = "95 %" if is_half_open(p) else "95 % in"
    notes = [f"{within} {interval_text(p)}"] if p.ends is not None else []
    return "; ".join([*notes, *([p.note] if p.note else ["known"] if p.known else [])])


def _fit_lines(e: Estimate) -> list[str]:
    lines = []
    for record, by_output in e.rmse.items():
        for output, value in by_output.items():
            held = e.held_out_rmse.get(record, {}).get(output)
            lines.append(
                f"  {record}/{output}: rms error {_error(e, output, value)}, "
                f"fit {e.nrmse_fit[record][output]:.1f} %"
                + (f"; held out {_error(e, output, held)}" if held is not None else "")
            )
    for record, by_output in e.held_out_rmse.items():
        if record not in e.rmse:
            for output, value in by_output.items():
                fit = e.held_out_fit.get(record, {}).get(output)
                lines.append(
                    f"  held out {record}/{output}: rms error {_error(e, output, value)}"
                    + (f", fit {fit:.1f} %" if fit is not None else "")
                )
    return lines


def _error(e: Estimate, output: str, value: float) -> str:
    """An error with the unit of its output."""
    unit = e.units.get(output, "")
    return f"{value:.4g}" if unit in {"", "1"} else f"{value:.4g} {unit}"


def moment_estimate_document(found: MomentEstimate) -> Document:
    """The estimate, its standard errors stage by stage, and what supports it."""
    document = estimate_document(found.estimate)
    stages: list[Labelled] = []
    if len(found.stages) > 1 or found.prior is not None:
        errors = (f"{n} {found.std_error(n, propagated=False):.2g}" for n in found.names)
        text = f"standard errors with earlier stages taken as exact: {', '.join(errors)}"
        stages = [("stages", text)]
    return Document(document.title, [*document.parts, *stages])


def prediction_document(found: Prediction) -> Document:
    """The estimate, and the noise that it estimates beside."""
    document = estimate_document(found.estimate)
    noise = ", ".join(f"{name} {sd:.4g}" for name, (sd, _) in found.noise.items())
    parts = [*document.parts, ("noise", f"standard deviations: {noise}")]
    return replace(document, parts=parts)


def iterative_document(found: IterativeJoint) -> Document:
    """The estimate, the black boxes behind its instruments, and how it converged."""
    document = moment_estimate_document(found.estimate)
    behind, steps = black_box_document(found.black_boxes), convergence_document(found.convergence)
    return replace(document, parts=[*document.parts, behind.title, *behind.parts, *steps.parts])


def regression_document(estimate: RegressionEstimate) -> Document:
    """Status, parameters with their errors, residuals, and what the errors rest on."""
    e = estimate
    rows = [
        (
            name,
            f"{e.values[i]:.10g}",
            f"{e.std_errors[i]:.5g}" if np.isfinite(e.std_errors[i]) else "--",
            f"{e.start[i]:.6g}",
            "at bound: no standard error" if name in e.at_bound else "",
        )
        for i, name in enumerate(e.parameters)
    ]
    head = ("parameter", "estimate", "std. error", "start", "note")
    smallest = e.singular_values[-1] if len(e.singular_values) else float("nan")
    status = (
        f"{e.status} in {count_text(e.iterations, 'iteration')} ({e.solver}, {e.hessian} "
        f"Hessian); relative offset {e.relative_offset:.1e}"
    )
    identifiable = (
        f"all (rank {e.rank} of {e.rank}; smallest singular value {smallest:.1e}, columns scaled)"
    )
    return Document(
        f"Regression {e.model} ({e.N} data)",
        [
            ("status", status),
            Table(head, rows, numbers=(1, 2, 3), widths=(12, 18, 14, 14)),
            ("residuals", f"rss {e.rss:.10g}, sd {e.residual_sd:.6g} ({e.dof} dof)"),
            ("identifiable", identifiable),
            ("error bars", "independent residuals of one variance, exact regressors, linearised"),
            *(("note", note) for note in e.notes),
        ],
    )


def reconciled_document(found: Reconciled) -> Document:
    """Whether the readings contradict one another, and every quantity beside its reading."""
    verdict = "nothing to test" if found.degrees == 0 else p_statement(found.p_value)
    parts: list[str | Table] = []
    if not found.is_consistent:
        parts.append("  the readings CONTRADICT one another; set aside, with the correction:")
        parts += [f"    {blame}" for blame in found.blamed]
        parts.append("  until that is settled the values below mean nothing")
    rows = []
    for name in found.names:
        read, off = "", ""
        if name in found.readings:
            read, off = f"{found.readings[name][0]:.6g}", f"{found.residuals[name]:+.1f}"
        rows.append(
            (
                name,
                f"{found[name]:.6g}",
                f"{found.std_error(name):.3g}",
                read,
                off,
                found.units[name],
            )
        )
    head = ("quantity", "value", "std. error", "read", "residual/sd", "unit")
    parts.append(Table(head, rows, numbers=(1, 2, 3, 4), widths=(24, 13, 12, 13, 13)))
    return Document(
        f"{found.title}: {len(found.readings)} readings, chi2 {found.statistic:.4g} with "
        f"{found.degrees} degrees of freedom, {verdict}",
        parts,
    )


def monte_carlo_document(result: MonteCarlo) -> Document:
    """How well each parameter is estimated, with remarks, and which runs failed."""
    labels = [f"{p.name} [{p.unit}]" for p in result.parameters]
    width = min(max(map(len, (*labels, "parameter"))), _LONGEST)
    rows: list[tuple[str, ...] | str] = []
    for label, p in zip(labels, result.parameters, strict=True):
        covers = "--"
        if p.coverage is not None and p.coverage_interval is not None:
            low, high = (100 * x for x in p.coverage_interval)
            covers = f"{100 * p.coverage:.1f} [{low:.1f}, {high:.1f}]"
        if len(label) > width:
            rows.append(label)
            label = ""
        rows.append(
            (
                label,
                "--" if p.truth is None else f"{p.truth:.5g}",
                p.mean_text,
                f"{'--' if p.bias is None else f'{p.bias:.2g}'} +- "
                f"{_finite(p.bias_std_error, '.2g'):<7}",
                _finite(p.spread, ".3g"),
                _finite(p.mean_std_error, ".3g"),
                covers,
            )
        )
    head = ("parameter", "truth", "mean", f"bias +- {'':7}", "spread", "std. err.", "coverage [%]")
    failed, judged = len(result.campaign.failures), judged_study(result)
    return Document(
        f"Monte Carlo study of {result.problem}: {count_text(result.campaign.runs, 'run')} with "
        f"seed {result.campaign.seed}, method {result.method}, {failed} failed",
        [
            ("verdict", f"{judged.word}: {judged.sentence}"),
            ("advice", judged.advice),
            Table(head, rows, numbers=(1, 2, 3, 4, 5), widths=(width + 1, 11, 12, 20, 9, 10)),
            "  bias +- its Monte Carlo standard error; spread: standard deviation of the estimates",
            "  std. err.: mean of those reported; coverage of 95 % intervals [its interval]",
            *(("REMARK", f"{p.name}: {'; '.join(p.remarks)}") for p in result.parameters
              if p.remarks),
            *(("failed", f"{count_text(n, 'time')}: {why}") for why, n in result.failures.items()),
            *((("NOT DONE", out_of_time_text(result.not_done)),) if result.not_done else ()),
        ],
        label=8,
        width=_WIDEST,
    )  # fmt: skip


def _finite(value: float, digits: str) -> str:
    """A number; `--` for that of too few runs."""
    return format(value, digits) if math.isfinite(value) else "--"


def model_comparison_document(found: ModelComparison) -> Document:
    """Fit in per cent and RMS error of every output, a row a model."""
    head, shown = ["model"], found.declared or found.units
    for output, unit in zip(found.outputs, shown, strict=True):
        head += [f"{output} [%]", f"rms [{unit}]"]
    rows = []
    for model in found.fit:
        cells = [model]
        for output, unit in zip(found.outputs, shown, strict=True):
            error = float(difference_from_si(found.rmse[model][output], unit))
            cells += [f"{found.fit[model][output]:.2f}", f"{error:.4g}"]
        rows.append(cells)
    table = Table(head, rows, numbers=range(1, len(head)))
    return Document(f"Fit to {found.record}, {found.how}", [table, *labelled("note", found.notes)])
