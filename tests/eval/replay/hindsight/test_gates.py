"""Gates: learned from what is inside and outside, put off where several must agree, none where landmarks are dense."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from association.conditional import ConditionalDecisions, conditional_distances
from association.expectation import Expectation
from data import se2
from data.result import DISCARD, NEW
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.constants import FALSE_REJECTION, FREEDOM, TAILS
from eval.replay.hindsight.gates import (
    LearnedGates,
    Scales,
    Tentative,
    TentativeObservation,
    as_stated,
    counted,
    dense,
    density,
    pair,
    relearned,
    widest,
)
from eval.replay.hindsight.ledger import Epoch, Ledger, Record
from eval.replay.hindsight.noise import NoiseScale
from eval.replay.settings import Setup
from tests.quick import slow

SENSOR = RelativePoint(max_range=20.0)
LANDMARKS = np.array([[5.0, 0.0], [5.0, 8.0]])
BESIDE = np.array([5.5, 0.0])
"""By the stated noise it may be of the first landmark."""
FINE = Scales(NoiseScale(0.01, 100.0), NoiseScale(0.01, 100.0))


class Frames:
    """Of a robot that knows two landmarks, 3 and 7."""

    def __init__(self, scales=None):
        ledger = Ledger(SENSOR)
        ledger._read = SENSOR
        ledger.records = {n: Record([], (0.0, 0.0), 0.0, 0.0) for n in (3, 7)}
        self.gates = LearnedGates(ledger)
        if scales is not None:
            self.gates.scales = scales

    def put_off(self, points, decisions, pose=(0.0, 0.0, 0.0), R=None):
        """A frame that reads these points (in the world) and decided so by the noise that there is."""
        back = se2.inverse(np.array(pose))
        z, z_hat = (se2.transform_points(back, np.array(p, float).reshape(-1, 2)) for p in (points, LANDMARKS))
        noise = np.tile(0.01 * np.eye(2) if R is None else R, (len(z), 1, 1))
        e = Expectation.from_arrays(z, z_hat, 0.04 * np.eye(4), noise, number=np.array([3, 7]))
        chosen = np.array(decisions)
        found = ConditionalDecisions(chosen, True, conditional_distances(e, chosen, 0.99999))
        return self.gates.put_off(e, found, np.array(pose), 0.99999).tolist()


@pytest.mark.parametrize(("scales", "second", "third"), [
    (None, NEW, NEW), (as_stated(), DISCARD, NEW), (FINE, DISCARD, DISCARD),
])  # fmt: skip
def test_a_second_reading_beside_a_paired_landmark_waits_until_three_agree_where_noise_is_as_stated(
    scales, second, third
):
    frames = Frames(scales)
    told = [frames.put_off([LANDMARKS[0], BESIDE], [3, second])[1] for _ in range(3)]
    assert told == [DISCARD, DISCARD, third]


def test_each_landmark_is_inside_and_outside_its_gate_once_from_one_place():
    frames = Frames(FINE)
    frames.put_off([*LANDMARKS, BESIDE], [3, 7, NEW])
    assert frames.gates.scales == counted(FINE, 2, 1)
    gated = {n: sorted(r.gated) for n, r in frames.gates.ledger.records.items()}
    assert gated == {3: [False, True], 7: [True]}, "the nearest landmark left it out"
    frames.put_off([*LANDMARKS, BESIDE], [3, 7, NEW])
    assert frames.gates.scales.observations == 3.0
    frames = Frames(FINE)  # one that is new in the end takes back what was counted against its neighbour
    for _ in range(3):
        frames.put_off([LANDMARKS[0], BESIDE], [3, NEW])
    assert frames.gates.scales == counted(counted(counted(FINE, 1, 1), 0, 0), 0, -1)


def test_a_new_log_begins_with_what_was_stated_and_learns_from_its_pairings():
    frames = Frames()
    assert frames.gates.scales == as_stated()
    e = Expectation.from_arrays(LANDMARKS, LANDMARKS, 0.04 * np.eye(4), np.tile(0.01 * np.eye(2), (2, 1, 1)))
    for _ in range(5):
        frames.gates.learn(e, np.array([0, 1]))
    assert frames.gates.scales.motion.scale < 1.0


REACH = 10.0


def at(x, travelled=0.0):
    return TentativeObservation(np.array([x, 0.0]), 0.01 * np.eye(2), travelled)


def test_the_third_that_agrees_is_new_once_the_pose_was_confirmed_unless_its_place_was_forgotten():
    seen = Tentative()
    assert [seen.see(at(1.0), n, REACH) for n in (4, 5, 5)] == [False, False, True]
    seen = Tentative()
    assert not any(seen.see(at(1.0, travelled), int(travelled), REACH) for travelled in (0.0, 1.0, 12.0, 13.0))
    assert seen.see(at(1.0, 14.0), 14, REACH)


def test_a_landmark_takes_its_own_doubts_and_leaves_the_others():
    seen = Tentative()
    for x in (1.0, 1.1, 4.0):
        seen.suspect(at(x))
    assert (seen.settle(at(1.0)), seen.settle(at(1.0)), seen.settle(at(4.0))) == (2, 0, 1)


def frame(rng, sensor, motion, R, P):
    """One landmark, seen once, with Student's noise that is so much of what is stated."""
    S = sensor * R + motion * P
    nu = rng.multivariate_normal(np.zeros(2), S) / np.sqrt(rng.chisquare(FREEDOM) / FREEDOM)
    return Expectation.from_arrays(nu[None], np.zeros((1, 2)), P, R[None])


def learn(sensor, motion, frames=3000):
    rng = np.random.default_rng(0)
    scales = as_stated()
    R = np.diag([0.04, 0.01])
    for k in range(frames):
        scales = relearned(scales, frame(rng, sensor, motion, R, R * (100.0 if k % 4 == 0 else 0.01)), np.zeros(1, int))
    return scales


@pytest.mark.parametrize(("sensor", "motion"), [(0.03, 0.5), slow(0.5, 0.03), slow(1.0, 1.0)])
def test_sensor_and_motion_are_told_apart(sensor, motion):
    scales = learn(sensor, motion)
    assert scales.sensor.scale == pytest.approx(sensor, rel=0.2, abs=0.03)
    assert scales.motion.scale == pytest.approx(motion, rel=0.2, abs=0.03)


def test_the_wider_of_both_counts_and_never_more_than_was_stated():
    assert widest(Scales(NoiseScale(0.05, 1.0), NoiseScale(0.2, 1.0))) == pytest.approx(0.2 * TAILS)
    assert widest(Scales(NoiseScale(3.0, 1.0), NoiseScale(0.2, 1.0))) == 1.0


def test_the_gate_goes_to_where_it_leaves_out_its_share():
    rng = np.random.default_rng(1)
    scales = Scales(NoiseScale(0.01, 1.0), NoiseScale(0.01, 1.0))
    squares = 0.01 * rng.chisquare(2, 20000) / rng.chisquare(2, 20000) * 2.0  # heavier tails than Student's four
    outside = []
    for d2 in squares:
        out = d2 > 9.21 * widest(scales)
        scales = counted(scales, int(not out), int(out))
        outside.append(out)
    assert np.mean(outside[5000:]) == pytest.approx(FALSE_REJECTION, rel=0.5)
    assert np.mean(squares > 9.21 * 0.01 * TAILS) > 4 * FALSE_REJECTION  # without


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
    assert dense(e, crowd(count, sensor), ledger(sensor=sensor), Setup(gate=gate)).tolist() == [False, True]


@pytest.mark.parametrize(("begun", "anew"), [(-math.inf, True), (29.0, True), (31.0, False)])
def test_a_doubt_begins_an_epoch_unless_one_began_nearby(begun, anew):
    assert constants.WINDOW_SPAN * POINT.max_range == 20.0
    book = ledger(travelled=50.0, begun=begun, first=12)
    found = pair(expecting(3), crowd(100), book, as_stated(), Setup())
    assert found.epoch == (Epoch(50.0, 77) if anew else Epoch(begun, 12))
    assert found.found.decisions.tolist() == ([NEW] * 3 if anew else [NEW, NEW, 12])


@pytest.mark.parametrize("count", [1, 100])
@pytest.mark.parametrize(("share", "paired"), [(1.0, True), (0.01, False)])
def test_pairings_are_made_by_the_noise_that_there_is(count, share, paired):
    """By the stated noise 0.6 m is inside the gate."""
    scales = Scales(NoiseScale(share, 100.0), NoiseScale(share, 100.0))
    book = ledger(travelled=50.0, begun=45.0, first=10)
    found = pair(expecting(2, off=0.6), crowd(count), book, scales, Setup())
    assert found.found.decisions.tolist() == ([10, 11] if paired else [NEW, NEW])
