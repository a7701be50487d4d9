"""Evidence for a landmark: how often it was seen, how often it should have been, and whether it stood still.

Each sighting brings the landmark's innovation given the other pairings of its frame
(`association.evidence.pairings.alone`). Of a landmark that stands still these are independent, their squares chi-square
and their weighted mean in the world zero; one that moves drags its estimate behind it, so that they all point where it
goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from association.candidates import polar_sigma
from association.evidence import constants
from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor


class Evidence(NamedTuple):
    """What speaks for one landmark and against it.

    seen: sightings, `looks` of them from different places; missed: places where it should have been seen and was not,
    `row` of them since the last sighting;
    judged: sightings judged by others of their frame; squares: the sum of these squared; pull (2,),
    information (2, 2): these in the world, weighted, summed.
    """

    seen: int
    looks: int
    missed: int
    row: int
    judged: int
    squares: float
    pull: Array
    information: Array


INITIALIZED = Evidence(1, 1, 0, 0, 0, 0.0, np.zeros(2), np.zeros((2, 2)))
"""Of a landmark that was initialized just now."""


class Judgement(NamedTuple):
    """Innovation (2,) of a sighting given others of its frame, its information (2, 2); G (2, 2): to the world."""

    innovation: Array
    information: Array
    G: Array


def sighted(e: Evidence, judged: Judgement | None, elsewhere: bool) -> Evidence:
    """One more sighting, and what the others of the frame say about it; `elsewhere`: not from the place of the last."""
    e = e._replace(seen=e.seen + 1, looks=e.looks + elsewhere, row=0)
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


def overlooked(e: Evidence) -> Evidence:
    """It should have been seen, and was not."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


class Visibility(NamedTuple):
    """How often certain landmarks in view were seen and missed: sightings and misses after a sighting, after a miss.

    A landmark that is hidden from here stays hidden for a while, so misses come in rows; where a sensor sees all there
    is in view, a second miss in a row is as unlikely as the first.
    """

    seen_seen: int = 0
    seen_missed: int = 0
    missed_seen: int = 0
    missed_missed: int = 0

    def counting(self, before_missed: bool, seen: bool) -> Visibility:
        """With one more landmark in view."""
        name = ("missed_" if before_missed else "seen_") + ("seen" if seen else "missed")
        return self._replace(**{name: getattr(self, name) + 1})

    def without(self, row: int) -> Visibility:
        """Without a row of misses that is not over: a landmark must not testify for itself."""
        if not row:
            return self
        return self._replace(
            seen_missed=max(0, self.seen_missed - 1), missed_missed=max(0, self.missed_missed - (row - 1))
        )

    @property
    def rate(self) -> float:
        """With which a landmark in view is seen."""
        return detection_rate(self.seen_seen + self.missed_seen, self.seen_missed + self.missed_missed)

    def row(self, length: int, rate: float) -> float:
        """Probability that a landmark which is there is missed so often in a row; `rate`: with which it is seen.

        A Markov chain; before much is known of rows, misses are taken for independent.
        """
        if not length:
            return 1.0
        prior, missed = constants.INDEPENDENT_MISSES, self.missed_missed
        again = (missed + prior * (1.0 - rate)) / (missed + self.missed_seen + prior)
        return (1.0 - rate) * max(again, 1.0 - rate) ** (length - 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate after so many sightings and misses, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def certain(e: Evidence, v: Visibility) -> bool:
    """Whether a landmark was seen as often as `CERTAIN` times in view would give, and at least twice."""
    return e.seen >= max(constants.CERTAIN_AT_LEAST, constants.CERTAIN * v.rate)


def verdict(e: Evidence, v: Visibility) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; empty: it stays.

    A certain landmark has its own rate of detection, if that is lower, and there must be more against it.
    """
    if e.judged:
        drift = float(e.pull @ np.linalg.solve(e.information, e.pull))
        if drift > gate_threshold(constants.MOVED) or e.squares > gate_threshold(constants.RESTLESS, 2 * e.judged):
            return "moved"
    if certain(e, v):
        v = v.without(e.row)
        own = min(v.rate, detection_rate(e.looks, e.missed - e.row))
        return "missed" if v.row(e.row, own) < constants.UNLIKELY**constants.UNLIKELY_POWER else ""
    return "missed" if v.row(e.row, v.rate) < constants.UNLIKELY else ""


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> BoolArray:
    """Candidates (n,) that should have been seen in a frame and were not paired.

    They stand in the field of view by `IN_VIEW_SIGMAS`, and nothing that was seen stands before them.
    """
    expected, seen = sensor.polar(e.z_hat), sensor.polar(e.z)
    sigma = constants.IN_VIEW_SIGMAS * polar_sigma(sensor, e.z_hat, e.HPHt)
    inside = sensor.in_view(e.z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    before = np.abs(wrap_angle(seen[None, :, 1] - expected[:, None, 1])) < constants.SHADOW
    hidden = (before & (seen[None, :, 0] < expected[:, None, 0])).any(axis=1)
    absent: BoolArray = inside & ~hidden & ~np.isin(e.number, decisions)
    return absent
