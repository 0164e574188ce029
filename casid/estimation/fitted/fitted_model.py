"""The fitted model: everything that is needed to simulate it again, elsewhere and later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from casid.arrays import Array
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.linear.noisy_model import White

Method = Literal["simulation error", "prediction error", "moments"]


@dataclass(frozen=True, slots=True, eq=False)
class FittedRecord:
    """A record that was fitted: what holds in it alone, in SI units.

    Attributes
    ----------
    Ts, t0 : sample time and time of the first sample on the record's clock [s].
    N : samples fitted; a record may go on after them.
    known : parameter -> value known for this record alone (its load case), or estimated for it.
    nodes : (segments, nx) states where each shooting segment starts; the first is the initial
        state. One segment but for multiple shooting.
    """

    name: str
    Ts: float
    t0: float
    N: int
    known: Mapping[str, float]
    nodes: Array


@dataclass(frozen=True, slots=True, eq=False)
class AddedCause:
    """A cause that a diagnosis added to the model.

    Attributes
    ----------
    kind, where : as `diagnosis.json` names them.
    parameters : names, in the model, of what it is described by.
    constants : what was chosen rather than estimated, SI units: `speed` below which dry friction is
        smoothed, `time` of a jump, `start` and `stop` of a drift, `mean` of a channel.
    shape, description : what tells it from others of its kind, in words where it has no name.
    """

    kind: str
    where: str
    parameters: tuple[str, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    shape: str = ""
    description: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SimulationSettings:
    """How the model was simulated when it was fitted.

    Attributes
    ----------
    substeps : Runge-Kutta steps a sample, at the sample time of the fit.
    segments : shooting segments a record.
    weights : (ny,) of the outputs' errors, one over their units.
    """

    substeps: int = 1
    segments: int = 1
    weights: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Where the problem's signals are found in a file or table.

    Attributes
    ----------
    columns : signal -> column, with its unit after a colon ("roll_deg:deg").
    recorded : channels recorded beside the model's, name -> SI unit.
    derived : signal that no file has -> how it is computed, in words.
    time : the time column; empty where it is found by name.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, str] = field(default_factory=dict)
    derived: Mapping[str, str] = field(default_factory=dict)
    time: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """White noise of the outputs and on the process, as a prediction-error fit has it.

    Attributes
    ----------
    sources : each with its known standard deviation.
    rest : state or input -> its value at the rest that the model was linearised about, SI.
    initial : state -> standard deviation of its initial value; None for a steady-state predictor.
    """

    sources: tuple[White, ...]
    rest: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel:
    """A model with its estimated values, and all that is needed to simulate it as the fit did.

    Every number is in SI units; `model.declared_units` has the units that the user declared.

    Attributes
    ----------
    name : of the problem.
    model : the equations, extended by every cause, each parameter with its value.
    records : the fitted records; the first gives the sample time and the initial state that hold
        where nothing else is given.
    covariance_names, covariance : (n, n) of the estimated parameters and initial states.
    baseline : the model before, with the values fitted to it; None where nothing was added.
    causes : what was added to the baseline.
    settings : of the integration and the criterion.
    channels : where the problem's signals are found in a table.
    noise : None without a noise model, as after a simulation-error fit.
    """

    name: str
    model: Model
    records: tuple[FittedRecord, ...]
    covariance_names: tuple[str, ...]
    covariance: Array
    baseline: Model | None = None
    causes: tuple[AddedCause, ...] = ()
    settings: SimulationSettings = SimulationSettings()
    channels: Channels = Channels()
    noise: NoiseModel | None = None

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value, SI; of one that each record has for itself the mean."""
        return {p.name: float(p.value or 0.0) for p in self.model.parameters.values()}

    @property
    def initial_states(self) -> dict[str, float]:
        """State -> its value at the first sample of the first fitted record, SI."""
        return dict(zip(self.model.states, self.records[0].nodes[0].tolist(), strict=True))

    @property
    def Ts(self) -> float:
        """Sample time of the first fitted record [s]."""
        return self.records[0].Ts
