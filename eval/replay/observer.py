"""Who looks on while a log is replayed, such as the step-through command."""

from __future__ import annotations

from typing import Protocol

from data.inputs import Frame, IntArray
from eval.replay.frontend import FrontEnd, Pairing


class Observer(Protocol):
    """Somebody who looks on, frame by frame, and changes nothing."""

    def moved(self, front: FrontEnd) -> None:
        """A frame begins; its observations were not looked at yet."""
        ...

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """The observations of (a part of) the frame were decided about, and not used yet."""
        ...

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """A frame is over; decisions and initialized landmarks (M,) are those of the whole log so far."""
        ...


class Writing(Observer, Protocol):
    """An observer who writes something down, which stays with the run as `Run.watched`."""

    @property
    def seconds(self) -> float:
        """Time spent on looking and writing, which is not the estimator's."""
        ...

    def left(self) -> object:
        """What was written down, after the last frame."""
        ...


class Nobody:
    """Nobody looks on."""

    def moved(self, front: FrontEnd) -> None:
        """Not looked at."""

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Not looked at."""

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """Not looked at."""
