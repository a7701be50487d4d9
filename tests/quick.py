"""What the fast tests leave to the slow ones: cases, and most examples of a property."""

from typing import Any

import pytest
from hypothesis import settings


def slow(*values: Any) -> Any:
    """A case of `parametrize` that the slow tests alone try."""
    return pytest.param(*values, marks=pytest.mark.slow)


def examples(full: int) -> int:
    """How many examples a property is tried on: `full` under the profile `thorough`, fewer under another."""
    return full * settings().max_examples // 100
