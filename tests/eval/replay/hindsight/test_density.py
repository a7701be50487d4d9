"""Where landmarks are dense, a single observation chooses none of them: only a frame as a whole does."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from association.expectation import Expectation
from data.result import NEW
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.gates import Scales, as_stated, dense, density, pair
from eval.replay.hindsight.ledger import Epoch, Ledger
from eval.replay.hindsight.noise import NoiseScale
from eval.replay.settings import Setup

POINT = RelativePoint(max_range=10.0)
SIGMA = 0.3
PLACES = np.array([[4.0, 0.0], [6.0, 4.0], [6.0, -4.0], [1.0, 6.0], [1.0, -6.0], [-4.0, 0.0]])


def crowd(count, sensor=POINT, at=(0.0, 0.0)):
    """A filter with so many landmarks in view."""
    at = np.array(at)
    return SimpleNamespace(sensor=sensor, mean=np.array([*at, 0.5]), xy=at + np.tile([2.0, 1.0], (count, 1)))


def ledger(travelled=0.0, begun=-math.inf, first=10**6, sensor=POINT):
    found = Ledger(sensor)
    found._read, found.travelled, found.created, found.epoch = sensor, travelled, 77, Epoch(begun, first)
    return found


def expecting(seen, off=0.0):
    """The first places are seen, all are expected."""
    n = len(PLACES)
    z, R = PLACES[:seen] + [0.0, off], np.tile(0.01 * np.eye(2), (seen, 1, 1))
    return Expectation.from_arrays(z, PLACES, SIGMA**2 * np.eye(2 * n), R, number=10 + np.arange(n))


@pytest.mark.parametrize(("inside", "counted"), [(0, 1), (1, 1), (7, 7)])
def test_density_is_that_of_the_disk_that_the_sensor_reaches_with_one_landmark_at_least(inside, counted):
    near = np.tile([103.0, -4.0], (inside, 1))  # 5 m from the robot
    far = np.array([[103.1, -4.2], [0.0, 0.0]])
    slam = SimpleNamespace(mean=np.array([100.0, 0.0, 1.0]), xy=np.concatenate([near, far]))
    assert density(slam, 5.1) == pytest.approx(counted / (math.pi * 5.1**2))
    assert density(slam, 0.0) == 0.0


@pytest.mark.parametrize("gate", [0.95, None])
@pytest.mark.parametrize("sensor", [POINT, RangeBearing(max_range=10.0)])
@pytest.mark.parametrize("count", [40, 3])
def test_dense_is_where_half_a_landmark_is_in_the_gate_by_chance(gate, sensor, count):
    """The gate is an ellipse; of a bearing it is as wide as the range makes it."""
    area = constants.DENSE * math.pi * 10.0**2 / count / chi2.ppf(gate or constants.DENSE_GATE, 2) / math.pi
    r = 3.0
    across = 1.0 / r if sensor is not POINT else 1.0
    P = np.zeros((4, 4))
    for i, times in enumerate((0.98, 1.02)):
        P[2 * i, 2 * i], P[2 * i + 1, 2 * i + 1] = 2.0**2 * times, (0.5 * area * across) ** 2 * times
    expected = np.array([[r, 0.0], [r, 0.2]]) if sensor is not POINT else np.array([[r, 0.0], [0.0, r]])
    e = Expectation.from_arrays(np.empty((0, 2)), expected, P, np.empty((0, 2, 2)))
    told = dense(e, crowd(count, sensor), ledger(sensor=sensor), Setup(gate=gate))
    assert told.tolist() == [False, True]


@pytest.mark.parametrize(("count", "seen"), [(1, 1), (1, 3), (100, constants.TOGETHER), (100, constants.TOGETHER + 2)])
def test_where_landmarks_are_few_or_many_are_paired_at_once_the_frame_is_paired(count, seen):
    book = ledger(travelled=50.0)
    found = pair(expecting(seen), crowd(count), book, as_stated(), Setup())
    assert found.decisions.tolist() == list(range(10, 10 + seen))
    assert found.complete
    assert found.among.number.tolist() == list(range(10, 10 + len(PLACES)))
    assert found.epoch == book.epoch == Epoch(-math.inf, 10**6)


@pytest.mark.parametrize("seen", [1, constants.TOGETHER - 1])
def test_fewer_among_dense_landmarks_choose_only_what_this_epoch_initialized(seen):
    book = ledger(travelled=50.0, begun=45.0, first=10)
    found = pair(expecting(seen), crowd(100), book, as_stated(), Setup())
    assert found.decisions.tolist() == list(range(10, 10 + seen))
    book.epoch = Epoch(45.0, 11)
    found = pair(expecting(seen), crowd(100), book, as_stated(), Setup())
    assert found.decisions.tolist() == [NEW, *range(11, 10 + seen)]
    assert found.among.number.tolist() == list(range(11, 10 + len(PLACES)))


@pytest.mark.parametrize(("begun", "anew"), [(-math.inf, True), (29.0, True), (31.0, False)])
def test_a_doubt_begins_an_epoch_unless_one_began_nearby(begun, anew):
    assert constants.WINDOW_SPAN * POINT.max_range == 20.0
    book = ledger(travelled=50.0, begun=begun, first=12)
    found = pair(expecting(3), crowd(100), book, as_stated(), Setup())
    assert found.epoch == (Epoch(50.0, 77) if anew else Epoch(begun, 12))
    assert found.decisions.tolist() == ([NEW] * 3 if anew else [NEW, NEW, 12])


@pytest.mark.parametrize("count", [1, 100])
@pytest.mark.parametrize(("share", "paired"), [(1.0, True), (0.01, False)])
def test_pairings_are_made_by_the_noise_that_there_is(count, share, paired):
    """By the stated noise 0.6 m is inside the gate."""
    scales = Scales(NoiseScale(share, 100.0), NoiseScale(share, 100.0))
    book = ledger(travelled=50.0, begun=45.0, first=10)
    found = pair(expecting(2, off=0.6), crowd(count), book, scales, Setup())
    assert found.decisions.tolist() == ([10, 11] if paired else [NEW, NEW])


def test_nothing_read_or_expected_is_no_doubt():
    book = ledger(travelled=50.0)
    assert pair(expecting(0), crowd(100), book, as_stated(), Setup()).decisions.tolist() == []
    e = expecting(2)
    found = pair(e.only(np.empty(0, np.int64)), crowd(100), book, as_stated(), Setup())
    assert found.decisions.tolist() == [NEW, NEW]
    assert found.epoch.begun == -math.inf
