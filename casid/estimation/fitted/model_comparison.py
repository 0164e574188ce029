"""Fitted models compared on one record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.estimation.fit_statistics import nrmse_fit, rms
from casid.model.quantities import count_text
from casid.presentation import Presented, present

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison(Presented):
    """How well several models agree with one record.

    Attributes
    ----------
    record : name of the record.
    horizon : samples ahead of which was predicted; None for free simulation.
    t : (N,) s. outputs, units : names and SI units.
    measured : (N, ny), NaN where a sample is missing.
    expected : model -> (N, ny) simulated or predicted outputs.
    fit : model -> output -> 100 (1 - |y - yhat| / |y - mean y|) per cent.
    rmse : model -> output -> RMS error, SI.
    declared : the units that text and figures show; `units` by default.
    notes : what the models hold that does not act in this record.
    """

    record: str
    horizon: int | None
    t: Array
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    measured: Array
    expected: Mapping[str, Array]
    fit: Mapping[str, Mapping[str, float]]
    rmse: Mapping[str, Mapping[str, float]]
    declared: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def how(self) -> str:
        """Whether the models simulate or predict, in words."""
        if self.horizon is None:
            return "free simulation"
        return f"prediction {count_text(self.horizon, 'sample')} ahead"

    def to_frame(self) -> pd.DataFrame:
        """Fit in per cent: a row a model, a column an output."""
        import pandas as pd

        return pd.DataFrame({name: dict(row) for name, row in self.fit.items()}).T

    def to_json(self) -> dict[str, Any]:
        """The numbers without the signals."""
        return {
            "record": self.record,
            "horizon": self.horizon,
            "fit_percent": {name: dict(row) for name, row in self.fit.items()},
            "rmse": {name: dict(row) for name, row in self.rmse.items()},
            "notes": list(self.notes),
        }

    def __repr__(self) -> str:
        best = max(self.fit, key=lambda name: sum(self.fit[name].values()))
        return f"<ModelComparison on {self.record}: {len(self.fit)} models, best {best}>"

    def plot(self) -> Any:
        """Measured against simulated or predicted outputs, as a Plotly figure."""
        return present(self, "figure")


def compared(
    record: Record,
    expected: Mapping[str, Record],
    units: Mapping[str, str],
    horizon: int | None,
    declared: Sequence[str] = (),
    notes: tuple[str, ...] = (),
) -> ModelComparison:
    """The comparison of what models expect with what was measured.

    Parameters
    ----------
    expected : model -> its outputs over the record.
    units : output -> SI unit.
    declared : units of the outputs that are shown.
    notes : `ModelComparison.notes`.
    """
    outputs = tuple(units)
    measured = np.column_stack([np.where(record.is_missing(n), np.nan, record[n]) for n in outputs])
    arrays = {
        model: np.column_stack([found[n] for n in outputs]) for model, found in expected.items()
    }

    def by_output(values: Array) -> dict[str, float]:
        return dict(zip(outputs, values.tolist(), strict=True))

    return ModelComparison(
        record=record.name,
        horizon=horizon,
        t=np.asarray(record.t),
        outputs=outputs,
        units=tuple(units.values()),
        measured=measured,
        expected=arrays,
        fit={m: by_output(nrmse_fit(measured, measured - y)) for m, y in arrays.items()},
        rmse={m: by_output(rms(measured - y)) for m, y in arrays.items()},
        declared=tuple(declared),
        notes=notes,
    )
