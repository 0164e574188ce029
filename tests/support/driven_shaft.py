"""A rotor that a wind drives, and a brake behind an elastic shaft, sampled exactly.

The wind speed is recorded with much noise, and by straight lines between its samples; the torque of
the brake is a command that is held. The records come from the matrix exponential.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import casid

TRUTH = {"J1": 8.0, "J2": 0.5, "b": 5.8, "d": 1.2, "k": 200.0, "c": 0.8}
TS = 0.05


def shaft_model() -> casid.Model:
    """Speeds of rotor and brake, and the twist between them."""
    m = casid.Model("driven shaft")
    fast, slow, twist = m.state("w1", "rad/s"), m.state("w2", "rad/s"), m.state("twist", "rad")
    wind, torque = m.input("V", "m/s"), m.input("T", "N m", hold="zoh", known=True)
    J1 = m.parameter("J1", "kg m^2", start=6.0, lower=0.5, upper=50.0)
    J2 = m.parameter("J2", "kg m^2", start=0.4, lower=0.05, upper=5.0)
    b = m.parameter("b", "N s", start=4.0, lower=0.1, upper=50.0)
    d = m.parameter("d", "N m s/rad", start=1.0, lower=0.0, upper=20.0)
    k = m.parameter("k", "N m/rad", start=150.0, lower=5.0, upper=1e4)
    c = m.parameter("c", "N m s/rad", start=0.5, lower=0.0, upper=100.0)
    shaft = k * twist + c * (fast - slow)
    m.balance(fast, "rotor", inertia=J1, terms=[b * wind, -d * fast, -shaft])
    m.balance(slow, "brake", inertia=J2, terms=[shaft, -torque])
    m.derivative(twist, fast - slow)
    m.output("w1", fast, "rad/s")
    m.output("w2", slow, "rad/s")
    return m


def shaft_record(seed: int, *, N: int = 1800, wind_sd: float = 0.5) -> casid.Record:
    """Both speeds, the command, and the wind with noise of `wind_sd`."""
    rng = np.random.default_rng(seed)
    J1, J2, b, d, k, c = TRUTH.values()
    A = np.array([[-(d + c) / J1, c / J1, -k / J1], [c / J2, -c / J2, k / J2], [1.0, -1.0, 0.0]])
    B = np.array([[b / J1, 0.0], [0.0, -1.0 / J2], [0.0, 0.0]])
    # Of a sample: states, inputs at its begin, and their change over it (Van Loan 1978).
    whole = np.zeros((7, 7))
    whole[:3, :3], whole[:3, 3:5], whole[3:5, 5:] = A, B, np.eye(2) / TS
    step = expm(whole * TS)[:3]
    wind, correlation = np.zeros(N), np.exp(-TS / 4.0)
    for j in range(1, N):
        wind[j] = correlation * wind[j - 1] + rng.standard_normal()
    wind = np.convolve(wind, np.hanning(21), "same")
    wind = 8.0 + 1.3 * wind / np.std(wind)
    torque = np.repeat(36.0 + 1.2 * rng.uniform(-1, 1, N // 20 + 1), 20)[:N]
    ahead = np.append(wind[1:], wind[-1])
    x = np.zeros((N, 3))
    x[0] = (b * wind[0] - torque[0]) / d, (b * wind[0] - torque[0]) / d, torque[0] / k
    for j in range(N - 1):
        x[j + 1] = step @ [*x[j], wind[j], torque[j], ahead[j] - wind[j], 0.0]
    noise = rng.standard_normal((N, 3))
    return casid.Record(
        {
            "V": wind + wind_sd * noise[:, 0],
            "T": torque,
            "w1": x[:, 0] + 0.004 * noise[:, 1],
            "w2": x[:, 1] + 0.003 * noise[:, 2],
        },
        {"V": "m/s", "T": "N m", "w1": "rad/s", "w2": "rad/s"},
        Ts=TS,
        name=f"shaft {seed}",
    )
