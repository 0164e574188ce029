"""Whether what is held out rests, and can neither confirm nor refute what was found before it.

Of cells that are washed out of a vessel, or a body that has come to rest, the end of the record
shows noise alone. A law that explains all of a misfit before it improves nothing there, and is
refused as if that were chance.
"""

from __future__ import annotations

import numpy as np

from casid.diagnosis.search.findings import Findings

RESTS = (
    "no output moves by more than its noise in what was held out, which can neither confirm nor "
    "refute a cause: all of the record is fitted, and a record that moves confirms it (--hold-out "
    "FILE)"
)
"""The note on causes of whole records that end at rest."""


def refused_at_rest(found: Findings) -> bool:
    """True where nothing is named, an effect was refused by what was held out, and that rests."""
    if found.baseline.why_undecided or found.adopted or found.baseline.split.is_empty:
        return False
    refused = any(why.error == "held-out" for _, why in found.search.refused)
    return refused and rests_in_held_out(found)


def rests_in_held_out(found: Findings) -> bool:
    """True if no output moves by more than its noise in the ends of records, and one does before.

    Noise and a motion as large have twice the power of the noise.
    """
    split, outputs = found.baseline.split, found.base_fit.criterion.outputs
    noise = np.asarray(found.baseline.start.noise.output_sd, dtype=float)
    fitted, held = np.zeros(len(outputs)), np.zeros(len(outputs))
    for e, is_held in zip(split.whole, split.held, strict=True):
        for i, name in enumerate(outputs):
            y = np.asarray(e.record[name], dtype=float)
            for part, power in ((is_held, held), (~is_held, fitted)):
                if np.isfinite(y[part]).any():
                    power[i] = max(power[i], float(np.nanvar(y[part])))
    limit = 2 * noise**2
    return bool(np.all(held < limit) and np.any(fitted > limit))
