"""Names of the variables that a remainder may depend on, in words."""

from __future__ import annotations

import re

STEP = re.compile(r"step at (\S+) s")
"""What a change at an instant is called (`casid.model.effects.parameter_effects.step_at`)."""

RAMP = re.compile(r"share of the time from (\S+) to (\S+) s, .*")
"""What a drift is called (`ramp_over`)."""


def variable_words(name: str) -> str:
    """A variable as a reader has it; one made of the time with as many digits as he wants."""
    if step := STEP.fullmatch(name):
        return f"a step at {float(step[1]):.6g} s"
    if ramp := RAMP.fullmatch(name):
        start, stop = (f"{float(t):.6g}" for t in ramp.groups())
        return f"the time from {start} to {stop} s"
    return re.sub("^slope of", "the slope of", name)
