"""The estimate of least squares or instrumental variables, with its stages and tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.files import write_json
from casid.estimation.covariance import Sampled
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.propagation import Propagated
from casid.estimation.moments.stages.stage import StageFit
from casid.model.model import Model
from casid.model.units import difference_from_si
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class MomentEstimate(Presented):
    """An estimate from moment equations, with what the instruments could see.

    Values, standard errors and covariance are in the units that the model declares.

    Attributes
    ----------
    estimate : values, covariance with everything propagated, status, provenance.
    propagated : the covariances (SI), and the overidentification test.
    stages : what every stage found (SI), its iterations, instruments and noise models.
    """

    model: Model
    estimate: Estimate
    propagated: Propagated
    stages: tuple[StageFit, ...]
    prior: Prior | None = None

    def __getitem__(self, name: str) -> float:
        """The value of a parameter, in its unit."""
        return self.estimate[name]

    def parameter(self, name: str) -> Estimated:
        """The parameter called `name`, with its unit and standard error."""
        return self.estimate.parameter(name)

    @property
    def parameters(self) -> tuple[Estimated, ...]:
        """Every parameter, as `Estimate` has them."""
        return self.estimate.parameters

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.estimate.references()

    @property
    def values(self) -> dict[str, float]:
        """Every parameter of the model at the estimate, load cases left out."""
        return {p.name: p.value for p in self.estimate.parameters}

    @property
    def covariance(self) -> Array:
        """(n, n) in the order of `names`."""
        scaled: Array = self.propagated.covariance * np.outer(self._scale, self._scale)
        return scaled

    @property
    def _scale(self) -> Array:
        """(n,) factors from SI to the unit of each estimated parameter."""
        units = {p.name: p.unit for p in self.parameters}
        return np.array([float(difference_from_si(1.0, units[n])) for n in self.names])

    @property
    def names(self) -> tuple[str, ...]:
        """The estimated parameters in the order of the stages."""
        return self.propagated.names

    def std_error(self, name: str, *, propagated: bool = True) -> float:
        """Standard error; `propagated=False` takes earlier stages and known values as exact."""
        matrix = self.propagated.covariance if propagated else self.propagated.own
        i = self.names.index(name)
        return float(np.sqrt(max(matrix[i, i], 0.0)) * self._scale[i])

    def sample(self, function: Any, **options: Any) -> Sampled:
        """Draws of N(estimate, covariance) through a map, as Figure 7.15; see `Estimate.sample`."""
        return self.estimate.sample(function, **options)

    def __repr__(self) -> str:
        return f"<MomentEstimate {self.estimate.problem}: {self.estimate.method}>"

    def to_json(self) -> dict[str, Any]:
        """The content of `estimate.json`, with what moment equations add to it."""
        p = self.propagated
        return {
            **self.estimate.to_json(),
            "overidentification": {
                "chi2": p.statistic,
                "degrees_of_freedom": p.degrees,
                "p_value": p.p_value,
            },
            "std_error_unpropagated": {n: self.std_error(n, propagated=False) for n in self.names},
            "instruments": {
                f"stage {i + 1}/{part.name}": {
                    "rank": c.rank,
                    "coefficients": list(part.equation.coefficients),
                    "canonical_correlations": c.canonical.tolist(),
                    "weakest": dict(c.weakest),
                    "number": len(e.instruments),
                }
                for i, st in enumerate(self.stages)
                for part, c, e in zip(st.parts, st.correlations, st.equations, strict=False)
            },
        }

    def write(self, folder: str | Path) -> Path:
        """Write `estimate.json` into `folder`, whole or not at all; returns its path."""
        return write_json(Path(folder) / "estimate.json", self.to_json())
