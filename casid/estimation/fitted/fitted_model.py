"""The fitted model: everything that is needed to simulate it again, elsewhere and later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, TypeAlias

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError, ModelError, nearest
from casid.estimation.fitted.driving import Driving, driving_of, silent_causes, warn_of
from casid.estimation.fitted.equations import ModelEquations, equations_of
from casid.estimation.fitted.finite_simulation import require_finite_simulation
from casid.estimation.fitted.innovations_form import predicted
from casid.estimation.fitted.model_comparison import ModelComparison, compared
from casid.estimation.fitted.parts import (
    AddedCause,
    Channels,
    FittedRecord,
    NoiseModel,
    SimulationSettings,
)
from casid.estimation.simulation.initial_state import fit_initial_state
from casid.estimation.simulation.known_simulation import KnownSimulation
from casid.estimation.simulation.records.signals import off_the_clock
from casid.exportable import Exportable
from casid.model.model import Model
from casid.presentation import Viewed
from casid.saving.saved import Saved

if TYPE_CHECKING:
    import pandas as pd

Inputs: TypeAlias = (
    "Record | Experiment | pd.DataFrame | Mapping[str, Array | float] | int | Driving"
)
"""What a fitted model can be driven with; a number of samples where it has no inputs."""


class HasModel(Protocol):
    """What has a fitted model: an estimate or a diagnosis."""

    @property
    def model(self) -> FittedModel | None:
        """The model of the fit."""
        ...


def _met(model: Model) -> set[str]:
    """Names of the symbols that the equations of a model hold."""
    e = model.explicit()
    return {s.name() for s in ca.symvar(ca.veccat(e.f, e.h))}


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel(Saved, Exportable, Viewed):
    """A model with its estimated values, and all that is needed to simulate it as the fit did.

    Numbers that are given or read by name are in the units that the model declares
    (`model.unit_of(name)`). Records are in SI, and so are `covariance` and the equations.

    Attributes
    ----------
    name : of the problem.
    model : the equations, extended by every cause, each parameter with its value.
    records : the fitted records; the first gives the sample time and the initial state that hold
        where nothing else is given.
    covariance_names, covariance : (n, n) of the estimated parameters and initial states.
    baseline : the model before, as it was fitted; None where nothing was added.
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
    baseline: FittedModel | None = None
    causes: tuple[AddedCause, ...] = ()
    settings: SimulationSettings = SimulationSettings()
    channels: Channels = Channels()
    noise: NoiseModel | None = None

    def __repr__(self) -> str:
        added = ", ".join(f"{c.kind} in {c.where}" for c in self.causes)
        fitted = ", ".join(r.name for r in self.records)
        return f"<FittedModel {self.name}: {len(self.values)} parameters, fitted to {fitted}" + (
            f", with {added}>" if added else ">"
        )

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value, in its unit; of one that each record has for itself the mean."""
        return self.model.in_declared_units(self.si_values)

    @property
    def si_values(self) -> dict[str, float]:
        """The values in SI, as the equations take them."""
        return {p.name: float(p.value or 0.0) for p in self.model.parameters.values()}

    @property
    def initial_states(self) -> dict[str, float]:
        """State -> its value at the first sample of the first fitted record, in its unit."""
        return self.model.in_declared_units(self.si_initial_states)

    @property
    def si_initial_states(self) -> dict[str, float]:
        """The initial states in SI."""
        return dict(zip(self.model.states, self.records[0].nodes[0].tolist(), strict=True))

    @property
    def operating_point(self) -> dict[str, float]:
        """State or input -> where the first fitted record works, in its unit.

        0 for what passes through it, else the mean: of inputs as recorded, of states as simulated.
        """
        names = {*self.model.states, *self.model.inputs}
        found = {n: v for n, v in self.records[0].operating_point.items() if n in names}
        return self.model.in_declared_units(found)

    @property
    def Ts(self) -> float:
        """Sample time of the first fitted record [s]."""
        return self.records[0].Ts

    def simulate(
        self,
        inputs: Inputs,
        x0: Mapping[str, float] | Array | None = None,
        Ts: float | None = None,
        *,
        known: Mapping[str, float] | None = None,
        on_clock: bool | None = None,
    ) -> Record:
        """Outputs and states of a free simulation, integrated as in the fit.

        Parameters
        ----------
        inputs : a record, an experiment (with its load case), a DataFrame (read through the
            problem's channels), or a mapping of input to N samples in its unit, a number holding
            for all of them. For a model without inputs the number of samples will do.
        x0 : initial state (nx,), or state -> value for some of them, in the states' units. Of the
            others, and by default, a fitted record gets the initial state that was estimated for
            it, and anything else that of the first fitted record.
        Ts : sample time [s] of a mapping or number of samples, default that of the first fitted
            record. A record has its own.
        known : parameter -> value in its unit for this simulation, over those of the fit.
        on_clock : whether jumps, drifts and periodic terms act, which the fit found on the clock of
            its records. Default: in those records, and other windows of them or of their files;
            where they do not act a warning says so.

        Returns
        -------
        Record
            Inputs, outputs (without noise) and states, SI; a state that shares its name with an
            output has "(state)" behind it.

        Raises
        ------
        DataError
            For inputs that are missing, incomplete, or in another unit than the model's.
        ModelError
            For names of `x0` or `known` that the model does not have.
        SolveError
            If the simulation diverges: at which time.
        """
        given = self._driving(inputs, Ts, needs_outputs=False)
        warn_of(self._silent(given) if on_clock is None else "")
        return self._simulated(given, self._start_in_si(x0), self._known_in_si(known), on_clock)

    def predict(
        self,
        record: Record | Experiment | pd.DataFrame,
        horizon: int | None = 1,
        *,
        known: Mapping[str, float] | None = None,
        on_clock: bool | None = None,
    ) -> Record:
        """Outputs predicted `horizon` samples ahead, from the inputs and the outputs before.

        Without a noise model (after a simulation-error fit) the outputs measured say nothing of
        those to come: the prediction is the simulation, whatever the horizon.

        Parameters
        ----------
        record : with inputs and outputs. Where it was fitted, it starts from the estimated initial
            state, otherwise from the one with which it is simulated best (least squares).
        horizon : samples between the last output used and the one predicted, 1 or more; None
            simulates.
        known : parameter -> value in its unit for this record, over those of the fit.
        on_clock : as in `simulate`.

        Returns
        -------
        Record
            The outputs, SI. The first ones are predicted from the initial state, as nothing was
            measured before.

        Raises
        ------
        DataError
            For channels that are missing, or a horizon that is not a positive whole number.
        """
        if horizon is not None and (int(horizon) != horizon or horizon < 1):
            raise DataError(
                f"{self.name}: horizon = {horizon!r}; give a whole number of samples ahead, 1 or "
                "more, or None for the simulation"
            )
        given, known = self._driving(record, None), self._known_in_si(known)
        if given.record is None:
            raise DataError(f"{self.name}: a prediction needs measured outputs; give a record")
        acts = given.is_on_clock if on_clock is None else on_clock
        if self.noise is None or horizon is None:
            simulated = self._simulated(given, self._start(given, known, acts), known, acts)
            y = np.column_stack([simulated[name] for name in self.model.outputs])
        else:
            values = self._values(given, known)
            start = None if given.fitted is None else given.fitted.nodes[0]
            experiment = Experiment(given.record, {}, given.name)
            substeps = self._substeps(given.Ts)
            model = self.model if acts else off_the_clock(self.model)
            y = predicted(
                model.with_si_values(values),
                self.noise,
                experiment,
                start,
                int(horizon),
                substeps,
            )
        outputs = {name: y[:, i] for i, name in enumerate(self.model.outputs)}
        units = {name: unit for name, (_, unit) in self.model.outputs.items()}
        return self._record(given, outputs, units)

    def residuals(
        self,
        record: Record | Experiment | pd.DataFrame,
        horizon: int | None = None,
        *,
        known: Mapping[str, float] | None = None,
        on_clock: bool | None = None,
    ) -> Record:
        """Measured minus simulated outputs, or minus those predicted `horizon` samples ahead.

        Returns
        -------
        Record
            One channel an output (N,), SI; samples that are missing in `record` are marked so.
            `to_frame()` makes a DataFrame of it.

        Raises
        ------
        DataError
            As `predict`.
        """
        given = self._driving(record, None)
        if given.record is None:
            raise DataError(f"{self.name}: residuals need measured outputs; give a record")
        expected = self.predict(record, horizon, known=known, on_clock=on_clock)
        names = list(self.model.outputs)
        errors = {name: given.record[name] - expected[name] for name in names}
        units = {name: unit for name, (_, unit) in self.model.outputs.items()}
        missing = {name: given.record.is_missing(name) for name in names}
        return self._record(given, errors, units, missing)

    def compare(
        self,
        record: Record | Experiment | pd.DataFrame,
        *others: FittedModel | HasModel,
        horizon: int | None = None,
        on_clock: bool | None = None,
    ) -> ModelComparison:
        """This model and others against one record, as MATLAB's `compare`.

        Parameters
        ----------
        record : with inputs and outputs of all models; of one that a model was not fitted to, its
            initial state is estimated.
        others : fitted models, estimates or diagnoses; default the model before, where there is
            one.
        horizon : samples ahead of which is predicted; default free simulation.
        on_clock : as in `simulate`; what does not act is in the `notes`, too.

        Returns
        -------
        ModelComparison
            Fit in per cent, 100 (1 - norm(y - yhat) / norm(y - mean y)), of every output of this
            model; `to_frame()` is a table, `plot()` a figure.

        Raises
        ------
        DataError
            For channels that are missing, or models without an output of this one.
        """
        given = self._driving(record, None)
        if given.record is None:
            raise DataError(f"{self.name}: a comparison needs measured outputs; give a record")
        models: list[FittedModel] = [self]
        for other in others:
            model = other if isinstance(other, FittedModel) else other.model
            if model is None:
                raise DataError(f"{other!r} has no fitted model; give a FittedModel")
            lacking = [name for name in self.model.outputs if name not in model.model.outputs]
            if lacking:
                raise DataError(
                    f"{model.name} has no output {lacking[0]}, on which {self.name} is compared; "
                    f"it has {', '.join(model.model.outputs)}"
                )
            models.append(model)
        if not others and self.baseline is not None:
            models.append(self.baseline)
        experiment = Experiment(given.record, dict(self.model.in_declared_units(given.known)))
        expected: dict[str, Record] = {}
        silent: dict[str, None] = {}
        for model in models:
            if on_clock is None:
                silent[model._silent(model._driving(given.record, None))] = None
            added = " + ".join(c.kind for c in model.causes)
            label = f"{model.name} + {added}" if added else model.name
            number = sum(name.partition("#")[0] == label for name in expected) + 1
            label = label if number == 1 else f"{label}#{number}"
            expected[label] = model.predict(experiment, horizon, on_clock=on_clock)
        notes = tuple(filter(None, silent))
        warn_of(*notes)
        units = {name: unit for name, (_, unit) in self.model.outputs.items()}
        declared = [self.model.unit_of(name) for name in units]
        return compared(given.record, expected, units, horizon, declared, notes)

    def equations(self) -> ModelEquations:
        """The equations: `print` shows text, `latex()` gives LaTeX, new terms marked in both."""
        return equations_of(self.model, None if self.baseline is None else self.baseline.model)

    def without_noise(self) -> FittedModel:
        """The model without the disturbances that drive it: what is simulated and exported."""
        if self.noise is None:
            return self
        before, new = _met(self.model), self.model.copy()
        for w in self.noise.sources:
            if w.where in new.inputs:
                new.substitute_symbol(w.where, 0)
                del new.inputs[w.where]
        for name in self.noise.shaped:
            new.take_out_at_zero(name)
        for balance in new.balances.values():
            terms = tuple(term for term in balance.terms if not ca.SX(term).is_zero())
            new.balances[balance.name] = replace(balance, terms=terms)
        for name in before - _met(new):
            new.parameters.pop(name, None)
        new = new.copy()  # whose equations are solved anew
        kept = [name in new.states for name in self.model.states]
        records = tuple(replace(r, nodes=r.nodes[:, kept]) for r in self.records)
        return replace(self, model=new, records=records, noise=None)

    # -- inside ------------------------------------------------------------------------------

    @property
    def _driven(self) -> Model:
        """The model without the noise that drives it: what a simulation has to be given."""
        if self.noise is None:
            return self.model
        new = self.model.copy()
        for w in self.noise.sources:
            if w.where in new.inputs:
                new.inputs[w.where] = replace(new.inputs[w.where], kind="generated", signal=None)
        return new

    def _driving(self, inputs: Inputs, Ts: float | None, *, needs_outputs: bool = True) -> Driving:
        model, fitted, channels = self._driven, self.records, self.channels
        return driving_of(model, fitted, inputs, Ts, channels, needs_outputs=needs_outputs)

    def _silent(self, given: Driving) -> str:
        return silent_causes(self.model, self.causes, self.records, given)

    def _known_in_si(self, known: Mapping[str, float] | None) -> dict[str, float]:
        return self.model.in_si(known or {})

    def _start_in_si(
        self, x0: Mapping[str, float] | Array | None
    ) -> dict[str, float] | Array | None:
        """An initial state in the states' units, in SI; checked where it is used."""
        if x0 is None or isinstance(x0, Mapping):
            return None if x0 is None else self.model.in_si(x0)
        start = np.asarray(x0, dtype=float).ravel()
        if len(start) != len(self.model.states):
            return start
        named = dict(zip(self.model.states, start.tolist(), strict=True))
        return np.array(list(self.model.in_si(named).values()))

    def _values(self, given: Driving, known: Mapping[str, float] | None) -> dict[str, float]:
        """Value of every parameter in a record."""
        for name in {**given.known, **(known or {})}:
            if name not in self.model.parameters:
                raise ModelError(
                    f"{self.name}: the model has no parameter {name!r} to set"
                    f"{nearest(name, self.model.parameters)}"
                )
        own = given.fitted.known if given.fitted is not None else {}
        values = {**self.si_values, **own, **given.known, **(known or {})}
        return {n: float(v) for n, v in values.items()}

    def _substeps(self, Ts: float) -> int:
        """Runge-Kutta steps a sample: at least as many a second as the fit had."""
        return max(1, int(np.ceil(self.settings.substeps * Ts / self.Ts - 1e-6)))

    def _start(self, given: Driving, known: Mapping[str, float] | None, acts: bool) -> Array | None:
        """The initial state (nx,) that simulates a record best; None where it was fitted."""
        if given.fitted is not None:
            return None
        assert given.record is not None
        values = self._values(given, known)
        experiment = Experiment(given.record, {}, given.name)
        weights = self.settings.weights if self.settings.weights.size else None
        model = self._driven if acts else off_the_clock(self._driven)
        criterion, point = fit_initial_state(
            model.with_si_values(values),
            experiment,
            weights=weights,
            substeps=self._substeps(given.Ts),
        )
        return criterion.parameter_vector(point, 0)[1]

    def _nodes(
        self, given: Driving, x0: Mapping[str, float] | Array | None
    ) -> tuple[Array, Array | None]:
        """States (segments, nx) that a simulation starts from, and at which samples (segments,)."""
        fitted = given.fitted
        if x0 is None and fitted is not None and len(given.u) >= fitted.N:
            return fitted.nodes, fitted.cuts
        start = np.array((fitted or self.records[0]).nodes[0])
        names = list(self.model.states)
        if isinstance(x0, Mapping):
            for name, value in x0.items():
                if name not in names:
                    raise ModelError(
                        f"{self.name}: x0 names {name!r}, which is no state{nearest(name, names)}"
                    )
                start[names.index(name)] = value
        elif x0 is not None:
            start = np.asarray(x0, dtype=float).ravel()
        if start.shape != (len(names),) or not np.all(np.isfinite(start)):
            raise ModelError(
                f"{self.name}: x0 holds {start.size} numbers; give {len(names)} finite ones, of "
                f"{', '.join(names) or 'no state'} in this order, or a mapping"
            )
        return start[None, :], None

    def _simulated(
        self,
        given: Driving,
        x0: Mapping[str, float] | Array | None,
        known: Mapping[str, float] | None,
        on_clock: bool | None,
    ) -> Record:
        model = self._driven
        values = self._values(given, known)
        u = given.u
        if not (given.is_on_clock if on_clock is None else on_clock):
            of_clock = [entry.signal is not None for entry in model.inputs.values()]
            u = np.where(of_clock, 0.0, u)
        nodes, cuts = self._nodes(given, x0)
        simulation = KnownSimulation(model, given.Ts, self._substeps(given.Ts))
        y, x = simulation.run(u, values, nodes, cuts)
        require_finite_simulation(self.name, model, given, values, y, x)
        channels, units = {}, {}
        for i, (name, entry) in enumerate(model.inputs.items()):
            if entry.kind != "generated":
                channels[name], units[name] = given.u[:, i], entry.unit
        for i, (name, (_, unit)) in enumerate(model.outputs.items()):
            channels[name], units[name] = y[:, i], unit
        for i, (name, state) in enumerate(model.states.items()):
            label = name if name not in channels else f"{name} (state)"
            channels[label], units[label] = x[:, i], state.unit
        return self._record(given, channels, units)

    def _record(
        self,
        given: Driving,
        channels: Mapping[str, Array],
        units: Mapping[str, str],
        missing: Mapping[str, Array] | None = None,
    ) -> Record:
        line = f"computed with the fitted model {self.name}"
        return Record(channels, units, given.Ts, given.t0, given.name, missing or {}, (line,))
