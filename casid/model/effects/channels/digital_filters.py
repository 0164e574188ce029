"""A digital filter of first order behind a sensor: what a logger makes of its samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.declarations import Parameter, Stage
from casid.model.effects.effect import Effect, Sizes
from casid.model.effects.names import DIGITAL
from casid.model.effects.search_ranges import RANGES
from casid.model.model import Model


@names_wrong_types(ModelError)
def digital_filter(model: Model, channel: str, longest: float) -> Effect:
    """An output behind y_k = y_(k-1) + Ts/(tau + Ts) (x_k - y_(k-1)), tau up to `longest` seconds.

    An exponential moving average of the samples x_k, with the factor Ts/(tau + Ts). A `sensor_lag`
    is the lag of a sensor ahead of the sampling, which a step at a sample does not move yet; this
    filter shows its share of the step at once. Behind a signal without steps it is that lag, half a
    sample earlier. It comes behind all other stages of its output.

    Parameters
    ----------
    model, channel : the model and its output.
    """
    p = Parameter(f"filter_{channel}", "s", 0.0, lower=0.0, upper=longest)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.stages = (*new.stages, Stage("filter", channel, names[0]))

    return Effect(
        "sensor_lag",
        channel,
        (p,),
        apply,
        sided="positive",
        limit=longest,
        priority=1,
        shape=DIGITAL,
        description=f"the samples of {channel} have passed a {DIGITAL} of first order, "
        f"y_k = y_(k-1) + Ts/({p.name} + Ts) (x_k - y_(k-1))",
    )


def digital_filters_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Filters of outputs that a held input moves at once; elsewhere a lag does the same."""
    longest = RANGES.sensor_lag * sizes.longest_delay
    held = [model.symbol(n) for n, u in model.inputs.items() if "zoh" in u.holds]
    for channel, (expression, _) in model.outputs.items():
        lags = any(s.channel == channel and s.kind in ("lag", "filter") for s in model.stages)
        moves = held and any(ca.which_depends(ca.SX(expression), ca.vertcat(*held)))
        if moves and not lags:
            yield digital_filter(model, channel, longest)
