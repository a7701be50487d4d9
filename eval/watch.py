"""Somebody who looks on while a log is replayed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from association.expectation import Expectation
from data.inputs import IntArray

if TYPE_CHECKING:
    from eval.replay.frontend import FrontEnd


class Watch(Protocol):
    """Somebody who looks on while a log is replayed, frame by frame, and changes nothing."""

    def moved(self, front: FrontEnd) -> None:
        """A frame begins; its observations were not looked at yet."""
        ...

    def decided(self, front: FrontEnd, rows: slice, expectation: Expectation | None, decisions: IntArray) -> None:
        """Observations `rows` of the log were decided about, and not used yet; `known` needs no expectation."""
        ...

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """A frame is over; decisions and founded landmarks (M,) are those of the whole log so far."""
        ...
