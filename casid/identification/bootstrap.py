"""Moment bootstrap: intervals that do not rest on a linearisation.

The covariance of `propagation` is linear in the moments' noise. Where the map from moments to
parameters is not, its intervals are wrong in place and size: m and z_m follow from (7.38) by a
division by a product that a weakly excited record leaves near zero. The bootstrap passes resampled
moments through the whole estimator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import SolveError
from casid.estimation.moments.equations.long_run_covariance import memory
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.model.units import from_si


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bootstrap:
    """Estimates from resampled moments.

    Attributes
    ----------
    names : (n,); values : (runs that ended, n), in the parameters' units; failed : runs without an
        optimum.
    """

    names: tuple[str, ...]
    values: Array
    failed: int

    def __repr__(self) -> str:
        spread = ", ".join(f"{n} {self.std_error(n):.2g}" for n in self.names)
        return f"<Bootstrap of {len(self.values)} runs ({self.failed} failed): std {spread}>"

    def std_error(self, name: str) -> float:
        """Standard deviation over the runs."""
        return float(np.std(self.values[:, self.names.index(name)], ddof=1))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Percentile interval."""
        tail = (1 - level) / 2
        low, high = np.quantile(self.values[:, self.names.index(name)], [tail, 1 - tail])
        return float(low), float(high)


@names_wrong_types()
def bootstrap(estimate: MomentEstimate, *, runs: int = 500, seed: int = 0) -> Bootstrap:
    """Estimate again from moments whose noise is resampled in blocks, all stages in turn.

    The products zeta_t L(q) error_t are drawn in blocks as long as their memory, the same blocks
    for all parts of a record (Kunsch 1989); instruments and prefilters stay those of the estimate.

    Parameters
    ----------
    estimate : by `casid.instrumental_variables`, `least_squares` or `multistage`.
    runs : how often the noise is drawn; a run that cannot be solved is left out and counted.
    seed : of the draws.

    Raises
    ------
    SolveError
        If fewer than two runs could be solved.

    Source: H. R. Kunsch, Annals of Statistics 17 (1989) 1217-1241.
    """
    rng = np.random.default_rng(seed)
    noise = _MomentNoise.of(estimate)
    found, failed = [], 0
    for _ in range(runs):
        try:
            found.append(_estimated_again(estimate, noise, noise.drawn(rng)))
        except SolveError:
            failed += 1
    if len(found) < 2:
        raise SolveError(
            f"bootstrap: {failed} of {runs} runs had no optimum; the estimate itself rests on "
            "weak moments, look at its canonical correlations"
        )
    return Bootstrap(estimate.names, _in_units(estimate, np.array(found)), failed)


@dataclass(frozen=True, slots=True, eq=False)
class _MomentNoise:
    """The noise of an estimate's moments, to be drawn in blocks.

    Attributes
    ----------
    blocks : record -> number of its samples, length of a block.
    sums : (stage, part) -> sums of the noise over every block, (n - length + 1, nz): all that a
        resampled mean needs.
    """

    blocks: dict[str, tuple[int, int]]
    sums: dict[tuple[int, int], Array]

    @classmethod
    def of(cls, estimate: MomentEstimate) -> _MomentNoise:
        """From the products zeta_t L(q) error_t of all stages."""
        scores: dict[tuple[int, int], Array] = {}
        blocks: dict[str, tuple[int, int]] = {}
        for i, st in enumerate(estimate.stages):
            for k, e in enumerate(st.equations):
                error = e.error(st.thetas[k])
                columns = [c.samples(e.signals, e.start) for c in e.instruments]
                products = np.column_stack([c * error for c in columns])
                scores[i, k] = products - products.mean(axis=0)
                record = st.parts[k].record
                n = len(error)
                # Long against the memory: what the ends of a block add is not small where the
                # error's power lies at other frequencies than the instruments'.
                length = max(4 * memory(error) + 1, n // 60, 10)
                old = blocks.get(record, (n, length))
                blocks[record] = (min(n, old[0]), max(length, old[1]))
        sums = {}
        for (i, k), s in scores.items():
            n, length = blocks[estimate.stages[i].parts[k].record]
            sums[i, k] = _block_sums(s[-n:], length)
        return cls(blocks, sums)

    def drawn(self, rng: np.random.Generator) -> dict[str, Array]:
        """Record -> first samples of the blocks that make up a record of its length."""
        return {
            record: rng.integers(0, n - length + 1, n // length)
            for record, (n, length) in self.blocks.items()
        }

    def mean(self, part: tuple[int, int], record: str, picks: Array) -> Array:
        """(nz,) mean of the noise of a part over the blocks `picks` of its record."""
        return np.asarray(
            self.sums[part][picks].sum(axis=0) / (len(picks) * self.blocks[record][1])
        )


def _estimated_again(
    estimate: MomentEstimate, noise: _MomentNoise, picks: dict[str, Array]
) -> list[float]:
    """The free parameters of all stages, in turn, from moments with the noise of these blocks."""
    values: dict[str, float] = {}
    row: list[float] = []
    for i, st in enumerate(estimate.stages):
        equations = []
        for k, e in enumerate(st.equations):
            record = st.parts[k].record
            drawn = noise.mean((i, k), record, picks[record])
            equations.append(replace(e, Y=e.Phi @ st.thetas[k] + drawn))
        at = [
            {**v, **{q: w for q, w in values.items() if q not in p.known}}
            for v, p in zip(st.values, st.parts, strict=True)
        ]
        theta_p, _, _ = st.stage.programs.solve(equations, st.roots, at, st.theta_p)
        values |= dict(zip(st.free, theta_p.tolist(), strict=True))
        row += theta_p.tolist()
    return row


def _in_units(estimate: MomentEstimate, values: Array) -> Array:
    """(runs, n) SI values in the units of the estimated parameters."""
    units = [estimate.parameter(name).unit for name in estimate.names]
    columns = zip(values.T, units, strict=True)
    return np.column_stack([from_si(column, unit) for column, unit in columns])


def _block_sums(scores: Array, length: int) -> Array:
    """Sums over every run of `length` samples, (n - length + 1, nz)."""
    total = np.vstack([np.zeros((1, scores.shape[1])), np.cumsum(scores, axis=0)])
    return np.asarray(total[length:] - total[:-length])
