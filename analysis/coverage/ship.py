"""The roll of a ship with a rudder in beam seas: the direct model, its sway a disturbance.

The accelerometer feels the roll torque of the waves at once. As an input it brings that torque
back, and everything is biased by tens of standard errors; as an output it shows it. So the sway
acceleration, which nobody measures, is a disturbance of the first order beside the torque, a
resonance. Neither spectrum is what the sea has (JONSWAP, and the answer of the hull to the rudder),
and the two come from the same waves: the innovations are not white, and `identify` warns of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import casid
from analysis.ship_bias.speed import records_at_sea
from casid.estimation.simulation.fit import FitSettings
from problems import ship

SOUGHT = ("m", "zbar_m", "k", "A_x", "d", "K_r", "K_vdot", "K_delta")


@dataclass(frozen=True, slots=True, eq=False)
class SeaCell:
    """Three load cases of `seconds` each in beam seas of a significant height [m], many times."""

    Hs: float
    seconds: float = 60.0

    @property
    def name(self) -> str:
        """Ship and sea."""
        return f"ship with a rudder: waves of {self.Hs:g} m"

    @property
    def truth(self) -> dict[str, float]:
        """The weight aboard and the roll coefficients."""
        return {name: ship.TABLE_8_2[name] for name in SOUGHT}

    def estimate(self, draw: int) -> casid.Estimate:
        """The estimate of one draw."""
        model = ship.direct_model().with_known(z_f=ship.TABLE_8_2["z_f"])
        records, _ = records_at_sea(self.Hs, draw, seconds=self.seconds)
        return casid.identify(
            casid.Problem("ship at sea", model),
            records,
            settings=FitSettings(starts=1),
            intervals="quick",
            disturbances=("torque:peak", "vdot:first"),
        )


SEAS = (SeaCell(0.3), SeaCell(0.5))
