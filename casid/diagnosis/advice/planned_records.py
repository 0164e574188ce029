"""Records that could be made next, predicted from the present record.

A next experiment changes what acts (nothing, more, over another band), how the system is released,
its load, or what is measured; `FittedMotion` predicts what the sensors would record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.fft import irfft, rfftfreq

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.advice.fitted_motion import FittedMotion
from casid.diagnosis.thresholds import EXPERIMENTS
from casid.errors import CasidError
from casid.model.model import Model
from casid.model.quantities import quantity_text, times_text

Change = Callable[[Array], Array]  # (N,) of one input, less its mean -> (M,)

Bands = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """One possible next experiment, simulated.

    Attributes
    ----------
    experiments : what would be analysed together.
    initial : state -> initial value, one mapping an experiment.
    model : the model with a further output, where a sensor is added.
    further_sd : noise of the sensors added, in the order of the model's outputs.
    bands : frequencies (from, to) of a multisine [Hz].
    """

    name: str
    description: str
    experiments: tuple[Experiment, ...]
    initial: tuple[Mapping[str, float], ...]
    model: Model
    further_sd: tuple[float, ...] = ()
    bands: Bands = ()

    @property
    def seconds(self) -> float:
        """Length of all its records [s]."""
        return float(sum(e.record.duration for e in self.experiments))


@dataclass(frozen=True, slots=True)
class Planner:
    """Makes the feasible next experiments of a fitted model; `seed` draws the multisines."""

    motion: FittedMotion
    seed: int = 0

    @property
    def experiments(self) -> Sequence[Experiment]:
        """The records fitted."""
        return self.motion.experiments

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.motion.at.model

    def all(self) -> list[Planned]:
        """Every feasible one; those that diverge or cannot be simulated are left out."""
        makers: list[Callable[[], Planned | None]] = [
            self.free_decay,
            self.wider_band,
            self.slower,
            self.around,
            partial(self.larger, EXPERIMENTS.larger),
            partial(self.longer, EXPERIMENTS.longer),
        ]
        makers += [partial(self.load, n, v) for n, v in self._loads().items()]
        makers += [partial(self.sensor, n) for n in self.motion.unmeasured()]
        found = []
        for make in makers:
            try:
                planned = make()
            except (CasidError, RuntimeError, ArithmeticError):
                planned = None
            if planned is not None:
                found.append(planned)
        return found

    # -- kinds of experiments ----------------------------------------------------------------

    def again(self) -> Planned:
        """The present record repeated: the one that all others are compared with."""
        initial = tuple(self.motion.initial(e) for e in range(len(self.experiments)))
        return Planned(
            "the same again",
            "the same again",
            tuple(self.experiments),
            initial,
            self.model,
        )

    def larger(self, factor: float) -> Planned | None:
        """Everything that acts, `factor` times as large."""
        return self._changed(
            "larger amplitude",
            f"the same excitation, {times_text(factor)} as large",
            lambda u: factor * u,
            lambda x0, mean: mean + factor * (x0 - mean),
        )

    def longer(self, times: int) -> Planned | None:
        """The excitation `times` over."""
        return self._changed(
            "longer record",
            f"the same excitation for {times} times as long",
            lambda u: np.tile(u, times),
        )

    def wider_band(self) -> Planned | None:
        """A multisine of equal power up to three times the band of excitation and motion."""
        top = self.motion.band(EXPERIMENTS.wider)
        what = f"a wide-band excitation of the same strength, up to {top:.2g} Hz"
        return self._multisine("wider band", what, ((0.0, top),)) if top > 0 else None

    def slower(self) -> Planned | None:
        """A multisine of the same power well below what the system answers most."""
        top = EXPERIMENTS.slower * self.motion.main_frequency()
        what = f"slow excitation of the same strength, up to {top:.2g} Hz"
        return self._multisine("slower", what, ((0.0, top),)) if top > 0 else None

    def around(self) -> Planned | None:
        """A multisine on both sides of what the system answers most, and not there.

        Where a resonance makes most of the motion, stiffness, inertia and damping show at one
        frequency alone, and what changes them looks alike.
        """
        centre, top = self.motion.main_frequency(), self.motion.band(EXPERIMENTS.wider)
        low, high = centre / EXPERIMENTS.aside, centre * EXPERIMENTS.aside
        middle = "resonance" if self.motion.resonates(low, high) else "main frequency"
        what = (
            f"an excitation of the same strength on both sides of the {middle}, up to {low:.2g} "
            f"Hz and from {high:.2g} to {top:.2g} Hz"
        )
        if not 0 < high < top:
            return None
        return self._multisine(f"beside the {middle}", what, ((0.0, low), (high, top)))

    def free_decay(self) -> Planned | None:
        """Releases from the largest and half the largest offset seen, nothing acting."""
        made, starts = [], []
        model = self.model
        positions = {p for r in model.states if (p := model.position_of(r)) is not None}
        # A position that nothing restores stays: what moves is then set going by its rate.
        felt = {n for n in model.states if self.motion.is_felt(n)}
        released = positions & felt or felt
        if not released:
            return None
        moved = np.array([n in released for n in model.states])
        for e in range(len(self.experiments)):
            x = self.motion.states(e)
            mean = x.mean(axis=0)
            peak = np.max(np.abs(x - mean), axis=0)
            for label, share in (("", 1.0), (" small", 0.5)):
                start = mean + np.where(moved, share * peak, 0.0)
                u = {n: np.full(len(x), np.mean(v)) for n, v in self.motion.acting(e).items()}
                record = self.motion.simulated(e, u, start)
                if record is None:
                    return None
                n = self.motion.settling(record)
                cut = self.motion.with_noise(record.between(record.t0, record.t[n - 1]), e)
                made.append(self.motion.as_experiment(cut, e, label))
                starts.append(dict(zip(model.states, start.tolist(), strict=True)))
        what = ", ".join(sorted(released)) if positions else "initial state"
        seconds = quantity_text(made[0].record.duration, "s")
        return Planned(
            "free decay",
            f"repeated free decays of {seconds} without any input, released from the largest "
            f"recorded {what} and from half of it",
            tuple(made),
            tuple(starts),
            self.model,
        )

    def load(self, name: str, known: Mapping[str, float]) -> Planned | None:
        """The present record together with as much under another load or known value."""
        new, starts = [], []
        for e in range(len(self.experiments)):
            start = self.motion.initial(e)
            record = self.motion.simulated(
                e, self.motion.acting(e), np.array(list(start.values())), known
            )
            if record is None:
                return None
            made = self.motion.as_experiment(self.motion.with_noise(record, e), e, f" {name}")
            new.append(Experiment(made.record, {**made.known, **known}, made.name))
            starts.append(start)
        old = self.again()
        shown = self.model.shown
        values = ", ".join(
            f"{k} = {f'{shown(k, v):g} {self.model.unit_of(k)}'.removesuffix(' 1')}"
            for k, v in known.items()
        )
        is_case = name in self.motion.problem.load_cases
        what = f"under the load {name} ({values})" if is_case else f"with {values}"
        return Planned(
            f"second load: {name}",
            f"a second record {what}, analysed with the present one",
            (*old.experiments, *new),
            (*old.initial, *starts),
            self.model,
        )

    def sensor(self, name: str) -> Planned:
        """One more output: a state, or an unknown input that was eliminated."""
        model = self.model.copy()
        unit = model.states[name].unit if name in model.states else model.eliminated_units[name]
        channel = model.free_name(f"{name} sensor")
        model.output(channel, model.symbol(name), unit)
        values = [self.motion.signal(name, e) for e in range(len(self.experiments))]
        size = float(np.sqrt(np.mean(np.concatenate(values) ** 2)))
        sd = max(size, 1e-12) * self.motion.noise_share()
        rng = np.random.default_rng(self.seed)
        made = []
        for old, v in zip(self.experiments, values, strict=True):
            record = old.record.with_channel(channel, v + sd * rng.standard_normal(len(v)), unit)
            made.append(Experiment(record, old.known, old.name))
        noise = quantity_text(model.shown_size(name, sd), model.unit_of(name))
        return Planned(
            f"sensor of {name}",
            f"the same experiment with an additional sensor of {name}, as accurate as the present "
            f"ones (noise {noise})",
            tuple(made),
            self.again().initial,
            model,
            (sd,),
        )

    def _changed(
        self,
        name: str,
        description: str,
        change: Change,
        start: Callable[[Array, Array], Array] = lambda x0, mean: x0,
    ) -> Planned | None:
        made, starts = [], []
        for e in range(len(self.experiments)):
            u = {}
            for n, v in self.motion.acting(e).items():
                mean = float(np.mean(v))
                u[n] = mean + change(v - mean) if self.motion.is_free(n) else v
            N = max((len(v) for v in u.values()), default=0)
            u = {n: np.resize(v, N) for n, v in u.items()}
            x = self.motion.states(e)
            own = self.motion.initial(e)
            x0 = start(np.array(list(own.values())), x.mean(axis=0))
            record = self.motion.simulated(e, u, x0) if N else None
            if record is None:
                return None
            made.append(self.motion.as_experiment(self.motion.with_noise(record, e), e))
            starts.append(dict(zip(own, x0.tolist(), strict=True)))
        return Planned(name, description, tuple(made), tuple(starts), self.model)

    def _multisine(self, name: str, description: str, bands: Bands) -> Planned | None:
        rng = np.random.default_rng(self.seed)

        def change(u: Array) -> Array:
            """A multisine in the bands, of the standard deviation of the input that it replaces."""
            f = rfftfreq(len(u), self.motion.Ts)
            inside = np.any([(f >= low) & (f <= high) for low, high in bands], axis=0)
            line = np.where((f > 0) & inside, np.exp(2j * np.pi * rng.random(len(f))), 0)
            made = irfft(line, len(u))
            size = float(np.std(made))
            return np.asarray(made * (np.std(u) / size if size > 0 else 0.0))

        if not any(
            np.ptp(v) > 0 for n, v in self.motion.acting(0).items() if self.motion.is_free(n)
        ):
            return None
        made = self._changed(name, description, change)
        return None if made is None else replace(made, bands=bands)

    # -- what there is to choose from --------------------------------------------------------

    def _loads(self) -> dict[str, dict[str, float]]:
        """Load cases that no record has, and known values that might be changed by a half."""
        model = self.model
        have = [
            {n: e.known.get(n, p.value) for n, p in model.parameters.items()}
            for e in self.experiments
        ]
        out = {}
        for case, values in self.motion.problem.load_cases.items():
            if not any(all(h.get(n) == v for n, v in values.items()) for h in have):
                out[case] = {n: float(v) for n, v in values.items()}
        of_cases = {n for values in self.motion.problem.load_cases.values() for n in values}
        for name, p in model.parameters.items():
            if p.value and not p.is_constant and name not in of_cases:
                value = float(np.clip(EXPERIMENTS.load * p.value, p.lower, p.upper))
                if value != p.value:
                    out[f"{name} changed"] = {name: value}
        return out


def with_start(planned: Planned, values: Mapping[str, float], own: Sequence[str]) -> dict[str, Any]:
    """Start values by the names that a criterion of the planned experiments gives its variables."""
    several = len(planned.experiments) > 1
    start = {k: v for k, v in values.items() if "(0)" not in k}
    for name in own:
        known = [v for k, v in values.items() if k.partition("@")[0] == name]
        if known:
            start.setdefault(name, known[0])
    for experiment, initial in zip(planned.experiments, planned.initial, strict=True):
        label = f"@{experiment.name}" if several else ""
        start |= {f"{n}(0){label}": v for n, v in initial.items()}
    return start
