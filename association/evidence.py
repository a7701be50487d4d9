"""Evidence for a landmark: how often it was seen, how often it should have been, and whether it stood still.

Each sighting brings the landmark's innovation given the other pairings of its frame (`association.hindsight.alone`).
Of a landmark that stands still these are independent, their squares chi-square and their weighted mean in the world
zero; one that moves drags its estimate behind it, so that they all point where it goes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.candidates import SIGMAS, polar_sigma
from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor

ENOUGH = 4
"""Sightings that make a landmark certain; people are mostly seen two or three times as the same one."""
MOVED = 0.9999
"""A landmark has moved if its mean innovation is outside this chi-square probability, 2 dof, ..."""
RESTLESS = 0.99999
"""... or the sum of its squared innovations outside this one, 2 dof for each."""
UNLIKELY = 1e-3
"""A landmark is not there if it was missed so often in a row that this had so small a probability."""
SHADOW = math.radians(0.5)
"""rad. What is nearer and within this angle may hide a landmark."""


class Evidence(NamedTuple):
    """What speaks for one landmark and against it.

    seen: sightings; missed: times it should have been seen and was not, `row` of them since the last sighting;
    squares: sum of its squared innovations; pull (2,), information (2, 2): those in the world, weighted, summed.
    """

    seen: int
    missed: int
    row: int
    squares: float
    pull: Array
    information: Array


FOUNDED = Evidence(1, 0, 0, 0.0, np.zeros(2), np.zeros((2, 2)))
"""Of a landmark that was founded just now."""


def sighted(e: Evidence, innovation: Array, information: Array, G: Array) -> Evidence:
    """One more sighting: innovation (2,) with information (2, 2); G (2, 2) turns it into a shift in the world."""
    inverse = np.linalg.inv(G)
    world = inverse.T @ information @ inverse
    squares = e.squares + float(innovation @ information @ innovation)
    return Evidence(e.seen + 1, e.missed, 0, squares, e.pull + world @ (G @ innovation), e.information + world)


def overlooked(e: Evidence) -> Evidence:
    """It should have been seen, and was not."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate after so many sightings and misses, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def verdict(e: Evidence, rate: float) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; empty: it stays.

    `rate`: with which certain landmarks in view are seen. A certain landmark has its own, if that is lower.
    """
    if e.seen > 1:
        drift = float(e.pull @ np.linalg.solve(e.information, e.pull))
        if drift > gate_threshold(MOVED) or e.squares > gate_threshold(RESTLESS, 2 * (e.seen - 1)):
            return "moved"
    if e.seen >= ENOUGH:
        rate = min(rate, detection_rate(e.seen, e.missed - e.row))
    return "missed" if (1.0 - rate) ** e.row < UNLIKELY else ""


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> BoolArray:
    """Candidates (n,) that should have been seen in a frame and were not paired.

    They stand in the field of view by 3 sigma, and nothing that was seen stands before them.
    """
    expected, seen = sensor.polar(e.z_hat), sensor.polar(e.z)
    sigma = SIGMAS * polar_sigma(sensor, e.z_hat, e.HPHt)
    inside = sensor.in_view(e.z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    before = np.abs(wrap_angle(seen[None, :, 1] - expected[:, None, 1])) < SHADOW
    hidden = (before & (seen[None, :, 0] < expected[:, None, 0])).any(axis=1)
    absent: BoolArray = inside & ~hidden & ~np.isin(e.number, decisions)
    return absent
