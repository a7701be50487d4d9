"""Lost: is the pose that the pairings assume, or the map that is being made, still right?

Cumulative-sum tests: every frame adds the log-likelihood ratio of "lost" against "healthy" to a score that never falls
below zero (Page, Biometrika 41, 1954); where a score last left zero is where the trouble began.

In a known map, a robot that was moved unseen, or believes a wrong place, finds its observations unpaired, or pairs what
fits badly: a score each.

A robot that is lost while it maps sees its surroundings anew: what certain landmarks should be in view is missed, and
what is read is newer than them. One that explores misses nothing old; one whose sensor often fails misses much, but
reads old landmarks beside. So two kinds count: certain landmarks that are paired, and certain ones that are missed
where something was read that came after they had been seen last. A frame is one piece of evidence, however much it
holds: its errors have one cause. Frames from one place are one, too. At the end a second test: a robot that finds again
what it mapped keeps it; of a map that is bent most goes. All this is said; nothing is decided by it.
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
class Monitor:
    """What is demanded of the test.

    Attributes:
        threshold: score of an alarm. By Wald's inequality a healthy log raises one in exp(threshold) frames at most, if
            what is expected of it is right; set far above the one in 10^4 that is wanted, because it never quite is.
        lost_share: a lost robot pairs this share of what a healthy one pairs.
        lost_scale: the NIS of what a lost robot pairs is this many times the expected one.
        memory: observations over which the healthy share of pairings and their NIS are learned.
        start: share of observations paired and NIS per degree of freedom that are expected at first, worth as much as
            `weight` observations.
    """

    threshold: float = field(default_factory=lambda: constants.ALARM)
    lost_share: float = field(default_factory=lambda: constants.LOST_SHARE)
    lost_scale: float = field(default_factory=lambda: constants.LOST_SCALE)
    memory: float = field(default_factory=lambda: constants.HEALTH_MEMORY)
    start: tuple[float, float] = field(default_factory=lambda: constants.HEALTH_START)
    weight: float = field(default_factory=lambda: constants.HEALTH_WEIGHT)


@dataclass(frozen=True)
class Health:
    """State of the test after a frame.

    Attributes:
        unpaired, misfit: cumulative sums, 0 where nothing speaks for being lost.
        share, strays, scale: what is expected of a healthy frame: share of its observations paired, number of those
            that are not, NIS per degree of freedom.
        learned: weight of what was learned, in observations.
        lost: one of them has reached the threshold.
    """

    unpaired: float = 0.0
    misfit: float = 0.0
    share: float = field(default_factory=lambda: constants.HEALTH_START[0])
    strays: float = 0.0
    scale: float = field(default_factory=lambda: constants.HEALTH_START[1])
    learned: float = field(default_factory=lambda: constants.HEALTH_WEIGHT)
    lost: bool = False


def healthy(monitor: Monitor) -> Health:
    """The state before the first frame."""
    return Health(share=monitor.start[0], scale=monitor.start[1], learned=monitor.weight)


def watch(monitor: Monitor, before: Health, offered: int, paired: int, nis: float, dof: int) -> Health:
    """The state after a frame of which `paired` of the `offered` observations were paired, with their NIS and its dof.

    Expectations are learned from every frame but those of a lost robot. The expected NIS never falls below its
    chi-square mean: conservative noise is not to make the test hasty.
    """
    if offered == 0:
        return before
    unpaired = before.unpaired + _against_strays(monitor, before, offered, offered - paired)
    # one instant full of misfits is one piece of evidence: its errors are not independent
    r = monitor.lost_scale
    fit = 0.5 * (nis / max(before.scale, 1.0) * (1.0 - 1.0 / r) - dof * math.log(r))
    misfit = before.misfit + min(fit, constants.MISFIT_MOST * monitor.threshold)
    unpaired, misfit = max(0.0, unpaired), max(0.0, misfit)
    after = replace(before, unpaired=unpaired, misfit=misfit)
    if max(unpaired, misfit) >= monitor.threshold:
        return replace(after, lost=True)
    weight = min(before.learned + offered, monitor.memory)
    gain, scale = offered / weight, before.scale
    if dof > 0:
        scale += 0.5 * dof / weight * (nis / dof - scale)
    share = before.share + gain * (paired / offered - before.share)
    strays = before.strays + gain * (offered - paired - before.strays)
    return replace(after, lost=False, share=share, strays=strays, scale=scale, learned=weight)


def _against_strays(monitor: Monitor, before: Health, offered: int, left: int) -> float:
    """Log-likelihood ratio of "lost" against "healthy" for `left` of the `offered` observations unpaired.

    The lesser of two: the unpaired as a share of what is seen (binomial), and as a number that does not depend on how
    much is seen (Poisson: clutter). Which of them is right differs from log to log.
    """
    share = min(max(before.share, constants.HEALTH_SHARE_LEAST), constants.HEALTH_SHARE_MOST)
    binomial = (offered - left) * math.log(monitor.lost_share)
    binomial += left * math.log((1.0 - monitor.lost_share * share) / (1.0 - share))
    usual = max(before.strays, constants.HEALTH_STRAYS_LEAST * offered)
    more = max(usual, (1.0 - monitor.lost_share * share) * offered)
    return min(binomial, left * math.log(more / usual) - (more - usual))


def recovered(before: Health) -> Health:
    """The state after the pose was found again: no suspicion left, expectations as they were."""
    return replace(before, unpaired=0.0, misfit=0.0, lost=False)


class Suspicion(NamedTuple):
    """State of the test. score: 0 where nothing speaks for being lost; since: frame after the one where it was last 0.

    alarm: since when (frame) the robot has been lost, as it turned out at the first alarm, None: there was none; over:
    the frame in which the score was back at 0, None: it has not been.
    """

    score: float = 0.0
    since: int = 0
    alarm: int | None = None
    over: int | None = None


def looked(before: Suspicion, frame: int, paired: int, replaced: int) -> Suspicion:
    """After a frame from another place that paired so many certain landmarks and read newer ones for so many others."""
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

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        s, found = self.suspicion, []
        if s.alarm is not None:
            found.append(notice(Code.MAP_RESTARTED, frame=s.alarm, over=s.over))
        if self.often >= constants.RETRACTED_FEWEST and self.gone > constants.RETRACTED_SHARE * self.often:
            found.append(notice(Code.RETRACTED, gone=self.gone, often=self.often))
        return found
