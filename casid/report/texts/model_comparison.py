"""A comparison of fitted models as a document."""

from __future__ import annotations

from casid.estimation.fitted.model_comparison import ModelComparison
from casid.report.document import Document, Table


def model_comparison_document(found: ModelComparison) -> Document:
    """Fit in per cent and RMS error of every output, a row a model."""
    head = ["model"]
    for output, unit in zip(found.outputs, found.units, strict=True):
        head += [f"{output} [%]", f"rms [{unit}]"]
    rows = []
    for model in found.fit:
        cells = [model]
        for output in found.outputs:
            cells += [f"{found.fit[model][output]:.2f}", f"{found.rmse[model][output]:.4g}"]
        rows.append(cells)
    table = Table(head, rows, numbers=range(1, len(head)))
    return Document(f"Fit to {found.record}, {found.how}", [table])
