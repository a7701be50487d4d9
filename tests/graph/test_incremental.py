"""iSAM2 with the filters' verbs: it agrees with batch and, where all is linear or noise-free, with the EKF."""

import gtsam
import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.errors import DataError
from data.inputs import FrameObservations, Increment
from data.result import DISCARD, NEW
from data.sensors import RangeBearing
from ekf.slam import EkfSlam
from ekf.whole_run import run_filter
from graph.batch import smooth
from graph.engine import Engine
from graph.factors import UnderConstrained, between_factors
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.graph.worlds import (
    SENSORS,
    TIGHT,
    both_tasks,
    circle,
    drive,
    every_sensor,
    for_task,
    lagged,
    parted,
    resting,
    solved,
    truncated,
)


@every_sensor
@both_tasks
def test_the_newest_pose_is_that_of_batch_over_the_same_data(sensor, task):
    """To 1e-6 with a threshold of 1e-6 and a few more updates; as it is, to a share of a sigma."""
    whole, _, _ = circle(sensor)
    whole = for_task(whole, task)
    decisions, _ = known_decisions(whole)
    loose = drive(whole, decisions)
    for frames in (9, 22, 41, len(whole)):
        batch, _ = solved(truncated(whole, frames))
        pose, covariance = batch.trajectory.pose[-1], batch.trajectory.covariance[-1]
        assert (np.abs(se2.pose_error(loose[1][frames - 1], pose)) < 0.1 * np.sqrt(np.diag(covariance))).all()
        tight, *_ = drive(whole, decisions, until=frames, threshold=1e-6, skip=1)
        tight.refine(6)
        ours = tight.estimate()
        np.testing.assert_allclose(se2.pose_error(ours.mean, pose), 0.0, atol=1e-6)
        np.testing.assert_allclose(ours.covariance, covariance, atol=1e-5 * np.abs(covariance).max())


@both_tasks
def test_frames_without_sightings_are_composed_at_once_and_join_the_graph_later(task):
    inputs, _, _ = circle(SENSORS["range-bearing"])
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    o = inputs.observations
    blind = np.isin(o.frame % 10, (0, 4, 5, 6, 7)) & (created < 0)
    decisions[blind] = DISCARD
    seeing = sorted(set(o.frame[decisions != DISCARD].tolist()))
    s, poses, covariances, _ = drive(inputs, decisions)
    for k in set(range(1, len(inputs))) - set(seeing):
        move, F = inputs.increment(k), np.eye(3)
        moved = se2.compose(poses[k - 1], move.mean)
        F[:2, 2] = [-(moved - poses[k - 1])[1], (moved - poses[k - 1])[0]]
        B = se2.world_from_body(poses[k - 1, 2])
        np.testing.assert_allclose(poses[k], moved, atol=1e-12)
        np.testing.assert_allclose(covariances[k], F @ covariances[k - 1] @ F.T + B @ move.covariance @ B.T, atol=1e-12)
    run = run_filter(inputs, decisions)
    landmark = np.empty((0, 2)) if run.map is None else run.map.xy
    batch = smooth(inputs, decisions, created, Start(run.pose, landmark))
    final = s.finish().final
    assert len(final.pose) == len(inputs)
    np.testing.assert_allclose(final.pose, batch.trajectory.pose, atol=1e-5)


@pytest.mark.parametrize("sensor", [SENSORS["range-bearing"], SENSORS["relative point"]], ids=["polar", "cartesian"])
@pytest.mark.parametrize("lag", [None, 6.0], ids=["isam2", "fixed lag"])
def test_increments_known_to_the_floor_are_eliminated_by_qr(sensor, lag):
    inputs = resting(sensor)
    decisions, _ = known_decisions(inputs)
    s, poses, covariances, _ = drive(
        inputs, decisions, smoother=None if lag is None else lagged(inputs, lag, **TIGHT), **TIGHT
    )
    run = run_filter(inputs, decisions)
    assert s._engine.qr
    np.testing.assert_allclose(poses, run.pose, atol=1e-6)
    np.testing.assert_allclose(covariances, run.covariance, rtol=2e-3, atol=1e-9)


def test_a_landmark_initialized_at_range_zero_is_at_the_robot_as_well_as_its_range_is_known():
    """It is a point: its bearing, which has no derivative there, tells only how far across it may be."""
    inputs, _, _ = circle(RangeBearing(), P0=np.zeros((3, 3)))
    s = Isam2Smoother(inputs.prior, inputs.sensor)
    R = np.tile(np.diag([0.01, 0.0004]), (2, 1, 1))
    done = s.update(FrameObservations(np.array([[2.0, 0.3], [0.0, 0.1]]), R), np.array([NEW, NEW]))
    assert done.created.tolist() == [0, 1]
    found = s.finish().map
    np.testing.assert_allclose(found.xy[1], inputs.prior.mean[:2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.eigvalsh(found.covariance[1]), [0.01 * 0.0004, 0.01], rtol=1e-4)


@pytest.mark.parametrize("qr", [False, True], ids=["Cholesky", "QR"])
def test_what_the_data_leave_free_is_named(qr):
    values = gtsam.Values()
    for k in range(2):
        values.insert(gtsam.symbol("x", k), gtsam.Pose2(k, 0.0, 0.0))
    step, _ = between_factors(1, np.array([[1.0, 0.0, 0.0]]), np.eye(3)[None])
    with pytest.raises(UnderConstrained, match=r"pose of frame \d is not determined"):
        Engine(0.1, 1, qr=qr).add(step, values)


def test_senseless_requests_are_refused():
    inputs, _, _ = circle(SENSORS["range-bearing"])
    seen = inputs.frame_observations(0)
    s = Isam2Smoother(inputs.prior, inputs.sensor)
    with pytest.raises(ValueError, match="no landmark has number 3"):
        s.update(seen, np.full(len(seen.z), 3))
    known = Isam2Smoother(inputs.prior, inputs.sensor, inputs.map)
    with pytest.raises(ValueError, match="no landmark has number 99"):
        known.update(seen, np.full(len(seen.z), 99))
    with pytest.raises(ValueError, match="known map"):
        known.remove(np.array([0]))
    s.predict(Increment(np.zeros(3), np.zeros((3, 3))))
    with pytest.raises(DataError, match="increment into frame 1: its covariance is singular"):
        s.update(seen, np.full(len(seen.z), NEW))


@every_sensor
def test_removing_a_landmark_leaves_what_there_would_be_without_its_sightings(sensor):
    inputs, _, _ = circle(sensor)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    gone = np.array([1, 4])
    s, *_ = drive(inputs, decisions, **TIGHT)
    # past the last update, so that motion is pending when the landmarks go
    extra = Increment(np.array([0.3, 0.0, 0.1]), inputs.increment(1).covariance)
    s.predict(extra)
    s.remove(gone)
    without = decisions.copy()
    number = np.where(created >= 0, created, decisions)
    without[np.isin(number, gone)] = DISCARD
    renumbered = np.cumsum(~np.isin(np.arange(created.max() + 1), gone)) - 1
    without[without >= 0] = renumbered[without[without >= 0]]
    other, *_ = drive(inputs, without, **TIGHT)
    other.predict(extra)
    assert s.numbers.tolist() == [n for n in range(created.max() + 1) if n not in gone]
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, atol=5e-6)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, atol=1e-6)
    one, two = s.finish(), other.finish()
    np.testing.assert_allclose(one.final.pose, two.final.pose, atol=1e-6)
    np.testing.assert_allclose(one.map.xy, two.map.xy, atol=1e-6)
    assert set(one.map.number).isdisjoint(gone)
    with pytest.raises(ValueError, match="not all are in the map"):
        s.remove(gone)
    s.predict(extra)  # numbers are never used again
    first = FrameObservations(*inputs.frame_observations(0))
    assert s.update(first, np.full(len(first.z), NEW)).created.min() > created.max()


@every_sensor
def test_a_motion_that_is_not_believed_is_as_uncertain_as_said(sensor):
    """The filter's prediction with that much more, and what is seen afterwards decides."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = inputs.without_map()
    decisions, _ = known_decisions(inputs)
    more = np.diag([25.0, 25.0, 1.0])
    twin = EkfSlam(inputs.prior, inputs.sensor)
    s, *_ = drive(inputs, decisions, until=20, **TIGHT)
    drive(inputs, decisions, until=20, smoother=twin)
    rows = slice(int(inputs.start[20]), int(inputs.start[21]))
    for f in (s, twin):
        f.predict(inputs.increment(20))
        f.inflate(more)
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-6)
    assert s.estimate().covariance[0, 0] > 25.0
    for f in (s, twin):
        f.update(inputs.frame_observations(20), decisions[rows])
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-4)
    assert s.estimate().covariance[0, 0] < 1.0
    with pytest.raises(ValueError, match="no motion"):
        s.inflate(more)


@every_sensor
def test_joining_landmarks_is_having_known_that_they_are_one(sensor):
    inputs, _, _ = circle(sensor)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    late = int(inputs.observations.frame[created >= 0].max())
    apart, number = parted(inputs, decisions, created, 2, late + 5)
    s, *_ = drive(inputs, apart, **TIGHT)
    assert number in s.numbers
    other, *_ = drive(inputs, decisions, **TIGHT)
    assert np.abs(s.estimate().mean - other.estimate().mean).max() > 1e-4
    s.merge(np.array([number]), np.array([2]))
    assert s.numbers.tolist() == other.numbers.tolist()
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, atol=5e-6)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, atol=1e-6)
    one, two = s.finish(), other.finish()
    np.testing.assert_allclose(one.final.pose, two.final.pose, atol=1e-6)
    np.testing.assert_allclose(one.map.xy, two.map.xy, atol=1e-6)
    assert one.total_nis[1] == two.total_nis[1]
    for senseless in ((number, 2), (2, 2), (2, 99)):
        with pytest.raises(ValueError, match="cannot merge"):
            s.merge(np.array(senseless[:1]), np.array(senseless[1:]))
    localizer = Isam2Smoother(inputs.prior, inputs.sensor, circle(sensor)[0].map)
    with pytest.raises(ValueError, match="known map"):
        localizer.merge(np.array([1]), np.array([0]))


@every_sensor
def test_amended_pairings_leave_no_trace_of_what_they_replace(sensor):
    inputs, _, _ = circle(sensor, frames=40, landmarks=6)
    right, _ = known_decisions(inputs)
    o, rng = inputs.observations, np.random.default_rng(0)
    amended = np.flatnonzero((o.frame > 5) & (rng.random(len(right)) < 0.3))
    wrong = right.copy()
    wrong[amended] = np.where(rng.random(len(amended)) < 0.5, DISCARD, (right[amended] + 1) % 6)
    straight, *_ = drive(inputs, right, until=30, **TIGHT)
    detour, *_ = drive(inputs, wrong, until=30, **TIGHT)
    detour.predict(inputs.increment(30))  # the newest frame may be without an observation yet
    straight.predict(inputs.increment(30))
    whole = np.flatnonzero(np.isin(o.frame, o.frame[amended]) & (o.frame < 30))
    detour.amend(o.frame[whole], FrameObservations(o.z[whole], o.R[whole]), right[whole])
    detour.refine(10)
    straight.refine(10)
    for a, b in zip(detour.estimate(), straight.estimate(), strict=True):
        assert np.allclose(a, b, atol=1e-7)
    for s in (detour, straight):
        for k in range(30, 40):
            if k > 30:
                s.predict(inputs.increment(k))
            s.update(inputs.frame_observations(k), right[inputs.start[k] : inputs.start[k + 1]])
    ended, expected_end = detour.finish(), straight.finish()
    assert np.allclose(ended.final.pose, expected_end.final.pose, atol=1e-6)
    assert np.allclose(ended.final.covariance, expected_end.final.covariance, rtol=1e-3, atol=1e-8)
    assert ended.total_nis[1] == expected_end.total_nis[1]
