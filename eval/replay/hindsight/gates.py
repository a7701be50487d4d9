"""Step 4, gates learned in a run of SLAM: what only the stated noise explains is put off until several sightings agree.

See `association.evidence.scales` for how wide gates really are and `association.evidence.tentative` for what waits.
"""

from __future__ import annotations

import numpy as np

from association.evidence.pairings import beside, settled
from association.evidence.scales import as_stated, counted, relearned, widest
from association.evidence.tentative import Sighting, Tentative
from association.expectation import Expectation
from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array
from eval.replay.hindsight.ledger import Ledger


class LearnedGates:
    """How wide gates are in this log.

    Attributes:
        scales: what was learned.
    """

    def __init__(self, ledger: Ledger) -> None:
        """Before the first frame."""
        self.ledger = ledger
        self.scales = as_stated()
        self._tentative = Tentative()
        self._pairings = 0

    def learn(self, e: Expectation, decisions: IntArray) -> None:
        """Take in how well the pairings of a frame fit what was expected, as stated."""
        self.scales = relearned(self.scales, e, decisions)

    def put_off(self, e: Expectation, decisions: IntArray, pose: Array, new_gate: float | None) -> IntArray:
        """Decisions (m,) with `DISCARD` for what the stated noise allows to be a landmark, until several agree.

        Args:
            e: what is expected, by the stated noise.
            decisions: (m,) by the noise that there is.
            pose: (3,) of the robot.
            new_gate: outside which, by the stated noise, an observation is new at once.
        """
        ledger, sensor, reach = self.ledger, self.ledger.sensor, self.ledger.range
        stated, nearest = settled(e, decisions, new_gate), e.individual_distances()
        waiting = (decisions == NEW) & (stated != NEW)
        if widest(self.scales) == 1.0:  # where less noise is there than was stated, three sightings agree too easily
            waiting |= beside(e, stated, new_gate)
        paired = stated[stated >= 0].tolist()
        self._pairings += len(paired)
        inside, outside = sum(ledger.gated_elsewhere(n, True) for n in paired), 0
        for i in np.flatnonzero(stated < 0).tolist():
            xy, _, Gz = sensor.inverse(pose, e.z[i : i + 1])
            sighting = Sighting(xy[0], Gz[0] @ e.R[i] @ Gz[0].T, ledger.travelled)
            if waiting[i] and self._tentative.see(sighting, self._pairings, reach):
                stated[i] = NEW
            if stated[i] == NEW:
                # what was in doubt there was not of the landmark next to it
                outside -= self._tentative.settle(sighting)
            elif ledger.gated_elsewhere(int(e.number[np.argmin(nearest[i])]), False):
                self._tentative.doubt(sighting)
                outside += 1
        self.scales = counted(self.scales, inside, outside)
        return stated
