"""Write what later versions must read: `python -m tests.saving.write_golden`.

A saved estimate, and the fields of every class that a saved result holds. Run it once for a new
version of the schema, with the version in the names of the files.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casid
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.parameter_effects import parameter_jump
from casid.saving.archive import VERSION
from casid.saving.plain_values import Encoder
from tests.estimation.fitted.test_fitted_model import record
from tests.report.golden_results import assessment
from tests.support import samples
from tests.support.fitted_models import driven_mass

FOLDER = Path(__file__).parent / "golden"


def estimate() -> casid.Estimate:
    """An oscillator whose sensor is late and whose stiffness jumps."""
    model = driven_mass()
    model = time_delay(model, "position", 0.2).extend(model, starts={"delay_position": 0.03})
    model = parameter_jump(model, "k", 1.0).extend(model)
    return casid.identify(casid.Problem("oscillator", model, starts=1), record(N=100))


def saved_fields() -> dict[str, list[str]]:
    """Class -> fields, of all that the sample results hold."""
    found: dict[str, list[str]] = {}
    for result in (estimate(), samples.rich(), samples.undecided(), assessment()):
        for place, fields in _classes(Encoder().plain(result, "")):
            found[place] = sorted(fields)
    return dict(sorted(found.items()))


def _classes(plain: Any) -> Iterator[tuple[str, Any]]:
    """Place and fields of every instance within plain values."""
    if isinstance(plain, dict):
        if "$class" in plain:
            yield plain["$class"], plain["fields"]
        plain = list(plain.values())
    if isinstance(plain, list):
        for value in plain:
            yield from _classes(value)


if __name__ == "__main__":
    print(estimate().save(FOLDER / f"estimate_{VERSION}.casid"))
    table = json.dumps(saved_fields(), indent=1) + "\n"
    (FOLDER / f"fields_{VERSION}.json").write_text(table, encoding="utf-8")
