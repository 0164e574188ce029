"""Residual, tangent and signatures of a catalogue: the columns that scores are computed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.feedback import inputs_without_feedthrough, slope
from casid.estimation.noise.innovations import GROUP
from casid.estimation.noise.thresholds import REMOVAL
from casid.estimation.simulation.input_noise.input_noise import input_noise_sd
from casid.estimation.simulation.minimization import Fit, widened
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Effect, extend_all


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Residual, tangent and signatures from the simulation of an extended model.

    Attributes
    ----------
    wide : the criterion with every effect at its null value.
    tangent : columns of the model's own unknowns.
    candidate : columns of the effects' first parameters.
    clipped : effects without a derivative at their null value.
    late : a delay's column, and the output that it makes late.
    effects : all of them, those of clippings last.
    """

    wide: SimulationError
    tangent: Sequence[int]
    candidate: Sequence[int] = ()
    clipped: Sequence[Effect] = ()
    late: Sequence[tuple[int, int]] = ()
    effects: Sequence[Effect] = ()

    @property
    def judged(self) -> list[int]:
        """The column that each effect is scored by: for delays in closed loop a later one."""
        plain = len(self.candidate) + len(self.clipped)
        order = list(range(plain))
        for i, (column, _) in enumerate(self.late):
            order[column] = plain + i
        return order

    def of_record(self, x: Array, k: int, added: Array | None = None) -> tuple[Array, Array, Array]:
        """Whitened residual (M,), baseline tangent and signatures of one record.

        Samples by outputs are stacked; `added` (N, nu) is noise on the inputs. Signatures are those
        of the candidates, of the clippings, and of the delays by slopes of what came before.
        """
        wide, d = self.wide, self.wide.data[k]
        if added is not None:
            d = replace(d, u=d.u + added)
        at = wide.simulated(x, k, signals=d)
        extra = np.zeros((*at.y.shape, len(self.clipped) + len(self.late)))
        for j, effect in enumerate(self.clipped):
            if effect.variant is None:
                raise ModelError(f"{effect!r} has no level to test at")
            i = wide.outputs.index(effect.where)
            y = at.y[:, i]
            extra[:, i, j] = (np.clip(y, -effect.variant, effect.variant) - y) * d.used[:, i]
        ny, n = len(wide.outputs), len(self.candidate)
        anew = wide.starts_anew(k)
        for j, (_, i) in enumerate(self.late, len(self.clipped)):
            extra[:, i, j] = -slope(at.y[:, i], d.Ts, backward=True, anew=anew) * d.used[:, i]
        psi = np.empty((len(at.y), ny, n + extra.shape[2]))
        for first in range(0, n, GROUP):
            group = slice(first, min(first + GROUP, n))
            psi[:, :, group] = _white(wide, at.jacobian[:, :, list(self.candidate[group])], k)
        psi[:, :, n:] = _white(wide, extra, k)
        tangent = at.jacobian[:, :, list(self.tangent)]
        both = _white(wide, np.concatenate([at.residual[:, :, None], tangent], axis=2), k)
        both = both.reshape(-1, 1 + len(self.tangent))
        return both[:, 0].copy(), both[:, 1:].copy(), psi.reshape(len(both), psi.shape[2])

    def antithetic(
        self, x: Array, k: int, sd: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Change of `of_record` by a draw of input noise, without its part even in the noise.

        The draw is `REMOVAL.drawn_share` of the noise, and what it adds is scaled up. The record
        has noise of its own already: with a whole draw more, a function with a kink where an input
        rests, as the sign of a rate, shows 1/sqrt(2) of what that noise gives to it.

        Channels without noise take no part in the draw: candidates that bring one leave it as it
        is.
        """
        w, share = np.zeros(self.wide.data[k].u.shape), REMOVAL.drawn_share
        noisy, here = np.flatnonzero(sd > 0), input_noise_sd(self.wide.data, k, sd)
        w[:, noisy] = share * here[noisy] * rng.standard_normal((len(w), len(noisy)))
        up, down = (self.of_record(x, k, sign * w) for sign in (1.0, -1.0))
        for above, below in zip(up, down, strict=True):
            above -= below
            above *= 0.5 / share
        return up


def extended_columns(fit: Fit, effects: Sequence[Effect]) -> Columns:
    """Columns of the fitted model with every effect in it, those of clippings last."""
    base = fit.criterion
    effects = [e for test in ("score", "clip") for e in effects if e.test == test]
    scored = [e for e in effects if e.test == "score"]
    model, names = extend_all(base.model, scored)
    wide = widened(fit, model)
    position = {n: i for i, n in enumerate(wide.names)}
    late = [
        (i, wide.outputs.index(e.where))
        for i, e in enumerate(scored)
        if e.kind in ("time_delay", "sensor_lag")
        and e.where in wide.outputs
        and inputs_without_feedthrough(base.model, e.where)
    ]
    return Columns(
        wide,
        [position[n] for n in base.names],
        [position[n] for n in names],
        [e for e in effects if e.test == "clip"],
        late,
        effects,
    )


def without(criterion: SimulationError, x: Array, names: Sequence[str]) -> Array:
    """Variables (n,) with some of them at zero: gains that do nothing."""
    return np.where([name in names for name in criterion.names], 0.0, x)


def _white(wide: SimulationError, columns: Array, k: int) -> Array:
    """Columns (N, ny, m) weighted and whitened; `columns` are used up."""
    columns *= wide.weights[None, :, None]
    return columns if wide.whiten is None else wide.whiten(columns, k)
