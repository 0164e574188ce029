"""What is doubtful in a problem as it is written, before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_floor import floor_error
from casid.estimation.noise.thresholds import STATED_NOISE
from casid.estimation.simulation.records.signals import signals_of
from casid.identification.inertia_sides import note_on_sides
from casid.model.quantities import quantity_text


def problem_notes(problem: Problem, experiments: Sequence[Experiment]) -> list[str]:
    """What its equations and its records say against its bounds and the noise that it states."""
    sides = note_on_sides(problem, experiments)
    return [*sides, *notes_on_stated_noise(problem, experiments)]


def notes_on_stated_noise(problem: Problem, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """A note on each measured input whose channel shows far more noise than is stated of it.

    With less noise of an input stated than there is, what the rest of it adds to the outputs passes
    for a disturbance, or for a cause. The floor of a spectrum bounds the noise from above: an input
    may be as fast itself.
    """
    model, stated = problem.model, problem.noise
    measured = {n for n, u in model.inputs.items() if u.kind == "measured"}
    if not any(stated.get(name, 0.0) > 0 for name in measured):
        return ()
    data = [signals_of(model, e) for e in experiments]
    by_chance = STATED_NOISE.floor_errors * floor_error([d.N for d in data])
    least = max(1.0 - by_chance, 0.0) ** 0.5
    out = []
    for name, floor in input_noise_floor(data, list(model.inputs)).items():
        sd = stated.get(name, 0.0)
        if name not in measured or not 0 < STATED_NOISE.larger * sd < least * floor:
            continue
        unit = model.unit_of(name)
        own, shown = (quantity_text(model.shown_size(name, v), unit) for v in (sd, floor))
        out.append(
            f"the channel of {name} scatters from sample to sample as noise of {shown} would, and "
            f"{own} is stated. If its sensor is that noisy, error bars are too small, and a "
            f"disturbance or a cause may be its noise: state {shown}, or no noise of {name}, to "
            "have it estimated"
        )
    return tuple(out)
