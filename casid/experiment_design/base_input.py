"""An input that keeps the limits where the input at rest does not: a room that has to be heated.

First the limits are relaxed by as little as possible; where they need not be, the input is found
that stays as far from all of them as it can. Amplitudes of standard inputs are measured from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.errors import SolveError
from casid.experiment_design.information import Target
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.program import Program
from casid.experiment_design.thresholds import KEEPING


def based(prediction: Prediction) -> Prediction:
    """The prediction with an input that keeps all limits as its base, where rest does not.

    Raises
    ------
    SolveError
        If there is none: which limit to relax, by how much.
    """
    if prediction.is_allowed(*prediction.setup.begun_at):
        return prediction
    base = _nearest(prediction)
    inner = _solved(prediction, base, (-KEEPING.room, 0.0))
    if prediction.is_allowed(*inner):
        base = inner
    return replace(prediction, setup=replace(prediction.setup, base=base))


def _nearest(prediction: Prediction) -> tuple[Array, Array]:
    """An input with which no limit has to be relaxed."""
    setup = prediction.setup
    ends = np.array([setup.limits.inputs[n] for n in setup.designed]).reshape(-1, 2).T
    for share in np.linspace(0, 1, KEEPING.levels):
        held = np.tile(ends[0] + share * (ends[1] - ends[0]), (setup.N, 1))
        constant = held, setup.begun_at[1]
        if not setup.limits.slew and prediction.is_allowed(*constant):
            return constant
    solved = _solved(prediction, setup.begun_at, (0.0, np.inf))
    if prediction.is_allowed(*solved):
        return solved
    # The solution touches a limit, or exceeds it between the nodes of the program.
    over = prediction.excess(*solved)
    if not np.all(np.isfinite(over)):
        raise SolveError(
            f"{setup.nominal.name}: every simulation within the limits diverges; check the "
            "parameters' values and the limits of the inputs"
        )
    if np.all(over <= KEEPING.touched * setup.limits.widths):
        inner = _solved(prediction, solved, (-KEEPING.room, 0.0))
        if prediction.is_allowed(*inner):
            return inner
    model = setup.nominal.acting
    relaxed = [
        f"{n} by {model.shown_size(n, 1.01 * v):.3g} {model.unit_of(n)}"
        for n, v in zip(setup.limits.signals, over.tolist(), strict=True)
        if v > 0
    ]
    raise SolveError(
        f"{setup.nominal.name}: no input keeps every limit; relax the limit of "
        f"{', and of '.join(relaxed)}, or start elsewhere (--x0)"
    )


def _solved(
    prediction: Prediction, begun: tuple[Array, Array], slack: tuple[float, float]
) -> tuple[Array, Array]:
    """The input whose limits, as shares of their widths, are relaxed least."""
    setup = prediction.setup
    # No rival is fitted where only the limits are in question.
    possible = [prediction.hypotheses[i] for i in prediction.possible]
    alone = Prediction(setup, possible, [], prediction.substeps)
    margins = np.zeros(len(setup.limits.signals))
    targets: list[Target] = []
    program = Program(alone, targets, KEEPING.feasible, margins)
    w = setup.excitation.nearest(begun[0] - setup.at_rest)
    solved = program.solve(w, begun[1], slack=slack)
    return solved.u, solved.release
