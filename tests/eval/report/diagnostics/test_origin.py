"""Where an implausible run went wrong: the frame that jumps, the pairing there, and readings next to the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.inputs import Observations
from data.notice import stopped
from data.result import Failure, Innovations
from eval.referee.score import Trial
from eval.report.diagnostics import origin_statement
from tests.eval.handmade import FRAMES, circle_log, run_with_error

LOG = circle_log()
DOUBT = Failure("implausible", 0, stopped("why"))


def innovative(frame):
    """A filter whose innovations jump in a frame; there is one observation in each of the first four."""
    nis, dof, white = np.full(FRAMES, np.nan), np.zeros(FRAMES, np.int64), np.zeros((4, 2))
    nis[1:4], dof[1:4] = 2.0, 2
    nis[frame], white[frame] = 900.0, [30.0, 0.0]
    run = run_with_error(np.zeros(3))
    return replace(run, innovations=Innovations(nis, dof, np.full(FRAMES, np.nan), white), doubt=DOUBT)


def told(run, log=LOG):
    return origin_statement(run, Trial(log, "slam", (run,)))


def test_nothing_is_told_of_a_run_without_doubt():
    assert told(run_with_error(np.zeros(3))) == ""


def test_the_frame_and_the_pairing_of_the_first_jump_are_named():
    text = told(innovative(2))
    assert text.startswith(
        "it probably began in frame 2, where NIS per degree of freedom jumps to 450: observation 0 was"
    )
    # the map of the run is off by 0.1 m in x and y
    assert "was paired (rightly, says the truth) with landmark 0, which the last map has 0.141 m from" in text
    assert "next to the robot" not in text


def test_a_wrong_pairing_is_called_so():
    log = replace(LOG, truth=replace(LOG.truth, landmark_of=np.array([3, 3, 7, 3])))
    assert "was paired (wrongly, says the truth) with landmark 0" in told(innovative(2), log)


def test_a_reading_next_to_the_robot_is_named_as_a_known_cause():
    o = LOG.recorded.observations
    z = np.array(o.z)
    z[2, 0] = 0.25  # sigma is 0.1 m
    log = replace(LOG, recorded=replace(LOG.recorded, observations=Observations(o.frame, z, o.R)))
    assert "is next to the robot (0.250 m), where a bearing means nothing" in told(innovative(2), log)


def test_the_difference_of_filter_and_smoother_tells_the_frame_where_there_are_no_innovations():
    off = np.zeros((FRAMES, 3))
    off[3:, 0] = 1.5  # of 0.1 m claimed
    run = run_with_error(np.zeros(3), estimator="isam2", phases=("online", "final"))
    run = replace(run, online=run_with_error(off).online, doubt=DOUBT)
    text = told(run)
    assert text.startswith("it probably began in frame 3, where the pose of isam2 online is 15.0 of its sigmas from")
    assert "observation 0 was paired" in text


def test_a_frame_without_observations_says_so():
    off = np.zeros((FRAMES, 3))
    off[9:, 0] = 1.5
    run = run_with_error(np.zeros(3), estimator="isam2", phases=("online", "final"))
    run = replace(run, online=run_with_error(off).online, doubt=DOUBT)
    assert told(run).endswith("no observation of that frame was used")


def test_of_innovations_and_difference_the_earlier_one_is_where_it_began():
    off = np.zeros((FRAMES, 3))
    off[3:, 0] = 1.5
    both = run_with_error(np.zeros(3), phases=("online", "final"))
    for frame, began in ((2, "NIS per degree"), (3, "NIS per degree")):
        run = replace(innovative(frame), online=run_with_error(off).online, final=both.final)
        assert told(run).startswith(f"it probably began in frame {frame}, where {began}")
    off[1:, 0] = 1.5
    run = replace(innovative(2), online=run_with_error(off).online, final=both.final)
    assert told(run).startswith("it probably began in frame 1, where the pose of ekf online is 15.0 of its sigmas")
