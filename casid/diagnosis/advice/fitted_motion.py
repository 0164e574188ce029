"""What acted in the fitted records, how the system moved, and how it would under something else.

Recorded inputs are known; an unknown input that was eliminated follows from the output it was
eliminated with. The direct model (`Model.direct`) then says what every sensor records when
something else acts, so that a measured input of an indirect model is consistent with the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from scipy.fft import rfft, rfftfreq

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import EXPERIMENTS
from casid.errors import CasidError
from casid.estimation.simulation.integration.simulator import Simulator
from casid.model.model import Model


@dataclass(slots=True)
class FittedMotion:
    """The records of a fitted model, and the means to predict others.

    Parameters
    ----------
    problem : has the channels that are recorded beside the model's.
    at : the fitted model under its noise.
    seed : of the noise that is drawn.
    """

    problem: Problem
    at: Weighted
    seed: int = 0
    _direct: Model = field(init=False)
    _simulators: dict[float, Simulator] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        try:
            self._direct = self.at.model.direct()
        except CasidError:  # an effect entered an eliminated channel nonlinearly
            self._direct = self.problem.model.direct()

    @property
    def experiments(self) -> Sequence[Experiment]:
        """The records fitted."""
        return self.at.criterion.experiments

    @property
    def Ts(self) -> float:
        """Sample time of the first record [s]."""
        return float(self.at.criterion.data[0].Ts)

    def states(self, e: int) -> Array:
        """(N, nx) of one experiment."""
        return np.asarray(self.at.criterion.simulated(self.at.fit.x, e).x)

    # -- what acts ---------------------------------------------------------------------------

    def acting(self, e: int) -> dict[str, Array]:
        """(N,) of every input of the direct model in one experiment, generated ones apart."""
        out = {}
        for name, entry in self._direct.inputs.items():
            if entry.kind == "generated":
                continue
            record = self.experiments[e].record
            out[name] = self.signal(name, e) if entry.kind == "unknown" else record[name]
        return out

    def signal(self, name: str, e: int) -> Array:
        """(N,) of a state or an eliminated input, as the fitted model has it."""
        at = self.at.criterion.simulated(self.at.fit.x, e)
        if name in self.at.model.states:
            return np.asarray(at.x[:, list(self.at.model.states).index(name)])
        explicit = self.at.model.explicit()
        solved = ca.Function("w", [explicit.x, explicit.u, explicit.p], [explicit.eliminated[name]])
        d = self.at.criterion.data[e]
        p, _ = self.at.criterion.parameter_vector(self.at.fit.x, e)
        values = solved.map(d.N)(at.x.T, d.u.T, np.tile(p[:, None], (1, d.N)))
        return np.asarray(values).ravel()

    def is_free(self, name: str) -> bool:
        """True for an input that an experimenter may change: none that is recorded beside."""
        return name not in self.problem.recorded

    def band(self, times: float) -> float:
        """`times` the frequency up to which 95 % acts, or of the motion [Hz]; 0 at rest."""
        d = self.at.criterion.data[0]
        tops = []
        for n, v in self.acting(0).items():
            if self.is_free(n) and np.ptp(v) > 0:
                power = np.cumsum(np.abs(rfft(v - v.mean())) ** 2)
                share = np.searchsorted(power, EXPERIMENTS.band_power * power[-1])
                tops.append(float(rfftfreq(d.N, d.Ts)[share]))
        if not tops:
            return 0.0
        return min(times * max(*tops, self.main_frequency()), EXPERIMENTS.highest / d.Ts)

    def main_frequency(self) -> float:
        """Frequency at which the first output moves most [Hz]."""
        d = self.at.criterion.data[0]
        y = self.at.criterion.simulated(self.at.fit.x, 0).y[:, 0]
        power = np.abs(rfft(y - y.mean())) ** 2
        return float(rfftfreq(d.N, d.Ts)[int(np.argmax(power))])

    def period(self) -> float:
        """Seconds that one period takes, at half of the power, of the slowest output."""
        d = self.at.criterion.data[0]
        y = self.at.criterion.simulated(self.at.fit.x, 0).y
        slowest = 0.0
        for v in y.T:
            power = np.cumsum(np.abs(rfft(v - v.mean())) ** 2)
            if np.ptp(v) > 0:
                half = int(np.searchsorted(power, 0.5 * power[-1]))
                slowest = max(slowest, 1 / float(rfftfreq(len(v), d.Ts)[max(half, 1)]))
        return slowest

    def resonates(self, low: float, high: float) -> bool:
        """True if the response has a peak between two frequencies [Hz]: a pair of poles there."""
        e = self._direct.explicit()
        slopes = ca.Function("A", [e.x, e.u, e.p], [ca.densify(ca.jacobian(e.f, e.x))])
        mean = {n: float(v.mean()) for n, v in self.acting(0).items()}
        u, values = [mean.get(n, 0.0) for n in e.inputs], self._values(0)
        A = slopes(self.states(0).mean(axis=0), u, [values[n] for n in e.parameters]).full()
        poles = np.linalg.eigvals(A) if A.size and np.all(np.isfinite(A)) else np.zeros(1)
        f = np.abs(poles.imag) / (2 * np.pi)
        return bool(np.any((np.abs(poles.imag) > np.abs(poles.real)) & (f > low) & (f < high)))

    def is_felt(self, state: str) -> bool:
        """True if a rate depends on a state: what no rate depends on stays where it is released."""
        explicit = self.at.model.explicit()
        return any(ca.which_depends(explicit.f, self.at.model.symbol(state)))

    def _values(self, e: int) -> dict[str, float]:
        """All parameters in one experiment."""
        p, _ = self.at.criterion.parameter_vector(self.at.fit.x, e)
        return dict(zip(self.at.model.explicit().parameters, p.tolist(), strict=True))

    # -- simulating --------------------------------------------------------------------------

    def initial(self, e: int) -> dict[str, float]:
        """The estimated initial state of one experiment."""
        _, x0 = self.at.criterion.parameter_vector(self.at.fit.x, e)
        return dict(zip(self.at.model.states, x0.tolist(), strict=True))

    def simulated(
        self,
        e: int,
        acting: Mapping[str, Array],
        x0: Array,
        known: Mapping[str, float] | None = None,
    ) -> Record | None:
        """A noise-free record of all channels under what acts; None where it diverges."""
        d, old = self.at.criterion.data[e], self.experiments[e].record
        direct = self._direct
        if d.Ts not in self._simulators:
            substeps = self.at.criterion.substeps
            self._simulators[d.Ts] = Simulator(direct, d.Ts, substeps=substeps)
        simulator = self._simulators[d.Ts]
        N = max((len(v) for v in acting.values()), default=d.N)
        t = d.t[0] + d.Ts * np.arange(N)
        columns = []
        for name, entry in direct.inputs.items():
            if entry.kind == "generated":
                columns.append(np.zeros(N) if entry.signal is None else entry.signal(t))
            else:
                columns.append(acting[name])
        values = self._values(e) | dict(known or {})
        vector = np.array([values[n] for n in simulator.equations.parameters])
        u = np.column_stack(columns) if columns else np.zeros((N, 0))
        with np.errstate(all="ignore"):
            run = simulator.simulate(u, vector, x0)
        if not (np.all(np.isfinite(run.y)) and np.all(np.isfinite(run.x))):
            return None
        channels: dict[str, Array] = {
            n: np.resize(old[n], N) for n in self.problem.recorded if n in old
        }
        channels |= {n: v for n, v in acting.items() if direct.inputs[n].kind != "unknown"}
        channels |= {n: run.y[:, i] for i, n in enumerate(direct.outputs)}
        units = {n: old.units[n] for n in channels}
        return Record(channels, units, Ts=d.Ts, t0=float(d.t[0]), name=old.name)

    def with_noise(self, record: Record, e: int) -> Record:
        """White noise on the outputs; that of the inputs is in the whitening."""
        rng = np.random.default_rng((self.seed, e))
        channels = dict(record.channels)
        for name, sd in zip(self.at.criterion.outputs, self.at.noise.output_sd, strict=True):
            channels[name] = channels[name] + float(sd) * rng.standard_normal(record.N)
        return Record(channels, record.units, Ts=record.Ts, t0=record.t0, name=record.name)

    def as_experiment(self, record: Record, e: int, label: str = "") -> Experiment:
        """A predicted record with the load case of experiment `e`."""
        old = self.experiments[e]
        return Experiment(record, old.known, f"{old.name}{label}")

    def settling(self, record: Record) -> int:
        """Samples until no output exceeds its noise any more."""
        last = shortest = EXPERIMENTS.shortest_decay
        for name, sd in zip(self.at.criterion.outputs, self.at.noise.output_sd, strict=True):
            y = record[name]
            above = np.flatnonzero(np.abs(y - y[-1]) > float(sd))
            last = max(last, int(above[-1]) + 1 if len(above) else 0)
        return min(last, max(int(EXPERIMENTS.settling * record.N), shortest), record.N)

    def unmeasured(self) -> list[str]:
        """States that are no output themselves, and eliminated inputs."""
        model = self.at.model
        measured = [h for h, _ in model.outputs.values()]
        states = [
            n
            for n in model.states
            if not any(ca.is_equal(ca.SX(h), model.symbol(n), 2) for h in measured)
        ]
        return [*states, *model.eliminated_units]

    def noise_share(self) -> float:
        """Smallest noise of an output against what it shows."""
        criterion = self.at.criterion
        y = np.concatenate(
            [criterion.simulated(self.at.fit.x, e).y for e in range(len(criterion.data))]
        )
        size = np.sqrt(np.mean(y**2, axis=0))
        return float(np.min(self.at.noise.output_sd / np.maximum(size, TINY)))
