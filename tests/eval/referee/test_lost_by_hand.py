"""Limits of the tests of lost estimators, for runs written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.inputs import Observations
from data.result import MapEstimate
from eval.referee.lost import former_observations
from tests.eval.handmade import FRAMES, LANDMARKS, circle_log, run_with_error

PER_FRAME = 3


def observing(*, known_map=True):
    """All frames see landmark 3 three times."""
    log = circle_log(known_map=known_map)
    r = log.recorded
    frame = np.repeat(np.arange(FRAMES), PER_FRAME)
    z = np.concatenate([np.tile(r.sensor.predict(p, LANDMARKS.xy[:1]), (PER_FRAME, 1)) for p in log.truth.pose])
    return replace(r, observations=Observations(frame, z, np.tile(0.01 * np.eye(2), (len(z), 1, 1))))


M = PER_FRAME * FRAMES


def slam(decisions=None, *, times_seen=3, first=0):
    """A run that has landmark 0 in its map where it is."""
    run = run_with_error(np.zeros(3), association="nn")
    found = MapEstimate(
        np.array([0]), LANDMARKS.xy[:1], 0.01 * np.eye(2)[None], np.array([first]), np.array([times_seen])
    )
    decisions = np.zeros(M, int) if decisions is None else decisions
    return replace(run, map=found, decisions=decisions, final_decisions=decisions, created=np.full(M, -1))


def test_a_landmark_is_expected_twenty_frames_after_it_was_made_if_it_was_seen_three_times():
    inputs = observing(known_map=False)
    could, did, looked = former_observations(slam(first=5), inputs)
    assert looked.all()
    # well inside: 0.9 of 8 m; the robot is at most 10 m from (6, 0) on its circle of 4 m
    away = np.linalg.norm(circle_log().truth.pose[:, :2] - LANDMARKS.xy[0], axis=1)
    assert could.tolist() == ((away < 7.2) & (np.arange(FRAMES) >= 25)).astype(float).tolist()
    assert did.tolist() == [3 * (k >= 25) for k in range(FRAMES)]
    seldom, done, _ = former_observations(slam(times_seen=2), inputs)
    assert not seldom.any()
    assert not done.any()
