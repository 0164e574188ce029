"""Tables of numbers as text, and the instants of a short record."""

from __future__ import annotations

import numpy as np


def rows(times, *columns, header="t,phi_deg,force_N", separator=","):
    """A table as text, every number written so that it reads back to the last bit."""
    lines = [header]
    columns = columns or (np.sin(times), np.cos(times))
    for values in zip(times, *columns, strict=True):
        lines.append(separator.join(repr(float(v)) for v in values))
    return "\n".join(lines) + "\n"


T = np.arange(50) / 10
