"""The table of published answers holds together: printed errors follow from printed estimates."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from tests.support.shared import ROOT

TABLE = tomllib.loads((ROOT / "tests" / "published.toml").read_text(encoding="utf-8"))
SHIP = TABLE["ship_scale_model"]
LABORATORY = TABLE["pendulum_laboratory"]


def case_of(name: str) -> str:
    return "_".join(name.split("_")[:2])


@pytest.mark.parametrize(
    ("name", "estimate", "errors"),
    [
        *((c, SHIP[c], SHIP["error_percent"][c]) for c in ("case_1", "case_2", "case_3")),
        *(
            (c, estimate, SHIP["others"]["error_percent"][c])
            for c, estimate in SHIP["others"].items()
            if c.startswith("case")
        ),
    ],
)
def test_errors_of_the_scale_model_are_estimate_over_truth_less_one(
    name: str, estimate: dict[str, Any], errors: dict[str, float]
) -> None:
    """|estimate / true - 1|, within the rounding of the estimate's four printed decimals."""
    true = SHIP["true"][case_of(name)]
    for parameter, printed in errors.items():
        found = 100 * abs(estimate[parameter] / true[parameter] - 1)
        rounding = 100 * 0.5e-4 / abs(true[parameter])
        assert found == pytest.approx(printed, abs=rounding + 0.005), parameter


@pytest.mark.parametrize("approach", ["multi_stage", "joint"])
def test_errors_of_the_laboratory_pendulum_follow_from_its_estimates(approach: str) -> None:
    """Table 7.5; I_x is printed with four decimals, its error comes from more of them."""
    decimals = {"I_x": 4, "m": 4, "z_m": 3}
    for parameter, printed in LABORATORY[approach]["error_percent"].items():
        true = LABORATORY["true"][parameter]
        found = 100 * abs(LABORATORY[approach]["estimate"][parameter] / true - 1)
        rounding = 100 * 0.5 * 10 ** -decimals[parameter] / abs(true)
        # m and z_m of Table 7.4 are rounded as well
        own = 100 * 0.5e-4 / abs(true)
        assert found == pytest.approx(printed, abs=rounding + own + 0.05), parameter
