"""The saved result that a command names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from casid.errors import DataError

if TYPE_CHECKING:
    from casid.estimation.fitted.fitted_model import FittedModel


def fitted_model(path: str) -> FittedModel:
    """The fitted model of a saved result, or of a folder of `casid identify` or `casid diagnose`.

    Raises
    ------
    DataError
        If there is no such result, or it has no model that can be simulated.
    """
    from casid.estimation.fitted.fitted_model import FittedModel
    from casid.saving.archive import load

    if Path(path).suffix == ".py":
        raise DataError(
            f"{path} is a problem file; fit it first, casid identify {path} DATA --out DIR, and "
            "name DIR"
        )
    result = load(path)
    model = result if isinstance(result, FittedModel) else getattr(result, "model", None)
    if not isinstance(model, FittedModel):
        raise DataError(
            f"{path} holds a {type(result).__name__} without a fitted model; name the result of "
            "casid identify or casid diagnose"
        )
    return model
