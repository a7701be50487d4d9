"""Corridor logs that are replayed, made once."""

import pytest

from data.worlds.corridor import Corridor, simulate as corridor


@pytest.fixture(scope="module")
def lab():
    return corridor(Corridor(), 0)


@pytest.fixture(scope="module")
def crowded():
    return corridor(Corridor(people=True), 0)
