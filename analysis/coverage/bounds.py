"""The least errors that unbiased estimates of a cell can have: the bound of Cramer and Rao.

Of normal samples with the mean m and the covariance S the information is

    I_ij = m_i' S^-1 m_j + 1/2 tr(S^-1 S_i S^-1 S_j)                                           (1)

with derivatives by the parameters as indices (Kay, Fundamentals of Statistical Signal Processing
1993, (3.31)). Means move with the parameters and the initial states; covariances, which a force
that nobody measures gives, with the parameters, the size and the corner of the force and the noise
of the sensors, all of them unknown. The first term is that of innovations of a Kalman filter, the
second one that of spectra in the limit of long records (Whittle 1953). Simulators are those of the
study: nothing here is casid's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, solve_discrete_lyapunov

from analysis.coverage.systems import Plant, Push, System
from casid.arrays import Array

STEP = 1e-4  # relative, of central differences
FREQUENCIES = 4  # of a spectrum, for each sample


def bounds(system: System, condition: str, missing: Array) -> dict[str, float]:
    """Parameter -> least standard deviation; empty where the inputs are noisy or nothing is linear.

    `missing` (N, ny) are samples that the outputs do not have.
    """
    plant = system.plant
    if plant is None or condition.startswith("input"):
        return {}
    names, sensors = list(system.truth), np.array(list(system.noise.values()))
    slopes = _slopes(plant, system.truth)
    pushed = system.push if condition == "disturbance" else None
    if pushed is not None:
        noise = _Noise.of_force(plant, pushed, system.truth, sensors)
    else:
        noise = _Noise.of_sensors(sensors, system.pole if condition == "coloured" else None)
    white = noise.innovations(slopes, missing)
    information = white.T @ white
    if pushed is not None:
        n_states = len(plant.x0)
        more = _of_spectra(plant, pushed, system.truth, sensors)
        padded = block_diag(information, np.zeros((len(more) - len(names),) * 2))
        own = [*range(len(names)), *range(len(names) + n_states, len(padded))]
        padded[np.ix_(own, own)] += more
        information = padded
    deviations = np.sqrt(np.diag(np.linalg.inv(information)))
    return dict(zip(names, deviations.tolist(), strict=False))


def _slopes(plant: Plant, truth: Mapping[str, float]) -> Array:
    """(N, ny, parameters and initial states) of the outputs without noise."""
    out = []
    for name, value in truth.items():
        ends = [plant.outputs({**truth, name: value * (1 + s)}) for s in (-STEP, STEP)]
        out.append((ends[1] - ends[0]) / (2 * STEP * value))
    unmoved = plant.outputs(truth)
    out += [plant.outputs(truth, plant.x0 + one) - unmoved for one in np.eye(len(plant.x0))]
    return np.stack(out, axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """Normal noise v = h s + e with s' = step s + w; covariances of s at first, of w and of e."""

    step: Array
    h: Array
    first: Array
    white: Array
    sensor: Array

    @classmethod
    def of_sensors(cls, sensors: Array, pole: complex | None) -> _Noise:
        """White, or of unit variance with a pole; as large as each sensor's."""
        if pole is None:
            nothing = np.zeros((0, 0))
            return cls(nothing, np.zeros((len(sensors), 0)), nothing, nothing, np.diag(sensors**2))
        poles = [pole, np.conj(pole)] if np.imag(pole) else [pole]
        order = len(poles)
        step = np.eye(order, k=-1)
        step[0] = -np.poly(poles).real[1:]
        white = np.diag(np.eye(order)[0])
        first = solve_discrete_lyapunov(step, white)
        both = [m / first[0, 0] for m in (first, white)]
        first, white = (block_diag(*[m * s**2 for s in sensors]) for m in both)
        h = block_diag(*[np.eye(order)[:1] for _ in sensors])
        step = block_diag(*[step for _ in sensors])
        return cls(step, h, first, white, np.zeros((len(sensors),) * 2))

    @classmethod
    def of_force(
        cls, plant: Plant, push: Push, values: Mapping[str, float], sensors: Array
    ) -> _Noise:
        """Of a force from rest, beside white noise of the sensors."""
        of = plant.matrices(values)
        step, white = push.steps(of, plant.Ts)
        h = np.column_stack([of.c, np.zeros(len(of.c))])
        first = np.diag([*np.zeros(len(of.a)), push.size**2])
        return cls(step, h, first, white, np.diag(sensors**2))

    def innovations(self, columns: Array, missing: Array) -> Array:
        """(samples that are there, m) of columns (N, ny, m), each divided by its deviation."""
        x, P = np.zeros((len(self.step), columns.shape[2])), self.first
        out = []
        for now, absent in zip(columns, missing, strict=True):
            h, there = self.h[~absent], ~absent
            S = h @ P @ h.T + self.sensor[np.ix_(there, there)]
            new = now[there] - h @ x
            out.append(np.linalg.solve(np.linalg.cholesky(S), new))
            gain = np.linalg.solve(S, h @ P).T
            x = self.step @ (x + gain @ new)
            P = self.step @ (P - gain @ h @ P) @ self.step.T + self.white
        return np.vstack(out)


def _of_spectra(plant: Plant, push: Push, truth: Mapping[str, float], sensors: Array) -> Array:
    """The second term of (1), by the parameters, size, corner and the logarithms of the sensors."""
    N = len(plant.u)
    shift = np.exp(1j * np.pi * (np.arange(FREQUENCIES * N) + 0.5) / (FREQUENCIES * N))

    def spectrum(factors: Array) -> Array:
        """(frequencies, ny, ny), all values multiplied by their factors."""
        mine, force, own = np.split(factors, [len(truth), len(truth) + 2])
        values = {n: v * f for (n, v), f in zip(truth.items(), mine, strict=True)}
        pushed = replace(push, size=push.size * force[0], corner=push.corner * force[1])
        noise = _Noise.of_force(plant, pushed, values, sensors * own)
        resolvent = shift[:, None, None] * np.eye(len(noise.step)) - noise.step
        path = noise.h @ np.linalg.inv(resolvent)
        whole = path @ noise.white @ path.conj().transpose(0, 2, 1) + noise.sensor
        return np.asarray(whole)

    n = len(truth) + 2 + len(sensors)
    whole = spectrum(np.ones(n))
    moves = STEP * np.eye(n)
    slopes = [(spectrum(1 + d) - spectrum(1 - d)) / (2 * STEP) for d in moves]
    relative = [np.linalg.solve(whole, s) for s in slopes]
    information = np.array(
        [[0.5 * N * np.einsum("fij,fji->f", a, b).real.mean() for a in relative] for b in relative]
    )
    units = np.array([*truth.values(), *np.ones(2 + len(sensors))])
    return information / np.outer(units, units)
