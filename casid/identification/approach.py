"""Which approach `identify` took, and why: what its result says of it."""

from __future__ import annotations

from collections.abc import Sequence

from casid.data.problem import Problem
from casid.errors import shell_option
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.simulation.instability import growth_rate


def approach(
    problem: Problem, found: Corrected, segments: int, feedback: Sequence[str]
) -> dict[str, str]:
    """Sentences by what they are about.

    Parameters
    ----------
    segments : that were requested.
    feedback : warnings of inputs that follow a residual.
    """
    out: dict[str, str] = {}
    criterion = found.fit.criterion
    if criterion.segments > max(segments, 1):
        rate = growth_rate(criterion)
        out["segments"] = (
            f"the model is unstable: at the start values a small error grows e-fold in "
            f"{1 / rate:.2g} s, so a simulation of a whole record diverges; the record is cut "
            f"into {criterion.segments} segments that are joined by constraints"
        )
    if found.text:
        out["noise on inputs"] = found.text
    if found.weights is not None:
        out["weights"] = found.weights.text
    elif found.why_plain:
        out["weights"] = f"plain least squares: {found.why_plain}"
    if found.why_not or feedback or found.reference:
        out["instruments"] = _instruments(problem, found)
    elif problem.external:
        out["instruments"] = "not needed: nothing shows that least squares is biased"
        if found.is_removed:
            out["instruments"] = "not needed: what remains after the removal of the bias is noise"
    return out


def _instruments(problem: Problem, found: Corrected) -> str:
    """Whether a signal is recorded that may be a reference; which one no record can say."""
    if found.reference:
        name, apart = found.apart
        return (
            f"chosen, since feedback or noise on inputs biases least squares: made of "
            f"{found.reference}, which is declared external. Least squares is off by "
            f"{apart:.2g} standard errors in {name}"
        )
    if found.refused:
        return f"not chosen, although {problem.external[0]} is declared external: {found.refused}"
    model = problem.model
    records = [e.record for e in found.fit.criterion.experiments]
    beside = [
        name
        for name in problem.recorded
        if name not in {*model.inputs, *model.outputs} and all(name in r for r in records)
    ]
    if not beside:
        return (
            "not possible: beside the model's channels nothing is recorded that could be a "
            "reference"
        )
    names, example = " or ".join(beside), shell_option("--reference", beside[0])
    return (
        "not chosen: only you can know whether a disturbance affects a signal; if none affects "
        f"{names}: {example}, or external={beside[0]!r} in the problem"
    )
