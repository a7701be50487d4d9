"""Questions about numbers of things: true poses beside frames, labels beside readings."""

from __future__ import annotations

import numpy as np

from data.log import Log
from data.questions.question import Question
from data.timeline import MAX_GAP

SPARSE = 0.5
"""Share of frames with a true pose below which the scores are about a sample of the run. The least in the recordings
this was tried on is 0.92 (a camera system that was switched off before the robot)."""
FEW = 50
"""Fewer labelled readings say nothing about how often a landmark is seen."""


def truth_rate(log: Log) -> list[Question]:
    """True poses in a small part of the frames."""
    pose = log.truth.pose
    if pose is None or len(pose) < 2:
        return []
    known = log.truth.known_poses
    if known >= SPARSE * len(pose):
        return []
    return [
        Question(
            "truth rate",
            f"{known} of {len(pose)} frames have a true pose, so errors are about those alone: truth is interpolated "
            f"across at most {MAX_GAP:g} s; give it as often as that, and check that its stamps run with the log's",
        )
    ]


def labels(log: Log) -> list[Question]:
    """Labels that number the readings instead of the landmarks."""
    label = log.granted
    if label is None:
        return []
    named = label[label >= 0]
    distinct = len(np.unique(named))
    if len(named) < FEW or 2 * distinct <= len(named):
        return []
    return [
        Question(
            "labels",
            f"{len(named)} labelled readings name {distinct} landmarks, so most are seen once: do the labels number "
            "the readings? A label names the landmark; leave the column out if nobody knows it",
        )
    ]
