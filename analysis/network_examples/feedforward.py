"""Feedforward from a model that was estimated and inverted, or from an inverse that was estimated.

    y_O = G_K u_K + G_I u_I + e_O,    y_I = u_I + e_I,    u_K = F y_I                 (6.22)-(6.24)

with u_K white and known, u_I unknown and coloured. F is had in several ways from records of u_K,
y_O and y_I, each estimator at its exact limit (infinitely many samples), and what counts is the
variance of G_K u_K + G_I u_I that is left when F is used. e_O and e_I make either regression one
with errors in variables: least squares is biased in both, instruments in neither.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from analysis.common.targets import Target, near
from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.indirect.direct_model import direct_model
from casid.unknown_inputs.indirect.feedforward import feedforward
from casid.unknown_inputs.indirect.indirect_model import indirect_model
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import Regression, Term, lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.networks.network import Signal
from casid.unknown_inputs.networks.prediction.error_variance import variance

q = Rational.shift(Ts=1.0)
POLE, GAIN, COLOUR = 0.7, 0.5, 0.9  # of G_K and G_I; G_I's gain; of u_I
NOISE = {"e_O": 0.2, "e_I": 0.3}
INSTRUMENTS: tuple[Term, ...] = (*lags("u_K", 0, 3), *lags("y_I", 1, 3))


@dataclass(frozen=True)
class Plant:
    """G_K = (b0 + b1 q^-1)/(1 - a q^-1), G_I = c/(1 - a q^-1)."""

    b0: float
    b1: float
    a: float = POLE
    c: float = GAIN

    @property
    def G_K(self) -> Rational:
        """From u_K to y_O."""
        return (self.b0 * q + self.b1) / (q - self.a)

    @property
    def G_I(self) -> Rational:
        """From u_I to y_O."""
        return self.c * q / (q - self.a)

    def signals(self) -> LinearSignals:
        """What is recorded, made of white signals; u_I has variance 1."""
        pole = [1.0, -self.a]
        shaped = (1 - COLOUR**2) ** 0.5
        return LinearSignals.of(
            {
                "u_I": {"w": ([shaped], [1.0, -COLOUR])},
                "y_I": {"u_I": 1.0, "e_I": 1.0},
                "y_O": {"u_K": ([self.b0, self.b1], pole), "u_I": ([self.c], pole), "e_O": 1.0},
            },
            {"u_K": 1.0, "w": 1.0} | NOISE,
            Ts=1.0,
        )

    def filter(self) -> Rational:
        """F of (6.22), refused where it cannot be run."""
        model = direct_model(G_OK=self.G_K, G_OI=self.G_I, G_II=1.0 + 0 * q)
        return feedforward(indirect_model(model)).require_realisable().G_KI[0, 0]

    def left(self, F: Rational) -> float:
        """Variance of G_K F y_I + G_I u_I."""
        through = self.G_K * F
        shape = (1 - COLOUR**2) ** 0.5 * q / (q - COLOUR)
        return variance(
            {"u_I": through + self.G_I, "e_I": through},
            {"u_I": Signal(1.0, shape), "e_I": Signal(NOISE["e_I"])},
        )


def inverted(plant: Plant, instruments: Sequence[Term] | None) -> Plant:
    """The plant that a regression of y_O finds in the limit, to be inverted."""
    found = regression_limit(
        plant.signals(),
        Regression(
            "y_O",
            {"a": ("y_O", 1), "b0": "u_K", "b1": ("u_K", 1), "c": "y_I"},
            instruments=instruments,
        ),
    )
    return Plant(found["b0"], found["b1"], found["a"], found["c"])


def directly(plant: Plant, instruments: Sequence[Term] | None) -> Rational:
    """F of the inverse regression (6.24), u_K on y_O, y_I and its own past, in the limit."""
    found = regression_limit(
        plant.signals(),
        Regression(
            "u_K",
            {"k0": "y_O", "k1": ("y_O", 1), "f": ("u_K", 1), "g": "y_I"},
            instruments=instruments,
        ),
    )
    inverse: Rational = found["g"] * q / (q - found["f"])
    return inverse


def finite(plant: Plant, lags_used: int) -> Rational:
    """F of an inverse with finite responses, which is stable whatever the plant: u_K on lags."""
    regressors: dict[str, Term] = {f"k{i}": ("y_O", i) for i in range(lags_used)}
    regressors |= {f"g{i}": ("y_I", i) for i in range(lags_used)}
    found = regression_limit(plant.signals(), Regression("u_K", regressors))
    total = Rational(())
    for i in range(lags_used):
        total = total + found[f"g{i}"] * q**-i
    return total


def best(plant: Plant, lags_used: int = 30) -> float:
    """The least variance that any causal F of so many lags leaves: -G_I u_I on lags of G_K y_I."""
    pole = [1.0, -plant.a]
    more = plant.signals().with_signals(
        {"d": {"u_I": ([-plant.c], pole)}, "z": {"y_I": ([plant.b0, plant.b1], pole)}}
    )
    regressors: dict[str, Term] = {f"f{i}": ("z", i) for i in range(lags_used)}
    return float(regression_limit(more, Regression("d", regressors)).residual_variance)


def compared() -> Iterator[Target]:
    """A plant that can be inverted, and one that cannot."""
    plant = Plant(b0=0.8, b1=-0.4)
    none, exact = plant.left(Rational(())), plant.left(plant.filter())
    # With the true inverse G_K F = -G_I: the remainder is the noise of the measurement through G_I.
    wanted = NOISE["e_I"] * plant.c**2 / (1 - plant.a**2)
    yield near("feedforward, true inverse: variance left", exact, wanted, 1e-9, "")
    left = {
        "estimated by LS, inverted": plant.left(inverted(plant, None).filter()),
        "estimated by IV, inverted": plant.left(inverted(plant, INSTRUMENTS).filter()),
        "inverse estimated by LS": plant.left(directly(plant, None)),
        "inverse estimated by IV": plant.left(directly(plant, INSTRUMENTS)),
        "inverse with 8 lags, LS": plant.left(finite(plant, 8)),
    }
    print(f"  variance of the output, without feedforward {none:.4g}, true inverse {exact:.4g}")
    for name, value in left.items():
        print(f"    {name:<28}{value:.4g}")
    for name in ("estimated by IV, inverted", "inverse estimated by IV"):
        yield near(f"feedforward, {name}", left[name], exact, 1e-6, "")
    biased = min(abs(v - exact) / exact for n, v in left.items() if "LS" in n)
    yield Target(
        "feedforward by LS, direct or inverted: off the true one by",
        f"{100 * biased:.2g} % and more", "> 1 %", biased > 0.01,
    )  # fmt: skip
    yield from not_invertible()


def not_invertible() -> Iterator[Target]:
    """A zero outside the unit circle: the inverse is refused; what can be run leaves more.

    A zero at -1.25 is met by fast signals and a slow u_I is compensated all the same; at 1.25 by
    slow ones, and no causal filter does much.
    """
    for b1 in (1.0, -1.0):
        plant = Plant(b0=0.8, b1=b1)
        zero = -plant.b1 / plant.b0
        try:
            plant.filter()
            said = "run all the same"
        except ModelError as refusal:
            said = str(refusal)
        print(f"  {said}")
        named = "zero" in said and f"{zero:g}" in said
        yield Target(
            f"feedforward, zero at {zero:g}: the inverse", "refused" if named else said,
            "refused, the zero named", named,
        )  # fmt: skip
        model = direct_model(G_OK=plant.G_K, G_OI=plant.G_I, G_II=1.0 + 0 * q)
        ideal = feedforward(indirect_model(model))
        none, least = plant.left(Rational(())), best(plant)
        print(f"    variance left: {none:.4g} without, {least:.4g} with the best causal filter")
        left = {
            f"{a.kind} inverse": plant.left(ideal.approximated(a).G_KI[0, 0])
            for a in ideal.approximations()
            if a.kind != "noncausal"
        }
        left |= {f"inverse estimated, {n} lags": plant.left(finite(plant, n)) for n in (2, 4, 16)}
        for name, value in left.items():
            print(f"      {name:<28}{value:.4g}")
        yield Target(
            f"feedforward, zero at {zero:g}: none leaves less than the best",
            f"{min(left.values()):.4g}", f">= {least:.4g}", min(left.values()) >= least - 1e-9,
        )  # fmt: skip
        if zero < 0:
            yield Target(
                f"feedforward, zero at {zero:g}: the best of those that can be run",
                f"{min(left.values()):.4g}", f"< {none:.4g} without", min(left.values()) < none,
            )  # fmt: skip
