"""What a question is."""

from __future__ import annotations

from typing import NamedTuple


class Question(NamedTuple):
    """A name, and one sentence with the numbers it is asked for and what to do."""

    name: str
    text: str
