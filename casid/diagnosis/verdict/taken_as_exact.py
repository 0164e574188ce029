"""What a diagnosis takes as exact because the model says so: constants and known inputs."""

from __future__ import annotations

from casid.model.effects.channels.channel_effects import constant_beside, is_command
from casid.model.model import Model


def taken_as_exact(model: Model) -> tuple[str, ...]:
    """Notes that name what no cause stands for, and how to have it suspected.

    Where it is wrong or changes, what it does is named as another effect that does much the same.
    """
    return (*_constants(model), *_commands(model))


def _constants(model: Model) -> tuple[str, ...]:
    """A note that names the constants of a model; none without any."""
    names = [name for name, p in model.parameters.items() if p.is_constant]
    if not names:
        return ()
    return (
        f"taken as exact, as `constant` declares, and never suspected: {', '.join(names)}. The "
        "causes named here may stand for one that is wrong or changes. Where one may be wrong, "
        "have it estimated, `parameter(name, unit, start=)`; where it is right at first and may "
        "change, as an efficiency may, declare it `parameter(name, unit, value=)`, of which "
        "changes are tested, and not the value",
    )


def _commands(model: Model) -> tuple[str, ...]:
    """A note that names the inputs declared known, and what passes for their bias."""
    names = [n for n in model.inputs if is_command(model, n)]
    if not names:
        return ()
    beside = {n: where for n in names if (where := constant_beside(model, n)) is not None}
    text = (
        f"taken as free of noise, as `known=True` declares, and never suspected of any: "
        f"{', '.join(names)}. Gain and dead time are tested all the same"
    )
    for name, where in beside.items():
        place = f"the {where} balance" if where in model.balances else where
        text += f"; a bias of {name} acts exactly as a constant of {place} and is named as that"
    return (text,)
