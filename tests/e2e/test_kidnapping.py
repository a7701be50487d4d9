"""A robot moved unseen: the monitor notices, the map tells where it is, and the filter goes on from there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data import se2
from data.inputs import Observations
from data.notice import Code
from data.result import revised
from data.worlds.arena import Arena, simulate
from ekf.filter import DEFAULT
from ekf.localizer import EkfLocalizer
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.hindsight.mapper import MappingFrontEnd
from eval.replay.settings import Setup
from tests.builders.estimators import followed

AT = 40
WITHIN = chi2.ppf(0.9973, 3)


def kidnapped(seed, frames=60, distance=5.0):
    """Inputs of an arena in which the robot is moved and turned by somebody before frame `AT`, true poses and ids."""
    arena = Arena(frames=frames)
    log = simulate(arena, seed)
    rng = np.random.default_rng([seed, 1])
    truth, way = log.truth.pose.copy(), rng.uniform(-np.pi, np.pi)
    there = truth[AT] + [distance * np.cos(way), distance * np.sin(way), rng.uniform(-np.pi, np.pi)]
    truth[AT:] = se2.compose(se2.compose(there, se2.inverse(truth[AT])), truth[AT:])
    sensor, xy = log.recorded.sensor, log.recorded.map.xy
    frame, z, who = [], [], []
    for k, pose in enumerate(truth):
        exact = sensor.predict(pose, xy)
        seen = np.flatnonzero(sensor.in_view(exact) & (exact[:, 0] > arena.min_range))
        reading = exact[seen] + np.array(arena.sigma()) * rng.standard_normal((len(seen), 2))
        reading[:, 1] = se2.wrap_angle(reading[:, 1])
        frame, z, who = [*frame, *[k] * len(seen)], [*z, reading], [*who, *seen]
    R = np.tile(np.diag(np.square(arena.sigma())), (len(frame), 1, 1))
    return replace(log.recorded, observations=Observations(np.array(frame), np.concatenate(z), R)), truth, np.array(who)


def replay(inputs, estimator="ekf"):
    """The front end at the end, poses (N, 3), covariances (N, 3, 3), online and final decisions (M,)."""
    front = LocalizingFrontEnd(estimator, "jcbb-hindsight", inputs, Setup())
    pose, covariance, decisions, used = followed(front, inputs)
    decisions = np.where(used, decisions, -2)
    return front, pose, covariance, decisions, revised(decisions, front.events())


def back_after(inputs, truth, pose, covariance):
    """Scans of three landmarks or more until the pose was within 3 sigma and half a metre; None: never."""
    scans = 0
    for k in range(AT, len(truth)):
        scans += inputs.start[k + 1] - inputs.start[k] >= 3
        error = se2.pose_error(pose[k], truth[k])
        if error @ np.linalg.solve(covariance[k], error) < WITHIN and np.hypot(*error[:2]) < 0.5:
            return scans
    return None


def outcome(seed):
    """Whether the robot was back in time (None: it never saw three landmarks thrice), and false alarms before."""
    inputs, truth, _ = kidnapped(seed)
    front, pose, covariance, *_ = replay(inputs)
    back = back_after(inputs, truth, pose, covariance)
    enough = (np.diff(inputs.start)[AT:] >= 3).sum() >= 3
    false = sum(k < AT for k in front.alarms)
    return bool(back is not None and back <= 3) if enough or back is not None else None, false


def test_a_kidnapped_robot_is_back_after_three_scans():
    found = [outcome(seed) for seed in range(2)]
    assert sum(ok is False for ok, _ in found) == 0
    assert sum(false for _, false in found) == 0


@pytest.mark.slow
def test_two_hundred_kidnapped_robots():
    found = [outcome(seed) for seed in range(200)]
    answered = [ok for ok, _ in found if ok is not None]
    assert len(answered) >= 180
    assert np.mean(answered) >= 0.95
    assert sum(false for _, false in found) <= 1  # in 8000 healthy frames


def test_a_smoother_is_begun_anew_where_the_robot_is_found():
    inputs, truth, who = kidnapped(1, frames=55)
    front, pose, _, _, final = replay(inputs, "isam2")
    assert np.hypot(*(pose[-1] - truth[-1])[:2]) < 0.2
    path = front.estimator.finish().final
    assert path.pose.shape == (55, 3)
    found = front.found[0]
    away = np.hypot(*(path.pose - truth)[:, :2].T)
    assert away[: AT - 1].max() < 0.2
    assert away[found:].max() < 0.2
    assert (final == who).mean() > 0.97


def test_a_filter_that_is_reset_believes_only_that():
    for options in (DEFAULT, replace(DEFAULT, first_estimates=True)):
        inputs, _, _ = kidnapped(0)
        anew, fresh = (EkfLocalizer(inputs.prior, inputs.sensor, inputs.map, options) for _ in range(2))
        for k in range(5):
            anew.predict(inputs.increment(k + 1))
            anew.update(inputs.frame_observations(k), np.full(len(inputs.frame_observations(k).z), -2))
        mean, P = np.array([3.0, -1.0, 2.0]), np.diag([0.04, 0.01, 0.02])
        expectation = anew.expect(inputs.frame_observations(5))
        anew.reset(mean, P)
        with pytest.raises(RuntimeError, match="form a new one"):
            expectation.joint(np.arange(2))
        fresh = EkfLocalizer(replace(inputs.prior, mean=mean, covariance=P), inputs.sensor, inputs.map, options)
        for f in (anew, fresh):
            f.update(inputs.frame_observations(5), np.full(len(inputs.frame_observations(5).z), -2))
            f.predict(inputs.increment(6))
        assert np.array_equal(anew.mean, fresh.mean)
        assert np.array_equal(anew.covariance, fresh.covariance)


def mapped(seed, estimator="ekf", frames=60):
    """The front end of SLAM at the end of a log with a kidnapping, and position errors (N,)."""
    inputs, truth, _ = kidnapped(seed, frames=frames)
    inputs = inputs.without_map()
    front = MappingFrontEnd(estimator, "jcbb-hindsight", inputs, Setup())
    return front, np.hypot(*(followed(front, inputs)[0] - truth)[:, :2].T)


@pytest.mark.parametrize(("seed", "estimator"), [
    (12, "ekf"), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0, "isam2"), (0, "ekf"), (3, "isam2"))),
])  # fmt: skip
def test_a_robot_moved_while_it_maps_finds_its_place_in_its_own_map(seed, estimator):
    front, off = mapped(seed, estimator)
    told = front.kidnapping
    assert [AT <= k < AT + 3 for k in told.alarms] == [True]
    assert told.found == told.alarms
    assert off[told.found[0]] < off[AT - 1] + 0.5
    assert off[-1] < off[AT - 1] + 0.5
    assert Code.MOVED_UNSEEN in [note.code for note in front.notes()]
