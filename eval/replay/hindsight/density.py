"""Step 3, pairing a frame of SLAM: joint compatibility; no single observation chooses among dense landmarks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.evidence.pairings import jcbb_hindsight
from association.evidence.scales import Scales, scaled
from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import BoolArray
from data.sensors import RANGE_BEARING
from ekf.slam import EkfSlam
from eval.replay.hindsight.ledger import Ledger
from eval.replay.settings import Setup


class Paired(NamedTuple):
    """Decisions (m,) among candidates, and whether the search for them was complete."""

    among: Expectation
    decisions: IntArray
    complete: bool


def pair(e: Expectation, slam: EkfSlam, ledger: Ledger, scales: Scales, setup: Setup) -> Paired:
    """Joint compatibility; a pairing among several likely ones counts only if the frame as a whole makes it.

    Args:
        e: what is expected of the landmarks in view, by the stated noise.
        slam: the filter that expects it.
        ledger: its landmarks; a frame that cannot tell which is which begins an epoch.
        scales: how much of the stated noise there is.
        setup: its gates.
    """
    real = scaled(e, scales)
    found = Paired(e, *jcbb_hindsight(real, setup.gate, setup.new_gate))
    if not len(e.number) or not len(e.z):
        return found
    unclear = dense(e, slam, ledger, setup)
    # what leaves no doubt was seen on the way here, and does not tell where in the old map the robot is
    if np.isin(found.decisions, e.number[unclear]).sum() >= constants.TOGETHER or not unclear.any():
        return found
    if ledger.travelled - ledger.epoch.begun > constants.WINDOW_SPAN * ledger.range:
        ledger.begin_epoch()
    few = clear(e, unclear, ledger)
    return Paired(e.only(few), *jcbb_hindsight(real.only(few), setup.gate, setup.new_gate))


def clear(e: Expectation, dense: BoolArray, ledger: Ledger) -> IntArray:
    """Candidates (k,) that a single observation may choose: the others, and what this epoch initialized.

    (None of these is to be initialized once more.)
    """
    few: IntArray = np.flatnonzero(~dense | (e.number >= ledger.epoch.first))
    return few


def dense(e: Expectation, slam: EkfSlam, ledger: Ledger, setup: Setup) -> BoolArray:
    """Candidates (n,) into whose gate so many landmarks fall by chance that a single observation tells nothing."""
    sensor, threshold = slam.sensor, gate_threshold(setup.gate or constants.DENSE_GATE)
    area = np.sqrt(np.linalg.det(e.HPHt)) * (sensor.polar(e.z_hat)[:, 0] if sensor.kind == RANGE_BEARING else 1.0)
    too_many: BoolArray = density(slam, ledger.range) * math.pi * threshold * area > constants.DENSE
    return too_many


def density(slam: EkfSlam, reach: float) -> float:
    """Landmarks per square metre around the robot, as far as the sensor reaches [m]."""
    near = np.hypot(*(slam.xy - slam.mean[:2]).T) < reach
    return max(1, int(near.sum())) / (math.pi * reach**2) if reach > 0.0 else 0.0
