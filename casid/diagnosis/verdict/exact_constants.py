"""Constants that a diagnosis takes as exact: none of its causes is a wrong or changing one."""

from __future__ import annotations

from casid.model.model import Model


def exact_constants(model: Model) -> tuple[str, ...]:
    """A note that names the constants of a model, which no cause stands for; none without any.

    Where one is wrong or changes, what it does is named as another effect that does much the same.
    """
    names = [name for name, p in model.parameters.items() if p.is_constant]
    if not names:
        return ()
    return (
        f"taken as exact, as `constant` declares, and never suspected: {', '.join(names)}. Where "
        "one may be wrong or may change, as an efficiency may, declare it "
        "`parameter(name, unit, value=)`: the causes named here may stand for it",
    )
