"""The pose of a frame by geometry: found where no linearization helps, and chosen by what speaks for it."""

import math

import numpy as np
import pytest

from association.expectation import Expectation
from data import se2
from data.inputs import FrameObservations, LandmarkMap, Prior
from data.result import NEW
from data.sensors import RangeBearing, RelativePoint
from ekf.localizer import EkfLocalizer
from eval.replay.hindsight.placement import Memory, candidates, place

FORWARD = np.diag([0.4, 0.1, math.radians(60)]) ** 2
START = np.array([1.0, -2.0, 0.7])
GATE, NEW_GATE = 0.99, 0.99999
SIGMA = 0.02


def apart(rng, count, side):
    """Points (n, 2) of a square, farther from each other than the noise confuses."""
    xy = np.empty((0, 2))
    while len(xy) < count:
        p = rng.uniform(-side, side, 2)
        if not len(xy) or np.hypot(*(xy - p).T).min() > 0.5:
            xy = np.vstack([xy, p])
    return xy


def look(sensor, pose, xy, rng):
    """Observations of points (n, 2), and which of them are in view."""
    z = sensor.predict(pose, xy)
    seen = np.flatnonzero(sensor.in_view(z))
    sigma = np.array([SIGMA, 0.01]) if isinstance(sensor, RangeBearing) else np.full(2, SIGMA)
    z = z[seen] + sigma * rng.standard_normal((len(seen), 2))
    return FrameObservations(z, np.tile(np.diag(sigma**2), (len(seen), 1, 1))), seen


def at_start(sensor, known, mean=START, motion=FORWARD):
    """A localizer whose pose has the covariance `motion` in its own body frame."""
    B = se2.world_from_body(mean[2])
    return EkfLocalizer(Prior(mean, B @ motion @ B.T), sensor, known)


def placed(filter_, observations, seen_from=(), rate=0.99, strays=0.01, motion=FORWARD):
    e = filter_.expect(observations)
    memory = Memory(list(seen_from), np.full(len(e.number), rate), strays)
    return place(e, filter_.sensor, filter_.estimate().mean, motion, memory, GATE, NEW_GATE)


@pytest.mark.parametrize("sensor", [RelativePoint(max_range=6.0), RangeBearing(8.0, -2.0, 2.0, 0.3, (0.2, -0.1))])
@pytest.mark.parametrize("turn", [-1.7, 0.4, 1.5])
def test_pose_and_pairings_are_found_after_a_turn_no_linearization_survives(sensor, turn):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        known = LandmarkMap(np.arange(40) * 3 + 5, START[:2] + apart(rng, 40, 9.0))
        pose = se2.compose(START, np.array([0.5, 0.1, turn]))
        observations, seen = look(sensor, pose, known.xy, rng)
        found = placed(at_start(sensor, known), observations)
        assert found is not None
        assert np.abs(se2.pose_error(found.pose, pose)).max() < 4 * SIGMA
        paired = found.decisions >= 0
        assert np.array_equal(found.decisions[paired], known.id[seen][paired])
        assert paired.mean() > 0.8


# two rows of points that repeat every 2 m, seen up to 5 m ahead: a step of 1 m and one of -1 m look alike
ROWS = np.concatenate([[[x, -0.5] for x in range(-10, 16, 2)], [[x, 0.6] for x in range(-9, 16, 2)]]).astype(float)
AHEAD = RelativePoint(max_range=5.0, min_angle=-math.pi / 2 + 0.01, max_angle=math.pi / 2 - 0.01)


def rows(first, last):
    inside = (ROWS[:, 0] >= first) & (ROWS[:, 0] <= last)
    return LandmarkMap(np.flatnonzero(inside), ROWS[inside])


@pytest.mark.parametrize("step", [1.0, -1.0])
def test_where_the_world_repeats_itself_the_motion_decides_and_not_the_number_of_pairings(step):
    # mapped are the points behind the robot and those in view from x = 0: a move backwards would pair everything
    for seed in range(5):
        rng = np.random.default_rng(seed)
        observations, seen = look(AHEAD, np.array([1.0, 0.0, 0.0]), ROWS, rng)
        expected = np.array([0.5 * step, 0.0, 0.0])
        found = placed(at_start(AHEAD, rows(-10, 4), expected), observations, [np.zeros(3)])
        assert found is not None
        assert found.pose[0] == pytest.approx(step, abs=0.1)
        mapped = ROWS[seen, 0] <= 4
        assert (found.decisions[mapped] >= 0).mean() > 0.8
        if step > 0:
            assert (found.decisions[~mapped] == NEW).all()


NARROW = np.diag([0.4, 0.1, math.radians(20)]) ** 2
BACK = np.array([-0.4, 0.0, 0.0])  # the motion speaks for -1, where only the marks tell it from 1


def test_a_landmark_that_should_be_seen_and_is_not_speaks_against_a_pose():
    observations, _ = look(AHEAD, np.array([1.0, 0.0, 0.0]), ROWS, np.random.default_rng(1))
    marks = np.array([[0.3, 0.1], [0.5, 0.1], [0.7, 0.2]])  # ahead of -1, behind 1
    known = LandmarkMap(np.arange(len(ROWS) + 3), np.concatenate([ROWS, marks]))

    def step(landmarks, rate):
        return placed(at_start(AHEAD, landmarks, BACK, NARROW), observations, rate=rate, motion=NARROW).pose[0]

    assert step(rows(-10, 15), 0.99) == pytest.approx(-1.0, abs=0.1)
    assert step(known, 0.99) == pytest.approx(1.0, abs=0.1)
    assert step(known, 0.2) == pytest.approx(-1.0, abs=0.1)  # hardly ever seen: that they are not says little


def test_a_point_that_should_have_been_seen_before_speaks_against_a_pose():
    strange = np.array([[2.0, 0.1], [2.4, -0.1], [2.7, 0.2]])  # if the robot were at -1, they would be 2 m nearer
    points = np.concatenate([ROWS, strange])
    observations, _ = look(AHEAD, np.array([1.0, 0.0, 0.0]), points, np.random.default_rng(2))
    filter_ = at_start(AHEAD, rows(-10, 15), BACK, NARROW)
    free = placed(filter_, observations, motion=NARROW)
    assert free.pose[0] == pytest.approx(-1.0, abs=0.1)
    assert free.sudden == 0
    # from -3.5 one sees as far as 1.5: where they would stand if the robot were at -1, and not where they stand
    held = placed(filter_, observations, [np.array([-3.5, 0.0, 0.0])], motion=NARROW)
    assert held.pose[0] == pytest.approx(1.0, abs=0.1)
    assert held.sudden == 0
    assert placed(filter_, observations, [np.array([-3.5, 0.0, 0.0])], strays=0.9, motion=NARROW).sudden == 3


def test_landmarks_that_stand_close_are_told_apart_by_all_pairings_together():
    rng = np.random.default_rng(11)
    xy = START[:2] + apart(rng, 12, 4.0)
    known = LandmarkMap(np.arange(24), np.concatenate([xy, xy + [0.11, 0.0]]))
    sensor, pose = RelativePoint(max_range=12.0), se2.compose(START, np.array([0.2, 0.0, 1.2]))
    observations, seen = look(sensor, pose, known.xy, rng)
    assert (placed(at_start(sensor, known), observations).decisions == seen).mean() > 0.95


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_observations_give_no_pose(count):
    rng = np.random.default_rng(0)
    known = LandmarkMap(np.arange(9), rng.uniform(-4, 4, (9, 2)))
    observations, _ = look(RelativePoint(max_range=20.0), np.zeros(3), known.xy, rng)
    few = FrameObservations(observations.z[:count], observations.R[:count])
    assert placed(at_start(RelativePoint(max_range=20.0), known, np.zeros(3)), few) is None


def test_a_scan_of_another_place_gives_no_pose():
    rng = np.random.default_rng(7)
    known = LandmarkMap(np.arange(9), rng.uniform(-4, 4, (9, 2)))
    sensor = RelativePoint(max_range=20.0)
    observations, _ = look(sensor, np.zeros(3), rng.uniform(-4, 4, (9, 2)), rng)
    assert placed(at_start(sensor, known, np.zeros(3)), observations, motion=FORWARD / 4) is None


SENSOR = RelativePoint(max_range=20.0)
THERE = np.array([[2.0, 1.0], [5.0, -1.5], [3.0, 4.0], [7.0, 2.5], [1.0, -4.0], [9.0, -3.0], [6.0, 6.5]])
"""Landmarks as expected, no two pairs of them equally far apart."""


def pairings(pose, off=(), wide=0.5):
    """Of a frame that sees all landmarks from `pose` in the expected body frame, some of them moved by `off`."""
    z = se2.transform_points(se2.inverse(np.asarray(pose, float)), THERE)
    for k, by in off:
        z[k] += by
    n = len(THERE)
    e = Expectation.from_arrays(
        z, THERE, SIGMA**2 * np.eye(2 * n), np.tile(SIGMA**2 * np.eye(2), (n, 1, 1)), number=np.arange(n)
    )
    return candidates(e, SENSOR, wide**2 * np.eye(3))


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2), (-0.5, 0.2, -0.4)])
def test_the_best_one_pairs_all_and_is_as_far_as_the_pose_is(pose):
    d2, best = pairings(pose)[0]
    assert best.tolist() == list(range(len(THERE)))
    assert d2 == pytest.approx(np.sum(np.square(pose)) / 0.5**2, abs=0.05)


def test_an_observation_far_from_every_landmark_by_its_own_noise_stays_unpaired():
    for off, paired in (((0.03, 0.0), True), ((0.4, 0.0), False)):
        best = pairings((0.3, 0.1, 0.1), off=[(2, np.array(off))])[0][1]
        assert (best[2] == 2) == paired
        assert best[[0, 1, 3, 4, 5, 6]].tolist() == [0, 1, 3, 4, 5, 6]


def test_a_pose_that_the_motion_does_not_allow_is_none():
    found = pairings((0.4, -0.3, 0.2), wide=0.05)
    assert all((paired >= 0).sum() < len(THERE) for _, paired in found)


@pytest.mark.parametrize(("seen", "there"), [(0.02, 0.02), (0.04, 0.001), (0.001, 0.04)])
@pytest.mark.parametrize(("sigmas", "paired"), [(2.85, True), (3.1, False)])
def test_two_points_give_a_pose_where_their_distances_agree_by_the_noise_of_both(seen, there, sigmas, paired):
    """A triangle that is read too large, so that its shortest side is off by so many standard deviations."""
    triangle = THERE[:3]
    sides = np.hypot(*(triangle - np.roll(triangle, 1, axis=0)).T)
    larger = 1.0 + sigmas * np.sqrt(2.0 * (seen**2 + there**2)) / sides.min()
    z = (triangle - triangle.mean(axis=0)) * larger + triangle.mean(axis=0)
    e = Expectation.from_arrays(z, triangle, there**2 * np.eye(6), np.tile(seen**2 * np.eye(2), (3, 1, 1)))
    found = candidates(e, SENSOR, 0.25 * np.eye(3))
    assert [best.tolist() for _, best in found] == ([[0, 1, 2]] if paired else [])
