"""Fixes and closures frame by frame: iSAM2 and a fixed lag against the batch optimum and dense innovations."""

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.pose_measurements import Fixes, expected_closure
from data.sensors import RelativePoint
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from tests.graph.test_pose_factors import SOURCES, closures_of, dense, drive, fix_error, found
from tests.graph.worlds import TIGHT


def stepped(inputs, smoother, gate=None, until=None):
    """The smoother after all frames; newest poses, covariances, and what updates with fixes and closures returned."""
    poses, covariances, done = [], [], []
    for k in range(len(inputs) if until is None else until):
        frame = inputs.frame(k)
        if frame.increment is not None:
            smoother.predict(frame.increment)
        if frame.fixes is not None:
            done.append(smoother.fix(frame.fixes, inputs.fixes.sources, gate))
        if frame.closures is not None:
            done.append(smoother.close_loops(frame.closures, gate))
        pose, covariance = smoother.estimate()
        poses.append(pose)
        covariances.append(covariance)
    return np.array(poses), np.array(covariances), done


def isam2(inputs, **options):
    return Isam2Smoother(inputs.prior, inputs.sensor, **{**TIGHT, **options})


def first(inputs, n):
    fixes, closures = inputs.fixes.before(n), inputs.closures.before(n)
    return replace(
        inputs, time=inputs.time[:n], increments=inputs.increments.only(slice(n)), fixes=fixes, closures=closures
    )


def test_isam2_ends_at_the_optimum_of_the_batch_smoother_and_its_newest_poses_are_those_of_the_data_so_far():
    inputs, _ = drive(seed=2)
    smoother = isam2(inputs)
    poses, covariances, done = stepped(inputs, smoother)
    batch, end = found(inputs), smoother.finish()
    assert end.total_nis[0] == pytest.approx(batch.cost, rel=1e-9)
    assert end.total_nis[1] == batch.dof
    np.testing.assert_allclose(end.final.pose, batch.trajectory.pose, atol=1e-7)
    np.testing.assert_allclose(end.final.covariance, batch.trajectory.covariance, atol=1e-8)
    np.testing.assert_allclose(end.fixes.nis, batch.fixes.nis, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(end.closures.white, batch.closures.white, atol=1e-6)
    assert end.closures.used.all()
    assert all(each.used.all() for each in done)
    for n in (8, 10, 15, 20):
        part = found(first(inputs, n))
        np.testing.assert_allclose(poses[n - 1], part.trajectory.pose[-1], atol=1e-5)
        np.testing.assert_allclose(covariances[n - 1], part.trajectory.covariance[-1], atol=1e-5)


@pytest.mark.parametrize("make", ["isam2", "fixed lag"])
def test_a_linear_world_gives_the_filters_innovations_and_estimate(make):
    """For errors so small that everything is linear; each kind of fix, and closures in both directions."""
    inputs, truth = drive(scale=1e-7)
    exact = {"threshold": 1e-13, "skip": 1}  # smaller changes than that do not reach the past
    smoother = isam2(inputs, **exact)
    if make == "fixed lag":
        smoother = FixedLagSmoother(inputs.prior, inputs.sensor, lag=100.0, **exact)
    poses, covariances, done = stepped(inputs, smoother)
    path, P = dense(inputs, truth)
    np.testing.assert_allclose(poses[-1], path[-1], atol=1e-12)
    np.testing.assert_allclose(covariances[-1], P[-3:, -3:], atol=1e-9)
    np.testing.assert_allclose(smoother.finish().final.pose[-1], path[-1], atol=1e-12)
    results = iter(done)
    seen_fixes = seen_closures = 0
    for k in range(len(inputs)):
        frame = inputs.frame(k)
        for kind in ("fixes", "closures"):
            if getattr(frame, kind) is None:
                continue
            result = next(results)
            for i in range(len(result.used)):
                before = first(inputs, k + 1)
                before = replace(
                    before,
                    fixes=before.fixes.only(np.arange(len(before.fixes)) < seen_fixes),
                    closures=before.closures.only(np.arange(len(before.closures)) < seen_closures),
                )
                path, P = dense(before, truth[: k + 1])
                if kind == "fixes":
                    error, J, R = fix_error(inputs, seen_fixes, path[k])
                    H = np.zeros((len(error), len(P)))
                    H[:, 3 * k :] = J
                    seen_fixes += 1
                else:
                    a, b = inputs.closures.frame1[seen_closures], inputs.closures.frame2[seen_closures]
                    z, J1, J2 = expected_closure(path[a], path[b])
                    error, R = se2.pose_error(inputs.closures.relative[seen_closures], z), inputs.closures.covariance[0]
                    H = np.zeros((3, len(P)))
                    H[:, 3 * a : 3 * a + 3], H[:, 3 * b : 3 * b + 3] = J1, J2
                    seen_closures += 1
                white = np.linalg.solve(np.linalg.cholesky(R + H @ P @ H.T), error)
                np.testing.assert_allclose(result.white[i][np.isfinite(result.white[i])], white, atol=1e-12)
                assert result.nis[i] == pytest.approx(white @ white, rel=1e-5)
    assert (seen_fixes, seen_closures) == (4, 4)


def test_a_gate_rejects_false_ones_which_are_still_tested_in_the_end():
    inputs, truth = drive(seed=4, scale=0.5)
    relative, z = inputs.closures.relative.copy(), inputs.fixes.z.copy()
    relative[3, 0] += 30.0
    z[2, 1] += 25.0
    wrong = replace(inputs, closures=replace(inputs.closures, relative=relative), fixes=replace(inputs.fixes, z=z))
    smoother = isam2(wrong)
    _, _, done = stepped(wrong, smoother, gate=0.9999)
    end = smoother.finish()
    assert end.closures.used.tolist() == [True, True, True, False]
    assert end.fixes.used.tolist() == [True, True, False, True]
    assert sum(int(each.used.sum()) for each in done) == 6
    assert end.closures.nis[3] > 100.0
    assert end.total_nis[1] == 20 - 6
    assert np.abs(se2.pose_error(end.final.pose, truth)[:, :2]).max() < 0.5


def test_a_closure_to_a_frame_that_left_the_lag_is_not_used():
    inputs, _ = drive(seed=5)
    smoother = FixedLagSmoother(inputs.prior, inputs.sensor, lag=5.0, slack=0.0, **TIGHT)
    _, _, done = stepped(inputs, smoother)
    used = np.concatenate([each.used for each in done])
    nis = np.concatenate([each.nis for each in done])
    assert used.sum() == 4  # the fixes alone: the closures span nine frames and more
    assert (np.isnan(nis) == ~used).all()
    end = smoother.finish()
    assert len(end.final.pose) == len(inputs)
    assert np.isfinite(end.final.covariance).all()
    near = replace(
        inputs, closures=closures_of(found(inputs).trajectory.pose, [(5, 9), (19, 15)], np.random.default_rng(0))
    )
    smoother = FixedLagSmoother(inputs.prior, inputs.sensor, lag=5.0, slack=0.0, **TIGHT)
    assert all(each.used.all() for each in stepped(near, smoother)[2])


@pytest.mark.parametrize("make", ["isam2", "fixed lag", "errors of odometry"])
@pytest.mark.parametrize("measured", ["fix", "closure"])
def test_a_motion_is_doubted_after_the_frames_fixes_and_closures_as_if_it_had_been_so_stated(make, measured):
    """A robot that was moved unseen may be found so by what it sees, after its receiver said where it is."""
    inputs, _ = drive(seed=8)
    at, more = (16, np.diag([25.0, 25.0, 9.0])) if measured == "fix" else (19, np.diag([25.0, 25.0, 9.0]))
    stated = inputs.increments.covariance.copy()
    stated[at] += more
    doubted = replace(inputs, increments=replace(inputs.increments, covariance=stated))
    if make == "errors of odometry":
        errors = {"systematic": Systematic(("scale",), np.array([0.05]))}
        inputs, doubted = replace(inputs, **errors), replace(doubted, **errors)

    def smoother():
        if make == "fixed lag":
            return FixedLagSmoother(
                inputs.prior, inputs.sensor, lag=0.0 if measured == "fix" else 30.0, slack=0.0, **TIGHT
            )
        return isam2(inputs, systematic=inputs.systematic)

    s, other = smoother(), smoother()
    stepped(inputs, s, until=at + 1)
    sure = s.estimate().covariance
    s.inflate(more)
    stepped(doubted, other, until=at + 1)
    # without a lag the frame before is about to leave, and was linearized at another pose
    near = {"atol": 1e-2} if make == "fixed lag" else {"atol": 1e-5}
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, **near)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, rtol=1e-3, **near)
    assert np.trace(s.estimate().covariance) > 1.2 * np.trace(sure)
    if make != "fixed lag":
        np.testing.assert_allclose(s.finish().total_nis, other.finish().total_nis, rtol=1e-8)


def test_a_robot_that_was_turned_unseen_is_found_where_it_was_placed_after_its_position_was_measured():
    """From the prediction, which is turned by 3.1 rad, the search ends metres away."""
    known = LandmarkMap(np.arange(3), np.array([[9.0, 2.0], [4.0, 9.0], [-3.0, 5.0]]))
    sensor, truth = RelativePoint(), np.array([3.0, 2.0, 3.1])
    s = Isam2Smoother(Prior(np.zeros(3), 0.01 * np.eye(3)), sensor, known, **TIGHT)
    s.predict(Increment(np.array([3.0, 2.0, 0.0]), 0.01 * np.eye(3)))
    one = np.array([0])
    position = Fixes(one, one, one, np.array([[3.0, 2.0, 0.0]]), np.diag([0.01, 0.01, 0.0])[None], SOURCES)
    assert s.fix(position, SOURCES, 0.99).used.all()
    s.inflate(np.diag([100.0, 100.0, np.pi**2]))
    seen = FrameObservations(sensor.predict(truth, known.xy), np.tile(1e-4 * np.eye(2), (3, 1, 1)))
    s.update(seen, known.id, at=truth)
    np.testing.assert_allclose(s.estimate().mean, truth, atol=1e-3)
    np.testing.assert_allclose(s.finish().final.pose[-1], truth, atol=1e-3)
