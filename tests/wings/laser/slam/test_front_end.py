"""The front end on a drive through rooms whose truth is known."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data.inputs import Inputs
from data.se2 import Array, between, pose_error
from wings.laser.floorplan.world import Floorplan, simulate
from wings.laser.slam.front_end import FrontEndResult, run_front_end
from wings.laser.slam.parameters import LaserParameters

HONEST = LaserParameters(variance_scale=1.0)


@cache
def _drive(frames: int = 900) -> tuple[Inputs, Array]:
    log = simulate(Floorplan(frames=frames), 2)
    assert log.truth.pose is not None
    return log.inputs(), log.truth.pose


@cache
def _found() -> FrontEndResult:
    return run_front_end(_drive()[0], HONEST)


def _way(pose: Array, first: Array, second: Array) -> Array:
    return between(pose[first], pose[second])


def test_a_narrow_view_does_not_carry_the_path_away() -> None:
    log = simulate(Floorplan(frames=300, beams=160, field_of_view=math.radians(58.0), max_range=5.0, people=True), 0)
    assert log.truth.pose is not None
    online = run_front_end(log.inputs(), LaserParameters()).online
    error = between(log.truth.pose[0], log.truth.pose) - between(online[0], online)
    assert float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())) < 0.3  # 0.23; 0.42 if every scan is matched


@pytest.mark.slow
def test_key_poses_follow_each_other_by_distance_and_every_frame_hangs_on_one() -> None:
    (inputs, truth), chain = _drive(), _found().chain
    assert chain.frame[0] == 0
    assert (np.diff(chain.frame) > 0).all()
    np.testing.assert_array_equal(chain.key, np.searchsorted(chain.frame, np.arange(len(inputs)), side="right") - 1)
    assert not chain.since[chain.frame].any()
    step = np.hypot(*chain.motion[1:, :2].T)
    turn = np.abs(chain.motion[1:, 2])
    assert ((step >= HONEST.keyframe_distance) | (turn >= HONEST.keyframe_angle)).all()
    error = pose_error(chain.since, _way(truth, chain.frame[chain.key], np.arange(len(inputs))))
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.05


def test_chain_is_near_the_truth_and_says_how_near() -> None:
    (_, truth), chain = _drive(), _found().chain
    error = pose_error(chain.motion[1:], _way(truth, chain.frame[:-1], chain.frame[1:]))
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(chain.covariance[1:]), error) / 3.0
    assert np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()) < 0.01
    assert 0.6 < nees.mean() < 1.6


def test_frames_without_a_scan_follow_odometry_and_the_first_may_be_one() -> None:
    inputs, truth = _drive(200)
    assert inputs.scans is not None
    few = replace(inputs.scans, frame=inputs.scans.frame[3::4], ranges=inputs.scans.ranges[3::4])
    assert few.of(0) is None
    found = run_front_end(replace(inputs, scans=few), HONEST)
    assert found.chain.frame[1] == 3
    odometry = inputs.increments.mean[5]
    np.testing.assert_allclose(between(found.online[4], found.online[5]), odometry, atol=1e-12)
    error = pose_error(between(found.online[3], found.online[199]), between(truth[3], truth[199]))
    assert np.hypot(*error[:2]) < 0.1
    assert abs(error[2]) < 0.02


def test_a_log_without_scans_is_refused() -> None:
    with pytest.raises(ValueError, match="scans"):
        run_front_end(replace(_drive(200)[0], scans=None), HONEST)
