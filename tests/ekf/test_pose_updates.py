"""Fixes and closures in the filter: dense oracles, and NEES and NIS over many seeded logs of several sensors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.motion.systematic import sensor_frame
from data.pose_measurements import FixKind, FixSource, closure_of
from data.result import NEW
from data.se2 import pose_error, wrap_angle
from data.sensors import Line, RangeBearing, RelativePoint
from data.worlds.mixed import Mixed, simulate
from ekf.filter import FilterDivergedError
from ekf.localizer import EkfLocalizer
from ekf.pose_updates import model_of
from ekf.slam import EkfSlam
from eval.replay.estimators import OPTIONS
from eval.replay.run import step_by_step
from tests.ekf.pose_oracle import VARIANTS, Dense, closures_of, fixes_of, wandering
from tests.quick import slow

NOWHERE = LandmarkMap(np.array([0]), np.array([[5.0, 5.0]]))
SENSOR = RelativePoint(max_range=50.0)
PRIOR = Prior(np.array([1.0, 2.0, 0.4]), np.array([[0.09, 0.02, 0.0], [0.02, 0.06, 0.01], [0.0, 0.01, 0.04]]))


def through(filter_, motions, fixes=None, closures=None, gate=None, last_use=None):
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


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_filter_that_keeps_the_poses_it_needs_is_one_that_keeps_all(variant):
    motions, fixes, closures, sources = wandering(np.random.default_rng(8), 16, PRIOR)
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
    assert filter_.close_loops(closures.of(2), None).used.all()
    assert np.isfinite(filter_.estimate().covariance).all()
    filter_.update(seen, np.array([0]))
    filter_.predict(Increment(np.array([1.0, 0.0, 0.2]), 0.01 * np.eye(3)))
    assert filter_.carried == 0 if slam else filter_._used == filter_.base


@pytest.mark.parametrize("forward", [False, True])
def test_the_jacobian_of_a_closure_has_the_errors_of_the_sensor(forward):
    errors = Systematic(("scale", "range", "bearing"), np.array([0.05, 0.05, 0.03]))
    frame = sensor_frame(errors, RangeBearing(max_range=30.0, translation=(0.2, 0.1)), PRIOR)
    ends = (3, 0) if forward else (0, 3)
    measure = model_of(frame, closure_of(np.zeros(3), np.eye(3), *ends, 6), 0).measure
    x = np.array([3.0, 1.0, 0.7, 0.02, -0.03, 0.04, -1.0, 2.0, -0.4])
    columns = [(measure(x - h, x - h)[0] - measure(x + h, x + h)[0]) / 2e-6 for h in 1e-6 * np.eye(9)]
    np.testing.assert_allclose(measure(x, x)[1], np.stack(columns, axis=1), atol=1e-8)


def test_beside_walls_a_fix_is_that_of_the_pose_in_the_world():
    filter_ = EkfSlam(PRIOR, Line(max_range=20.0))
    filter_.update(FrameObservations(np.array([[2.0, 0.3]]), 0.01 * np.eye(2)[None]), np.array([NEW]))
    before, R = filter_.estimate(), np.diag([0.04, 0.02, 0.01])
    through(filter_, [None], fixes_of([(0, FixKind.POSE, 0, before.mean, R)], (FixSource("mocap"),)))
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


WORLD = Mixed(frames=120, closure_gap=5.0, closure_period=1.0)
WORLDS = {
    "closures alone": replace(WORLD, gps_period=0.0, compass_period=0.0),
    "fixes alone": replace(WORLD, closure_period=0.0),
    "both": WORLD,
}


def squares(name, world, seeds, task="slam", *, blind):
    """NEES of the pose (n, N), and the NIS over its degrees of freedom of all fixes and closures."""
    nees, nis, dof = [], 0.0, 0
    for seed in seeds:
        log = simulate(world, seed)
        inputs = log.inputs(labels=True)
        if blind:
            inputs = replace(inputs, observations=inputs.observations.only(slice(0)))
        run = step_by_step(name, inputs if task == "localization" else inputs.without_map(), task)
        assert run.failure is None
        e, P = pose_error(run.online.pose, log.truth.pose), run.online.covariance
        nees.append(np.einsum("ni,ni->n", e[1:], np.linalg.solve(P[1:], e[1:, :, None])[..., 0]))
        for done in (run.fixes, run.closures):
            if done is not None:
                nis, dof = nis + float(done.nis[done.used].sum()), dof + int(done.dof[done.used].sum())
    return np.array(nees), nis, dof


def consistent(nees, nis, dof):
    """Nearly all frames in the 95 % interval of the mean over runs, and the NIS in its own of 99.99 %."""
    n = len(nees)
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    mean = nees.mean(axis=0)
    assert ((mean > low) & (mean < high)).mean() > 0.85
    assert abs(nis / dof - 1.0) < 4.0 * np.sqrt(2.0 / dof)


@pytest.mark.parametrize("name", ["ekf", *map(slow, [n for n in OPTIONS if n != "ekf"])])
def test_filters_with_fixes_and_closures_alone_are_consistent(name):
    consistent(*squares(name, replace(WORLD, frames=60, closure_radius=9.0), range(20), blind=True))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "world"), [
    (name, world) for name in OPTIONS for world in WORLDS if (name, world) != ("ekf", "closures alone")
])  # fmt: skip
def test_filters_are_consistent_over_many_runs(name, world):
    consistent(*squares(name, WORLDS[world], range(2000, 2100), blind=True))


@pytest.mark.slow
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("name", OPTIONS)
def test_so_are_they_beside_landmarks(name, task):
    consistent(*squares(name, WORLD, range(2000, 2100), task, blind=False))


@pytest.mark.slow
def test_closures_alone_make_the_plain_filter_too_sure():
    """Its Jacobians contradict each other, which claims knowledge of the heading that no closure gives (Huang et al.).

    Measured at the last frame, over the expected NEES: 1.28; with first estimates 1.14, with the invariant one 1.12.
    """
    last = {name: squares(name, WORLDS["closures alone"], range(2000, 2100), blind=True)[0][:, -1] for name in OPTIONS}
    mean = {name: each.mean() / 3.0 for name, each in last.items()}
    assert mean["ekf"] > chi2.ppf(0.99, 300) / 300
    assert max(mean["ekf-fej"], mean["ekf-invariant"]) < mean["ekf"] - 0.1
