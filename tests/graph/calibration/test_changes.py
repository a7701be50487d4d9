"""What happens to systematic errors where the graph changes: late loops, pairings amended, a drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations, LabelledObservations
from data.result import DISCARD
from ekf.slam import EkfSlam
from graph.batch import smooth
from graph.problem import Start
from tests.graph.calibration.running import calibrated, in_sigmas, true_map
from tests.graph.calibration.worlds import ALL, CARTESIAN, ODOMETRY, POLAR, POLAR_OFF, erring, to_estimate, truncated
from tests.graph.driving import TIGHT, drive, for_task


def near(s, batch):
    """How many sigmas the newest pose and errors are off at most."""
    P = batch.trajectory.covariance[-1]
    pose = in_sigmas(se2.pose_error(s.estimate().mean, batch.trajectory.pose[-1]), P).max()
    return max(pose, (np.abs(s.errors[0] - batch.systematic.mean[-1]) / batch.systematic.sigma[-1]).max())


def batch_of(inputs, path, xy):
    decisions, created = known_decisions(inputs)
    return smooth(inputs, decisions, created, Start(path, true_map(inputs, created, xy)))


def late_loop():
    """SLAM that sees something at the beginning and the end of a way only: the end is off by metres until then."""
    inputs, path, xy = erring(to_estimate(*ODOMETRY), POLAR, frames=60, noise=1.0, see=1.0, sigma=(0.15, 0.1, 0.08))
    o = inputs.observations
    keep = (o.frame < 4) | (o.frame >= 52)
    seen = LabelledObservations(o.frame[keep], o.z[keep], o.R[keep], o.label[keep])
    return replace(inputs, observations=seen).without_map(), path, xy


@pytest.mark.slow
def test_a_loop_that_moves_the_path_by_metres_ends_where_batch_does():
    inputs, path, xy = late_loop()
    decisions, _ = known_decisions(inputs)
    before = drive(inputs, decisions, smoother=calibrated(inputs), until=52)[0].estimate().mean
    for frames, within in ((54, 0.5), (60, 0.1)):
        prefix = truncated(inputs, frames)
        batch = batch_of(prefix, path[:frames], xy)
        assert np.hypot(*(batch.trajectory.pose[51] - before)[:2]) > 5.0
        s = drive(prefix, decisions, smoother=calibrated(prefix))[0]
        assert near(s, batch) < within
    finished = s.finish()
    np.testing.assert_allclose(finished.final.pose, batch.trajectory.pose, atol=1e-5)
    np.testing.assert_allclose(finished.systematic.mean, batch.systematic.mean, atol=1e-5)
    np.testing.assert_allclose(finished.systematic.sigma, batch.systematic.sigma, atol=1e-6)


def test_predictions_are_those_of_a_filter():
    """Not with errors of turns: a filter has them act on the turn of late."""
    systematic = to_estimate("scale", "curvature", "drift", "range", "bearing")
    inputs, *_ = erring(systematic, POLAR_OFF, frames=30)
    s = drive(inputs, np.full(len(inputs.observations.frame), DISCARD), smoother=calibrated(inputs))[0]
    theirs = EkfSlam(inputs.prior, inputs.sensor, systematic=systematic)
    for k in range(1, len(inputs)):
        theirs.predict(inputs.increment(k))
    for mine, other in zip((*s.estimate(), *s.errors), (*theirs.estimate(), *theirs.errors), strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-9)


@pytest.mark.parametrize("names", [ODOMETRY, pytest.param(ALL, marks=pytest.mark.slow)], ids=["odometry", "all"])
def test_pairings_amended_leave_what_they_would_have_been_from_the_start(names):
    inputs, *_ = erring(to_estimate(*names), POLAR, frames=24)
    decisions, _ = known_decisions(inputs)
    right = drive(inputs, decisions, smoother=calibrated(inputs, **TIGHT))[0]
    right.refine()
    wrong, frame = decisions.copy(), inputs.observations.frame
    swapped = np.isin(frame, (20, 21))
    wrong[swapped] = (wrong[swapped] + 1) % 8
    s = drive(inputs, wrong, smoother=calibrated(inputs, **TIGHT))[0]
    sigma = np.sqrt(np.diag(right.errors[1]))
    assert (np.abs(s.errors[0] - right.errors[0]) > 0.5 * sigma).any()
    rows = np.flatnonzero(swapped)
    s.amend(frame[rows], FrameObservations(inputs.observations.z[rows], inputs.observations.R[rows]), decisions[rows])
    s.refine()
    assert (np.abs(s.errors[0] - right.errors[0]) < 0.01 * sigma).all()
    np.testing.assert_allclose(s.estimate().mean, right.estimate().mean, atol=1e-4)
    np.testing.assert_allclose(s.errors[1], right.errors[1], atol=0.01 * sigma.min() ** 2)


def test_an_update_may_start_at_any_pose_of_the_robot():
    """In the world, not in that of the graph: at its own pose nothing changes, and from elsewhere it comes back."""
    inputs, *_ = erring(to_estimate(*ALL), POLAR_OFF, frames=20)
    decisions, _ = known_decisions(inputs)
    last = inputs.observations.frame == 19
    nis, found = [], []
    for off in (None, np.zeros(3), np.array([0.4, -0.3, 0.2])):
        s = drive(inputs, np.where(last, DISCARD, decisions), smoother=calibrated(inputs, **TIGHT))[0]
        at = None if off is None else s.estimate().mean + off
        nis.append(s.update(inputs.frame_observations(19), decisions[last], at=at, innovations=True).nis)
        s.refine()
        s.refine()
        found.append(np.concatenate([s.estimate().mean, s.errors[0]]))
    assert nis[1] == pytest.approx(nis[0], rel=1e-9)
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-6)


@pytest.mark.parametrize("task", ["slam", pytest.param("localization", marks=pytest.mark.slow)])
def test_constants_and_drift_are_those_of_batch(task):
    inputs, path, xy = erring(to_estimate(*ODOMETRY, "drift"), CARTESIAN)
    inputs = for_task(inputs, task)
    decisions, _ = known_decisions(inputs)
    s = drive(inputs, decisions, smoother=calibrated(inputs, **TIGHT))[0]
    s.refine()
    batch = batch_of(inputs, path, xy)
    assert near(s, batch) < 0.01
    np.testing.assert_allclose(np.sqrt(np.diag(s.errors[1])), batch.systematic.sigma[-1], rtol=0.01)
    finished = s.finish()
    np.testing.assert_allclose(finished.systematic.mean, batch.systematic.mean, atol=1e-5)
