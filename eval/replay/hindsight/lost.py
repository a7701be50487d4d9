"""Lost while mapping: a run's own evidence that its map is not to be believed is said; nothing is decided by it.

See `association.evidence.lost` for the test.
"""

from __future__ import annotations

import math

from association.evidence import constants
from association.evidence.lost import Suspicion, looked
from data.inputs import Frame, IntArray
from data.se2 import Array
from eval.replay.hindsight.ledger import Ledger

WORDS = "most of what should be in view is missed, and newer landmarks are read instead"


class Lost:
    """Looks at every frame that the ledger has judged.

    Attributes:
        suspicion: the state of the test.
    """

    def __init__(self, ledger: Ledger) -> None:
        """At the start all is well."""
        self.ledger, self.suspicion = ledger, Suspicion()
        self._looked_from = (math.inf, math.inf)

    def look(self, frame: Frame, decisions: IntArray, pose: Array) -> None:
        """A frame with its decisions (m,), before they are used; `pose` (3,) is where it was predicted."""
        x, y = self._looked_from
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.ledger.range:
            return
        paired, replaced = self.ledger.replaced(decisions)
        if paired + replaced:
            self._looked_from = float(pose[0]), float(pose[1])
        self.suspicion = looked(self.suspicion, frame.number, paired, replaced)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        s = self.suspicion
        if s.alarm is None:
            return []
        span = f"from frame {s.alarm} {'on' if s.over is None else f'to {s.over}'}"
        return [f"{span} {WORDS}: the robot was lost, or maps places anew, and path and map are not to be trusted"]
