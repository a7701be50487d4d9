"""Monitor: is the pose that the pairings assume still the right one? Cumulative-sum tests on what they leave behind.

A robot that was moved unseen, or believes a wrong place, finds its observations unpaired, or pairs what fits badly.
Each of the two has a score, to which every frame adds the log-likelihood ratio of "lost" against "healthy" and which
never falls below zero (Page, Biometrika 41, 1954); where a score last left zero is where the trouble began.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from association.evidence import constants


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
