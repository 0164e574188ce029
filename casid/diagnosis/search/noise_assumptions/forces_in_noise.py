"""Causes that forces in the noise hide where they are small against the noise of the sensors.

The noise of a model may hold white forces beside the noise of its sensors and inputs. Where their
part is far more than the rest, misfit is known to pass for them. Where it is a few per cent, of
many samples, they explain the misfit of a cause that acts for a small part of the record as well,
and under them its score is small. So where no cause is found, and the forces are likelier than none
by BIC, effects are tested under the noise of sensors and inputs alone, too. One that raises the
likelihood by more than the forces, each less its price, is looked for there; what is found is
compared with a random disturbance in its place, as all causes are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.adoption.refinement import Adoption
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.disturbance.disturbance_price import price_of
from casid.diagnosis.search.noise_assumptions.disturbance_rival import weighed_against_disturbances
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.settings import DiagnosisSettings


def found_without_forces(
    search: Search, alone: Weighted, baseline: Baseline, settings: DiagnosisSettings
) -> tuple[Search, Weighted, Adoption] | None:
    """The search under sensors and inputs alone, the model as it is there, and the causes found.

    None where no effect, or none beside a random disturbance, explains more than the forces.

    Parameters
    ----------
    alone : the model of `baseline` without forces in its noise.
    """
    settings.progress("test every effect without forces in the noise")
    again = replace(search, first_table=None, first_candidates=[], refused=[])
    table = again.table(alone, [])
    if not again.has_alarm(alone, table):
        return None
    refitted = again.round(alone, table, [])
    if not _explains_more(refitted, baseline.start, alone, len(table.tested)):
        return None
    found = adopt_causes(again, alone, baseline.fit, baseline.split, settings.refit)
    if not found.adopted:
        return None
    misfit = replace(baseline, start=replace(alone, noise_absorbs_misfit=True))
    compared = weighed_against_disturbances(again, found, misfit, settings)
    return compared if compared[2].adopted else None


def _explains_more(
    found: Sequence[Candidate], start: Weighted, alone: Weighted, tested: int
) -> bool:
    """True if an effect raises the likelihood by more than the forces do, each less its price.

    Parameters
    ----------
    start, alone : the model with forces in its noise, and without.
    tested : effects among which the candidates were chosen.
    """
    n = start.criterion.n_samples
    forces = price_of(len(start.full.forces(start.model.inputs)), n, 1)
    by_forces = 2 * (minus_log_likelihood(alone) - minus_log_likelihood(start)) - forces
    merits = (c.gain - price_of(c.effect.cost, n, tested) for c in found)
    return max(merits, default=0.0) > max(by_forces, 0.0)
