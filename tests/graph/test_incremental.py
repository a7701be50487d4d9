"""iSAM2 with the filters' verbs: it agrees with batch and, where all is linear or noise-free, with the EKF."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from association.candidates import Drift, in_view, may_be_in_view
from association.known import known_decisions
from data import se2
from data.errors import DataError
from data.inputs import Increment, Increments, LabelledObservations, Prior, Sightings
from data.result import DISCARD, NEW
from data.sensors import RangeBearing, RelativePoint
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from ekf.whole_run import run_filter
from graph import expected
from graph.batch import Start, build, smooth
from graph.engine import Engine
from graph.factors import UnderConstrained, between_factors
from graph.incremental import Isam2Smoother
from tests.graph.test_marginals import solved
from tests.graph.worlds import SENSORS, circle, order_of_creation, truncated

every_sensor = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
both_tasks = pytest.mark.parametrize("task", ["localization", "slam"])
TIGHT = {"threshold": 1e-7, "skip": 1}


def for_task(inputs, task):
    return inputs if task == "localization" else inputs.without_map()


def drive(inputs, decisions, *, gate=np.inf, until=None, smoother=None, **options):
    """The smoother after frames [0, until), with its poses and covariances and what the updates said."""
    s = smoother or Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, **options)
    poses, covariances, done = [], [], []
    for k in range(len(inputs) if until is None else until):
        if k:
            s.predict(inputs.increment(k))
        s.stamp(inputs.time[k])
        rows = slice(inputs.start[k], inputs.start[k + 1])
        if rows.stop > rows.start:
            done.append(s.update(inputs.sightings(k), decisions[rows], threshold=gate))
        pose, covariance = s.estimate()
        poses.append(pose)
        covariances.append(covariance)
    return s, np.array(poses), np.array(covariances), done


@every_sensor
@both_tasks
@pytest.mark.parametrize("P0", [None, np.zeros((3, 3)), 0.01 * np.ones((3, 3))], ids=["P0", "zero", "rank one"])
def test_noise_free_input_returns_the_truth_with_the_filters_covariance(sensor, task, P0):
    inputs, truth, xy = circle(sensor, noise=0.0, P0=P0, frames=40)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    s, poses, covariances, _ = drive(inputs, decisions, **TIGHT)
    finished = s.finish()
    run = run_filter(inputs, decisions)
    assert np.abs(se2.pose_error(poses, truth)).max() < 1e-6
    assert np.abs(se2.pose_error(finished.final.pose, truth)).max() < 1e-6
    # a singular prior stands in iSAM2 with sigma 1e-6 in its exact directions, in `finish` as it is
    np.testing.assert_allclose(covariances, run.covariance, atol=1e-8)
    np.testing.assert_allclose(finished.final.covariance[-1], run.covariance[-1], atol=1e-9)
    if task == "slam":
        ids = order_of_creation(inputs, decisions, created)
        np.testing.assert_allclose(finished.map.xy, xy[ids], atol=1e-6)
        np.testing.assert_allclose(finished.map.covariance, run.map.covariance, atol=1e-8)
    else:
        assert finished.map is None


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


@every_sensor
@both_tasks
@pytest.mark.parametrize("loss", ["gaussian", "huber"])
def test_finish_returns_the_batch_solution(sensor, task, loss):
    inputs, _, _ = circle(sensor)
    inputs = for_task(inputs, task)
    batch, (decisions, _) = solved(inputs, loss)
    finished = drive(inputs, decisions, loss=loss)[0].finish()
    np.testing.assert_allclose(finished.final.pose, batch.trajectory.pose, atol=1e-5)
    np.testing.assert_allclose(finished.final.covariance, batch.trajectory.covariance, atol=1e-6)
    if task == "slam":
        np.testing.assert_allclose(finished.map.xy, batch.map.xy, atol=1e-5)


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


def test_a_run_without_any_sighting_is_dead_reckoning():
    inputs, _, _ = circle(SENSORS["relative point"])
    nothing = np.full(len(inputs.observations.frame), DISCARD)
    run = run_filter(inputs, nothing)
    for task in ("localization", "slam"):
        s, poses, covariances, _ = drive(for_task(inputs, task), nothing)
        np.testing.assert_allclose(poses, run.pose, atol=1e-12)
        np.testing.assert_allclose(covariances, run.covariance, atol=1e-12)
        np.testing.assert_allclose(s.finish().final.pose, run.pose, atol=1e-9)


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
    # numbers are never used again
    s.predict(extra)
    assert (
        s.update(Sightings(*inputs.sightings(0)), np.full(len(inputs.sightings(0).z), NEW)).created.min()
        > created.max()
    )


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
        f.lose(more)
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-6)
    assert s.estimate().covariance[0, 0] > 25.0
    for f in (s, twin):
        f.update(inputs.sightings(20), decisions[rows])
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-4)
    assert s.estimate().covariance[0, 0] < 1.0
    with pytest.raises(ValueError, match="no motion"):
        s.lose(more)


def parted(inputs, decisions, created, landmark, later):
    """Decisions under which a landmark is founded again at its first sighting after frame `later`, with that number."""
    o, number = inputs.observations, np.where(created >= 0, created, decisions)
    again = np.flatnonzero((number == landmark) & (o.frame > later))
    apart = decisions.copy()
    apart[again[0]] = NEW
    apart[again[1:]] = created.max() + 1
    return apart, int(created.max() + 1)


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
    s.join(np.array([number]), np.array([2]))
    assert s.numbers.tolist() == other.numbers.tolist()
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, atol=5e-6)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, atol=1e-6)
    one, two = s.finish(), other.finish()
    np.testing.assert_allclose(one.final.pose, two.final.pose, atol=1e-6)
    np.testing.assert_allclose(one.map.xy, two.map.xy, atol=1e-6)
    assert one.total_nis[1] == two.total_nis[1]
    for senseless in ((number, 2), (2, 2), (2, 99)):
        with pytest.raises(ValueError, match="cannot join"):
            s.join(np.array(senseless[:1]), np.array(senseless[1:]))
    localizer = Isam2Smoother(inputs.prior, inputs.sensor, circle(sensor)[0].map)
    with pytest.raises(ValueError, match="known map"):
        localizer.join(np.array([1]), np.array([0]))


@every_sensor
@both_tasks
def test_it_expects_what_the_filter_expects(sensor, task):
    """Noise-free, so that both linearize at the truth; two frames after the last update."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = for_task(inputs, task)
    decisions, _ = known_decisions(inputs)
    twin = (
        EkfLocalizer(inputs.prior, inputs.sensor, inputs.map)
        if task == "localization"
        else EkfSlam(inputs.prior, inputs.sensor)
    )
    s, *_ = drive(inputs, decisions, until=20, **TIGHT)
    drive(inputs, decisions, until=20, smoother=twin)
    for k in (20, 21):
        s.predict(inputs.increment(k))
        twin.predict(inputs.increment(k))
    ours, filters = s.expect(inputs.sightings(21)), twin.expect(inputs.sightings(21))
    assert 0 < len(ours.number) < len(filters.number)
    rows = np.searchsorted(filters.number, ours.number)
    np.testing.assert_array_equal(filters.number[rows], ours.number)
    np.testing.assert_allclose(ours.z_hat, filters.z_hat[rows], atol=1e-6)
    np.testing.assert_allclose(ours.HPHt, filters.HPHt[rows], atol=1e-8)
    pick = np.array([2, 0, 1])
    np.testing.assert_allclose(ours.joint(pick), filters.joint(rows[pick]), atol=1e-8)
    np.testing.assert_array_equal(ours.frame, 0)
    assert (ours.z == inputs.sightings(21).z).all()


def test_candidates_are_cut_by_the_field_of_view_and_three_sigma_and_five_degrees():
    sensor = RangeBearing(max_range=5.0, min_angle=-0.5, max_angle=0.5)
    z_hat = np.array([[5.2, 0.0], [5.4, 0.0], [3.0, 0.7], [3.0, 0.9], [3.0, -0.58], [3.0, 3.1]])
    loose = np.tile(np.diag([0.1**2, 0.1**2]), (6, 1, 1))
    assert in_view(sensor, z_hat, loose).tolist() == [True, False, True, False, True, False]
    assert in_view(sensor, z_hat, 0.0 * loose).tolist() == [False, False, False, False, True, False]
    cartesian = RelativePoint(max_range=5.0, min_angle=-0.5, max_angle=0.5)
    at = np.stack([z_hat[:, 0] * np.cos(z_hat[:, 1]), z_hat[:, 0] * np.sin(z_hat[:, 1])], 1)
    turn = np.stack([[np.cos(a), -np.sin(a), np.sin(a), np.cos(a)] for a in z_hat[:, 1]]).reshape(-1, 2, 2)
    polar = turn @ np.stack([np.diag([0.1**2, (0.1 * r) ** 2]) for r in z_hat[:, 0]]) @ turn.transpose(0, 2, 1)
    assert in_view(cartesian, at, polar).tolist() == [True, False, True, False, True, False]


@every_sensor
def test_the_quick_cut_keeps_everything_the_exact_one_keeps(sensor):
    """Against the filter's covariance over all landmarks, with a narrow view and a lot of uncertainty."""
    narrow = replace(sensor, max_range=4.0, min_angle=-0.6, max_angle=0.9)
    inputs, _, _ = circle(sensor, noise=0.0, landmarks=25)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    drift, kept = Drift(), 0
    for k in range(20):
        drive(inputs, decisions, until=k, smoother=(twin := EkfSlam(inputs.prior, inputs.sensor)))
        n = (twin.size - 3) // 2
        xy, P = twin.mean[3:].reshape(n, 2), twin.covariance
        if k:
            drift.move(inputs.increment(k))
        everything = expected.form(narrow, twin.mean[:3], P, np.arange(n), xy, inputs.sightings(k))
        exact = in_view(narrow, everything.z_hat, everything.HPHt)
        rows = slice(inputs.start[k], inputs.start[k + 1])
        number = np.where(created[rows] >= 0, created[rows], decisions[rows])
        drift.see(sensor, inputs.sightings(k), number, P[:3, :3])
        quick = may_be_in_view(narrow, twin.mean[:3], xy, *drift.sigmas(np.arange(n), P[:3, :3]))
        assert not (exact & ~quick).any()
        kept += quick.sum() < n
    assert kept > 10  # and it does cut


@every_sensor
def test_the_bounds_on_relative_uncertainty_are_bounds_and_stay_small_far_from_the_start(sensor):
    """Against the filter's joint covariance: position of each landmark in the robot's frame."""
    inputs, _, _ = circle(sensor, noise=0.0, landmarks=25)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    drift, twin = Drift(), EkfSlam(inputs.prior, inputs.sensor)
    for k in range(len(inputs)):
        if k:
            drift.move(inputs.increment(k))
            twin.predict(inputs.increment(k))
        rows = slice(inputs.start[k], inputs.start[k + 1])
        twin.update(inputs.sightings(k), decisions[rows])
        number = np.where(created[rows] >= 0, created[rows], decisions[rows])
        drift.see(sensor, inputs.sightings(k), number, twin.estimate().covariance)
        n = (twin.size - 3) // 2
        c, s = np.cos(twin.mean[2]), np.sin(twin.mean[2])
        C = np.array([[c, s], [-s, c]])
        bound, _ = drift.sigmas(np.arange(n), twin.estimate().covariance)
        for i, at in enumerate(twin.mean[3:].reshape(n, 2)):
            d = at - twin.mean[:2]
            H = np.zeros((2, twin.size))
            H[:, :2], H[:, 2], H[:, 3 + 2 * i : 5 + 2 * i] = -C, C @ (d[1], -d[0]), C
            assert np.sqrt(np.trace(H @ twin.covariance @ H.T)) <= bound[i] * (1.0 + 1e-9)


@every_sensor
@both_tasks
def test_the_gate_and_its_statistics_are_the_filters(sensor, task):
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = for_task(inputs, task)
    o = inputs.observations
    decisions, created = known_decisions(inputs)
    z = o.z.copy()
    # in the last frame only, so that all that went before is noise-free: one outlier, two small errors
    last = np.flatnonzero((o.frame == o.frame[-1]) & (created < 0))
    z[last[:3]] += [[1.5, 0.4], [0.05, -0.03], [-0.02, 0.04]]
    inputs = replace(inputs, observations=LabelledObservations(o.frame, z, o.R, o.label))
    twin = (
        EkfLocalizer(inputs.prior, inputs.sensor, inputs.map)
        if task == "localization"
        else EkfSlam(inputs.prior, inputs.sensor)
    )
    ours = drive(inputs, decisions, gate=11.0, until=int(o.frame[-1]) + 1, **TIGHT)[3]
    filters = drive(inputs, decisions, gate=11.0, until=int(o.frame[-1]) + 1, smoother=twin)[3]
    for a, b in zip(ours, filters, strict=True):
        np.testing.assert_array_equal(a.used, b.used)
        np.testing.assert_array_equal(a.created, b.created)
        assert a.dof == b.dof
        if b.dof:
            assert a.nis == pytest.approx(b.nis, abs=1e-5)
            assert a.log_likelihood == pytest.approx(b.log_likelihood, abs=1e-5)
    assert not ours[-1].used[0]
    assert ours[-1].nis > 1e-3
    ungated = drive(inputs, decisions)[3][-1]
    assert ungated.dof == 0
    assert np.isnan(ungated.nis)
    assert np.isnan(ungated.log_likelihood)


def resting(sensor):
    """Noise-free SLAM of a robot that hardly moves: increments are known to 1e-5 m, which Cholesky does not survive."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = inputs.without_map()
    covariance = np.tile(1e-10 * np.eye(3), (len(inputs), 1, 1))
    covariance[::2] += np.outer([0.02, 0.0, 0.03], [0.02, 0.0, 0.03])
    covariance[0] = 0.0
    return replace(inputs, increments=Increments(inputs.increments.mean, covariance))


@pytest.mark.parametrize("sensor", [SENSORS["range-bearing"], SENSORS["relative point"]], ids=["polar", "cartesian"])
def test_increments_known_to_the_floor_are_eliminated_by_qr(sensor):
    inputs = resting(sensor)
    decisions, _ = known_decisions(inputs)
    s, poses, covariances, _ = drive(inputs, decisions, **TIGHT)
    run = run_filter(inputs, decisions)
    assert s._engine.qr
    np.testing.assert_allclose(poses, run.pose, atol=1e-6)
    np.testing.assert_allclose(covariances, run.covariance, rtol=1e-3, atol=1e-9)


def test_cholesky_that_breaks_down_is_replaced_by_qr_without_a_trace(monkeypatch):
    import graph.incremental as module

    monkeypatch.setattr(module, "DELICATE", 0.0)  # so that nothing warns beforehand
    inputs = resting(SENSORS["range-bearing"])
    covariance = inputs.increments.covariance.copy()
    covariance[1:30] = np.diag([0.02, 0.02, 0.02]) ** 2  # ... and it starts well
    inputs = replace(inputs, increments=Increments(inputs.increments.mean, covariance))
    decisions, _ = known_decisions(inputs)
    assert not drive(inputs, decisions, until=30, **TIGHT)[0]._engine.qr
    s, poses, *_ = drive(inputs, decisions, **TIGHT)
    assert s._engine.qr
    np.testing.assert_allclose(poses, run_filter(inputs, decisions).pose, atol=1e-6)
    # handles on factors outlived the change
    s.remove(np.array([0, 2]))
    assert len(s.finish().map.number) == decisions.max() - 1


def test_bare_gtsam_breaks_down_where_the_recovery_is_needed():
    inputs = resting(SENSORS["range-bearing"])
    decisions, created = known_decisions(inputs)
    run = run_filter(inputs, decisions)
    problem = build(inputs, decisions, created)
    values = problem.values(run.pose, dict(enumerate(run.map.xy)))
    with pytest.raises(RuntimeError, match="Indeterminate"):
        gtsam.ISAM2().update(problem.graph(), values)


def test_a_landmark_founded_at_range_zero_is_named():
    inputs, _, _ = circle(RangeBearing())
    s = Isam2Smoother(inputs.prior, inputs.sensor)
    R = np.tile(0.01 * np.eye(2), (2, 1, 1))
    seen = Sightings(np.array([[2.0, 0.3], [0.0, 0.1]]), R)
    with pytest.raises(UnderConstrained, match="landmark 1 is not determined"):
        s.update(seen, np.array([NEW, NEW]))


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
    seen = inputs.sightings(0)
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


@pytest.mark.parametrize("variance", [(0.0, 0.0, 0.0), (1e-4, 1e-4, 0.0), (0.0, 0.0, 1e-4), (0.01, 0.02, 0.001)])
@every_sensor
def test_the_first_expectations_are_the_filters_whatever_the_prior(sensor, variance):
    """While the first pose is the only one in the graph: an exact prior is a hard constraint there."""
    inputs, _, _ = circle(sensor, noise=0.0, landmarks=25)
    inputs = replace(inputs.without_map(), prior=Prior(inputs.prior.mean, np.diag(variance)))
    decisions, _ = known_decisions(inputs)
    ours, twin = Isam2Smoother(inputs.prior, inputs.sensor), EkfSlam(inputs.prior, inputs.sensor)
    for k in range(3):
        rows = slice(inputs.start[k], inputs.start[k + 1])
        sightings = inputs.sightings(k)
        if k:
            a, b = (e.predict(inputs.increment(k)) or e.expect(sightings).by_age() for e in (ours, twin))
            both = np.intersect1d(a.number, b.number)
            assert len(both) > 2
            A, B = (e.joint(np.searchsorted(e.number, both)) for e in (a, b))
            np.testing.assert_allclose(A, B, atol=1e-4 * np.abs(B).max())
        for e in (ours, twin):
            e.update(sightings, decisions[rows])


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
    detour.predict(inputs.increment(30))  # the newest frame may be without a sighting yet
    straight.predict(inputs.increment(30))
    whole = np.flatnonzero(np.isin(o.frame, o.frame[amended]) & (o.frame < 30))
    detour.amend(o.frame[whole], Sightings(o.z[whole], o.R[whole]), right[whole])
    detour.refine(10)
    straight.refine(10)
    for a, b in zip(detour.estimate(), straight.estimate(), strict=True):
        assert np.allclose(a, b, atol=1e-7)
    for s in (detour, straight):
        for k in range(30, 40):
            if k > 30:
                s.predict(inputs.increment(k))
            s.update(inputs.sightings(k), right[inputs.start[k] : inputs.start[k + 1]])
    ended, expected_end = detour.finish(), straight.finish()
    assert np.allclose(ended.final.pose, expected_end.final.pose, atol=1e-6)
    assert np.allclose(ended.final.covariance, expected_end.final.covariance, rtol=1e-3, atol=1e-8)
    assert ended.total_nis[1] == expected_end.total_nis[1]


def test_a_pairing_can_be_taken_back_without_another_one():
    inputs, _, _ = circle(SENSORS["range-bearing"], frames=12)
    decisions, _ = known_decisions(inputs)
    fewer = np.where(inputs.observations.frame == 4, DISCARD, decisions)
    s, *_ = drive(inputs, decisions, **TIGHT)
    other, *_ = drive(inputs, fewer, **TIGHT)
    rows = slice(inputs.start[4], inputs.start[5])
    s.amend(np.full(rows.stop - rows.start, 4), inputs.sightings(4), fewer[rows])
    assert np.allclose(s.finish().final.pose, other.finish().final.pose, atol=1e-6)
