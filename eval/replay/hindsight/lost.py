"""Tests for a lost robot, with a known map and while mapping.

Every frame adds the log-likelihood ratio of "lost" against "healthy" to a cumulative sum, which never falls below zero
(Page, Biometrika 41, 1954). The trouble began where the sum last left zero.

With a known map, a kidnapped robot leaves observations unpaired or pairs them badly: a sum each.

A robot lost while mapping observes known surroundings as new: it misses confirmed landmarks and observes newer ones in
their place. Exploration misses no old landmarks; a bad sensor misses many, but also observes old ones. So two kinds
count: confirmed landmarks that are paired, and those missed where something newer was observed. One frame is one piece
of evidence, because its errors have one cause; frames from one place are one, too. A second test at the end: most
landmarks of a bent map are retracted. Both tests only report; they decide nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from data.inputs import Frame, IntArray
from data.notice import Code, Notice, notice
from data.se2 import Array
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import Ledger


@dataclass(frozen=True)
class Health:
    """State of the test after a frame."""

    unpaired: float = 0.0  # cumulative sums, 0 while nothing indicates a lost robot
    misfit: float = 0.0
    # expected in a healthy frame: share of paired observations, ...
    share: float = field(default_factory=lambda: constants.HEALTH_START[0])
    strays: float = 0.0  # ... number of unpaired ones, ...
    scale: float = field(default_factory=lambda: constants.HEALTH_START[1])  # ... NIS per degree of freedom
    # weight of what was learned, in observations
    learned: float = field(default_factory=lambda: constants.HEALTH_WEIGHT)
    lost: bool = False  # one of the sums has reached the threshold


def watch(before: Health, offered: int, paired: int, nis: float, dof: int) -> Health:
    """The state after a frame with `paired` of `offered` observations paired, and the NIS of these with its dof.

    Expectations are learned from all frames except those of a lost robot. The expected NIS is at least its chi-square
    mean, so that conservative noise does not speed up the test.
    """
    if offered == 0:
        return before
    unpaired = before.unpaired + _against_strays(before, offered, offered - paired)
    # one instant full of misfits is one piece of evidence: its errors are not independent
    r = constants.LOST_SCALE
    fit = 0.5 * (nis / max(before.scale, 1.0) * (1.0 - 1.0 / r) - dof * math.log(r))
    misfit = before.misfit + min(fit, constants.MISFIT_MOST * constants.ALARM)
    unpaired, misfit = max(0.0, unpaired), max(0.0, misfit)
    after = replace(before, unpaired=unpaired, misfit=misfit)
    if max(unpaired, misfit) >= constants.ALARM:
        return replace(after, lost=True)
    weight = min(before.learned + offered, constants.NOISE_MEMORY)
    gain, scale = offered / weight, before.scale
    if dof > 0:
        scale += 0.5 * dof / weight * (nis / dof - scale)
    share = before.share + gain * (paired / offered - before.share)
    strays = before.strays + gain * (offered - paired - before.strays)
    return replace(after, lost=False, share=share, strays=strays, scale=scale, learned=weight)


def _against_strays(before: Health, offered: int, left: int) -> float:
    """Log-likelihood ratio of "lost" for `left` of the `offered` observations unpaired.

    The smaller of a binomial model (share of what is observed) and a Poisson model (clutter, a constant number).
    """
    share = min(max(before.share, constants.HEALTH_SHARE_LEAST), constants.HEALTH_SHARE_MOST)
    binomial = (offered - left) * math.log(constants.LOST_SHARE)
    binomial += left * math.log((1.0 - constants.LOST_SHARE * share) / (1.0 - share))
    usual = max(before.strays, constants.HEALTH_STRAYS_LEAST * offered)
    more = max(usual, (1.0 - constants.LOST_SHARE * share) * offered)
    return min(binomial, left * math.log(more / usual) - (more - usual))


def recovered(before: Health) -> Health:
    """The state after the pose was found again: sums are zero, expectations stay."""
    return replace(before, unpaired=0.0, misfit=0.0, lost=False)


class Suspicion(NamedTuple):
    """State of the test while mapping. score: see the module; since: frame after the last one with score 0."""

    score: float = 0.0
    since: int = 0
    alarm: int | None = None  # frame since which the robot has been lost, from the first alarm, None: no alarm
    over: int | None = None  # frame where the score returned to 0, None: not yet


def suspect(before: Suspicion, frame: int, paired: int, replaced: int) -> Suspicion:
    """After a frame from another place with this many paired and replaced confirmed landmarks."""
    if not paired + replaced:
        return before
    here, lost = constants.PAIRED_HEALTHY, constants.PAIRED_LOST
    ratio = paired * math.log(lost / here) + replaced * math.log((1.0 - lost) / (1.0 - here))
    after = before._replace(score=max(0.0, before.score + ratio / (paired + replaced)))
    if after.score == 0.0:
        over = frame if after.alarm is not None and after.over is None else after.over
        return after._replace(since=frame + 1, over=over)
    if after.score >= constants.PAIRED_ALARM:
        return after._replace(alarm=after.since if after.alarm is None else after.alarm, over=None)
    return after


class Lost:
    """Tests every frame that the ledger has judged."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.suspicion = ledger, Suspicion()
        self._place = (math.inf, math.inf)
        self.often, self.retracted = 0, 0  # number of often observed landmarks, and of those retracted at the end

    def see(self, frame: Frame, decisions: IntArray, pose: Array) -> None:
        """Add a frame with its decisions (m,), before the update; `pose` (3,) is the predicted one."""
        x, y = self._place
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.ledger.range:
            return
        paired, replaced = self.ledger.replaced(decisions)
        if paired + replaced:
            self._place = float(pose[0]), float(pose[1])
        self.suspicion = suspect(self.suspicion, frame.number, paired, replaced)

    def end(self, often: Sequence[int], retracted: IntArray) -> None:
        """The end of the log: often observed landmarks (n,) and retracted ones (r,)."""
        self.often, self.retracted = len(often), int(np.isin(often, retracted).sum())

    def notes(self) -> list[Notice]:
        """Messages about a restarted or bent map."""
        s, found = self.suspicion, []
        if s.alarm is not None:
            found.append(notice(Code.MAP_RESTARTED, frame=s.alarm, over=s.over))
        if self.often >= constants.RETRACTED_FEWEST and self.retracted > constants.RETRACTED_SHARE * self.often:
            found.append(notice(Code.RETRACTED, gone=self.retracted, often=self.often))
        return found
