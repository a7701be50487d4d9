"""Step 2: the uncertainty of the motion, and what `eval.replay.hindsight.placement` needs to place a frame."""

from __future__ import annotations

from collections import deque

import numpy as np

from association.expectation import Expectation
from data.inputs import Increment
from data.notice import Code, Notice, notice
from data.se2 import Array
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import Ledger
from eval.replay.hindsight.placement import Memory, Placed, drifted, place, too_uncertain
from eval.replay.hindsight.record import detection_rate
from eval.replay.settings import Setup


class UncertainMotion:
    """Motion since the last pairing with the map, and the poses from which the map was seen."""

    def __init__(self, ledger: Ledger, setup: Setup) -> None:
        self.ledger, self.setup = ledger, setup
        self.placed = 0  # number of frames whose pose was found by geometry
        self._motion = np.zeros((3, 3))
        self._explained = (0, 0)  # observations where the map was in view before: paired, and strays
        self._seen_from: deque[Array] = deque(maxlen=constants.REMEMBERED_FRAMES)

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._motion = drifted(self._motion, increment)

    def place(self, e: Expectation, predicted: Array) -> Placed | None:
        """The pose of a frame by geometry; None if the prediction is good enough, or the map does not give a pose."""
        sensor, s = self.ledger.sensor, self.setup
        if e.elsewhere is None or not too_uncertain(e, sensor, self._motion):
            return None
        strays = 1.0 - detection_rate(*self._explained)
        memory = Memory(self._seen_from, self.ledger.rates(e.number), strays)
        found = place(e, sensor, predicted, self._motion, memory, s.gate, s.new_gate)
        if found is not None:
            self.placed += 1
            paired, sudden = self._explained
            self._explained = paired + int((found.decisions >= 0).sum()), sudden + found.sudden
        return found

    def see(self, pose: Array, paired: bool) -> None:
        """Note a used frame and its pose (3,); `paired`: with landmarks of the map."""
        self._seen_from.append(pose)
        if paired or len(self._seen_from) == 1:
            self._motion = np.zeros((3, 3))

    def notes(self) -> list[Notice]:
        """A message about placed frames."""
        mostly = 2 * self.placed > self.ledger.frames
        return [notice(Code.PLACED, frames=self.placed, mostly=mostly)] if self.placed else []
