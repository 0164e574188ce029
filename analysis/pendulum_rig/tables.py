"""What the thesis published of its laboratory pendulum."""

from __future__ import annotations

from collections.abc import Mapping

PUBLISHED: Mapping[str, Mapping[str, float]] = {
    "multi-stage (7.58)": {"I_x": 0.602, "m": 5.81, "z_m": 5.52, "m z_m": 10.5, "m z_m^2": 17.6},
    "multi-stage (7.60)": {"I_x": 3.2, "m": 26.2, "z_m": 10.8, "m z_m": 17.8, "m z_m^2": 11.3},
    "joint (7.58)": {"I_x": 0.575, "m": 5.40, "z_m": 5.77, "m z_m": 10.9, "m z_m^2": 16.0},
}
"""Relative errors of Table 7.5, per cent."""

PUBLISHED_VALUES: Mapping[str, Mapping[str, float]] = {
    "multi-stage (7.58)": {
        "I_x": 0.0071, "m": 0.0918, "z_m": -0.116, "m z_m": -0.0106, "m z_m^2": 0.0012,
    },
    "multi-stage (7.60)": {
        "I_x": 0.0073, "m": 0.0719, "z_m": -0.136, "m z_m": -0.0098, "m z_m^2": 0.0013,
    },
    "joint (7.58)": {
        "I_x": 0.0071, "m": 0.0922, "z_m": -0.115, "m z_m": -0.0106, "m z_m^2": 0.0012,
    },
}  # fmt: skip
"""Estimates of Table 7.5, SI. E-16: the printed 0.0006 contradicts its own error and m and z_m; the
minus signs of z_m and m z_m in the joint row were lost in print."""

PUBLISHED_FITS = {
    ("nominal", "gyro"): 75.4,
    ("nominal", "accel"): 75.8,
    ("loaded", "gyro"): 73.8,
    ("loaded", "accel"): 74.3,
}
