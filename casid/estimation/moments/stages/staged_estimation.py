"""Estimation in stages, each given the estimates of the earlier ones.

A joint estimate is the case of one stage with all records (Linder 2017, Approaches 5.1, 5.2, 7.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import ModelError
from casid.estimation.moments.equations.parts import parts_of
from casid.estimation.moments.instruments.instruments import Instruments, Loop
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.stage import Stage, StageFit
from casid.estimation.moments.stages.stage_estimate import moment_estimate
from casid.estimation.moments.stages.stage_plan import StageRecords, StageSpec, refuse_undetermined
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Programs:
    """Programs built once for all records of one form, whatever the values of a prior."""

    equations: dict[tuple[str, float], DifferenceEquation] = field(default_factory=dict)
    loops: dict[float, Loop] = field(default_factory=dict)
    stages: dict[tuple[Any, ...], Stage] = field(default_factory=dict)


class StagedEstimation:
    """Stages whose programs are built once, for any records of the same form.

    Parameters
    ----------
    stages : in order; without `free`, those parameters that the model declares unknown.
    instruments : None: least squares.
    prior : known values with their uncertainty.
    programs : those of an estimation that differs in the values of its prior alone.

    Raises
    ------
    ModelError
        For a model that is no difference equation, parameters that do not exist, or are estimated
        and known at once.
    """

    def __init__(
        self,
        problem: Problem | Model,
        stages: Sequence[StageSpec],
        instruments: Instruments | None = None,
        prior: Prior | None = None,
        settings: MomentSettings | None = None,
        programs: Programs | None = None,
    ) -> None:
        self.name = problem.name
        self.model = model = with_prior(problem, prior)
        self.prior, self.settings = prior, settings or MomentSettings()
        if model.stages:
            stage = model.stages[0]
            raise ModelError(
                f"{model.name}: channel {stage.channel} has a {stage.kind}, which a difference "
                "equation cannot show; leave that effect out, or use casid.identify"
            )
        if instruments is not None and not isinstance(instruments, Instruments):
            raise ModelError(
                f"instruments = {instruments!r}; give casid.Instruments('reference'), named after "
                "the channel that no disturbance reaches"
            )
        self.instruments = instruments
        self.declared = tuple(p.name for p in model.parameters.values() if not p.is_known)
        self.stages = [replace(s, free=tuple(s.free) or self.declared) for s in stages]
        for f in (f for s in self.stages for f in s.free):
            model.parameter_named(f)
            if prior is not None and f in prior.values:
                raise ModelError(
                    f"{f} is estimated and has a prior value; take it out of one of the two"
                )
        self._programs = programs or Programs()

    def read(self, experiments: Sequence[Experiment]) -> list[StageRecords]:
        """The records of all stages.

        Raises
        ------
        ModelError
            If a stage names a record that is not there, or a parameter that affects its records
            is neither known nor estimated by then.
        DataError
            As `parts_of`.
        """
        by_name = {e.name: e for e in experiments}
        out = []
        for i, s in enumerate(self.stages):
            own = s.settings or self.settings
            absent = [r for r in s.records or () if r not in by_name]
            if absent:
                raise ModelError(
                    f"stage {i + 1}: no record {absent[0]!r}; there are {', '.join(by_name)}"
                )
            chosen = experiments if s.records is None else [by_name[r] for r in s.records]
            parts = parts_of(
                self.model,
                chosen,
                method=own.method,
                outputs=own.outputs,
                equations=self._programs.equations,
            )
            before = {f for earlier in self.stages[:i] for f in earlier.free}
            refuse_undetermined(self.stages, i, parts, {*self.declared} - before - {*s.free})
            out.append(StageRecords(i, tuple(s.free), own, tuple(chosen), tuple(parts)))
        return out

    def fit(self, stages: Sequence[StageRecords]) -> tuple[StageFit, ...]:
        """One stage after the other, each with the estimates of the earlier ones."""
        fits: list[StageFit] = []
        found: dict[str, float] = {}
        for s in stages:
            key = (s.number, *((p.name, p.Ts, p.known) for p in s.parts))
            if key not in self._programs.stages:
                self._programs.stages[key] = Stage(
                    self.model,
                    s.parts,
                    s.free,
                    s.settings,
                    self.instruments,
                    loops=self._programs.loops,
                    name=f"stage {s.number + 1}",
                )
            values = [
                {**p.values, **{k: v for k, v in found.items() if k not in p.known}}
                for p in s.parts
            ]
            fits.append(self._programs.stages[key].fit(s.parts, values))
            found |= dict(zip(s.free, fits[-1].theta_p.tolist(), strict=True))
        return tuple(fits)

    def estimate(
        self,
        experiments: Sequence[Experiment],
        stages: Sequence[StageRecords],
        structural: str,
    ) -> MomentEstimate:
        """The estimate from records that were read; `structural`: their identifiability."""
        provenance = [f"{e.name}: {line}" for e in experiments for line in e.record.provenance]
        fits = self.fit(stages)
        return moment_estimate(
            self.model,
            fits,
            self.settings,
            self.prior,
            how=self.settings.covariance,
            origin=(self.name, provenance),
            structural=structural,
        )


def with_prior(problem: Problem | Model, prior: Prior | None) -> Model:
    """The model of a problem, the parameters of a prior known.

    Raises
    ------
    ModelError
        If the model has no such parameter.
    """
    model = problem.model if isinstance(problem, Problem) else problem
    if prior is None:
        return model
    for name in prior.values:
        model.parameter_named(name)
    return model.with_known(**{k: float(v) for k, v in prior.values.items()})
