"""Numbers modulo the prime 2^61 - 1, which do not grow as fractions do."""

from __future__ import annotations

from dataclasses import dataclass

PRIME = 2**61 - 1


@dataclass(frozen=True, slots=True)
class ModularInteger:
    """A number modulo `PRIME`, with + - * / among its own kind."""

    value: int

    def __add__(self, other: ModularInteger) -> ModularInteger:
        return ModularInteger((self.value + other.value) % PRIME)

    def __sub__(self, other: ModularInteger) -> ModularInteger:
        return ModularInteger((self.value - other.value) % PRIME)

    def __mul__(self, other: ModularInteger) -> ModularInteger:
        return ModularInteger(self.value * other.value % PRIME)

    def __truediv__(self, other: ModularInteger) -> ModularInteger:
        return ModularInteger(self.value * pow(other.value, -1, PRIME) % PRIME)

    def __neg__(self) -> ModularInteger:
        return ModularInteger(-self.value % PRIME)
