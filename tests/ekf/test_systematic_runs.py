"""Filters with systematic errors as states: the same by every way of running them; the plain filter at the limit."""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior
from data.sensors import RangeBearing
from data.worlds.arena import Arena, simulate
from ekf.filter import DEFAULT, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.whole_run import run_filter
from tests.builders.estimators import drive, ekf_of
from tests.ekf.test_systematic import ALL, ODOMETRY

VARIANTS = {
    "stacked": DEFAULT, "iterated": FilterOptions(iterations=5), "first-estimates": FilterOptions(first_estimates=True),
    "invariant": FilterOptions(invariant=True),
}  # fmt: skip
MOUNTED = {"rotation": 0.4, "translation": (0.3, -0.2)}


@pytest.fixture(scope="module")
def arena():
    """Inputs of a short run, its sensor mounted off the robot's centre (the log need not fit)."""
    inputs = simulate(Arena(frames=120, landmarks=25), 0).inputs(labels=True)
    return replace(inputs, sensor=replace(inputs.sensor, **MOUNTED))


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("of", [None, ODOMETRY, ALL], ids=["none", "odometry", "all"])
@pytest.mark.parametrize("name", VARIANTS)
def test_the_whole_run_has_the_bytes_of_the_stepping_filter(arena, task, of, name):
    inputs = replace(arena.without_map() if task == "slam" else arena, systematic=of)
    threshold = 30.0 if name != "iterated" else np.inf
    decisions, _ = known_decisions(inputs)
    f = ekf_of(inputs, VARIANTS[name])
    pose, covariance, updates = drive(f, inputs, decisions, threshold=threshold)
    run = run_filter(inputs, decisions, threshold=threshold, options=VARIANTS[name])
    assert run.failure is None
    np.testing.assert_array_equal(run.pose, pose)
    np.testing.assert_array_equal(run.covariance, covariance)
    np.testing.assert_array_equal(run.nis[np.diff(inputs.start) > 0], [done.nis for done in updates])
    if of is not None:
        assert run.errors.names == of.names
        np.testing.assert_array_equal(run.errors.mean[-1], f.errors[0])
        np.testing.assert_array_equal(run.errors.sigma[-1], np.sqrt(np.diag(f.errors[1])))
    if task == "slam":
        assert run.state_size[-1] == f.size
        np.testing.assert_array_equal(run.map.xy, f.landmarks().xy)
        np.testing.assert_array_equal(run.map.covariance, f.landmarks().covariance)


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("of", [ODOMETRY, ALL], ids=["odometry", "all"])
def test_errors_that_are_all_but_certain_to_be_none_change_nothing(arena, task, name, of):
    if of is ALL:  # a lever arm between sensor and robot is linearized elsewhere
        arena = replace(arena, sensor=replace(arena.sensor, translation=(0.0, 0.0)))
    inputs = arena.without_map() if task == "slam" else arena
    decisions, _ = known_decisions(inputs)
    plain = run_filter(inputs, decisions, options=VARIANTS[name])
    run = run_filter(replace(inputs, systematic=replace(of, sigma=1e-9 * of.sigma)), decisions, options=VARIANTS[name])
    np.testing.assert_allclose(se2.pose_error(run.pose, plain.pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(run.covariance, plain.covariance, atol=1e-9)
    np.testing.assert_allclose(run.nis, plain.nis, atol=1e-5)
    np.testing.assert_allclose(run.log_likelihood, plain.log_likelihood, atol=1e-5)
    if task == "slam":
        np.testing.assert_allclose(run.map.covariance, plain.map.covariance, atol=1e-9)


def localizer(seed=0, count=400, options=DEFAULT):
    """A localizer that has driven and looked around in a large map, and what it sees next."""
    rng = np.random.default_rng(seed)
    sensor = RangeBearing(max_range=12.0, **MOUNTED)
    xy = rng.uniform(-60.0, 60.0, (count, 2))
    prior = Prior(np.array([3.0, -2.0, 0.5]), np.diag([0.3, 0.2, 0.05]) ** 2)
    f = EkfLocalizer(prior, sensor, LandmarkMap(np.arange(count), xy), options, systematic=ALL)
    pose = prior.mean
    for _ in range(10):
        step = np.array([0.5, 0.0, 0.1])
        f.predict(Increment(step, np.diag([0.05, 0.02, 0.02]) ** 2))
        pose = se2.compose(pose, step)
        z = sensor.predict(pose, xy)
        near = np.argsort(z[:, 0])[:3]
        seen = FrameObservations(z[near] * [1.04, 1.0] + [0.0, 0.02], np.tile(np.diag([0.1, 0.02]) ** 2, (3, 1, 1)))
        f.update(seen, near)
    return f, seen, near


def test_a_localizer_expects_what_it_will_be_surprised_by():
    """Expectation and update are two ways to the same innovations, with the range error in both."""
    for options in (DEFAULT, FilterOptions(first_estimates=True)):
        f, seen, near = localizer(options=options)
        e = f.expect(seen)
        d2, S = e.individual_distances(), e.joint(near)
        nu = f.sensor.residual(seen.z, e.z_hat[near])
        for i in range(3):
            np.testing.assert_allclose(S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], e.HPHt[near[i]], rtol=1e-9)
            assert d2[i, near[i]] == pytest.approx(
                nu[i] @ np.linalg.solve(e.HPHt[near[i]] + seen.R[i], nu[i]), rel=1e-9
            )
        for i in range(3):
            S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += seen.R[i]
        nis = nu.ravel() @ np.linalg.solve(S, nu.ravel())
        assert f.update(seen, near).nis == pytest.approx(nis, rel=1e-9)
        assert f.size == 10


def test_a_localizer_leaves_out_no_landmark_that_some_reading_may_be_of():
    f, seen, _ = localizer()
    every = f.expect(seen)
    for within in (9.0, 30.0):
        f.within = within
        e = f.expect(seen)
        assert np.isin(every.number[(every.individual_distances() < within).any(axis=0)], e.number).all()
        assert len(e.number) < len(every.number)


def test_another_pose_may_be_linearized_at_where_a_sensor_errs():
    f, seen, near = localizer()
    mean = f.estimate().mean
    e = f.expect(seen)
    np.testing.assert_allclose(e.elsewhere(mean).z_hat, e.z_hat, atol=1e-9)
    twin, _, _ = localizer()
    f.update(seen, near)
    twin.update(seen, near, at=mean)
    np.testing.assert_allclose(twin.estimate().mean, f.estimate().mean, atol=1e-9)
    np.testing.assert_allclose(twin.errors[0], f.errors[0], atol=1e-9)


def test_a_localizer_set_to_a_pose_is_there_and_keeps_what_it_knows_of_the_errors():
    f, _, _ = localizer()
    errors = f.errors
    mean, covariance = np.array([-4.0, 1.0, 2.0]), np.diag([0.1, 0.2, 0.3])
    covariance[0, 2] = covariance[2, 0] = 0.05
    f.reset(mean, covariance)
    np.testing.assert_allclose(f.estimate().mean, mean, atol=1e-12)
    np.testing.assert_allclose(f.estimate().covariance, covariance, atol=1e-12)
    for now, before in zip(f.errors, errors, strict=True):
        np.testing.assert_allclose(now, before, atol=1e-12)


def test_more_doubt_of_the_last_motion_is_doubt_of_the_robots_pose():
    f, _, _ = localizer()
    before, more = f.estimate().covariance, np.diag([0.4, 0.2, 0.1])
    f.inflate(more)
    np.testing.assert_allclose(f.estimate().covariance, before + more, atol=1e-12)
