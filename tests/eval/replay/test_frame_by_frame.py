"""A front end has no log: it gets what is known before the first frame, then one frame after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Observations
from data.worlds.arena import Arena, simulate
from eval.replay.run import front_end, step_by_step
from eval.replay.settings import ASSOCIATIONS, STEPPING, Beginning, Setup
from tests.quick import slow

MANAGED = Setup(maintain=True, forget_after=3.0, lag=2.0)


@pytest.fixture(scope="module")
def inputs():
    return simulate(Arena(frames=60, landmarks=20), 3).inputs(labels=True)


def alone(name, association, inputs, setup):
    """Decisions (M,) and poses (N, 3) by a front end that never sees more than a frame at a time."""
    frames = [inputs.frame(k) for k in range(len(inputs))]
    front = front_end(name, association, Beginning(inputs.prior, inputs.sensor, inputs.map), setup)
    decisions, poses = [], []
    while frames:
        frame = frames.pop(0)
        front.move(frame)
        if len(frame.observations.z):
            pairing = front.associate(frame)
            done = front.update(frame, pairing)
            decisions += np.where((pairing.decisions >= 0) & ~done.used, -2, pairing.decisions).tolist()
        front.tidy()
        poses.append(front.estimator.estimate().mean)
    front.close()
    return decisions, poses


@pytest.mark.parametrize("association", ["known", pytest.param("jcbb", marks=pytest.mark.slow), "jcbb-hindsight"])
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("name", ["ekf", slow("isam2"), slow("fixed-lag")])
def test_a_run_needs_no_more_than_a_frame_at_a_time(inputs, name, task, association):
    given = inputs if task == "localization" else inputs.without_map()
    given = given if association == "known" else given.without_labels()
    run = step_by_step(name, given, task, association, MANAGED)
    decisions, poses = alone(name, association, given, MANAGED)
    assert run.decisions.tolist() == decisions
    assert np.array_equal(run.online.pose, poses)


@pytest.mark.parametrize("association", ["known", "jcbb-hindsight"])
def test_a_log_cut_short_is_decided_as_the_whole_was(inputs, association):
    short = 40
    o, stop = inputs.observations, int(inputs.start[short])
    given = inputs if association == "known" else inputs.without_labels()
    whole = step_by_step("isam2", given, "localization", association)
    decisions, poses = [], []
    front = front_end("isam2", association, given, Setup())
    for k in range(short):
        front.move(given.frame(k))
        if len(given.frame(k).observations.z):
            pairing = front.associate(given.frame(k))
            done = front.update(given.frame(k), pairing)
            decisions += np.where((pairing.decisions >= 0) & ~done.used, -2, pairing.decisions).tolist()
        front.tidy()
        poses.append(front.estimator.estimate().mean)
    assert decisions == whole.decisions[:stop].tolist()
    assert np.array_equal(poses, whole.online.pose[:short])
    assert len(o.frame) > stop


def test_labels_that_were_not_granted_are_missed_at_the_first_sighting(inputs):
    o = inputs.observations
    front = front_end("ekf", "known", replace(inputs, observations=Observations(o.frame, o.z, o.R)), Setup())
    front.move(inputs.frame(0))
    with pytest.raises(ValueError, match="not granted"):
        front.associate(inputs.frame(0)._replace(label=None))


def test_every_name_is_one_of_a_front_end(inputs):
    for name in STEPPING:
        for association in ASSOCIATIONS:
            assert front_end(name, association, inputs, Setup()).k == -1
