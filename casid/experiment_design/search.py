"""The search for an input: the usual ones first, then the program from the best of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError
from casid.experiment_design.base_input import based
from casid.experiment_design.information import scores
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.program import Program, Solved
from casid.experiment_design.question import Question
from casid.experiment_design.rival_fits import imitation
from casid.experiment_design.setup import Setup
from casid.experiment_design.standard_inputs import StandardInput, drawn, shrunk
from casid.experiment_design.thresholds import DESIGN, KEEPING, NUMERICS, STARTING
from casid.time_limit import processor_clock


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """An input with what it gives: the scores of every comparison (see `information`)."""

    u: Array
    release: Array
    scores: Array
    prediction: Prediction  # rivals where they imitate the truth best under this input
    what: str
    iterations: int = 0

    @property
    def least(self) -> float:
        """The smallest score."""
        return float(np.min(self.scores))


@dataclass(slots=True, eq=False)
class Search:
    """Looks for the best input of a question.

    Parameters
    ----------
    candidates : standard inputs drawn; `starts` of them are improved, the best of every kind first;
        None: as many as the size of the program allows.
    seconds : of the processor, that may be spent on solving.
    kinds : of the standard inputs; default all.
    begin : other inputs (N, nu) with displacements (nr,) to begin from, before the standard ones.
    """

    setup: Setup
    question: Question
    candidates: int = DESIGN.candidates
    starts: int | None = None
    seconds: float = DESIGN.seconds
    seed: int = 0
    progress: Callable[[str], None] = lambda _: None
    begin: Sequence[tuple[Array, Array]] = ()
    kinds: Sequence[str] = ()
    standards: list[StandardInput] = field(init=False, default_factory=list)
    judged_standards: list[tuple[str, Found]] = field(init=False, default_factory=list)
    steps: int = field(init=False, default=1)

    def run(self) -> tuple[Found, Found]:
        """The designed input and the best standard one."""
        prediction = self._first_prediction()
        self.setup = prediction.setup
        ranked = self._standards(prediction)
        starts = self._number_of_starts()
        first = ranked[: max(starts, DESIGN.judged)]
        best_of_kind = {s.kind: s for s in reversed(ranked)}
        chosen = [*first, *(s for s in best_of_kind.values() if s not in first)]
        # Rivals linearised at one input say little of another: they are fitted anew to each.
        judged = [self.judged(prediction, s.u, s.release, s.description) for s in chosen]
        self.judged_standards = list(zip([s.kind for s in chosen], judged, strict=True))
        diverse = _best_of_kinds_first(self.judged_standards)
        judged.sort(key=lambda f: -f.least)
        allowed = [shrunk(prediction, *given) for given in self.begin]
        given = [self.judged(prediction, *at, "another design") for at in allowed if at is not None]
        begun, improved = [*given, *diverse][: max(starts, len(given))], []
        ends = processor_clock() + self.seconds
        for k, start in enumerate(begun):
            left = (ends - processor_clock()) / (len(begun) - k)
            if left <= 0:
                break
            self.progress(f"solve from: {start.what}")
            improved.append(self.improved(start, processor_clock() + left))
        return max([judged[0], *given, *improved], key=lambda f: f.least), judged[0]

    def _number_of_starts(self) -> int:
        if self.starts is not None:
            return self.starts
        size = self.setup.excitation.n * len(self.setup.designed) + len(self.setup.released)
        return int(np.clip(STARTING.variables // size, DESIGN.starts, STARTING.most))

    # -- standard inputs ---------------------------------------------------------------------

    def _first_prediction(self) -> Prediction:
        q = self.question
        prediction = based(Prediction(self.setup, q.hypotheses, q.comparisons))
        return replace_substeps(prediction, self._allowed_input(prediction))

    def _allowed_input(self, prediction: Prediction) -> tuple[Array, Array]:
        """An input that keeps the limits and moves the system, where any such input will do."""
        rng = np.random.default_rng((self.seed, 1))
        _, _, u, release = drawn(prediction.setup, rng)
        return shrunk(prediction, u, release) or prediction.setup.begun_at

    def _standards(self, prediction: Prediction) -> list[StandardInput]:
        """The standard inputs, best first."""
        rng = np.random.default_rng((self.seed, 0))
        found: list[StandardInput] = []
        most = 0.0
        self.progress(f"compare {self.candidates} standard inputs")
        for _ in range(self.candidates):
            kind, words, u, release = drawn(self.setup, rng, self.kinds)
            allowed = shrunk(prediction, u, release)
            if allowed is None or any(same(allowed, (s.u, s.release)) for s in found):
                continue
            grams = prediction.grams(*allowed)
            if grams is None:
                continue
            values, share = self._scores(grams)
            most = max(most, share)
            found.append(StandardInput(kind, words, *allowed, float(np.min(values))))
        if not any(np.isfinite(s.score) for s in found) or most < DESIGN.nothing:
            raise IdentifiabilityError(self._why_none_decides())
        found.sort(key=lambda s: -s.score)
        self.standards = found
        return found

    def _scores(self, grams: Sequence[Array]) -> tuple[Array, float]:
        """Scores of all comparisons whose truth has its size, and the largest share of a misfit."""
        values, share = [], 1.0
        for gram, target in zip(grams, self.question.targets, strict=True):
            values.append(scores(gram, target))
            if target.kind == "misfit":
                share = min(share, float(np.exp(values[-1][0])) / max(float(gram[-1, -1]), TINY))
        return np.concatenate(values) if values else np.array([-np.inf]), share

    def _why_none_decides(self) -> str:
        """Why no standard input answers the question, and what to change."""
        q, name = self.question, self.setup.nominal.name
        if q.effects:
            pairs = " and ".join(q.hypotheses[i].name for i in q.comparisons[0] if i is not None)
            return (
                f"{name}: no standard input within the limits separates {pairs}: what one does "
                "the other imitates, or nothing moves. Give a wider limit, another sensor "
                "(an output of the model) or other causes"
            )
        return (
            f"{name}: no standard input within the limits identifies every parameter; widen the "
            "limits, record longer, or give some parameters known values"
        )

    # -- improvement -------------------------------------------------------------------------

    def judged(
        self, prediction: Prediction, u: Array, release: Array, what: str, iterations: int = 0
    ) -> Found:
        """An input with its scores, rivals fitted anew to what the truths would show."""
        hypotheses, exact = list(prediction.hypotheses), {}
        for k, c in enumerate(self.question.comparisons):
            if c.truth is None:
                continue
            now = replace(prediction, hypotheses=tuple(hypotheses))
            exact[k], hypotheses[c.rival] = imitation(now, c.truth, hypotheses[c.rival], u, release)
        new = replace(prediction, hypotheses=tuple(hypotheses))
        grams = new.grams(u, release)
        found = []
        for k, target in enumerate(self.question.targets):
            linear = scores(grams[k], target) if grams is not None else np.array([-np.inf])
            if k in exact and np.isfinite(exact[k]):
                linear = np.array([np.log(max(exact[k], TINY))])
            found.append(linear)
        return Found(u, release, np.concatenate(found), new, what, iterations)

    def improved(self, start: Found, ends: float) -> Found:
        """The program solved from an input, rivals and margins renewed as long as they matter."""
        best, prediction = start, start.prediction
        u, release, iterations = start.u, start.release, 0
        for _ in range(KEEPING.rounds):
            if processor_clock() >= ends:
                break
            solved = self._solved(prediction, u, release, ends)
            iterations += solved.iterations
            new = self.judged(
                prediction, solved.u, solved.release, f"designed from: {start.what}", iterations
            )
            expected = self._least_score(prediction, solved.u, solved.release)
            best = new if new.least > best.least else best
            u, release, prediction = solved.u, solved.release, new.prediction
            self.progress(f"information times {np.exp(best.least - start.least):.3g}")
            if new.least >= expected + np.log(DESIGN.refitted):
                break
        return best

    def _least_score(self, prediction: Prediction, u: Array, release: Array) -> float:
        """The smallest score of an input, its rivals linearised as the program had them."""
        grams = prediction.grams(u, release)
        return -np.inf if grams is None else float(np.min(self._scores(grams)[0]))

    def cheapest(self, start: Found, floor: float) -> Found | None:
        """The input of least energy whose scores reach a floor; None where none is found."""
        floors = np.full(len(start.scores), floor + np.log1p(2 * DESIGN.accuracy))
        ends = processor_clock() + self.seconds
        solved = self._solved(start.prediction, start.u, start.release, ends, floors)
        found = self.judged(
            start.prediction,
            solved.u,
            solved.release,
            f"designed from: {start.what}",
            start.iterations + solved.iterations,
        )
        return found if found.least >= floor else None

    def _solved(
        self,
        prediction: Prediction,
        u: Array,
        release: Array,
        ends: float,
        floors: Array | None = None,
    ) -> Solved:
        """The program solved, with margins as wide as ten times the sampling rate needs."""
        setup, excitation = self.setup, self.setup.excitation
        w = excitation.nearest(u - setup.at_rest)
        w, release = self._inside(prediction, w, release)
        self.steps = self._enough_steps(prediction, w, release)
        margins = KEEPING.inset * setup.limits.widths
        best, most, iterations = (u, release), -np.inf, 0
        for _ in range(KEEPING.rounds):
            program = Program(prediction, self.question.targets, self.steps, margins, floors)
            solved = program.solve(w, release, seconds=ends - processor_clock())
            iterations += solved.iterations
            kept = shrunk(prediction, solved.u, solved.release, finer=KEEPING.finer)
            if kept is not None:
                worth = self._least_score(prediction, *kept)
                if floors is not None:  # the least energy, once the floors are reached
                    enough = np.min(floors) - np.log1p(2 * DESIGN.accuracy)
                    worth = -self._moved(*kept) if worth >= enough else -np.inf
                best, most = (kept, worth) if worth > most else (best, most)
                if self._moved(*kept) >= KEEPING.shrunk * self._moved(solved.u, solved.release):
                    break
            over = prediction.excess(solved.u, solved.release, finer=KEEPING.finer)
            if not np.all(np.isfinite(over)) or processor_clock() >= ends:
                break
            # Limits hold at the steps; where they do not hold between them, the steps are too long.
            share = over / setup.limits.widths
            if np.any(share > KEEPING.between) and self.steps < DESIGN.finest:
                self.steps *= 2
            else:
                widest = KEEPING.widest * setup.limits.widths
                margins = np.minimum(margins + KEEPING.wider * over, widest)
            w, release = excitation.nearest(best[0] - setup.at_rest), best[1]
        return solved._replace(u=best[0], release=best[1], iterations=iterations)

    def _moved(self, u: Array, release: Array) -> float:
        """Size of what is done, measured from the base."""
        base, start = self.setup.begun_at
        return float(np.hypot(np.linalg.norm(u - base), np.linalg.norm(release - start)))

    def _inside(self, prediction: Prediction, w: Array, release: Array) -> tuple[Array, Array]:
        """Decision variables (n, nu) whose input keeps the limits."""
        setup = self.setup
        for k, name in enumerate(setup.designed):
            if setup.excitation.shape != "multisine":
                low, high = setup.limits.inputs[name]
                w[:, k] = np.clip(w[:, k], low - setup.rest[name], high - setup.rest[name])
        samples = setup.excitation.samples
        found = shrunk(prediction, setup.at_rest + samples @ w, release)
        if found is None:
            return w, release
        return setup.excitation.nearest(found[0] - setup.at_rest), found[1]

    def _enough_steps(self, prediction: Prediction, w: Array, release: Array) -> int:
        """Runge-Kutta steps an interval with which the scores are right, or change no more."""
        u = self.setup.at_rest + self.setup.excitation.samples @ w
        grams = prediction.grams(u, release)
        if grams is None:
            return self.steps
        wanted, before = self._scores(grams)[0], None
        per: int = self.setup.excitation.per  # with these the steps end at the samples
        tried: set[int] = {per, *(2**k for k in range(int(np.log2(DESIGN.finest)) + 1))}
        coarser: int = self.steps
        for steps in sorted(n for n in tried if self.steps <= n <= DESIGN.finest):
            program = Program(prediction, self.question.targets, steps, np.zeros(0))
            with np.errstate(all="ignore"):
                information = program.rollout.outputs(w, release).information
            if np.all(np.isfinite(information)):
                there = self._scores(program.grams(information))[0]
                if np.all(np.abs(there - wanted) < DESIGN.accuracy):
                    return steps
                if before is not None and np.all(np.abs(there - before) < DESIGN.accuracy):
                    return coarser
                before, coarser = there, steps
        return coarser


def _best_of_kinds_first(judged: Sequence[tuple[str, Found]]) -> list[Found]:
    """The best of every kind, best first, and then the others."""
    ranked = sorted(judged, key=lambda entry: -entry[1].least)
    best = {kind: found for kind, found in reversed(ranked)}
    leading = sorted(best.values(), key=lambda f: -f.least)
    return [*leading, *(f for _, f in ranked if f not in leading)]


def same(one: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    """True where two experiments do the same."""
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def replace_substeps(prediction: Prediction, at: tuple[Array, Array]) -> Prediction:
    """The prediction with as many Runge-Kutta steps a sample as it needs."""
    before = [prediction.course(i, *at).y for i in range(len(prediction.hypotheses))]
    for substeps in (2, 4, 8, 16):
        finer = replace(prediction, substeps=substeps)
        after = [finer.course(i, *at).y for i in range(len(prediction.hypotheses))]
        noise = prediction.setup.noise
        if all(
            np.all(np.abs(a - b) <= NUMERICS.rounding * noise)
            for a, b in zip(before, after, strict=True)
        ):
            return prediction
        prediction, before = finer, after
    return prediction
