"""First misfit of an implausible run: frame, pairing, and observations next to the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Observations
from data.notice import stopped
from data.result import Failure, Innovations
from data.words import sentence
from eval.referee.diagnostics import origin
from eval.referee.score import Trial
from tests.eval.handmade import FRAMES, circle_log, run_with_error

LOG = circle_log()
DOUBT = Failure("implausible", 0, stopped("why"))


def innovative(frame):
    """A filter whose innovations jump in a frame; there is one observation in each of the first four."""
    nis, dof, white = np.full(FRAMES, np.nan), np.zeros(FRAMES, np.int64), np.zeros((4, 2))
    nis[1:4], dof[1:4] = 2.0, 2
    nis[frame], white[frame] = 900.0, [30.0, 0.0]
    run = run_with_error(np.zeros(3))
    return replace(run, innovations=Innovations(nis, dof, np.full(FRAMES, np.nan), white), implausible=DOUBT)


def told(run, log=LOG):
    return origin(run, Trial(log, "slam", (run,)))


def seen(run):
    """The frame, what is seen in it, and its size."""
    found = told(run)
    return found.frame, found.named["sign"], found.named["online"], pytest.approx(found.named["size"])


def test_a_plausible_run_has_no_origin():
    assert told(run_with_error(np.zeros(3))) is None


def test_the_frame_and_the_pairing_of_the_first_jump_are_named():
    found = told(innovative(2))
    assert seen(innovative(2)) == (2, "innovation", "ekf", 450.0)
    # the map of the run is off by 0.1 m in x and y
    where = {"observation": 0, "landmark": 0, "began": False, "right": True, "off": pytest.approx(0.1414, abs=1e-3)}
    assert {name: found.named[name] for name in where} == where
    assert found.named["beside"] == ()
    assert sentence(found).startswith("it probably began in frame 2, where NIS per degree of freedom jumps to 450")


def test_a_wrong_pairing_is_reported():
    log = replace(LOG, truth=replace(LOG.truth, landmark_of=np.array([3, 3, 7, 3])))
    assert told(innovative(2), log).named["right"] is False


def test_an_observation_next_to_the_robot_is_named_as_a_known_cause():
    o = LOG.recorded.observations
    z = np.array(o.z)
    z[2, 0] = 0.25  # sigma is 0.1 m
    log = replace(LOG, recorded=replace(LOG.recorded, observations=Observations(o.frame, z, o.R)))
    assert told(innovative(2), log).named["beside"] == (0.25,)


def test_without_innovations_the_frame_is_that_of_the_filter_smoother_difference():
    off = np.zeros((FRAMES, 3))
    off[3:, 0] = 1.5  # of 0.1 m claimed
    run = run_with_error(np.zeros(3), estimator="isam2", phases=("online", "final"))
    run = replace(run, online=run_with_error(off).online, implausible=DOUBT)
    assert seen(run) == (3, "path", "isam2", 15.0)
    assert told(run).named["observation"] == 0


def test_a_frame_without_observations_says_so():
    off = np.zeros((FRAMES, 3))
    off[9:, 0] = 1.5
    run = run_with_error(np.zeros(3), estimator="isam2", phases=("online", "final"))
    run = replace(run, online=run_with_error(off).online, implausible=DOUBT)
    assert told(run).named["observation"] is None
    assert sentence(told(run)).endswith("no observation of that frame was used")


def test_of_innovations_and_difference_the_earlier_one_is_where_it_began():
    off = np.zeros((FRAMES, 3))
    off[3:, 0] = 1.5
    both = run_with_error(np.zeros(3), phases=("online", "final"))
    for frame in (2, 3):
        run = replace(innovative(frame), online=run_with_error(off).online, final=both.final)
        assert seen(run)[:2] == (frame, "innovation")
    off[1:, 0] = 1.5
    run = replace(innovative(2), online=run_with_error(off).online, final=both.final)
    assert seen(run) == (1, "path", "ekf", 15.0)
