"""The steps that refine causes, begun from the baseline of a diagnosis."""

from __future__ import annotations

from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.search.adoption.refinement import Refinement
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.simulation.minimization import Fit


def baseline_refinement(
    search: Search, baseline: Baseline, settings: DiagnosisSettings, in_units_of: Fit | None = None
) -> Refinement:
    """The steps whose model without causes is the baseline.

    Parameters
    ----------
    in_units_of : the fit whose weights are the units of the errors; None: that of the baseline.
    """
    units = (in_units_of or baseline.fit).criterion.weights
    split = baseline.split
    return Refinement(search, split, settings.refit, units, baseline.start, baseline.fit)
