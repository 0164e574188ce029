"""The extended model of a diagnosis: the baseline with every cause that was found."""

from __future__ import annotations

from dataclasses import replace

from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.findings import Findings
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.parts import AddedCause, fingerprint
from casid.model.effects.channels.channel_effects import sensor_scale


def extended_model(
    found: Findings, fitted: FittedModel, baseline: FittedModel | None
) -> FittedModel:
    """`fitted`, the model of the extended fit, with the `baseline` and the causes in it.

    A channel that was recorded with the wrong sign was negated before the fit; here the sign is in
    the model, which takes the record as it is.
    """
    model, records = fitted.model, fitted.records
    kept = [a for a in found.remainders if a.candidate.names[0] in found.best_fit.criterion.names]
    causes = [_cause(a, fitted) for a in (*found.adopted, *kept)]
    negated = found.baseline.negated
    if negated is not None:
        model, names = sensor_scale(model, negated.channel).extended(model)
        model = model.with_known(**{names[0]: -2.0})
        recorded = found.baseline.recorded.fitted
        records = tuple(
            replace(r, fingerprint=fingerprint(model, e.record))
            for r, e in zip(records, recorded, strict=True)
        )
        causes.insert(0, AddedCause("sensor_scale", negated.channel, names))
    sizes = found.baseline.rectified
    if sizes is not None:
        causes.insert(0, AddedCause("rectified", sizes.channel, (sizes.name,)))
    return replace(
        fitted,
        model=model,
        records=records,
        baseline=baseline,
        causes=tuple(causes),
    )


def _cause(adopted: Adopted, fitted: FittedModel) -> AddedCause:
    effect, names = adopted.candidate.effect, adopted.candidate.names
    return AddedCause(
        effect.kind,
        effect.where,
        tuple(n for n in names if n in fitted.model.parameters),
        dict(effect.constants),
        effect.shape,
        effect.description,
    )
