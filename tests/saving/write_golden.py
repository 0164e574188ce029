"""Write a saved estimate for later versions to read: `python -m tests.saving.write_golden`.

Run it once for a new version of the schema, with the version in the name of the file.
"""

from __future__ import annotations

from pathlib import Path

import casid
from casid.model.effects.channel_effects import time_delay
from casid.model.effects.parameter_effects import parameter_jump
from casid.saving.archive import VERSION
from tests.estimation.fitted.test_fitted_model import record
from tests.support.fitted_models import driven_mass

FOLDER = Path(__file__).parent / "golden"


def estimate() -> casid.Estimate:
    """An oscillator whose sensor is late and whose stiffness jumps."""
    model = driven_mass()
    model = time_delay(model, "position", 0.2).extend(model, starts={"delay_position": 0.03})
    model = parameter_jump(model, "k", 1.0).extend(model)
    return casid.identify(casid.Problem("oscillator", model, starts=1), record(N=100))


if __name__ == "__main__":
    print(estimate().save(FOLDER / f"estimate_{VERSION}.casid"))
