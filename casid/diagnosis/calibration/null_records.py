"""Records as the fitted model would give them: the null of a diagnosis, drawn again and again.

The model at its estimate is simulated on the record's own inputs, which are taken as the true ones,
to the record's end and on the records held out. The estimated disturbances act in the simulation;
the outputs get the sensors' noise, the measured inputs the noise that was found on them. So every
drawn record has the length, the excitation, the gaps and the noise of the recorded one, and nothing
that the model lacks (a parametric bootstrap: A. C. Davison, D. V. Hinkley, Bootstrap Methods and
their Application, Cambridge 1997, section 4.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import with_samples
from casid.errors import SolveError
from casid.estimation.holdout import Split
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum, parts_of
from casid.estimation.noise.forces import name_of_force, with_forces
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.simulation.input_noise.input_noise import with_input_noise
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


@dataclass(frozen=True, slots=True)
class NullNoise:
    """Noise of every source, standard deviation of a sample in SI units.

    Attributes
    ----------
    outputs : output -> of its sensor.
    inputs : measured input -> of its sensor, so in the record and not in the motion.
    disturbances : measured input, balance or stated rate -> of what acts there, so in the motion
        and not in the record; of what acts in several balances, what it does in the first.
    spectra : of disturbances that are not white.
    """

    outputs: Mapping[str, float]
    inputs: Mapping[str, float]
    disturbances: Mapping[str, float]
    spectra: Mapping[str, DisturbanceSpectrum] = field(default_factory=dict)


def null_noise(
    noise: NoiseModel, outputs: Sequence[str], input_sd: Mapping[str, float]
) -> NullNoise:
    """Divide the noise found into that of sensors and disturbances.

    What the sensors of the inputs cannot account for is a disturbance, there where the residual's
    spectrum shows it: with both, the drawn records have the spectrum of the residual.

    Parameters
    ----------
    noise : with what may be a disturbance.
    input_sd : measured input -> noise of its sensor.
    """
    left = {}
    for group in noise.alike:
        found = noise.source_sd[group[0]] ** 2 * _gain(noise, group[0])
        used = sum(input_sd.get(n, 0.0) ** 2 * _gain(noise, n) for n in group)
        gain = _gain(noise, group[0])
        if gain > 0 and found > used * (1 + 1e-9):
            left[group[0]] = float(np.sqrt((found - used) / gain))
    sensors = {n: float(sd) for n, sd in input_sd.items() if sd > 0}
    by_output = dict(zip(outputs, noise.output_sd.tolist(), strict=True))
    return NullNoise(by_output, sensors, left, noise.spectra)


def _gain(noise: NoiseModel, source: str) -> float:
    """Mean squared response of the outputs to a source, over the records."""
    return sum(float(r.gain2[:, :, r.sources.index(source)].mean()) for r in noise.responses)


@dataclass(frozen=True, slots=True, eq=False)
class Recipe:
    """All that null records are drawn from; free of CasADi objects, so that it can be pickled.

    Attributes
    ----------
    whole, apart : the recorded experiments, to their end, and those held out as a whole.
    hold_out : share of every record of `whole` that is held out at its end.
    values : variable -> estimate; those of initial states count for `whole`.
    own : parameters that every experiment has for itself.
    weights, substeps : of the fit.
    """

    whole: tuple[Experiment, ...]
    apart: tuple[Experiment, ...]
    hold_out: float
    values: Mapping[str, float]
    noise: NullNoise
    own: tuple[str, ...]
    weights: Array
    substeps: int

    @staticmethod
    def of(
        split: Split, criterion: SimulationError, values: Mapping[str, float], noise: NullNoise
    ) -> Recipe:
        """The recipe of records as they are split, fitted by a criterion, under the noise found."""
        return Recipe(
            whole=tuple(split.whole),
            apart=tuple(split.apart),
            hold_out=_share(split),
            values=values,
            noise=noise,
            own=tuple(criterion.own),
            weights=criterion.weights,
            substeps=criterion.substeps,
        )


class NullRecords:
    """Draws the fitted and held-out records anew, as the model at its estimate would give them.

    Parameters
    ----------
    model : as it is, without any cause.

    Raises
    ------
    SolveError
        If the simulation at the estimate diverges.
    """

    def __init__(self, model: Model, recipe: Recipe) -> None:
        noise, values, own = recipe.noise, recipe.values, recipe.own
        whole, apart = list(recipe.whole), list(recipe.apart)
        self.noise, self.whole, self.apart = noise, whole, apart
        places = (p.place for n in noise.disturbances for p in parts_of(n, noise.spectra))
        forced = list(dict.fromkeys(n for n in places if n not in model.inputs))
        disturbed = with_forces(model, forced, "measured")
        self._criteria: list[tuple[SimulationError, Array]] = []
        settings: dict[str, Any] = {"weights": recipe.weights, "substeps": recipe.substeps}
        channels = disturbed.inputs.keys() - model.inputs.keys()
        added = {n: disturbed.inputs[n].unit for n in channels}
        if whole:
            criterion = SimulationError(
                disturbed,
                [_at_rest(e, added) for e in whole],
                own=own,
                start=values,
                **settings,
            )
            self._criteria += [(criterion, criterion.start)]
        for e in apart:
            known = {n: v for n, v in values.items() if n in model.parameters}
            for name in own:
                of_each = [v for key, v in values.items() if key.startswith(f"{name}@")]
                known[name] = float(np.mean(of_each)) if of_each else values.get(name, 0.0)
            criterion = SimulationError(model.with_known(**known), [e], **settings)
            point = criterion.start
            if len(point):
                point = minimize_simulation_error(criterion, check_rank=False).x
            wide = SimulationError(
                disturbed.with_known(**known),
                [_at_rest(e, added)],
                start=dict(zip(criterion.names, point.tolist(), strict=True)),
                **settings,
            )
            self._criteria += [(wide, wide.start)]

    def draw(self, rng: np.random.Generator) -> tuple[list[Experiment], list[Experiment]]:
        """The experiments `whole` and `apart` with outputs and measured inputs drawn anew."""
        out: list[Experiment] = []
        for criterion, x in self._criteria:
            for e in range(len(criterion.data)):
                recorded = (self.whole + self.apart)[len(out)]
                out.append(self._drawn(criterion, x, e, recorded, rng))
        return out[: len(self.whole)], out[len(self.whole) :]

    def _drawn(
        self,
        criterion: SimulationError,
        x: Array,
        e: int,
        recorded: Experiment,
        rng: np.random.Generator,
    ) -> Experiment:
        d = criterion.data[e]
        u = d.u.copy()
        for name, sd in self.noise.disturbances.items():
            spectrum = self.noise.spectra.get(name)
            drawn = spectrum.draw(d.N, d.Ts, rng) if spectrum else rng.standard_normal(d.N)
            for part in parts_of(name, self.noise.spectra):
                u[:, _column(criterion.model, part.place)] += sd * part.ratio * drawn
        with np.errstate(all="ignore"):
            y, _, _ = criterion.simulate(x, e, signals=replace(d, u=u))
        if not np.all(np.isfinite(y)):
            raise SolveError(
                f"{recorded.name}: the fitted model's simulation diverges under the noise that was "
                "found; a null record cannot be drawn. Fit a shorter window"
            )
        record = recorded.record
        for i, name in enumerate(criterion.outputs):
            noise = self.noise.outputs[name] * rng.standard_normal(d.N)
            values = y[:, i] + noise * d.relative_sizes[:, i]
            record = with_samples(record, name, values)
        record = with_input_noise(record, criterion, e, self.noise.inputs, rng)
        return replace(recorded, record=record)


def _column(model: Model, source: str) -> int:
    names = list(model.inputs)
    return names.index(source if source in names else name_of_force(source))


def _at_rest(experiment: Experiment, added: Mapping[str, str]) -> Experiment:
    record = experiment.record
    for name, unit in added.items():
        record = record.with_channel(name, np.zeros(record.N), unit)
    return replace(experiment, record=record)


def _share(split: Split) -> float:
    """The share held out at the end of every record; the same number of samples comes of it."""
    return float(np.mean(split.held[0])) if split.held and not split.apart else 0.0
