"""Gates by the noise that there is: learned apart for sensor and motion, and widened to what they are to leave out."""

import numpy as np
import pytest

from association.expectation import Expectation
from eval.replay.hindsight.constants import FALSE_REJECTION, FREEDOM, TAILS
from eval.replay.hindsight.gates import Scales, as_stated, counted, relearned, scaled, widest
from eval.replay.hindsight.noise import NoiseScale
from tests.quick import slow


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


@pytest.mark.parametrize(
    ("sensor", "motion"),
    [(0.03, 0.5), slow(0.5, 0.03), slow(1.0, 1.0)],
)
def test_sensor_and_motion_are_told_apart(sensor, motion):
    scales = learn(sensor, motion)
    assert scales.sensor.scale == pytest.approx(sensor, rel=0.2, abs=0.03)
    assert scales.motion.scale == pytest.approx(motion, rel=0.2, abs=0.03)


def test_the_wider_of_both_counts_and_never_more_than_was_stated():
    scales = Scales(NoiseScale(0.05, 1.0), NoiseScale(0.2, 1.0))
    assert widest(scales) == pytest.approx(0.2 * TAILS)
    assert widest(Scales(NoiseScale(3.0, 1.0), NoiseScale(0.2, 1.0))) == 1.0


def test_every_distance_grows_by_the_share():
    e = Expectation.from_arrays([[0.3, 0.1]], [[0.0, 0.0], [1.0, 0.5]], 0.1 * np.eye(4), 0.02 * np.eye(2)[None])
    scales = Scales(NoiseScale(0.1, 1.0), NoiseScale(0.1, 1.0))
    narrow = scaled(e, scales)
    assert narrow.individual_distances() == pytest.approx(e.individual_distances() / (0.1 * TAILS))
    assert narrow.joint(np.array([1, 0])) == pytest.approx(0.1 * TAILS * e.joint(np.array([1, 0])))
    assert scaled(e, Scales(NoiseScale(2.0, 1.0), NoiseScale(2.0, 1.0))) is e


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


def test_the_gate_comes_back_at_once_from_what_was_stated():
    scales = Scales(NoiseScale(0.1, 1.0), NoiseScale(0.1, 1.0))
    for _ in range(500):
        scales = counted(scales, 0, 1)
    assert widest(scales) == pytest.approx(1.0)
    for _ in range(300):
        scales = counted(scales, 1, 0)
    assert widest(scales) < 0.95
