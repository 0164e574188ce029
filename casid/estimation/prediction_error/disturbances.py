"""Disturbances that act on a model at a named place, with a parametric spectrum.

    white    w                                                     sd of the density: s
    first    f' = -w_0 f + sqrt(2 w_0) s w                         variance s^2, corner w_0
    peak     f = b, a' = w_0 b, b' = -2 zeta w_0 b - w_0 a + sqrt(4 zeta w_0) s w
                                                                   variance s^2, peak w_0       (1)

with w white noise of unit density and f what is added to the terms of a balance or to the rate of a
state, or what stands for an input that nobody measures. The last is the usual linear model of a
sea, without power at low frequencies (Fossen 2011, section 8.2.6): the band of
`disturbance_spectrum`. Its integral is taken times w_0: both states then have the unit and variance
of f, whether the peak is at 10 Hz or comes once a day. Size s, frequency w_0 and half the relative
width zeta are parameters of the model like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import casadi as ca

from casid.errors import DataError, ModelError, nearest
from casid.estimation.noise.forces import shown_force, unit_of_force
from casid.linear.filtering.noisy_model import White
from casid.model.model import Model
from casid.model.units import is_si, parse_unit, unit_quotient

SPECTRA = ("white", "first", "peak")
"""Of a disturbance."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Where it acts, a balance, a state or an unknown input, and what spectrum it has.

    Raises
    ------
    DataError
        For a spectrum that there is none of.
    """

    place: str
    spectrum: str = "white"

    def __post_init__(self) -> None:
        if self.spectrum not in SPECTRA:
            raise DataError(
                f"disturbance {self.place}:{self.spectrum}: the spectrum is one of "
                f"{', '.join(SPECTRA)}{nearest(self.spectrum, SPECTRA)}"
            )

    @classmethod
    def of(cls, text: str) -> Disturbance:
        """From PLACE or PLACE:SPECTRUM."""
        place, colon, spectrum = text.rpartition(":")
        return cls(place, spectrum) if colon else cls(text)

    @property
    def size(self) -> str:
        """The parameter s of (1)."""
        return f"size of disturbance in {self.place}"

    @property
    def frequency(self) -> str:
        """The parameter w_0 of (1): the corner or the peak."""
        return f"{'corner' if self.spectrum == 'first' else 'peak'} of disturbance in {self.place}"

    @property
    def width(self) -> str:
        """The parameter zeta of (1)."""
        return f"width of disturbance in {self.place}"

    @property
    def force(self) -> str:
        """The state f or b of (1)."""
        return f"disturbance in {self.place}"

    @property
    def quadrature(self) -> str:
        """The state a of (1), a quarter of a period behind b."""
        return f"quadrature of disturbance in {self.place}"

    @property
    def source(self) -> str:
        """The white noise behind it, an unknown input of the model."""
        return f"source of disturbance in {self.place}"


def with_disturbances(
    model: Model, disturbances: Sequence[Disturbance]
) -> tuple[Model, list[White]]:
    """The model with its disturbances, and the white noise that drives them.

    Raises
    ------
    ModelError
        For a place that is neither a balance, a state nor an unknown input, or is named twice; for
        an unknown input that no disturbance stands for.
    """
    new, sources = model.copy(), []
    places = [_place(model, d.place) for d in disturbances]
    for place in places:
        if places.count(place) > 1:
            raise ModelError(f"{model.name}: disturbances in {place} stated twice; give one")
    for name, entry in model.inputs.items():
        if entry.kind == "unknown" and name not in places:
            raise ModelError(
                f"{model.name}: input {name} is unknown; let a disturbance stand for it as well "
                f"(--disturbance {name}:first), or eliminate it with an output that responds to it"
            )
    for d, place in zip(disturbances, places, strict=True):
        force = _force(new, d, unit_of_force(model, place))
        _, shown = shown_force(model, place, 0.0)
        if d.spectrum != "white" and not (is_si(shown) or parse_unit(shown).offset):
            there = {*new.parameters, *new.states}
            own = [n for n in (d.size, d.force, d.quadrature) if n in there]
            new.declared_units |= dict.fromkeys(own, shown)
        if place in model.balances:
            new.add_term(place, force)
        elif place in model.states:
            new.add_rate(place, force)
        else:
            new.substitute_symbol(place, force)
            del new.inputs[place]
        sources.append(White(d.source, 1.0, is_known=True))
    return new, sources


def with_known_noise(model: Model, disturbances: Sequence[Disturbance]) -> Model:
    """The model with its disturbances, from zero, as if the noise that drives them were recorded.

    No statistics of the noise can determine more: what is not identifiable in this model is not
    identifiable.
    """
    new, sources = with_disturbances(model, disturbances)
    for source in sources:
        new.inputs[source.where] = replace(new.inputs[source.where], kind="known")
    for d in disturbances:
        for name in {d.force, d.quadrature} & set(new.states):
            new.states[name] = replace(new.states[name], initial=0.0)
    return new


def undisturbed(model: Model, disturbances: Sequence[Disturbance]) -> Model:
    """The model without the unknown inputs that disturbances stand for: they are zero."""
    new = model.copy()
    for d in disturbances:
        if d.place in model.inputs:
            new.substitute_symbol(d.place, ca.SX(0))
            del new.inputs[d.place]
    return new


def stationary_spread(model: Model, disturbances: Sequence[Disturbance]) -> dict[str, Any]:
    """State of a disturbance -> its stationary standard deviation, in the parameters of (1).

    `model` is the one that `with_disturbances` returned. White ones have no state.
    """
    spread = {}
    for d in disturbances:
        if d.spectrum == "white":
            continue
        spread[d.force] = model.symbol(d.size)
        if d.spectrum == "peak":
            spread[d.quadrature] = model.symbol(d.size)
    return spread


def _place(model: Model, place: str) -> str:
    """The balance, or the state with a rate of its own, that a place names."""
    if place in model.balances:
        return place
    for balance in model.balances.values():
        if balance.rate == place:
            return balance.name
    unknown = [n for n, entry in model.inputs.items() if entry.kind == "unknown"]
    if place in model.states or place in unknown:
        return place
    known = (*model.balances, *model.states, *unknown)
    raise ModelError(
        f"{model.name}: a disturbance in {place!r} acts on nothing{nearest(place, known)}; name a "
        f"balance ({', '.join(model.balances) or 'none'}), a state ({', '.join(model.states)}) or "
        f"an unknown input ({', '.join(unknown) or 'none'})"
    )


def _force(new: Model, d: Disturbance, unit: str) -> Any:
    """(1), its states and parameters added to the model."""
    if d.spectrum == "white":
        density = unit_quotient(unit, "s", Fraction(-1, 2))
        size = new.parameter(d.size, density, start=1.0, lower=0.0)
        return size * new.unknown_input(d.source, "1/s^0.5")
    size = new.parameter(d.size, unit, start=1.0, lower=0.0)
    white = new.unknown_input(d.source, "1/s^0.5")
    frequency = new.parameter(d.frequency, "rad/s", start=1.0, lower=1e-6, upper=1e6)
    force = new.state(d.force, unit)
    if d.spectrum == "first":
        new.derivative(force, -frequency * force + ca.sqrt(2 * frequency) * size * white)
        return force
    width = new.parameter(d.width, "1", start=0.1, lower=1e-3, upper=2.0)
    quadrature = new.state(d.quadrature, unit)
    new.derivative(quadrature, frequency * force)
    drive = ca.sqrt(4 * width * frequency) * size * white
    new.derivative(force, drive - 2 * width * frequency * force - frequency * quadrature)
    return force


def rest_of(model: Model) -> dict[str, Any] | None:
    """Where a linear model rests without inputs: state -> its value; empty where at zero.

    None for a model that is not linear in its states and inputs.
    """
    e = model.explicit()
    signals = ca.vertcat(e.x, e.u)
    slopes = ca.jacobian(ca.vertcat(e.f, e.h), signals)
    if ca.depends_on(slopes, signals):
        return None
    at_zero = ca.substitute(e.f, signals, ca.SX.zeros(*signals.shape))
    if at_zero.is_zero() or not at_zero.nnz():
        return {}
    A = ca.jacobian(e.f, e.x)
    where = ca.simplify(ca.solve(A, -at_zero))
    return {name: where[i] for i, name in enumerate(e.states)}
