"""What the ledger of SLAM in hindsight notes of a landmark, of a frame, and of a stretch of the log."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from association.evidence.landmarks import INITIALIZED, Evidence
from association.evidence.pairings import Alone
from data.inputs import IntArray


@dataclass
class Record:
    """What is known of one landmark of the map, but for where it stands.

    Attributes:
        sightings: (observation, decision) of all that are taken for it; the first one initialized it.
        looked_from: (x, y) [m] of the robot where it was last seen, or should have been.
        first, last: distances travelled [m] at its first and its last sighting.
        times: sightings, by the decisions that were used.
        evidence: what speaks for it and against it.
        covisible: landmarks that were seen in one frame with it: they cannot be the same.
        gated: distance travelled [m] where its gate was judged last, by whether the sighting was inside.
        looks: at it after the first sighting: the second one, and from other places; 1 seen, 0 missed in the view read.
    """

    sightings: list[tuple[int, int]]
    looked_from: tuple[float, float]
    first: float
    last: float
    times: int = 0
    evidence: Evidence = INITIALIZED
    covisible: set[int] = field(default_factory=set)
    gated: dict[bool, float] = field(default_factory=dict)
    looks: bytearray = field(default_factory=bytearray)


class Judged(NamedTuple):
    """What a frame's expectation says about its pairings, to be taken before the update, which it does not survive.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; the landmarks
    (n,) that should have been seen and were not, and those of them where something was read before.
    """

    rows: IntArray
    number: IntArray
    alone: Alone
    missing: IntArray
    in_read: IntArray


class Epoch(NamedTuple):
    """Since when the robot cannot tell which landmark is which: distance travelled [m], number of the next landmark."""

    begun: float = -math.inf
    first: int = 0
