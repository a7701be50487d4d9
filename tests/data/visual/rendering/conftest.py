"""A rendered recording without noise and the default one, made once."""

from __future__ import annotations

import pytest

from data.visual.rendering.render import Rendered
from tests.data.visual.rendering.galleries import CLEAN, DEFAULT


@pytest.fixture(scope="module")
def clean() -> Rendered:
    return Rendered(CLEAN, 0)


@pytest.fixture(scope="module")
def default() -> Rendered:
    return Rendered(DEFAULT, 0)
