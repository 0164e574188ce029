"""Persistent excitation: whether inputs excite the lags that a model needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError
from casid.estimation.cross_moments.moments import moments
from casid.estimation.local_rank import LocalRank, local_rank


def dependent_columns(gram: Array, names: Sequence[str]) -> tuple[LocalRank, str]:
    """Rank of a Gram matrix Phi'Phi, and the combinations of columns that vanish, as equations."""
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = 1 / np.where(length > 0, length, 1.0)
    rank = local_rank(gram, np.zeros(len(names)), names, scale)
    sentences = []
    for direction in rank.null:
        weights = {n: v * scale[list(names).index(n)] for n, v in direction.items()}
        largest = max(abs(v) for v in weights.values())
        terms = [f"{'+' if v > 0 else '-'} {abs(v) / largest:.3g} {n}" for n, v in weights.items()]
        sentences.append(" ".join(terms).removeprefix("+ ") + " = 0")
    return rank, " and ".join(sentences)


def require_excitation(
    data: Sequence[tuple[Array, Mapping[str, Array]]],
    lags: Mapping[str, tuple[int, int]],
    needed_by: str,
) -> None:
    """Refuse inputs whose lags (first, number) are linearly dependent over the records.

    An input is persistently exciting of order n if n of its lags are independent; B/F with nb and
    nf coefficients needs nb + nf (Ljung 1999, section 13.2).

    Raises
    ------
    IdentifiabilityError
        With the combination of lags that vanishes, and the inputs that are constant.
    """
    if not lags:
        return
    longest = max(first + n - 1 for first, n in lags.values())
    names = [
        f"{i}[t-{k}]" if k else f"{i}[t]" for i, (f, n) in lags.items() for k in range(f, f + n)
    ]
    place = [
        c * (longest + 1) + k for c, (f, n) in enumerate(lags.values()) for k in range(f, f + n)
    ]
    gram = np.zeros((len(names), len(names)))
    for y, u in data:
        if len(y) > longest:
            channels = {f"s{c}": u[i] for c, i in enumerate(lags)}
            gram += moments(channels, longest).gram[np.ix_(place, place)]
    rank, equations = dependent_columns(gram, names)
    if rank.is_full:
        return
    constant = [
        f"input {i} is constant ({u[i][0]:g})" + (f" in record {k + 1}" if len(data) > 1 else "")
        for k, (_, u) in enumerate(data)
        for i in lags
        if not np.any(u[i] != u[i][0])
    ]
    raise IdentifiabilityError(
        f"the inputs excite {rank.rank} of the {rank.unknowns} lags that {needed_by}: {equations} "
        f"over the data{'; ' + ', '.join(constant) if constant else ''}. Record an experiment "
        "with a richer input, or lower the orders"
    )
