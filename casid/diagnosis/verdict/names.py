"""Names of effects as an engineer says them, beside the identifiers that files and options have."""

from __future__ import annotations

_NAMES = {
    "quadratic_damping": "quadratic damping in {place}",
    "cubic_damping": "cubic damping in {place}",
    "coulomb_friction": "dry friction in {place}",
    "asymmetric_friction": "friction that differs with direction in {place}",
    "stribeck_friction": "Stribeck friction in {place}",
    "cubic_stiffness": "cubic stiffness in {place}",
    "quadratic_stiffness": "one-sided stiffness in {place}",
    "deadzone": "dead zone in {place}",
    "backlash": "backlash in {place}",
    "end_stop": "end stop in {place}",
    "cogging": "cogging in {place}",
    "offset": "constant term in {place}",
    "periodic_disturbance": "periodic disturbance in {place}",
    "missing_mode": "unmodelled oscillation in {place}",
    "parameter_drift": "drift of {where}",
    "parameter_jump": "jump of {where}",
    "scheduled_parameter": "change of {own} with {source}",
    "extra_input": "{where} as a further input",
    "sensor_bias": "bias of {where}",
    "sensor_scale": "gain error of {where}",
    "sensor_lag": "lag of {where}",
    "time_delay": "delay of {where}",
    "cross_axis": "cross-axis sensitivity of {where}",
    "lever_arm": "lever arm of {where}",
    "saturation": "clipping of {where}",
    "rectified": "absolute value of {where}",
    "outliers": "outliers in {where}",
    "hold": "motion of {where} between samples",
    "actuator_lag": "actuator lag of {where}",
    "actuator_saturation": "saturation of the command {where}",
    "unknown": "unknown cause in {where}",
}


def effect_words(kind: str, where: str, channels: frozenset[str] = frozenset()) -> str:
    """An effect and its place in words; a kind of the user's own keeps its name.

    Parameters
    ----------
    channels : names that are channels; any other place of a force is a balance.
    """
    if kind not in _NAMES:
        return f"{kind} in {where}"
    is_balance = where.isidentifier() and where not in channels
    place = f"the {where} balance" if is_balance else where
    own, _, source = where.partition("~")
    return _NAMES[kind].format(place=place, where=where, own=own, source=source)
