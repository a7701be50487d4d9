"""Noise told by consecutive frames: of ranges, of bearings and of the motion, apart, whatever else is in the frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from data import se2
from data.inputs import FrameObservations, Increment
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.worlds.registry import named_log
from eval.replay.hindsight import constants
from eval.replay.hindsight.noise import AS_STATED, Restated, Shares, Step, axes, fitted, paired, with_shares

RANGE, BEARING = 0.05, 0.02
MOTION = np.diag([0.03, 0.02, 0.02]) ** 2
STEP = np.array([0.3, 0.0, 0.05])


def drive(sensor: Sensor, times: Shares, frames: int, seed: int, *, clutter: int = 0, detection: float = 1.0):
    """Frames of a robot on a circle among landmarks; sigmas are so many `times` those stated."""
    rng = np.random.default_rng(seed)
    landmarks, pose = rng.uniform(-10.0, 10.0, (60, 2)), np.array([5.0, 0.0, math.pi / 2])
    sigma = np.array([RANGE * times.range, BEARING * times.bearing])
    for k in range(frames):
        increment = None
        if k:
            pose = se2.compose(pose, STEP)
            increment = Increment(STEP + times.motion * np.sqrt(np.diag(MOTION)) * rng.standard_normal(3), MOTION)
        off = se2.transform_points(se2.inverse(pose), landmarks)
        polar = np.stack([np.hypot(*off.T), np.arctan2(off[:, 1], off[:, 0])], axis=1)
        polar = polar[(polar[:, 0] < 6.0) & (polar[:, 0] > 0.5) & (rng.random(60) < detection)]
        polar = polar + sigma * rng.standard_normal(polar.shape)
        stray = np.stack([6.0 * np.sqrt(rng.random(clutter)), rng.uniform(-math.pi, math.pi, clutter)], axis=1)
        yield increment, readings(sensor, np.concatenate([polar, stray]))


def readings(sensor: Sensor, polar) -> FrameObservations:
    """As stated."""
    R = np.diag([RANGE**2, BEARING**2])
    if isinstance(sensor, RangeBearing):
        return FrameObservations(polar, np.tile(R, (len(polar), 1, 1)))
    r, b = polar.T
    z = r[:, None] * np.stack([np.cos(b), np.sin(b)], axis=1)
    T = np.stack([z / r[:, None], np.stack([-np.sin(b), np.cos(b)], axis=1)], axis=-1)
    S = np.zeros((len(r), 2, 2))
    S[:, 0, 0], S[:, 1, 1] = RANGE**2, (r * BEARING) ** 2
    return FrameObservations(z, T @ S @ T.transpose(0, 2, 1))


def told(sensor: Sensor, frames) -> Shares:
    differences = Restated(sensor)
    shares = AS_STATED
    for increment, observations in frames:
        shares = differences.fit(increment, observations)
    return shares


@pytest.mark.parametrize("sensor", [
    RangeBearing(max_range=6.0), pytest.param(RelativePoint(max_range=6.0), marks=pytest.mark.slow),
])  # fmt: skip
@pytest.mark.parametrize("times", [Shares(3.0, 1.0, 1.0), Shares(1.0, 3.0, 1.0), Shares(1.0, 1.0, 3.0)])
def test_it_is_told_which_noise_is_understated(sensor, times):
    shares = told(sensor, drive(sensor, times, 65, 1, clutter=1, detection=0.8))
    assert np.sqrt(shares) == pytest.approx(times, rel=0.25)


def test_a_few_frames_tell_already():
    shares = told(RangeBearing(max_range=6.0), drive(RangeBearing(), Shares(3.0, 3.0, 1.0), 5, 2))
    assert math.sqrt(shares.range) > constants.UNDERSTATED
    assert math.sqrt(shares.bearing) > constants.UNDERSTATED


def test_readings_at_zero_range_and_without_noise_do_no_harm():
    sensor = RelativePoint(max_range=6.0)
    here = FrameObservations(np.array([[0.0, 0.0], [2.0, 1.0]]), np.tile(1e-4 * np.eye(2), (2, 1, 1)))
    exact = FrameObservations(here.z, np.zeros((2, 2, 2)))
    assert np.linalg.det(axes(sensor, here.z)) == pytest.approx([1.0, 1.0])
    for frame in (here, exact):
        for covariance in (MOTION, np.zeros((3, 3))):
            still = Increment(np.zeros(3), covariance + 1e-18 * np.eye(3) * (frame is exact))
            assert all(np.isfinite(told(sensor, [(None, here), (still, here), (still, frame)])))


def test_one_frame_tells_nothing():
    assert told(RangeBearing(), drive(RangeBearing(), Shares(3.0, 3.0, 3.0), 1, 3)) == AS_STATED


def test_what_moves_by_itself_is_not_the_sensors_noise():
    rng = np.random.default_rng(4)
    still = list(rng.normal(0.0, 1.0, (300, 2)))
    walks = list(rng.normal(0.0, 6.0, (60, 2)))
    steps = []
    for k in range(60):
        nu = np.array(still[5 * k : 5 * k + 5] + walks[k : k + 1])
        A, B = np.tile(np.diag([1.0, 0.0]), (6, 1, 1)), np.tile(np.diag([0.0, 1.0]), (6, 1, 1))
        steps.append(Step(1e-6 * np.eye(3), nu, np.zeros((6, 2, 3)), A, B, np.full(6, 1e-9)))
    shares = fitted(steps)
    assert shares.range == pytest.approx(1.0, abs=0.25)
    assert shares.bearing == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_where_odometry_tells_little_the_other_pairs_of_a_step_tell_the_motion(times):
    """A difference is as uncertain as the motion, too, by what the other one says of it."""
    rng, steps = np.random.default_rng(5), []
    A, B = np.tile(np.diag([0.01, 0.0]), (2, 1, 1)), np.tile(np.diag([0.0, 0.01]), (2, 1, 1))
    for _ in range(200):
        nu = rng.normal(size=2) + 0.1 * times * rng.normal(size=(2, 2))
        steps.append(Step(np.diag([1.0, 1.0, 1e-6]), nu, np.tile(np.eye(2, 3), (2, 1, 1)), A, B, np.full(2, 1e-9)))
    assert np.array(fitted(steps)) == pytest.approx([times**2, times**2, 1.0], rel=0.15)


@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_is_told_where_a_nearest_neighbour_may_be_any(seed):
    inputs = named_log(f"corridor:{seed}:no-odometry").inputs().without_labels()
    frames = (inputs.frame(k) for k in range(len(inputs)))
    # noise is as stated; the motion is a guess
    assert max(told(inputs.sensor, ((f.increment, f.observations) for f in frames))[:2]) < constants.UNDERSTATED**2


@pytest.mark.slow
def test_nothing_after_the_last_step_that_is_looked_at_counts():
    sensor = RangeBearing(max_range=6.0)
    differences = Restated(sensor)
    for increment, observations in drive(sensor, AS_STATED, constants.DIFFERENCES_MOST + 1, 5):
        before = differences.fit(increment, observations)
    for increment, observations in drive(sensor, Shares(4.0, 4.0, 4.0), 3, 6):
        assert differences.fit(increment or Increment(STEP, MOTION), observations) == before


def test_an_empty_frame_begins_anew():
    sensor = RangeBearing(max_range=6.0)
    differences = Restated(sensor)
    (_, first), (increment, second) = drive(sensor, Shares(4.0, 4.0, 4.0), 2, 7)
    differences.fit(None, first)
    differences.fit(increment, FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2))))
    assert differences.fit(increment, second) == AS_STATED


def test_pairs_are_each_others_nearest_neighbours():
    sensor = RangeBearing(max_range=6.0)
    before = readings(sensor, np.array([[2.0, 0.0], [3.0, 1.0]]))
    now = readings(sensor, np.array([[3.02, 1.0], [2.01, 0.0], [2.2, 0.0]]))
    step = paired(sensor, before, Increment(np.zeros(3), MOTION), now, 6.0)
    assert sorted(step.nu[:, 0].tolist()) == pytest.approx([0.01, 0.02])
    # two readings in the disk of 36 pi m^2; a square metre at range r is r m rad
    assert sorted(step.chance.tolist()) == pytest.approx([2.01 * 2 / (36 * math.pi), 3.02 * 2 / (36 * math.pi)])


def test_covariance_of_a_difference_is_that_of_both_readings():
    sensor = RelativePoint(max_range=6.0)
    before, now = (readings(sensor, np.array([[3.0, 0.7]])) for _ in range(2))
    turn = Increment(np.array([0.0, 0.0, 0.4]), MOTION)
    step = paired(sensor, before, turn, FrameObservations(now.z @ se2.rotation(-0.4).T, now.R), 6.0)
    u = np.array([math.cos(0.3), math.sin(0.3)])
    n = np.array([-u[1], u[0]])
    earlier = RANGE**2 * np.outer(u, u)
    later = np.array([math.cos(0.3), math.sin(0.3)])
    assert u @ step.by_range[0] @ u == pytest.approx(u @ earlier @ u + later @ now.R[0] @ later, rel=0.3)
    assert n @ step.by_bearing[0] @ n > u @ step.by_bearing[0] @ u


def test_the_noise_of_a_reading_turns_with_the_robot():
    sensor = RelativePoint(max_range=6.0)
    before = FrameObservations(np.array([[2.0, 0.0]]), np.diag([1.0, 1e-4])[None])
    # after a left turn it is expected at (0, -2), as uncertain along y as it was along x
    now = FrameObservations(np.array([[0.3, -2.0], [0.0, -2.8]]), np.tile(1e-4 * np.eye(2), (2, 1, 1)))
    step = paired(sensor, before, Increment(np.array([0.0, 0.0, math.pi / 2]), 1e-6 * np.eye(3)), now, 6.0)
    assert step.nu == pytest.approx(np.array([[0.0, -0.8]]))


@pytest.mark.parametrize("sensor", [RangeBearing(), RelativePoint()])
def test_shares_of_the_noise_scale_its_sigmas_along_and_across(sensor):
    observations = readings(sensor, np.array([[2.0, 0.5], [4.0, -2.0]]))
    more = with_shares(sensor, observations, Shares(4.0, 9.0, 1.0))
    T = axes(sensor, observations.z)
    before, after = (np.einsum("mij,mik,mkj->mj", T, s.R, T) for s in (observations, more))
    assert after == pytest.approx(before * [4.0, 9.0])
    assert more.z is observations.z


@pytest.mark.slow
def test_the_fit_is_the_most_likely_one(monkeypatch):
    """Against a direct search for the largest likelihood, where every pair is right and nothing moves."""
    for name, value in (("DIFFERENCES_PRIOR", 1e-9), ("DIFFERENCES_ROUNDS", 300), ("DIFFERENCES_WIDE", 1.0)):
        monkeypatch.setattr(constants, name, value)
    rng = np.random.default_rng(8)
    steps, blocks = [], []
    for _ in range(40):
        H = rng.normal(size=(5, 2, 3))
        A, B = np.tile(np.diag([0.04, 0.0]), (5, 1, 1)), np.tile(np.diag([0.0, 0.01]), (5, 1, 1))
        motion = rng.normal(size=3) * 0.3
        nu = H @ motion + rng.normal(size=(5, 2)) * [0.4, 0.05]
        steps.append(Step(0.04 * np.eye(3), nu, H, A, B, np.full(5, 1e-30)))
        blocks.append((nu.ravel(), H.reshape(10, 3)))

    def cost(logs):
        r, b, m = np.exp(logs)
        total = 0.0
        for nu, H in blocks:
            S = np.diag(np.tile([0.04 * r, 0.01 * b], 5)) + 0.04 * m * H @ H.T
            total += nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(S)[1]
        return total

    best = np.exp(minimize(cost, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6}).x)
    assert np.array(fitted(steps)) == pytest.approx(best, rel=1e-3)
