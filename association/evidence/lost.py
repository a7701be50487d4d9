"""Is what should be in view still there? A cumulative-sum test on a map that is being made.

A robot that is lost while it maps sees its surroundings anew: what certain landmarks should be in view is missed, and
what is read is newer than them. One that explores misses nothing old; one whose sensor often fails misses much, but
reads old landmarks beside. So two kinds count: certain landmarks that are paired, and certain ones that are missed
where something was read that came after they had been seen last.

The score adds the log-likelihood ratio of "lost" against "healthy" and never falls below zero (Page, Biometrika 41,
1954). A frame is one piece of evidence, however much it holds: its errors have one cause. Frames from one place are
one, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from association.evidence import constants


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
    here, lost = constants.THERE_HEALTHY, constants.THERE_LOST
    ratio = paired * math.log(lost / here) + replaced * math.log((1.0 - lost) / (1.0 - here))
    after = before._replace(score=max(0.0, before.score + ratio / (paired + replaced)))
    if after.score == 0.0:
        over = frame if after.alarm is not None and after.over is None else after.over
        return after._replace(since=frame + 1, over=over)
    if after.score >= constants.THERE_ALARM:
        return after._replace(alarm=after.since if after.alarm is None else after.alarm, over=None)
    return after
