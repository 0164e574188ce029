"""Black-box models from the external reference to channels that the model takes as inputs.

A ship's rudder turns it, and its yaw rate is an input of the roll model that is measured, disturbed
and fed back: no reference by itself. Algorithm 8.1 of Linder (2017) puts a black-box model of the
way from the reference to that channel in its place, fitted once to each record,

    A(q) r = B(q) delta + e,        r_hat = (B/A) delta,                                      (1)

and simulates the loop from delta and r_hat, with what delta does to the eliminated input left out
(G_dv = 0). A poor model costs variance and not consistency: whatever it is, r_hat is made of delta.
The other channels' black-box models give the first instruments, before there is a parameter
estimate (step A (c)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.instruments.reference_filter import (
    Filter,
    ReferenceFilter,
    SampledFilter,
)
from casid.estimation.prediction_error.polynomial.estimation import arx, oe
from casid.model.model import Model
from casid.presentation import Presented

SLOWEST = 0.9999
"""Poles of a black box nearer to the unit circle are drawn back to this modulus (a heuristic)."""


@dataclass(frozen=True, slots=True, eq=False)
class BlackBoxReferences(Presented):
    """Black-box models of every record, and their responses to the reference.

    Attributes
    ----------
    experiments : those given, each with a channel ``"<channel> from <reference>"`` for every model:
        (N,), in the channel's unit, zero where the reference rests.
    filters : record -> channel -> B/A as a filter of the reference, fit in simulation [%].
    notes : poles that were drawn into the unit circle.
    """

    reference: str
    experiments: tuple[Experiment, ...]
    filters: Mapping[str, Mapping[str, SampledFilter]]
    notes: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that were modelled."""
        return tuple(next(iter(self.filters.values())))

    def name(self, channel: str) -> str:
        """The channel that holds the response of a black box to the reference."""
        return simulated_name(channel, self.reference)

    def __repr__(self) -> str:
        return (
            f"<BlackBoxReferences of {self.reference}: {', '.join(self.channels)}; "
            f"{len(self.experiments)} records>"
        )


def simulated_name(channel: str, reference: str) -> str:
    """Name of the channel that holds the response of a black box to the reference."""
    return f"{channel} from {reference}"


def black_box_references(
    experiments: Sequence[Experiment] | Experiment,
    reference: str,
    channels: Sequence[str],
    *,
    structure: Literal["arx", "oe"] = "arx",
    na: int = 4,
    nb: int = 5,
    nk: int = 0,
) -> BlackBoxReferences:
    """Fit (1) to every channel of every record, and simulate it from the reference.

    Parameters
    ----------
    reference : recorded channel that no disturbance and no output reaches
        (`casid.estimation.moments.instruments.exogeneity` tests this on the record).
    channels : those to be modelled.
    structure : ``"arx"``, or ``"oe"`` (nf = na), whose poles noise does not draw inwards.
    na, nb : coefficients of A and B.
    nk : first lag of B; 0: the reference may act at once.

    Raises
    ------
    DataError
        If a record has no such channel, or its reference never moves.
    ModelError
        If no channel is named, or the reference is among them.
    IdentifiabilityError
        If the reference does not excite even a model of one pole. Fewer poles are fitted where a
        record does not determine `na` (without noise it has one order only), with a note.

    Notes
    -----
    Coefficients of (1) come from the same noise as the estimate later. Their part in the
    instruments vanishes with the length of the record; what they miss is lost variance alone
    (Linder 2017, sections 5.1 and 8.5).
    """
    if isinstance(experiments, Experiment):
        experiments = [experiments]
    if not channels or reference in channels:
        raise ModelError(
            f"black boxes from {reference} to {', '.join(channels) or 'nothing'}: name the "
            "channels that the model takes as inputs or outputs, without the reference itself"
        )
    if structure not in ("arx", "oe"):
        raise ModelError(f"black boxes: structure = {structure!r}; choose 'arx' or 'oe'")
    made: list[Experiment] = []
    filters: dict[str, dict[str, SampledFilter]] = {}
    notes: list[str] = []
    for e in experiments:
        record = e.record
        u = _centred_reference(e, reference, channels)
        own: dict[str, SampledFilter] = {}
        for channel in dict.fromkeys(channels):
            y = np.asarray(record[channel])
            b, a, order = _fitted(y, u, structure, na, nb, nk, record.Ts)
            if order < na:
                notes.append(
                    f"{e.name}: {channel} from {reference} does not determine {na} poles; {order} "
                    "were fitted"
                )
            stable, moved = _inside(a)
            if moved:
                notes.append(
                    f"{e.name}: {structure.upper()} model of {channel} had poles outside the unit "
                    f"circle, {moved}; reflected, which costs variance alone"
                )
            found = SampledFilter(b, stable, record.Ts)
            simulated = found.apply(u, record.Ts)
            own[channel] = replace(found, fit=_fit(y, simulated))
            record = record.with_channel(
                simulated_name(channel, reference), simulated, record.units[channel]
            )
        made.append(replace(e, record=record))
        filters[e.name] = own
    return BlackBoxReferences(reference, tuple(made), filters, tuple(notes))


def _centred_reference(e: Experiment, reference: str, channels: Sequence[str]) -> Array:
    """The reference (N,) without its mean; refused where it rests, or a channel is missing."""
    record = e.record
    for name in (reference, *channels):
        if name not in record.names:
            raise DataError(
                f"{e.name}: no channel {name!r} for a black-box model from {reference}; it has "
                f"{', '.join(record.names)}"
            )
    delta = record[reference]
    if np.ptp(delta) == 0.0:
        raise DataError(
            f"{e.name}: the reference {reference} never moves, so nothing can be modelled from "
            "it; use a record in which it is excited"
        )
    return np.asarray(delta - delta.mean())


def black_box_instruments(
    model: Model,
    found: BlackBoxReferences,
    *,
    n_y: int = 16,
    n_u: int = 16,
    n_delta: int = 2,
    known: Mapping[str, Filter] | None = None,
) -> Instruments:
    """Instruments of Algorithm 8.1 for `found.experiments`: (8.84) first, then (8.85)-(8.92).

    Measured inputs of the direct model are driven by their black boxes, the reference by itself,
    and the eliminated inputs by nothing, or by a filter in `known`.

    Parameters
    ----------
    model : the indirect model, without unknown inputs.
    n_y, n_u, n_delta : lags, from lag 0, of each simulated output, of each simulated input and of
        the reference. Lags 0 to n + 1 of a signal span n lags of its differences over two samples,
        the mu of (8.56), and two more are taken for them.
    known : eliminated input -> filter from the reference, where something is known of it.

    Raises
    ------
    ModelError
        If a measured input has no black box, or nothing drives the model.
    """
    direct, reference = model.direct(), found.reference
    filters: dict[str, Filter] = dict(known or {})
    channels: dict[str, str] = {}
    for name, entry in direct.inputs.items():
        if entry.kind == "generated":
            continue
        channels[name] = reference
        if entry.kind == "unknown":
            filters.setdefault(name, ReferenceFilter.nothing())
        elif name in found.channels:
            channels[name] = found.name(name)
        elif entry.kind == "known":
            channels[name] = name
        elif name != reference:
            raise ModelError(
                f"{direct.name}: input {name} is measured, and there is no black-box model from "
                f"{reference} to it; name it in black_box_references(channels=[{name!r}, ...])"
            )
    silent = [n for n, e in direct.inputs.items() if e.kind == "unknown" and n not in (known or {})]
    if len(silent) == len(channels):
        raise ModelError(
            f"{direct.name}: {reference} drives nothing but {', '.join(silent)}, which is left out "
            "of the simulation; give a filter to it in known="
        )
    outputs = tuple(model.outputs)
    first = {reference: n_delta + 2}
    for channel in found.channels:
        first[found.name(channel)] = n_y + 2 if channel in outputs else n_u + 2
    return Instruments(
        channels,
        filters,
        initial="channels",
        first=first,
        n_delta=n_delta + 2,
        n_y=n_y + 2,
        n_u=n_u + 2,
    )


def _fitted(
    y: Array, u: Array, structure: str, na: int, nb: int, nk: int, Ts: float
) -> tuple[Array, Array, int]:
    """B, A and their order: the highest, up to na, that the record determines."""
    inputs = {"u": u, "offset": np.ones(len(u))}  # a mean that the record cuts off, or a bias
    for less in range(na):
        order, zeros = na - less, max(nb - less, 1)
        try:
            lags, zero = {"u": zeros, "offset": 1}, {"u": nk, "offset": 0}
            if structure == "arx":
                model = arx(y, inputs, na=order, nb=lags, nk=zero, Ts=Ts)
            else:
                poles = {"u": order, "offset": 0}
                model = oe(y, inputs, nf=poles, nb=lags, nk=zero, Ts=Ts, throw=False)
        except IdentifiabilityError:
            if order == 1:
                raise
            continue
        a = model.A if structure == "arx" else model.F["u"]
        return np.asarray(model.B["u"]), np.asarray(a), order
    raise ModelError(f"black boxes: na = {na} poles; give 1 or more")


def _inside(a: Array) -> tuple[Array, str]:
    """A monic polynomial with its roots inside the circle, and the moduli that were outside."""
    roots = np.roots(a)
    size = np.abs(roots)
    if not roots.size or size.max() < SLOWEST:
        return a, ""
    outside = size >= 1.0
    roots = np.where(outside, 1.0 / np.conj(np.where(outside, roots, 1.0)), roots)
    roots = roots * np.minimum(1.0, SLOWEST / np.maximum(np.abs(roots), TINY))
    moved = ", ".join(f"{s:.5f}" for s in size[outside])
    return np.asarray(np.real(np.poly(roots))), moved and f"|z| = {moved}"


def _fit(y: Array, simulated: Array) -> float:
    error = np.linalg.norm(y - simulated - (y - simulated).mean())
    return float(100 * (1 - error / max(float(np.linalg.norm(y - y.mean())), TINY)))
