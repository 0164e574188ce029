"""Views of records that are simulated with an estimate which simulated nothing itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.data.experiment import Experiment
from casid.errors import SolveError
from casid.estimation.estimate import Estimate, RecordView
from casid.estimation.fitted.fitted_model import FittedModel


def simulated_views(
    estimate: Estimate, experiments: Sequence[Experiment]
) -> tuple[RecordView, ...]:
    """Measured outputs of every record beside those of a free simulation, in declared units.

    The recorded inputs drive it, from the initial state with which the record is simulated best.

    Raises
    ------
    SolveError
        If the estimate has no model to simulate, or its simulation diverges.
    DataError
        If a record lacks an input of the model.
    """
    fitted = estimate.model
    if fitted is None:
        raise SolveError(
            "the model has an input that nobody measures, a parameter without a value, or no state"
        )
    return tuple(_view(fitted, e) for e in experiments)


def _view(fitted: FittedModel, experiment: Experiment) -> RecordView:
    record, model = experiment.record, fitted.model
    outputs = [n for n in model.outputs if n in record.names]
    simulated = fitted.predict(experiment, None)
    y = np.column_stack([simulated[n] for n in outputs])
    bad = np.flatnonzero(~np.isfinite(y).all(axis=1))
    if bad.size:
        raise SolveError(
            f"{experiment.name}: the simulation diverges at t = {record.t[bad[0]]:g} s"
        )
    measured = np.column_stack([record[n] for n in outputs])
    view = RecordView(
        name=experiment.name,
        t=np.asarray(record.t),
        outputs=tuple(outputs),
        output_units=tuple(model.outputs[n][1] for n in outputs),
        measured=measured,
        used=~np.column_stack([record.is_missing(n) for n in outputs]),
        fitted=np.ones(record.N, dtype=bool),
        baseline=y,
        extended=None,
        inputs=(),
        input_units=(),
        u=np.empty((record.N, 0)),
        states=(),
        state_units=(),
        x=np.empty((record.N, 0)),
    )
    return view if model.takes_si else view.in_units(model.declared_units)
