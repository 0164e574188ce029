"""Signatures: what the simulation would do differently, were a signal added in one place.

A place is a balance, where the signal is a force and acts along the linearised path ((1) of
`linearised_path`), or an output, where it is added to what the sensor says. Signals are functions
of what is known (`force_functions`). In the place of a parameter they are changes of it. Regressing
the whitened residual on their signatures, off the baseline's own tangent and less what the inputs'
noise gives to signature and residual alike ((1) in `score_tests`), shows on what the missing part
depends.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import f as fisher

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.force_functions import Group, slope_of, variables_of
from casid.diagnosis.evidence.residual.linearised_path import Linearised, Motion
from casid.diagnosis.thresholds import FUNCTIONS, SCORES
from casid.errors import ModelError
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.feedback import inputs_without_feedthrough, one_sample_late, slope
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.residual_autoregressions import Autoregression, autoregression
from casid.estimation.noise.thresholds import REMOVAL
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError


def require_place(criterion: SimulationError, place: str) -> None:
    """Refuse what is no balance, no output of the model, and no estimated parameter.

    Raises
    ------
    ModelError
        With the places that there are.
    """
    model = criterion.model
    if place not in (*model.balances, *criterion.outputs, *criterion.names):
        raise ModelError(
            f"{model.name}: {place!r} is neither a balance nor an output; choose one of "
            f"{', '.join([*model.balances, *criterion.outputs])}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tested:
    """One group of signatures against the residual."""

    group: int
    gain: float  # sum of squares that the group explains, less the baseline's part
    chance: float  # of that, what noise alone is expected to give
    rank: int  # functions that the record sees
    p_value: float
    adjusted: float  # for all groups together


class Regression:
    """The whitened residual on the signatures of groups of signals in one place.

    Parameters
    ----------
    noise : whitens; `input_sd` is the white noise of each measured input.
    place : a balance or an output of the model, or an estimated parameter.
    groups : functions of the variables, see `variables_of` and, for an output, the output's own
        simulated value (under its name) and slope (under "slope of" its name).

    Raises
    ------
    ModelError
        If the model has no such place.
    """

    def __init__(
        self,
        fit: Fit,
        noise: NoiseModel,
        place: str,
        groups: Sequence[Group],
        experiments: Sequence[Experiment],
        *,
        input_sd: Mapping[str, float],
        recorded: Mapping[str, str],
        linearised: Linearised,
        seed: int = 0,
    ) -> None:
        criterion, x, model = fit.criterion, fit.x, fit.criterion.model
        require_place(criterion, place)
        self.fit, self.criterion, self.x = fit, criterion, x
        self.noise, self.input_sd, self.place = noise, input_sd, place
        self.groups, self.experiments, self.recorded = list(groups), experiments, recorded
        self.linearised, self.seed = linearised, seed
        self.ny = len(criterion.outputs)
        sd = np.array([input_sd.get(n, 0.0) for n in model.inputs])
        self._late = inputs_without_feedthrough(model, place) if place in criterion.outputs else []
        parts, drawn = [], []
        for motions in self.linearised.motions(sd, seed):
            own, *noisy = (self._stack(motion) for motion in motions)
            parts.append(own)
            if noisy:
                drawn.append((noisy[0] - noisy[1]) / (2 * REMOVAL.drawn_share))
        whole = np.concatenate(parts)
        n = len(x)
        self.e, self.tangent, self.psi = whole[:, 0], whole[:, 1 : 1 + n], whole[:, 1 + n :]
        self.odd = np.concatenate(drawn) if drawn else None
        edges = np.cumsum([0, *self._widths])
        self.slices = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        self.size = np.sqrt(np.maximum(np.einsum("ij,ij->j", self.psi, self.psi), TINY))

    def changed(
        self, *, groups: Sequence[Group] | None = None, noise: NoiseModel | None = None
    ) -> Regression:
        """The same on other groups, or under another noise."""
        return Regression(
            self.fit,
            noise or self.noise,
            self.place,
            groups or self.groups,
            self.experiments,
            input_sd=self.input_sd,
            recorded=self.recorded,
            linearised=self.linearised,
            seed=self.seed,
        )

    def _stack(self, motion: Motion) -> Array:
        """Whitened residual, tangent and signatures of one record, (N ny, 1 + n + K)."""
        criterion, model = self.criterion, self.criterion.model
        k, d, at = motion.experiment, motion.signals, motion.at
        table = dict(variables_of(criterion, self.experiments, self.recorded, k, at, d))
        if self.place in criterion.outputs:
            y = at.y[:, criterion.outputs.index(self.place)]
            own = slope(y, d.Ts, backward=bool(self._late), anew=criterion.starts_anew(k))
            table |= {self.place: y, slope_of(self.place): own}
            table |= {name: one_sample_late(table[name]) for name in self._late}
            of_late = {slope_of(name): name for name in self._late}
            table |= {
                k: slope(table[n], d.Ts, backward=True) for k, n in of_late.items() if k in table
            }
        made = [group.columns(table) for group in self.groups]
        self._widths = [m.shape[1] for m in made]
        signal = np.hstack(made) if made else np.zeros((d.N, 0))
        if self.place in criterion.outputs:
            out = np.zeros((d.N, self.ny, signal.shape[1]))
            out[:, criterion.outputs.index(self.place)] = signal
        elif self.place not in model.balances:
            out = self._of_parameter(motion, signal)
        else:
            before = self._before_steps(table, made)
            out = motion.path.respond(list(model.balances).index(self.place), signal, before)
            out = self.linearised.through_sensors(out, at.y, k)
        out *= d.used[:, :, None]
        stack = np.concatenate([at.residual[:, :, None], at.jacobian, out], axis=2)
        stack *= criterion.weights[None, :, None]
        return self.noise.whiten(stack, k).reshape(-1, stack.shape[2])

    def _of_parameter(self, motion: Motion, course: Array) -> Array:
        """Outputs (N, ny, m) to courses (N, m) of the parameter; slow ones, of a sensor's."""
        at = motion.at
        change = self.linearised.changed(motion, self.place)
        if change.is_nothing:
            moved = at.jacobian[:, :, self.criterion.names.index(self.place)]
            return np.asarray(moved[:, :, None] * course[:, None, :])
        out = motion.path.respond_to(change, course)
        return self.linearised.through_sensors(out, at.y, motion.experiment)

    def _before_steps(self, table: Mapping[str, Array], made: Sequence[Array]) -> Array | None:
        """The groups' functions right before the samples, at which held inputs step; None if none.

        What follows from the command of a sample must not be said of the sample itself: a
        controller makes that command of what was measured, noise included.
        """
        inputs = self.criterion.model.inputs
        own = [name for name, entry in inputs.items() if "zoh" in entry.holds]
        held = {n for name in own for n in (name, slope_of(name)) if n in table}
        if not any(held & {*group.names} for group in self.groups):
            return None
        before = {**table, **{name: one_sample_late(table[name]) for name in held}}
        return np.hstack(
            [
                group.columns(before) if held & {*group.names} else at_samples
                for group, at_samples in zip(self.groups, made, strict=True)
            ]
        )

    def of_innovations(self) -> Regression:
        """The same where the residual is no white noise: behind an autoregression of each output.

        Residual, tangent and signatures go through it alike, as in generalised least squares.
        """
        models = [autoregression([e[:, i] for e in self.residuals]) for i in range(self.ny)]
        out = copy.copy(self)
        own = (self.e[:, None], self.tangent, self.psi, self.between)
        e, out.tangent, out.psi, out.between = (self._behind(models, rows) for rows in own)
        out.e = e[:, 0]
        out.odd = None if self.odd is None else self._behind(models, self.odd)
        out.size = np.sqrt(np.maximum(np.einsum("ij,ij->j", out.psi, out.psi), TINY))
        return out

    @property
    def residuals(self) -> list[Array]:
        """The whitened residual (N, ny) of each record."""
        return [self.e.reshape(-1, self.ny)[rows] for rows in self._records]

    @property
    def _records(self) -> list[slice]:
        """The samples of each record."""
        edges = np.cumsum([0, *(d.N for d in self.criterion.data)])
        return [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def _behind(self, models: Sequence[Autoregression], columns: Array) -> Array:
        """Columns (N ny, K), each output's samples behind its autoregression, record by record."""
        if not columns.size:
            return columns
        out = columns.reshape(-1, self.ny, columns.shape[1]).copy()
        for rows in self._records:
            for i, model in enumerate(models):
                out[rows, i] = model.whiten(out[rows, i])
        return out.reshape(columns.shape)

    @functools.cached_property
    def between(self) -> Array:
        """`_between` of all records; only a test needs it."""
        data = self.criterion.data
        return np.concatenate([self._between(k) for k in range(len(data))])

    def _between(self, k: int) -> Array:
        """Whitened response to measured inputs `SCORES.between_samples` late, (N ny, inputs)."""
        late = self.linearised.late_inputs(k)
        if not late.shape[2]:
            return np.zeros((late.shape[0] * self.ny, 0))
        white = self.noise.whiten(late * self.criterion.weights[None, :, None], k)
        return np.asarray(white).reshape(-1, late.shape[2])

    @property
    def misfit(self) -> float:
        """Sum of squares left beyond what the noise gives."""
        used = sum(int(d.used.sum()) for d in self.criterion.data)
        return float(self.e @ self.e) - (used - len(self.x))

    @property
    def misfit_sd(self) -> float:
        """Standard deviation of `misfit` by chance: sqrt(2 M) of M squares."""
        return float(np.sqrt(2.0 * len(self.e)))

    def explained_and_energy(self) -> tuple[Array, Array]:
        """(G,) what each group explains, and the energy of its signatures, both off the tangent.

        The first is a sum of squares less the baseline's part, for what the noise leaves of each.
        """
        rest, z, _ = self._rest(())
        gains = [float(np.sum((root.T @ z[j]) ** 2)) for j, root in self._roots(rest)]
        own = np.einsum("ij,ij->j", rest, rest) * self.size**2
        return np.array(gains), np.array([float(own[j].sum()) for j in self.slices])

    def _roots(self, rest: Array) -> Iterator[tuple[slice, Array]]:
        """For each group, the directions that the record excites, of unit length."""
        for j in self.slices:
            values, vectors = np.linalg.eigh(rest[:, j].T @ rest[:, j])
            keep = values > max(SCORES.undetectable, SCORES.relative_rank * values.max(initial=0.0))
            yield j, vectors[:, keep] / np.sqrt(values[keep])

    def _rest(self, chosen: Sequence[int]) -> tuple[Array, Array, Array | None]:
        """Signatures off tangent and `chosen` groups, their scores, and the noise's part in them.

        Returns rest (M, K), z (K,), given (M, K) or None; columns of unit size before projection.
        """
        n = len(self.x)
        taken = [j for g in chosen for j in range(self.slices[g].start, self.slices[g].stop)]
        base = np.hstack([self.tangent, self.psi[:, taken]])
        base_size = np.sqrt(np.maximum(np.einsum("ij,ij->j", base, base), TINY))
        u, s, vt = np.linalg.svd(base / base_size, full_matrices=False)
        keep = s > 1e-6 * s[0]
        unit = self.psi / self.size
        gamma = (vt[keep].T / s[keep]) @ (u[:, keep].T @ unit)
        rest = unit - (base / base_size) @ gamma
        z = rest.T @ self.e
        if self.odd is None:
            return rest, z, None
        turned = np.hstack([self.odd[:, 1 : 1 + n], self.odd[:, 1 + n :][:, taken]])
        changed = self.odd[:, 1 + n :] / self.size
        given = (changed - (turned / base_size) @ gamma) * self.odd[:, :1]
        return rest, z - given.sum(axis=0), given

    def test(
        self,
        chosen: Sequence[int] = (),
        *,
        draws: int = SCORES.function_draws,
        charge: float = 0.0,
    ) -> list[Tested]:
        """Test every group, given that those `chosen` are in the model.

        What measured inputs could give that are no lines between their samples is taken off the
        scores (`SCORES.between_samples`).
        The covariance is that of what the best group leaves: where much is missing, the missing
        part itself would else pass for noise. Each sample counts as foreseen from the others
        (MacKinnon and White, J. Econometrics 29 (1985) 305-325, their jackknife). Family-wise by
        min-p draws, as in `score_tests`.

        Parameters
        ----------
        charge : what a function has to explain, in squares, to count in choosing the best group.
        """
        rest, z, given = self._rest(chosen)
        roots, gains = [], []
        for j, root in self._roots(rest):
            roots.append(root)
            gains.append(float(np.sum((root.T @ z[j]) ** 2)))
        merits = [g - charge * r.shape[1] for g, r in zip(gains, roots, strict=True)]
        free = [i for i in range(len(self.slices)) if i not in chosen and roots[i].shape[1]]
        if not free:
            return []
        best = max(free, key=lambda i: merits[i])
        of_best = self.slices[best]
        left = _leave_one_out(self.e, rest[:, of_best] @ roots[best], roots[best].T @ z[of_best])
        each = np.hstack([rest[:, self.slices[i]] @ roots[i] for i in free])
        edges = np.cumsum([0, *(roots[i].shape[1] for i in free)])
        per_sample = self._per_sample(each * left[:, None])
        lags = bartlett_lags(per_sample)
        covariance = long_run_covariance(per_sample, lags)
        covariance += np.diag(added_variance(each, np.diag(covariance), left))
        if given is not None:
            own = np.hstack([given[:, self.slices[i]] @ roots[i] for i in free])
            own = self._per_sample(own)
            covariance = covariance + long_run_covariance(own - own.mean(axis=0), lags)
        possible = np.abs(rest.T @ self.between).sum(axis=1)
        certain = np.sign(z) * np.maximum(np.abs(z) - possible, 0.0)
        score = np.concatenate([roots[i].T @ certain[self.slices[i]] for i in free])
        freedom = max(
            SCORES.freedom_per_lag * len(per_sample) / (lags + 1), SCORES.least_function_freedom
        )
        slices = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        p, adjusted = _family_wise(score, covariance, slices, freedom, draws, self.seed)
        return [
            Tested(
                group=i,
                gain=gains[i],
                chance=float(np.trace(covariance[part, part])),
                rank=roots[i].shape[1],
                p_value=p[k],
                adjusted=adjusted[k],
            )
            for k, (i, part) in enumerate(zip(free, slices, strict=True))
        ]

    def _per_sample(self, rows: Array) -> Array:
        """Rows (N ny, K) summed over the outputs of each sample, (N, K)."""
        if self.ny == 1:
            return rows
        return np.asarray(rows.reshape(-1, self.ny, rows.shape[1]).sum(axis=1))

    def estimate(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Coefficients of the chosen groups' functions, together, and their covariance.

        Directions that the record does not see are left at zero, with no uncertainty.
        """
        rest, z, _ = self._rest(())
        index = np.concatenate([np.arange(len(self.size))[self.slices[g]] for g in chosen])
        part = rest[:, index]
        values, vectors = np.linalg.eigh(part.T @ part)
        keep = values > max(SCORES.undetectable, SCORES.relative_rank * values.max(initial=0.0))
        root = vectors[:, keep] / np.sqrt(values[keep])
        score = root.T @ z[index]
        left = self.e - part @ (root @ score)
        per_sample = self._per_sample((part @ root) * left[:, None])
        covariance = long_run_covariance(per_sample, bartlett_lags(per_sample))
        map_back = root / self.size[index][:, None]
        return map_back @ score, map_back @ covariance @ map_back.T


def _leave_one_out(e: Array, columns: Array, score: Array) -> Array:
    """Leave-one-out residuals (M,) of e (M,) on columns (M, K), orthonormal, with score (K,).

    Each sample is predicted by a fit to the others. A column that few samples determine, such as a
    step of one sample, would fit the noise of those samples.
    """
    leverage = np.einsum("ij,ij->i", columns, columns)
    return np.asarray((e - columns @ score) / np.maximum(1.0 - leverage, SCORES.undetectable))


def added_variance(columns: Array, variances: Array, left: Array) -> Array:
    """What to add to the variances (K,) of the scores of columns (M, K) of unit length.

    A robust variance from few samples, such as the one that determines a step, may be small by
    chance. The fewer samples determine a column (`samples`, 1 / sum c^4), the closer its variance
    is raised to that of the residual `left` (M,).
    """
    samples = 1.0 / np.maximum(np.einsum("ij,ij,ij,ij->j", *[columns] * 4), TINY)
    share = FUNCTIONS.few_samples / (FUNCTIONS.few_samples + samples)
    return np.asarray(share * np.maximum(float(np.mean(left**2)) - variances, 0.0))


def _family_wise(
    score: Array, covariance: Array, groups: Sequence[slice], freedom: float, draws: int, seed: int
) -> tuple[list[float], list[float]]:
    """p-value of each group's score, alone and for all groups together, by min-p draws."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    sample = rng.standard_normal((draws, len(score))) @ root.T
    sample /= np.sqrt(rng.chisquare(freedom, draws) / freedom)[:, None]
    p = []
    largest: dict[int, Array] = {}  # of the drawn statistics, by rank: p falls with them
    for part in groups:
        rank = part.stop - part.start
        inverse = np.linalg.pinv(covariance[part, part], rcond=1e-10, hermitian=True)
        statistic = _hotelling(score[part] @ inverse @ score[part], rank, freedom)
        p.append(max(float(statistic), TINY))
        quadratic = np.einsum("di,ij,dj->d", sample[:, part], inverse, sample[:, part])
        largest[rank] = np.maximum(quadratic, largest.get(rank, 0.0))
    smallest = np.sort(
        np.min([_hotelling(most, rank, freedom) for rank, most in largest.items()], axis=0)
    )
    adjusted = []
    for one in p:
        share = float(np.searchsorted(smallest, one, side="right") + 1) / (draws + 1)
        drawn = share if share > SCORES.resolved / max(draws, 1) else 1.0
        adjusted.append(min(1.0, len(p) * one, drawn))
    return p, adjusted


def _hotelling(statistic: Any, rank: int, freedom: float) -> Any:
    """Tail of Hotelling's T^2 with `rank` components and `freedom` degrees of freedom."""
    other = max(freedom - rank + 1, 1.0)
    return fisher.sf(np.maximum(statistic, 0.0) * other / (freedom * rank), rank, other)
