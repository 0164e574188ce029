"""Pages of samples that several tests look at."""

from __future__ import annotations

import pytest

from tests.support import samples
from tests.support.samples import page_of


@pytest.fixture(scope="session")
def rich() -> str:
    return page_of(samples.rich())


@pytest.fixture(scope="session")
def hostile() -> str:
    return page_of(samples.hostile())
