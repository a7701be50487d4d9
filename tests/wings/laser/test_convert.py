"""A laser log as a log of key poses: the optimum of the laser run, no scan pair used twice, the truth carried."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.convert.__main__ import main
from data.formats.open_log import load_folder
from data.inputs import LabelledObservations
from data.se2 import between, compose, dead_reckoned, pose_error
from data.truth import Relations
from data.worlds.registry import named_log
from eval.referee.relations import errors
from eval.replay.run import compare
from eval.replay.settings import Setup
from wings.laser.key_poses import log_of_keys, relations_at_keys, true_inliers
from wings.laser.slam.key_log import ODOMETRY, SCAN_MATCH, key_log, wheels_between

SETUP = Setup()


@pytest.fixture(scope="module")
def log():
    return named_log("floorplan:0:frames=450")


@pytest.fixture(scope="module")
def matched(log):
    return key_log(log.recorded, SETUP, motion=SCAN_MATCH)


@pytest.fixture(scope="module")
def driven(log):
    return key_log(log.recorded, SETUP, motion=ODOMETRY, also=np.array([3, 50, 200]))


def without_corners(inputs):
    none = np.empty(0, np.int64)
    return replace(inputs, observations=LabelledObservations(none, np.empty((0, 2)), np.empty((0, 2, 2)), none))


def test_without_corners_the_smoother_ends_where_that_of_the_laser_run_does(log, matched):
    """Two programs on one graph: poses with any landmarks and closures, and the laser back end's pose graph."""
    (ours,) = compare(without_corners(matched.inputs), "slam", ["batch"], "known")
    (theirs,) = compare(log.recorded, "slam", ["batch"], "scan")
    assert len(matched.inputs.closures) == (theirs.loops.believed >= 0).sum() > 5
    assert np.abs(pose_error(ours.final.pose, theirs.key_pose)).max() < 1e-6


def test_no_pair_of_scans_is_motion_and_closure_at_once(matched, driven):
    assert matched.inputs.closures.sources == ("loop",)
    assert (matched.inputs.closures.frame2 - matched.inputs.closures.frame1 > 1).all()
    closures = driven.inputs.closures
    of = [set(zip(closures.frame1[s].tolist(), closures.frame2[s].tolist(), strict=True))
          for s in (closures.source == 0, closures.source == 1)]  # fmt: skip
    assert closures.sources == ("scan-match", "loop")
    assert not of[0] & of[1]


def test_each_frame_is_matched_to_the_key_pose_before_as_precisely_as_scan_matching_states(log, driven):
    closures, frame = driven.inputs.closures, driven.frame
    first, second = closures.frame1[closures.source == 0], closures.frame2[closures.source == 0]
    before = driven.chain.key[np.maximum(frame[second] - 1, 0)]
    np.testing.assert_array_equal(frame[first], driven.chain.frame[before])
    assert {3, 50, 200} <= set(frame[second].tolist())
    error = pose_error(closures.relative[closures.source == 0], between(*log.truth.pose[frame[[first, second]]]))
    assert np.abs(error).max() < 0.05
    P = closures.covariance[closures.source == 0]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(P), error) / 3.0
    assert 0.6 < nees.mean() * driven.claimed < 1.6  # in simulation scan matching's own variances need no scale


def test_the_wheels_alone_lead_where_dead_reckoning_does(log, driven):
    increments = driven.inputs.increments
    reckoned = dead_reckoned(log.recorded.prior.mean, log.recorded.increments.mean)
    ours = dead_reckoned(log.recorded.prior.mean, increments.mean)
    np.testing.assert_allclose(pose_error(ours, reckoned[driven.frame]), 0.0, atol=1e-9)
    one_step = wheels_between(log.recorded.increments, np.arange(20))
    np.testing.assert_allclose(one_step.covariance, log.recorded.increments.covariance[:20], atol=1e-15)


def test_relations_carried_to_key_poses_have_the_same_rotation_error_and_covariance(log, matched):
    rng, chain = np.random.default_rng(4), matched.chain
    row1, row2 = rng.integers(0, 200, 30), rng.integers(230, 450, 30)
    path = compose(log.truth.pose[chain.frame][chain.key], chain.since)
    off = rng.normal(0.0, 0.02, (30, 3))
    relative = between(path[row1], path[row2]) + off
    P = np.tile(np.diag([1e-4, 4e-4, 1e-5]), (30, 1, 1))
    carried = relations_at_keys(Relations(row1, row2, relative, covariance=P), chain)
    keys = log.truth.pose[chain.frame]
    before = errors(path[row1], path[row2], relative)
    after = errors(keys[carried.row1], keys[carried.row2], carried.relative)
    np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-12)
    exact = relations_at_keys(Relations(row1, row2, relative - off), chain)
    np.testing.assert_allclose(exact.relative, between(keys[exact.row1], keys[exact.row2]), atol=1e-9)
    step = 1e-6 * np.eye(3)
    J = np.stack([
        pose_error(relations_at_keys(Relations(row1, row2, relative + d), chain).relative, carried.relative) / 1e-6
        for d in step
    ], axis=-1)  # fmt: skip
    np.testing.assert_allclose(carried.covariance, J @ P @ J.transpose(0, 2, 1), atol=1e-8)


def test_relations_between_frames_of_the_log_stay_as_they_are(log, driven):
    relations = Relations(np.array([3, 50]), np.array([200, 200]), np.zeros((2, 3)), np.array([1, 0]))
    made = log_of_keys("keys", replace(log, truth=replace(log.truth, relations=relations)), driven, ODOMETRY)
    kept = made.truth.relations
    np.testing.assert_array_equal(driven.frame[kept.row1], [3, 50])
    np.testing.assert_array_equal(driven.frame[kept.row2], [200, 200])
    np.testing.assert_array_equal(kept.exact, [1, 0])
    np.testing.assert_array_equal(made.truth.pose, log.truth.pose[driven.frame])


def test_a_closure_that_is_metres_off_is_no_inlier(log, matched):
    closures, truth = matched.inputs.closures, log.truth.pose[matched.frame].copy()
    assert (true_inliers(closures, truth) == 1).all()
    bent = replace(
        closures, relative=closures.relative + np.array([2.0, 0.0, 0.0]) * (np.arange(len(closures)) == 1)[:, None]
    )
    np.testing.assert_array_equal(np.flatnonzero(true_inliers(bent, truth) == 0), [1])
    truth[closures.frame2[0]] = np.nan
    assert true_inliers(closures, truth)[0] == -1


def test_the_command_writes_a_log_that_reads_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["laser", "floorplan:0:frames=60", str(tmp_path / "keys"), "--leave-out", "loops"]) == 0
    made = load_folder(tmp_path / "keys")
    assert made.recorded.scans is None
    assert made.recorded.closures is None
    assert len(made.recorded.observations.frame) > 5
    assert made.truth.known_poses == len(made.recorded)
    assert "scan matching" in capsys.readouterr().out


@pytest.mark.parametrize(("words", "fault"), [
    (["arena:0"], "arena:0: no laser scans"),
    (["floorplan:0:frames=50", "--keyframe-distance", "0"], "--keyframe-distance 0"),
    (["floorplan:0:frames=50", "--motion", "odometry", "--no-odometry"], "--motion odometry: "),
    (["floorplan:0:frames=50", "--leave-out", "scans"], "scans: unknown"),
    (["floorplan:0:frames=50", "--leave-out", "loops", "--leave-out", "corners"], "nothing beside the motion is left"),
    (["nowhere.log"], "nowhere.log: no such log"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_a_line(words, fault, tmp_path, refused):
    assert fault in refused(main, ["laser", words[0], str(tmp_path / "out"), *words[1:]])
    assert not (tmp_path / "out").exists()
