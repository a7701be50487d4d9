"""Evidence for a landmark: detections, missed detections, and whether it stood still.

An observation gives the landmark's innovation given its frame's other pairings (`association.conditional.alone`). For a
static landmark these are independent, with chi-square squares and weighted mean zero in the world. A moving landmark
drags its estimate along, so its innovations point in the direction of motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from association.conditional import ConditionalInnovations
from association.expectation import gate_threshold
from data.inputs import IntArray
from data.se2 import Array
from eval.replay.hindsight import constants


class Evidence(NamedTuple):
    """Evidence for and against one landmark."""

    seen: int  # observations, `opportunities` of them from different places
    opportunities: int
    missed: int  # missed detections from different places, `row` of them since the last observation
    row: int
    judged: int  # observations judged by others of their frame
    squares: float  # sum of their squared innovations
    pull: Array  # (2,) weighted sum of their innovations in the world
    information: Array  # (2, 2) sum of their information


INITIALIZED = Evidence(1, 1, 0, 0, 0, 0.0, np.zeros(2), np.zeros((2, 2)))  # of a landmark that was initialized just now


class Judgement(NamedTuple):
    """Innovation (2,) of an observation given others of its frame, its information (2, 2); G (2, 2): to the world."""

    innovation: Array
    information: Array
    G: Array


def add_observation(e: Evidence, judged: Judgement | None, elsewhere: bool) -> Evidence:
    """Add an observation and what the others of its frame say of it; `elsewhere`: from another place than the last."""
    e = e._replace(seen=e.seen + 1, opportunities=e.opportunities + elsewhere, row=0)
    if judged is None:
        return e
    inverse = np.linalg.inv(judged.G)
    world = inverse.T @ judged.information @ inverse
    return e._replace(
        judged=e.judged + 1,
        squares=e.squares + float(judged.innovation @ judged.information @ judged.innovation),
        pull=e.pull + world @ (judged.G @ judged.innovation),
        information=e.information + world,
    )


def add_miss(e: Evidence) -> Evidence:
    """Add a missed detection."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


class Visibility(NamedTuple):
    """Counts over confirmed landmarks in view: detected and missed, after a detection and after a miss.

    Occlusions last, so misses come in rows.
    """

    seen_seen: int = 0
    seen_missed: int = 0
    missed_seen: int = 0
    missed_missed: int = 0

    def counting(self, before_missed: bool, seen: bool) -> Visibility:
        """Add one detection opportunity."""
        name = ("missed_" if before_missed else "seen_") + ("seen" if seen else "missed")
        return self._replace(**{name: getattr(self, name) + 1})

    def without(self, row: int) -> Visibility:
        """Leave out an unfinished row of misses: a landmark must not testify for itself."""
        if not row:
            return self
        return self._replace(
            seen_missed=max(0, self.seen_missed - 1), missed_missed=max(0, self.missed_missed - (row - 1))
        )

    @property
    def rate(self) -> float:
        """Detection probability of a landmark in view."""
        return detection_rate(self.seen_seen + self.missed_seen, self.seen_missed + self.missed_missed)

    def row(self, length: int, rate: float) -> float:
        """Probability (Markov chain) that an existing landmark of this detection probability is missed `length` times
        in a row.

        Before enough rows are known, misses count as independent.
        """
        if not length:
            return 1.0
        prior, missed = constants.INDEPENDENT_MISSES, self.missed_missed
        again = (missed + prior * (1.0 - rate)) / (missed + self.missed_seen + prior)
        return (1.0 - rate) * max(again, 1.0 - rate) ** (length - 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def confirmed(e: Evidence, v: Visibility) -> bool:
    """Whether a landmark has as many observations as `CONFIRMED` detection opportunities would give, and at
    least two.
    """
    return e.seen >= max(constants.CONFIRMED_AT_LEAST, constants.CONFIRMED * v.rate)


def verdict(e: Evidence, v: Visibility) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; or empty.

    A confirmed landmark has its own detection probability, if that is lower, and needs more evidence against it.
    """
    if e.judged:
        drift = float(e.pull @ np.linalg.solve(e.information, e.pull))
        if drift > gate_threshold(constants.MOVED) or e.squares > gate_threshold(constants.RESTLESS, 2 * e.judged):
            return "moved"
    if confirmed(e, v):
        v = v.without(e.row)
        own = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
        return "missed" if v.row(e.row, own) < constants.UNLIKELY**constants.UNLIKELY_POWER else ""
    return "missed" if v.row(e.row, v.rate) < constants.UNLIKELY else ""


@dataclass
class Record:
    """One landmark of the map, except its position."""

    observations: list[tuple[int, int]]  # (observation, decision) of all assigned to it; the first one initialized it
    place: tuple[float, float]  # (x, y) [m] of the robot at its last detection opportunity
    first: float  # distances travelled [m] at its first and its last observation
    last: float
    times: int = 0  # observations, by the decisions that were used
    evidence: Evidence = INITIALIZED
    covisible: set[int] = field(default_factory=set)  # landmarks seen in one frame with it: they cannot be the same
    # distance travelled [m] at the last judgement of its gate, by result
    gated: dict[bool, float] = field(default_factory=dict)
    opportunities: bytearray = field(default_factory=bytearray)  # after the first observation; see `opportunities.py`
    familiar: set[int] = field(default_factory=set)  # viewpoint cells in or beside which it was detected


class Judged(NamedTuple):
    """Judgement of a frame's pairings by its expectation, before the update changes the state.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; missed
    landmarks (n) and the cells of the viewpoints from which they were missed, None: another one may occlude it.
    """

    rows: IntArray
    number: IntArray
    alone: ConditionalInnovations
    missing: list[int]
    viewpoint: list[int | None]


class Epoch(NamedTuple):
    """Since when landmarks are ambiguous to the robot: distance travelled [m], number of the next landmark."""

    begun: float = -math.inf
    first: int = 0
