"""The report of a Monte Carlo study: histograms, and how well the intervals cover."""

from __future__ import annotations

from collections.abc import Sequence

from casid.campaigns.accuracy import Accuracy
from casid.campaigns.monte_carlo import MonteCarlo
from casid.model.quantities import count_text
from casid.report.document import (
    Banner,
    Bullets,
    Document,
    Section,
    Table,
    figure_parts,
    mapping_table,
)
from casid.report.figures.histograms import histogram_figure
from casid.report.numbers import number_text, value_text
from casid.report.pages.estimate_parts import notice, provenance
from casid.report.verdicts import judged_study
from casid.time_limit import out_of_time_text


def monte_carlo_report(result: MonteCarlo) -> Document:
    """Accuracy of every parameter, failed runs, and what makes the study again."""
    is_drawn = any(p.n > 1 for p in result.parameters)
    figure = figure_parts({"histograms": histogram_figure(result)} if is_drawn else {}).get
    failed = len(result.campaign.failures)
    runs = (
        f"{count_text(result.campaign.runs, 'run')} with seed {result.campaign.seed}, "
        f"method {result.method}; {failed or 'none'} failed."
    )
    words = (
        "Bias: mean minus truth, with its Monte Carlo standard error. Spread: standard deviation "
        "of the estimates, with its standard error for normal estimates. Coverage: share of the 95 "
        "% intervals that contain the truth, with its binomial 95 % interval (Wilson 1927)."
    )
    remarks = [f"{p.name}: {remark}" for p in result.parameters for remark in p.remarks]
    failures = {message: str(n) for message, n in result.failures.items()}
    settings = {"seed": str(result.campaign.seed)} | {
        name: ", ".join(f"{k} = {v}" for k, v in value.items())
        if isinstance(value, dict)
        else str(value)
        for name, value in result.settings.items()
        if value not in (None, {}, [])
    }
    cut = [out_of_time_text(result.not_done)] if result.not_done else []
    judged = judged_study(result)
    streams = "Run i has the random numbers of numpy.random.SeedSequence(seed).spawn(n)[i]."
    return Document(
        result.problem,
        [
            Section(
                "",
                [
                    Banner(judged.word, judged.beside, judged.sentence, judged.look),
                    notice((), cut),
                    Section("What to do next", [judged.advice], look="advice"),
                    runs,
                    Bullets(remarks),
                ],
                is_open=True,
            ),
            Section(
                "Parameters",
                [_accuracy(result.parameters), figure("histograms"), words],
                is_open=True,
            ),
            Section("Failed runs", [mapping_table(failures, ("message", "runs"))]),
            provenance((), settings, result.versions, streams),
            Section("References", [Bullets(result.sources)]),
        ],
        kind="Monte Carlo study",
    )


def _accuracy(parameters: Sequence[Accuracy]) -> Table:
    rows = []
    for p in parameters:
        covers = "\u2013"
        if p.coverage is not None and p.coverage_interval is not None:
            low, high = (100 * x for x in p.coverage_interval)
            covers = f"{100 * p.coverage:.1f} % ({low:.1f} .. {high:.1f} %)"
        rows.append(
            (
                p.name,
                p.unit,
                "\u2013" if p.truth is None else value_text(p.truth),
                p.mean_text,
                "\u2013" if p.bias is None else _plus_minus(p.bias, p.bias_std_error),
                _plus_minus(p.spread, p.spread_std_error),
                number_text(p.mean_std_error),
                covers,
                "; ".join(p.remarks),
            )
        )
    head = "parameter,unit,truth,mean,bias,spread,mean std. error,coverage,note".split(",")
    caption = "Accuracy of the estimates against the simulator's truth"
    return Table(head, rows, numbers=range(2, 8), caption=caption)


def _plus_minus(value: float, error: float) -> str:
    return f"{value:.2g} \u00b1 {error:.1g}"
