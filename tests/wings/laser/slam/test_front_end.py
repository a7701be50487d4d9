"""The front end on a drive through rooms whose truth is known, as a whole log and frame by frame."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data.inputs import Increment, Inputs, Prior
from data.se2 import Array, between, compose, pose_error
from wings.laser.floorplan.world import Floorplan, simulate
from wings.laser.slam.front_end import FrontEndResult, run_front_end
from wings.laser.slam.incremental import MOST_AT_ONCE, ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.simulated.physics import Lidar
from wings.robot.simulated.room import room

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


def test_loop_closures_are_true_and_never_of_one_key_pose_alone() -> None:
    (_, truth), found = _drive(), _found()
    loops, frame = found.loops, found.chain.frame
    assert (loops.believed >= 0).sum() > 10
    assert (loops.key2 - loops.key1 >= HONEST.loop_gap).all()
    assert (loops.believed[loops.believed >= 0] >= loops.key2[loops.believed >= 0]).all()
    first = loops.believed == loops.believed[loops.believed >= 0].min()
    assert len(set(loops.key2[first])) > 1
    error = pose_error(loops.relative, _way(truth, frame[loops.key1], frame[loops.key2]))
    assert np.hypot(error[:, 0], error[:, 1])[loops.believed >= 0].max() < 0.1


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


ROUNDS, FRAMES = 4, 60  # on an ellipse through the room, frames each
EXACT = Prior(np.zeros(3), np.zeros((3, 3)))
SIGMA = np.array([0.01, 0.005, 0.01])


@cache
def driven():
    """True poses (N, 3) from the first one, increments, and scans (N, B)."""
    rng, lidar, place = np.random.default_rng(0), Lidar(beams=180), room(0)
    angle = 2.0 * math.pi * np.arange(ROUNDS * FRAMES) / FRAMES
    xy = np.column_stack([5.0 + 3.8 * np.sin(angle), 3.0 - 2.0 * np.cos(angle)])
    heading = np.arctan2(2.0 * np.sin(angle), 3.8 * np.cos(angle))
    world = np.column_stack([xy, heading])
    scans = [lidar.scan(place, pose, 0.0, (0, 0, 0), rng).metres for pose in world]
    motion = between(world[:-1], world[1:]) + SIGMA * rng.standard_normal((len(world) - 1, 3))
    return between(world[0], world), motion, scans, lidar.directions.scanner(lidar.sigma)


@cache
def found(least):
    """The front end's online poses (N, 3), the number of its key poses (N,), and itself."""
    _, motion, scans, scanner = driven()
    slam = ScanSlam(EXACT, scanner, 180, LaserParameters(), least=least, with_covariance=True)
    online, size, claimed = [], [], []
    for k, ranges in enumerate(scans):
        increment = Increment(motion[k - 1], np.diag(SIGMA**2)) if k else None
        online.append(slam.step(increment, ranges, 0.25))
        size.append(slam.size)
        claimed.append(slam.covariance)
    return np.array(online), np.array(size), np.array(claimed), slam


def off(least):
    return np.hypot(*(found(least)[0] - driven()[0])[2 * FRAMES :, :2].T)


def test_their_number_does_not_grow_from_round_to_round_and_without_it_does():
    third, last = (found(0.1)[1][rounds * FRAMES - 1] for rounds in (3, ROUNDS))
    assert last <= third + 2
    everything = found(None)[1]
    assert everything[-1] - everything[3 * FRAMES - 1] > 30
    assert last < 0.5 * everything[-1]


@pytest.mark.slow
def test_the_cost_is_millimetres():
    all_of_them, few = off(None), off(0.1)
    assert np.sqrt((all_of_them**2).mean()) < 0.01
    assert np.sqrt((few**2).mean()) < 0.02


def test_the_covariance_is_that_of_the_frame_and_safe():
    _, _, claimed, _ = found(0.1)
    error = found(0.1)[0] - driven()[0]
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    nees = np.einsum("ki,kij,kj->k", error[FRAMES:], np.linalg.inv(claimed[FRAMES:]), error[FRAMES:])
    assert (np.linalg.eigvalsh(claimed[1:]) > 0.0).all()
    assert nees.mean() < 6.0


def test_poses_of_those_that_left_are_unknown_and_their_scans_are_forgotten():
    slam, p = found(0.1)[3], LaserParameters()
    number, poses = slam.keys()
    assert len(number) == slam.size
    assert np.isfinite(poses).all()
    gone = np.setdiff1d(np.arange(len(slam.frames)), number)
    assert np.isnan(slam.poses[gone]).all()
    assert all(len(slam.closer.ranges(int(k))) == 0 for k in gone)
    assert number[0] == 0
    assert MOST_AT_ONCE * len(slam.frames) > len(gone) > 0
    assert len(slam.closer.candidates) <= p.loops_per_key * (p.wait + 2)
    assert compose(poses[-1], slam.tracker.pose).shape == (3,)
