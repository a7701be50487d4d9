"""Fixes and closures in the filter against dense oracles: linear least squares over all poses, and a filter that keeps
every pose.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.motion.systematic import sensor_frame
from data.pose_measurements import FixKind, FixSource
from data.result import NEW
from data.se2 import wrap_angle
from data.sensors import Line, RangeBearing, RelativePoint
from ekf.filter import FilterDivergedError, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.pose_updates import measure_closure
from ekf.slam import EkfSlam
from tests.ekf.pose_oracle import VARIANTS, Dense, closures_of, fixes_of, rotation, spd, wandering

NOWHERE = LandmarkMap(np.array([0]), np.array([[5.0, 5.0]]))
SENSOR = RelativePoint(max_range=50.0)
PRIOR = Prior(np.array([1.0, 2.0, 0.4]), np.array([[0.09, 0.02, 0.0], [0.02, 0.06, 0.01], [0.0, 0.01, 0.04]]))
EXACT_HEADING = Prior(PRIOR.mean, np.pad(PRIOR.covariance[:2, :2], (0, 1)))


def through(filter_, motions, fixes=None, closures=None, gate=None, last_use=None):
    """What the filter did with the fixes and closures of each frame."""
    done = []
    if closures is not None:
        filter_.keep(closures.last_use() if last_use is None else last_use)
    for k, motion in enumerate(motions):
        if k:
            filter_.predict(motion)
        if fixes is not None and (now := fixes.of(k)) is not None:
            done.append(filter_.fix(now, fixes.sources, gate))
        if closures is not None and (now := closures.of(k)) is not None:
            done.append(filter_.close_loops(now, gate))
    return done


class LeastSquares:
    """Linear least squares over n poses of m entries each."""

    def __init__(self, n, m):
        self.A, self.b, self.n, self.m = [], [], n, m

    def add(self, z, covariance, *terms):
        """Add z = sum of H p_k + noise for terms (k, H)."""
        row = np.zeros((len(z), self.n * self.m))
        for k, H in terms:
            row[:, self.m * k : self.m * (k + 1)] += H
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        self.A.append(W @ row)
        self.b.append(W @ z)

    def last(self):
        A, b = np.concatenate(self.A), np.concatenate(self.b)
        P = np.linalg.inv(A.T @ A)
        return (P @ A.T @ b)[-self.m :], P[-self.m :, -self.m :]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("kind", ["position", "pose", "closure"])
def test_the_last_pose_is_that_of_least_squares_where_headings_are_known(kind, variant):
    rng = np.random.default_rng(3)
    frames, turn = 12, rng.uniform(-0.5, 0.5, 12)
    turn[0] = 0.0
    heading = 0.4 + np.cumsum(turn)
    source = FixSource("antenna", (0.3, -0.2), 0.1)
    oracle, motions = LeastSquares(frames, 2), [None]
    oracle.add(PRIOR.mean[:2], PRIOR.covariance[:2, :2], (0, np.eye(2)))
    for k in range(1, frames):
        d, M, C = rng.normal(0.0, 0.7, 2), spd(rng, 2, 0.2), rotation(heading[k - 1])
        oracle.add(C @ d, C @ M @ C.T, (k - 1, -np.eye(2)), (k, np.eye(2)))
        motions.append(Increment(np.array([*d, turn[k]]), np.pad(M, (0, 1))))
    fixes, closures = [], []
    if kind == "closure":
        for a, b in [(0, 4), (5, 1), (3, 5), (2, 7), (8, 2), (0, 8), (6, 7)]:
            z, R, C = rng.normal(0.0, 1.0, 2), spd(rng, 2, 0.3), rotation(heading[a]).T
            closures.append((a, b, np.array([*z, heading[b] - heading[a]]), np.pad(R, (0, 1)) + np.diag([0, 0, 0.1])))
            oracle.add(z, R, (a, -C), (b, C))
    else:
        for k in [0, 2, 2, 5, 9]:
            z, R = rng.normal(0.0, 2.0, 2), spd(rng, 2, 0.4)
            oracle.add(z - rotation(heading[k]) @ source.lever, R, (k, np.eye(2)))
            if kind == "pose":
                z, R = np.array([*z, wrap_angle(heading[k] + 0.1)]), np.pad(R, (0, 1)) + np.diag([0, 0, 0.2])
            fixes.append((k, FixKind[kind.upper()], 0, z, R))
    filter_ = EkfLocalizer(EXACT_HEADING, SENSOR, NOWHERE, VARIANTS[variant])
    through(
        filter_, motions, fixes_of(fixes, (source,)) if fixes else None, closures_of(closures) if closures else None
    )
    mean, P = oracle.last()
    np.testing.assert_allclose(filter_.estimate().mean, [*mean, wrap_angle(heading[-1])], atol=1e-9)
    np.testing.assert_allclose(filter_.estimate().covariance, np.pad(P, (0, 1)), atol=1e-9)
    assert filter_._used == 3, "no pose is kept after its last use"


@pytest.mark.parametrize("variant", ["plain", "iterated", "fej"])
def test_the_last_heading_is_that_of_least_squares_where_the_robot_turns_on_the_spot(variant):
    """A heading moves the position of the invariant filter about the origin, which is not linear."""
    rng = np.random.default_rng(5)
    frames, prior = 10, Prior(PRIOR.mean, np.diag([0.09, 0.06, 0.04]))
    oracle, motions = LeastSquares(frames, 1), [None]
    oracle.add(PRIOR.mean[2:], np.array([[0.04]]), (0, np.eye(1)))
    for k in range(1, frames):
        turn = rng.normal(0.0, 0.2, 1)
        oracle.add(turn, np.array([[0.01]]), (k - 1, -np.eye(1)), (k, np.eye(1)))
        motions.append(Increment(np.array([0.0, 0.0, turn[0]]), np.diag([0.02, 0.02, 0.01])))
    rows = []
    for k in [1, 4, 4, 7]:
        z = rng.normal(0.4, 0.3, 1)
        oracle.add(z - 0.1, np.array([[0.03]]), (k, np.eye(1)))
        rows.append((k, FixKind.HEADING, 0, z, np.array([[0.03]])))
    filter_ = EkfLocalizer(prior, SENSOR, NOWHERE, VARIANTS[variant])
    through(filter_, motions, fixes_of(rows, (FixSource("compass", (0.0, 0.0), 0.1),)))
    mean, P = oracle.last()
    np.testing.assert_allclose(filter_.estimate().mean, [*PRIOR.mean[:2], mean[0]], atol=1e-9)
    np.testing.assert_allclose(np.diag(filter_.estimate().covariance)[[0, 2]], [0.09 + 9 * 0.02, P[0, 0]], atol=1e-9)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_filter_that_keeps_the_poses_it_needs_is_one_that_keeps_all(variant):
    rng = np.random.default_rng(8)
    motions, fixes, closures, sources = wandering(rng, 16, PRIOR)
    ours, dense = EkfLocalizer(PRIOR, SENSOR, NOWHERE, VARIANTS[variant]), Dense(PRIOR, variant)
    ordered, found = sorted(closures, key=lambda row: max(row[:2])), closures_of(closures)
    done = through(ours, motions, fixes_of(fixes, sources), found)
    for k, motion in enumerate(motions):
        if k:
            dense.predict(*motion)
        for _, kind, source, z, R in (row for row in fixes if row[0] == k):
            dense.fix(kind, sources[source], z, R)
        for a, b, z, R in (row for row in ordered if max(row[:2]) == k):
            dense.close(a, b, z, R)
    mean, P = dense.newest()
    np.testing.assert_allclose(ours.estimate().mean, mean, atol=1e-9)
    np.testing.assert_allclose(ours.estimate().covariance, P, atol=1e-9)
    assert all(each.used.all() for each in done)
    assert ours._used == 3


@pytest.mark.parametrize("variant", VARIANTS)
def test_poses_kept_to_the_end_change_nothing(variant):
    rng = np.random.default_rng(9)
    motions, fixes, closures, sources = wandering(rng, 12, PRIOR)
    measured = fixes_of(fixes, sources), closures_of(closures)
    seen = FrameObservations(np.array([[1.0, 0.5], [2.0, -0.5]]), np.tile(0.02 * np.eye(2), (2, 1, 1)))
    ends = dict.fromkeys(range(12), 99)
    ran = []
    for last_use in (None, ends):
        filter_ = EkfSlam(PRIOR, SENSOR, VARIANTS[variant])
        filter_.update(seen, np.array([NEW, NEW]))
        through(filter_, motions, *measured, last_use=last_use)
        filter_.update(seen, np.array([0, NEW]))
        assert filter_.carried == (0 if last_use is None else 33)
        ran.append((filter_.mean, filter_.covariance))
    np.testing.assert_allclose(ran[1][0], ran[0][0], atol=1e-9)
    np.testing.assert_allclose(ran[1][1], ran[0][1], atol=1e-9)
    assert np.array_equal(ran[0][1], ran[0][1].T)


@given(st.permutations(range(6)))
@settings(max_examples=20)
def test_the_order_of_independent_fixes_does_not_matter(order):
    rng = np.random.default_rng(1)
    rows = [(0, FixKind.POSITION, 0, rng.normal(0.0, 1.0, 2), spd(rng, 2, 0.4)) for _ in range(3)]
    rows += [(0, FixKind.HEADING, 0, rng.normal(0.4, 0.2, 1), spd(rng, 1, 0.3)) for _ in range(2)]
    rows += [(0, FixKind.POSE, 0, rng.normal(0.4, 0.2, 3), spd(rng, 3, 0.3))]
    estimates = []
    for each in (range(6), order):
        filter_ = EkfLocalizer(PRIOR, SENSOR, NOWHERE)
        through(filter_, [None], fixes_of([rows[i] for i in each], (FixSource("all"),)))
        estimates.append(filter_.estimate())
    np.testing.assert_allclose(estimates[0].mean, estimates[1].mean, atol=1e-12)
    np.testing.assert_allclose(estimates[0].covariance, estimates[1].covariance, atol=1e-12)


def test_a_jump_is_outside_the_gate_and_changes_nothing():
    filter_ = EkfLocalizer(PRIOR, SENSOR, NOWHERE)
    R, jump = np.diag([0.01, 0.02]), np.array([8.0, 0.0])
    rows = [(0, FixKind.POSITION, 0, PRIOR.mean[:2] + jump, R), (0, FixKind.HEADING, 0, [0.3], np.array([[0.05]]))]
    before = filter_.estimate()
    (done,) = through(filter_, [None], fixes_of(rows[:1], (FixSource("gps"),)), gate=0.9999)
    np.testing.assert_array_equal(filter_.estimate().covariance, before.covariance)
    np.testing.assert_array_equal(filter_.estimate().mean, before.mean)
    (both,) = through(filter_, [None], fixes_of(rows, (FixSource("gps"),)), gate=0.9999)
    assert (done.used.tolist(), both.used.tolist(), both.dof.tolist()) == ([False], [False, True], [2, 1])
    S = PRIOR.covariance[:2, :2] + R
    assert done.nis[0] == pytest.approx(jump @ np.linalg.solve(S, jump))
    np.testing.assert_allclose(done.white[0, :2], np.linalg.solve(np.linalg.cholesky(S), jump))
    assert np.isnan(done.white[0, 2])
    assert np.isnan(both.white[1, :2]).all()
    assert both.white[1, 2] == pytest.approx(-0.1 / np.sqrt(0.09))
    assert both.nis[1] == pytest.approx(0.01 / 0.09)


def test_a_heading_is_measured_across_the_half_turn():
    filter_ = EkfLocalizer(Prior(np.array([0.0, 0.0, 3.1]), 0.04 * np.eye(3)), SENSOR, NOWHERE)
    row = (0, FixKind.HEADING, 0, [-3.1], np.array([[0.04]]))
    through(filter_, [None], fixes_of([row], (FixSource("compass"),)))
    assert abs(wrap_angle(filter_.estimate().mean[2] - np.pi)) < 1e-9


def test_a_closure_with_a_frame_that_is_not_kept_is_not_used():
    motion = Increment(np.array([1.0, 0.0, 0.1]), 0.01 * np.eye(3))
    closures = closures_of([(0, 2, np.array([2.0, 0.1, 0.2]), 0.01 * np.eye(3))])
    plain, unknown, reset = (EkfLocalizer(PRIOR, SENSOR, NOWHERE) for _ in range(3))
    through(plain, [None, motion, motion])
    (done,) = through(unknown, [None, motion, motion], closures=closures, last_use={})
    assert not done.used.any()
    assert np.isnan(done.nis).all()
    np.testing.assert_array_equal(unknown.estimate().covariance, plain.estimate().covariance)
    reset.keep(closures.last_use())
    reset.predict(motion)
    reset.reset(PRIOR.mean, PRIOR.covariance)
    reset.predict(motion)
    assert not reset.close_loops(closures.of(2), None).used.any(), "a reset robot does not know where it was"


@pytest.mark.parametrize("first", [(0, 1), (1, 0)])
def test_a_second_odometry_halves_the_variance_of_the_motion(first):
    motion = Increment(np.array([0.0, 0.0, 0.0]), np.diag([0.04, 0.02, 0.01]))
    closures = closures_of([(*first, np.zeros(3), motion.covariance)])
    filter_ = EkfLocalizer(Prior(np.zeros(3), np.zeros((3, 3))), SENSOR, NOWHERE)
    through(filter_, [None, motion], closures=closures)
    np.testing.assert_allclose(filter_.estimate().covariance, 0.5 * motion.covariance, atol=1e-12)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("slam", [False, True])
def test_in_the_frame_of_an_erring_sensor_a_fix_is_that_of_the_pose_in_the_world(variant, slam):
    errors = Systematic(("scale", "range", "bearing"), np.array([0.05, 0.05, 0.03]))
    sensor = RangeBearing(max_range=30.0, translation=(0.2, 0.1))
    given_map = LandmarkMap(np.array([0]), np.array([[6.0, 3.0]]))
    options = VARIANTS[variant]
    filter_ = (
        EkfSlam(PRIOR, sensor, options, systematic=errors)
        if slam
        else EkfLocalizer(PRIOR, sensor, given_map, options, systematic=errors)
    )
    closures = closures_of([(0, 2, np.zeros(3), 0.01 * np.eye(3))])
    filter_.keep(closures.last_use())
    seen = FrameObservations(np.array([[5.0, -0.2]]), np.diag([0.01, 0.001])[None])
    filter_.update(seen, np.array([NEW if slam else 0]))
    for _ in range(2):
        filter_.predict(Increment(np.array([1.0, 0.0, 0.2]), 0.01 * np.eye(3)))
    before = filter_.estimate()
    R = np.diag([0.04, 0.02, 0.01])
    at_rest = fixes_of([(2, FixKind.POSE, 0, before.mean, R)], (FixSource("mocap"),))
    filter_.fix(at_rest.of(2), at_rest.sources, None)
    P = before.covariance
    if variant != "fej":  # which takes the Jacobian elsewhere
        np.testing.assert_allclose(filter_.estimate().mean, before.mean, atol=1e-9)
        np.testing.assert_allclose(filter_.estimate().covariance, P - P @ np.linalg.solve(P + R, P), atol=1e-9)
    done = filter_.close_loops(closures.of(2), None)
    assert done.used.all()
    assert np.isfinite(filter_.estimate().covariance).all()
    filter_.update(seen, np.array([0]))
    filter_.predict(Increment(np.array([1.0, 0.0, 0.2]), 0.01 * np.eye(3)))
    assert filter_.carried == 0 if slam else filter_._used == filter_.base


@pytest.mark.parametrize("forward", [False, True])
def test_the_jacobian_of_a_closure_has_the_errors_of_the_sensor(forward):
    errors = Systematic(("scale", "range", "bearing"), np.array([0.05, 0.05, 0.03]))
    frame = sensor_frame(errors, RangeBearing(max_range=30.0, translation=(0.2, 0.1)), PRIOR)
    measure = measure_closure(frame, np.zeros(3), forward=forward)
    x = np.array([3.0, 1.0, 0.7, 0.02, -0.03, 0.04, -1.0, 2.0, -0.4])
    columns = [(measure(x - h, x - h)[0] - measure(x + h, x + h)[0]) / 2e-6 for h in 1e-6 * np.eye(9)]
    np.testing.assert_allclose(measure(x, x)[1], np.stack(columns, axis=1), atol=1e-8)


def test_beside_walls_a_fix_is_that_of_the_pose_in_the_world():
    filter_ = EkfSlam(PRIOR, Line(max_range=20.0))
    filter_.update(FrameObservations(np.array([[2.0, 0.3]]), 0.01 * np.eye(2)[None]), np.array([NEW]))
    before, R = filter_.estimate(), np.diag([0.04, 0.02, 0.01])
    fixes = fixes_of([(0, FixKind.POSE, 0, before.mean, R)], (FixSource("mocap"),))
    through(filter_, [None], fixes)
    P = before.covariance
    np.testing.assert_allclose(filter_.estimate().mean, before.mean, atol=1e-12)
    np.testing.assert_allclose(filter_.estimate().covariance, P - P @ np.linalg.solve(P + R, P), atol=1e-12)


def test_fixes_update_parked_landmarks_and_kept_poses_exclude_parking():
    rng = np.random.default_rng(2)
    seen = FrameObservations(rng.normal(0.0, 3.0, (6, 2)), np.tile(0.02 * np.eye(2), (6, 1, 1)))
    rows = [(0, FixKind.POSITION, 0, PRIOR.mean[:2] + 0.2, 0.05 * np.eye(2))]
    maps = []
    for parked in (np.empty(0, np.int64), np.array([0, 1, 2, 3])):
        filter_ = EkfSlam(PRIOR, SENSOR)
        filter_.update(seen, np.full(6, NEW))
        filter_.park(parked)
        through(filter_, [None], fixes_of(rows, (FixSource("gps", (0.1, 0.4)),)))
        maps.append(filter_.landmarks())
    np.testing.assert_allclose(maps[1].xy, maps[0].xy, atol=1e-12)
    np.testing.assert_allclose(maps[1].covariance, maps[0].covariance, atol=1e-12)
    filter_.keep({0: 3})
    with pytest.raises(ValueError, match="poses of earlier frames"):
        filter_.park(np.array([4]))


def test_a_covariance_that_is_none_stops_the_filter():
    row = (0, FixKind.POSITION, 0, np.zeros(2), -np.eye(2))
    with pytest.raises(FilterDivergedError, match="positive definite"):
        through(EkfLocalizer(PRIOR, SENSOR, NOWHERE), [None], fixes_of([row], (FixSource("gps"),)))


def test_variants_are_those_of_the_estimators():
    from eval.replay.estimators import OPTIONS

    assert [FilterOptions.rule(o) for o in VARIANTS.values()] == [FilterOptions.rule(o) for o in OPTIONS.values()]
