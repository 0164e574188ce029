"""Draws of an estimate for ArviZ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from casid.arrays import Array
from casid.errors import DataError


def inference_data(
    draws: Array, names: tuple[str, ...], units: Mapping[str, str], attributes: Mapping[str, str]
) -> Any:
    """An ArviZ InferenceData whose posterior has one chain of draws.

    Parameters
    ----------
    draws : (draws, n) in the order of `names`.
    units : name -> unit, written into the attributes of each variable.

    Raises
    ------
    DataError
        If ArviZ is not installed.
    """
    try:
        import arviz
    except ImportError:
        raise DataError(
            'to_inference_data needs ArviZ, which is not installed; pip install "casid[arviz]"'
        ) from None
    posterior = {name: draws[None, :, i] for i, name in enumerate(names)}
    found = arviz.from_dict(posterior=posterior, attrs=dict(attributes))
    for name in names:
        found.posterior[name].attrs["units"] = units.get(name, "")
    return found
