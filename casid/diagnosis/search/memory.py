"""Results that a search keeps: tests, scores and refits of a model under one noise."""

from __future__ import annotations

from dataclasses import dataclass, field

from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.evidence.residual_tests import ResidualTests
from casid.diagnosis.evidence.score_tests import ScoreTable
from casid.diagnosis.search.candidates import Candidate
from casid.estimation.simulation.minimization import Fit


@dataclass(slots=True)
class Memory:
    """Results kept, shared by the searches with and without disturbances in the noise.

    Attributes
    ----------
    tested : the last model whose residual was tested.
    disturbed : fit -> the model under the disturbances that its residual shows.
    tables : of a model and the causes that are in it -> the scores of all effects.
    refits : of a model without causes -> its shortlist as refitted, as large as the records each.
    references : recorded channels that are references of a control loop; None until sought.
    """

    tested: tuple[Weighted, ResidualTests] | None = None
    disturbed: dict[Fit, Weighted] = field(default_factory=dict)
    tables: dict[tuple[Weighted, tuple[Candidate, ...]], ScoreTable] = field(default_factory=dict)
    refits: dict[Weighted, list[Candidate]] = field(default_factory=dict)
    references: tuple[str, ...] | None = None
