"""Lost while mapping: a run's own evidence that its map is not to be believed is said; nothing is decided by it.

See `association.evidence.lost` for the test at every frame. At the end a second one: a robot that finds again what it
mapped keeps it; of a map that is bent most goes, because it is missed where it should be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from association.evidence import constants
from association.evidence.lost import Suspicion, looked
from data.inputs import Frame, IntArray
from data.se2 import Array
from eval.replay.hindsight.ledger import Ledger

CONCLUSION = "the robot was lost, or maps places anew, and path and map are not to be trusted"
WORDS = "most of what should be in view is missed, and newer landmarks are read instead"


class Lost:
    """Looks at every frame that the ledger has judged.

    Attributes:
        suspicion: the state of the test.
        often, gone: landmarks that were read often, and how many of these were retracted at the end of the log.
    """

    def __init__(self, ledger: Ledger) -> None:
        """At the start all is well."""
        self.ledger, self.suspicion = ledger, Suspicion()
        self._looked_from = (math.inf, math.inf)
        self.often, self.gone = 0, 0

    def look(self, frame: Frame, decisions: IntArray, pose: Array) -> None:
        """A frame with its decisions (m,), before they are used; `pose` (3,) is where it was predicted."""
        x, y = self._looked_from
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.ledger.range:
            return
        paired, replaced = self.ledger.replaced(decisions)
        if paired + replaced:
            self._looked_from = float(pose[0]), float(pose[1])
        self.suspicion = looked(self.suspicion, frame.number, paired, replaced)

    def end(self, often: Sequence[int], retracted: IntArray) -> None:
        """The end of the log: landmarks (n,) that were read often, and those (r,) that are retracted."""
        self.often, self.gone = len(often), int(np.isin(often, retracted).sum())

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        s, said = self.suspicion, []
        if s.alarm is not None:
            span = f"from frame {s.alarm} {'on' if s.over is None else f'to {s.over}'}"
            said.append(f"{span} {WORDS}: {CONCLUSION}")
        if self.often >= constants.THERE_OFTEN and self.gone > constants.THERE_GONE * self.often:
            said.append(
                f"{self.gone} of {self.often} landmarks that were read often were missed too often in the end, and"
                f" retracted: {CONCLUSION}"
            )
        return said
