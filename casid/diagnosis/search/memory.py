"""What a search has computed of a model under one noise, kept for where it is requested again."""

from __future__ import annotations

from dataclasses import dataclass, field

from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.evidence.residual_tests import ResidualTests
from casid.diagnosis.evidence.score_tests import ScoreTable
from casid.diagnosis.search.candidates import Candidate
from casid.estimation.simulation.minimization import Fit

Extended = tuple[Weighted, tuple[Candidate, ...]]
"""A model and the causes that are in it, by identity."""


@dataclass(slots=True)
class Memory:
    """Shared by the search under the noise of sensors and inputs, and by that beside disturbances.

    Attributes
    ----------
    tested : the last model whose residual was tested.
    disturbed : fit -> the model under the disturbances that its residual shows.
    tables, refits : of a model -> the scores of all effects, and the shortlist as refitted.
    references : recorded channels that are references of a control loop; None until sought.
    """

    tested: tuple[Weighted, ResidualTests] | None = None
    disturbed: dict[Fit, Weighted] = field(default_factory=dict)
    tables: dict[Extended, ScoreTable] = field(default_factory=dict)
    refits: dict[Extended, list[Candidate]] = field(default_factory=dict)
    references: tuple[str, ...] | None = None
