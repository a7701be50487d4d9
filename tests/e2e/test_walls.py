"""A robot with sonars along the walls of a room: from the packets to estimates that know how good they are."""

from __future__ import annotations

import numpy as np
import pytest

from data.logs import open_log
from eval.referee.consistency import CONSISTENT, nees, verdict
from eval.referee.score import confusion_of
from eval.replay.run import compare

SEEDS = range(50)
FIRST = 20
"""Frames, 5 s: until walls are seen odometry's rounding is all there is."""


def drive(log, task, name, association):
    """Pose error at the end [m], mean pose NEES, wrong pairings of a run."""
    (run,) = compare(log.inputs(labels=association == "known"), task, [name], association)
    assert run.status == "ok"
    path = run.online
    c = confusion_of(run, log, "online")
    end = float(np.hypot(*(path.pose[-1, :2] - log.truth.pose[-1, :2])))
    means = nees(path.pose, path.covariance, log.truth.pose, "pose")
    return end, float(np.nanmean(means[FIRST:])), c.wrong + c.spurious


@pytest.mark.slow
def test_walls_are_found_and_the_robot_back_at_the_start_knows_where_it_is():
    log = open_log("walls:0:frames=660")
    end, _, wrong = drive(log, "slam", "ekf-fej", "jcbb")
    assert end < 0.1
    assert wrong == 0


@pytest.mark.slow
def test_over_fifty_drives_the_end_is_known_to_five_centimetres_and_claims_are_right():
    """Labels known; the robot drives twice round the room of 10 x 6 m with two boxes and ends near its start."""
    ends, means = {}, {}
    for seed in SEEDS:
        log = open_log(f"walls:{seed}:room=0")
        for task, name in (("slam", "ekf-fej"), ("slam", "isam2"), ("localization", "isam2")):
            end, mean, _ = drive(log, task, name, "known")
            ends.setdefault((task, name), []).append(end)
            means.setdefault((task, name), []).append(mean)
    for key, values in ends.items():
        assert np.sqrt(np.mean(np.square(values))) < 0.05, key
        found = verdict(np.array(means[key]), 3)
        assert found.word == CONSISTENT, f"{key}: {found.mean:.2f} [{found.lower:.2f}, {found.upper:.2f}]"
