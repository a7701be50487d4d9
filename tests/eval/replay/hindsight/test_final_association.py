"""All readings paired anew: the noise that there is, one-to-one pairs, and the reading that a landmark begins with."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from association.expectation import gate_threshold
from data.inputs import LandmarkMap, Observations
from data.se2 import wrap_angle
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.final_association import Reassociation, beginnings, noise_share, reassociate

SENSORS = (RangeBearing(max_range=8.0), RelativePoint(max_range=8.0))
each_sensor = pytest.mark.parametrize("sensor", SENSORS, ids=["range-bearing", "point"])
SIGMA = np.array([0.1, 0.05])


def seen_from(sensor, pose, xy, rng, stated=1.0):
    """Each of the landmarks (L, 2) read from each pose; R is `stated` times the variance that there is."""
    frame = np.repeat(np.arange(len(pose)), len(xy))
    number = np.tile(np.arange(len(xy)), len(pose))
    z = sensor.predict(pose[frame], xy[number]) + SIGMA * rng.standard_normal((len(frame), 2))
    return Observations(frame, z, np.tile(stated * np.diag(SIGMA**2), (len(frame), 1, 1))), number


def poses(rng, count):
    return np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-np.pi, np.pi, count)])


@each_sensor
@pytest.mark.parametrize("stated", [0.25, 1.0, 9.0])
def test_the_noise_that_there_is_is_told_as_a_share_of_what_is_stated(sensor, stated):
    rng = np.random.default_rng(3)
    pose, known = poses(rng, 400), LandmarkMap(np.arange(5), rng.uniform(-4.0, 4.0, (5, 2)))
    seen, number = seen_from(sensor, pose, known.xy, rng, stated)
    assert noise_share(sensor, pose, known, seen, number) == pytest.approx(1.0 / stated, rel=0.1)


def test_a_landmark_read_three_times_tells_nothing_of_the_noise_and_one_read_four_times_does():
    sensor, rng = SENSORS[0], np.random.default_rng(4)
    known = LandmarkMap(np.array([0]), np.array([[2.0, 1.0]]))
    pose = poses(rng, 4)
    seen, _ = seen_from(sensor, pose, known.xy, rng, 100.0)
    assert noise_share(sensor, pose, known, seen, np.array([0, 0, 0, -1])) == 1.0
    assert noise_share(sensor, pose, known, seen, np.full(4, -1)) == 1.0
    assert noise_share(sensor, pose, known, seen, np.zeros(4, np.int64)) < 0.1


def test_it_is_the_quantile_of_the_squared_distances_and_never_less_than_the_finest():
    sensor, known = SENSORS[1], LandmarkMap(np.array([2]), np.array([[1.0, 0.0]]))
    pose, off = np.zeros((11, 3)), np.arange(11.0)
    z = np.column_stack([1.0 + off, np.zeros(11)])
    seen = Observations(np.arange(11), z, np.tile(np.eye(2), (11, 1, 1)))
    own = np.full(11, 2)
    assert noise_share(sensor, pose, known, seen, own) == pytest.approx(81.0 / gate_threshold(0.9))
    exact = Observations(np.arange(11), np.tile([1.0, 0.0], (11, 1)), seen.R)
    assert noise_share(sensor, pose, known, exact, own) == constants.LEAST_SCALE


def test_readings_that_no_landmark_is_named_for_do_not_count():
    sensor, known = SENSORS[1], LandmarkMap(np.array([2]), np.array([[1.0, 0.0]]))
    z = np.array([[1.5, 0.0]] * 5 + [[90.0, 0.0]] * 5)
    seen = Observations(np.arange(10), z, np.tile(np.eye(2), (10, 1, 1)))
    number = np.array([2] * 5 + [-2] * 5)
    assert noise_share(sensor, np.zeros((10, 3)), known, seen, number) == pytest.approx(0.25 / gate_threshold(0.9))


def by_trying_all(d2, gate):
    """The cheapest one-to-one assignment (m,) among all, an observation left alone costing `gate`."""
    m, n = d2.shape
    best, found = np.inf, None
    for choice in permutations([*range(n), *[-1] * m], m):
        cost = sum(gate if j < 0 else d2[i, j] for i, j in enumerate(choice))
        if cost < best and all(j < 0 or d2[i, j] < gate for i, j in enumerate(choice)):
            best, found = cost, choice
    return list(found)


@each_sensor
@given(seed=st.integers(0, 10**6))
def test_each_frame_is_paired_at_least_cost_and_what_one_landmark_alone_explains_is_told(sensor, seed):
    rng = np.random.default_rng(seed)
    known = LandmarkMap(np.array([0, 5, 8]), rng.uniform(1.0, 2.0, (3, 2)))
    pose = 0.2 * rng.standard_normal((2, 3))
    frame = np.array([0, 0, 1, 1, 1])
    R = np.tile(np.diag([0.2, 0.1]) ** 2, (5, 1, 1))
    z = sensor.predict(pose[frame], known.xy[rng.integers(3, size=5)]) + 0.3 * rng.standard_normal((5, 2))
    found = reassociate(sensor, pose, known, Observations(frame, z, R))
    gate = gate_threshold(constants.REASSOCIATION_GATE)
    for k in (0, 1):
        rows = np.flatnonzero(frame == k)
        nu = z[rows][:, None] - sensor.predict(pose[k], known.xy)[None]
        if sensor.kind == "range_bearing":
            nu[..., 1] = wrap_angle(nu[..., 1])
        d2 = (nu**2 / np.diagonal(R[0])).sum(axis=2)
        expected = by_trying_all(d2, gate)
        assert found.number[rows].tolist() == [-1 if j < 0 else known.id[j] for j in expected]
        single = (d2 < gate).sum(axis=1) == 1
        assert found.alone[rows].tolist() == [bool(s) and j >= 0 for s, j in zip(single, expected, strict=True)]


def test_what_is_nowhere_near_a_landmark_is_nobodys():
    sensor = SENSORS[0]
    found = reassociate(
        sensor, np.zeros((1, 3)), LandmarkMap(np.array([0]), np.array([[40.0, 0.0]])),
        Observations(np.array([0]), np.array([[40.0, 0.0]]), np.eye(2)[None]),
    )  # fmt: skip
    assert found.number.tolist() == [-1]
    assert found.alone.tolist() == [False]


def test_a_landmark_begins_with_its_first_reading_that_is_of_nobody_else():
    number = np.array([4, 4, -1, 6, 4, 6, 9, 9])
    alone = np.array([False, True, False, True, True, True, False, False])
    assert beginnings(Reassociation(number, alone)) == {4: 1, 6: 3, 9: 6}
    assert beginnings(Reassociation(number[:0], alone[:0])) == {}
