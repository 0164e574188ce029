"""Whether a random disturbance explains the whole misfit: then no cause has to be sought.

A search in a record with waves, say, finds many effects that imitate them, refits them, and refuses
them all against a disturbance in their place. Three checks predict that without the search: the
residual under the disturbance is random, and none of the effects that score best, with the
disturbance or under the sensors' noise alone, raises the likelihood with the disturbance by more
than its penalty. An effect that by its score explains most of the misfit is refitted beside the
disturbance, and the best of these in its place. All that score best are, if one is significant
there, or if the model errs by many times the sensors' noise, where linearised scores are inexact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from casid.diagnosis.evidence.gain_under_disturbance import (
    gains_under_disturbance,
    unwhitened,
)
from casid.diagnosis.evidence.records.signal_sizes import window_of
from casid.diagnosis.evidence.scores.score_tests import Score, ScoreTable
from casid.diagnosis.evidence.scores.signature_columns import extended_columns
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.disturbance.disturbance_price import (
    explaining_disturbance,
    pays_at_best,
    price_of,
)
from casid.diagnosis.search.instants.jump_times import placed, placed_by_tangents
from casid.diagnosis.search.instants.temporary_changes import temporary_changes
from casid.diagnosis.search.rounds import Search, strongest_of_each
from casid.diagnosis.thresholds import DISTURBED, RESTARTS
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.periodic import sinusoid
from casid.model.effects.effect import Effect
from casid.model.effects.search_ranges import PARAMETER_JUMPS, PERIODIC_FORCES


def sole_disturbance(
    search: Search, start: Weighted, base: Fit, adopted: Sequence[Candidate] = ()
) -> Weighted | None:
    """The model under a disturbance that explains its whole misfit; None where more is left.

    Parameters
    ----------
    start, base : the model, under the sensors' noise and by its simulation error.
    adopted : the causes that are in it.
    """
    search.progress("test whether a random disturbance explains all that the model leaves")
    bare, beside = explaining_disturbance(search, start, base), search.with_disturbances()
    if bare is None:
        return None
    table = beside.table(bare, adopted)
    gains = _Gains.of(search, bare)
    if gains.best_pays(table):
        return None
    alone = search.table(start, adopted)
    for effects, cost in (
        (_best_scored(start, alone), 1),
        (_lasting_changes(start, alone), PARAMETER_JUMPS.cost),
        (_ended_change(start, alone), PARAMETER_JUMPS.cost_of_two),
        (_spectral_lines(start, alone), PERIODIC_FORCES.cost),
    ):
        if gains.one_pays(effects, cost, len(alone.tested), start.noise):
            return None
    is_far = error_over_noise(base, start.noise) > RESTARTS.far and not adopted
    if is_far and _change_pays(search, start, base, alone):
        return None
    explaining = _explaining(start, alone)
    if _refit_pays(bare, table, beside.refits_of(bare, explaining)):
        return None
    for c in search.refits_of(start, explaining[:1]):
        # Beside a slow disturbance a constant gains nothing: that one explains it, less simply.
        if pays_at_best(search, base, c, len(alone.tested)):
            return None
    if is_far or beside.has_alarm(bare, table):
        if _refit_pays(bare, table, beside.round(bare, table, adopted)):
            return None
    if search.first_table is None:
        search.first_table = table
    if search.under_disturbance(base) is bare:
        return bare
    # A candidate led to a likelier disturbance of the model as it is.
    return explaining_disturbance(search, start, base)


def _refit_pays(bare: Weighted, table: ScoreTable, refitted: Sequence[Candidate]) -> bool:
    """True if an effect pays for itself by what its refit beside the disturbance gains."""
    n, tested = bare.criterion.n_samples, len(table.tested)
    return any(c.gain > price_of(c.effect.cost, n, tested) for c in refitted)


def _change_pays(search: Search, start: Weighted, base: Fit, table: ScoreTable) -> bool:
    """True if the most promising change in time, refitted and placed, pays beside what it leaves.

    Far from the record the parameters have followed the change, and tangents misplace it, whose
    instants are then too inexact to gain anything beside the disturbance that explains it.

    Parameters
    ----------
    start, table : the model under its sensors' noise, and its scores there.
    base : the model by its simulation error.
    """
    changes = [s for s in table.tested if s.effect.sets_in and s.effect.end is None]
    changes.sort(key=lambda s: -s.unrobust)
    promising = sorted([*changes[:1], *temporary_changes(start, table)], key=lambda s: -s.unrobust)
    found = search.refits_of(start, promising[:1])
    for c in placed(search.refitting, start, found, [], search.progress):
        if pays_at_best(search, base, c, len(table.tested)):
            return True
    return False


def pays_beside(search: Search, at: Weighted, table: ScoreTable) -> bool:
    """True if one of the effects that score best beside a disturbance pays for itself there.

    Its score, robust to what a disturbance leaves of misfit, knows a change at an instant, or with
    few steps of an input, by few independent samples: the likelihood, in which the disturbance is
    estimated again, knows it by all of them.

    Parameters
    ----------
    at, table : a model under a disturbance, and its scores there.
    """
    return _Gains.of(search, at).best_pays(table)


@dataclass(frozen=True, slots=True)
class _Gains:
    """Gains in likelihood of effects in a model under a disturbance.

    Attributes
    ----------
    at : the model at the likeliest point under the disturbance; `bare` as it was found.
    plain : the same point with the criterion weighted, not whitened.
    """

    known: Mapping[str, float]
    bare: Weighted
    at: Weighted
    plain: Fit

    @classmethod
    def of(cls, search: Search, bare: Weighted) -> _Gains:
        """The gains in a model under a disturbance, at its likeliest point."""
        at = replace(bare, fit=bare.unbiased or bare.fit)
        plain = replace(at.fit, criterion=unwhitened(at))
        return cls(search.weighing.known_noise, bare, at, plain)

    def best_pays(self, table: ScoreTable) -> bool:
        """True if one of those that score best there does."""
        return self.one_pays(_best_scored(self.bare, table), 1, len(table.tested), self.bare.noise)

    def one_pays(
        self, effects: Sequence[Effect], cost: int, tested: int, under: NoiseModel
    ) -> bool:
        """True if an effect raises the likelihood by more than it is charged.

        Parameters
        ----------
        cost : parameters of each effect.
        tested : effects among which they were chosen.
        under : the noise under which they are first regressed out.
        """
        columns = extended_columns(self.plain, effects)
        needed = 0.5 * price_of(cost, self.at.criterion.n_samples, tested)
        chosen = range(len(columns.effects))
        gains = gains_under_disturbance(
            self.at, columns, chosen, known=self.known, passing=needed, under=under
        )
        return any(gain > needed for gain in gains)


def _best_scored(at: Weighted, table: ScoreTable) -> list[Effect]:
    """The effects that score best, and the changes that are over before the record is.

    Without lines: those are estimates, and have a price of their own.
    """
    scored = [s for s in table.tested if s.effect.test != "peak"]
    scored.sort(key=lambda s: -s.unrobust)
    best = [*scored[: DISTURBED.looked_at], *temporary_changes(at, table)]
    return [s.effect for s in best]


def _explaining(at: Weighted, table: ScoreTable) -> list[Score]:
    """The lasting effects that by their scores explain most of the misfit, one of a kind and place.

    A slow disturbance explains as much of a misfit that goes with a slow input, but not as simply.

    Parameters
    ----------
    at, table : a model under its sensors' noise, and its scores there.
    """
    excess = 2 * at.fit.solution.value - at.criterion.n_samples
    lasting = (s for s in table.tested if not s.effect.is_on_the_clock)
    most = [s for s in lasting if s.unrobust > DISTURBED.explains * excess]
    return list(strongest_of_each(most).values())[: DISTURBED.looked_at]


def _lasting_changes(at: Weighted, table: ScoreTable) -> list[Effect]:
    """The most promising changes that stay, one of each kind and place, where they leave least.

    On the grid of the scores each is late by up to half a step of the grid, in which a disturbance
    explains it, and all of it after that. The one that scores best far from the record need not be
    the one that leaves a smaller disturbance: a bias of the sensor may imitate a load.
    """
    steps = [s for s in table.tested if s.effect.sets_in and s.effect.end is None]
    promising = list(strongest_of_each(steps).values())[: DISTURBED.looked_at]
    return [placed_by_tangents(at, s.effect) for s in promising]


def _ended_change(at: Weighted, table: ScoreTable) -> list[Effect]:
    """The most promising change that is over before the record is, at the instants of least misfit.

    Scores of steps place it roughly, and there it gains nothing beside a disturbance, which
    explains what two inexact instants leave.
    """
    promising = temporary_changes(at, table)[:1]
    return [placed_by_tangents(at, s.effect) for s in promising]


def _spectral_lines(at: Weighted, table: ScoreTable) -> list[Effect]:
    """The lines that the sensors' noise does not explain, at the phases of their scores."""
    out = []
    for line in (s for s in table.peaks if s.effect.kind == "periodic_disturbance"):
        frequency, where = line.effect.parameters[2].start, line.effect.where
        amplitudes = line.starts["a_cos"], line.starts["a_sin"]
        out.append(sinusoid(at.model, where, frequency, amplitudes, window_of(at)))
    return out
