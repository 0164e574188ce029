"""What a fit takes out of the spectrum of its own residual.

An estimate is x + B'r of the errors r, so that its residual is (1 - T B') r, with T the
sensitivities. A source of noise j with responses G_ij gives output i, instead of |G_ij|^2, the mean
periodogram

    |G_ij|^2 - 2 Re(T_i u_j G_ij*) + T_i (sum_w u_j u_j^H) T_i^H,     u_j = sum_b B_b^H G_bj,   (1)

where T_i and B_b are transforms at that frequency. Noise that shows in a few lines alone, as that
of an input of a slow system, is mostly absorbed by the parameters: taken for all of it, what is
left would be a noise far too small (restricted likelihood: Patterson and Thompson, Biometrika 58
(1971) 545-554).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import rfft

from casid.arrays import Array, scaled_inverse
from casid.estimation.noise.noise_response import Response


def absorbed(
    responses: Sequence[Response], tangents: Sequence[Array], weighted: Sequence[Array]
) -> list[Array]:
    """The second and third term of (1), (N // 2 + 1, ny, ny + ns) of each record.

    The first columns are those of the outputs' own white noise, the others of all `sources`.

    Parameters
    ----------
    tangents : (N, ny, n) T of each record.
    weighted : (N, ny, n) what the estimate multiplies them and the residual by: Gamma^-1 T.
    """
    n = tangents[0].shape[2]
    matrix = sum(
        t.reshape(-1, n).T @ w.reshape(-1, n) for t, w in zip(tangents, weighted, strict=True)
    )
    inverse = scaled_inverse(np.asarray(matrix))
    parts, shared = [], 0.0
    for response, t, w in zip(responses, tangents, weighted, strict=True):
        N, ny, _ = t.shape
        gain = _on_lines(response, N, ny)
        u = np.einsum("fan,faj->fjn", rfft(w @ inverse, axis=0).conj() / np.sqrt(N), gain)
        both = np.full(len(u), 2.0)
        both[0] = 1.0
        both[-1] = 1.0 if N % 2 == 0 else 2.0
        shared = shared + np.einsum("f,fjn,fjm->jnm", both, u, u.conj()).real
        parts.append((rfft(t, axis=0) / np.sqrt(N), u, gain))
    out = []
    for tangent, u, gain in parts:
        crossed = np.einsum("fin,fjn,fij->fij", tangent, u, gain.conj()).real
        added = np.einsum("fin,jnm,fim->fij", tangent, shared, tangent.conj()).real
        out.append(added - 2 * crossed)
    return out


def _on_lines(response: Response, N: int, ny: int) -> Array:
    """Complex gains (N // 2 + 1, ny, ny + ns): one of each output's own noise, then sources."""
    assert response.gain is not None
    lines = 2 * np.pi * np.arange(N // 2 + 1) / N
    flat = response.gain.reshape(len(response.omega), -1)
    columns = [np.interp(lines, response.omega, column) for column in flat.T]
    sources = np.stack(columns, axis=1).reshape(len(lines), ny, -1)
    own = np.broadcast_to(np.eye(ny), (len(lines), ny, ny))
    return np.concatenate([own, sources], axis=2)
