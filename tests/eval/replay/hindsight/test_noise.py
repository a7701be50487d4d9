"""The noise that there is: its scale, told by consecutive frames, and put in the place of what is stated."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_t

from data import se2
from data.inputs import Frame, FrameObservations, Increment
from data.notice import Code, notice
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.worlds.registry import named_log
from eval.replay.hindsight import constants
from eval.replay.hindsight.constants import FREEDOM, LEAST_SCALE
from eval.replay.hindsight.mapper import MappingFrontEnd
from eval.replay.hindsight.noise import (
    AS_STATED,
    Consecutive,
    NoiseScale,
    Restated,
    Shares,
    Step,
    axes,
    fitted,
    learned,
    log_density,
    paired,
    stated,
    with_shares,
)
from eval.replay.run import step_by_step
from eval.replay.settings import HINDSIGHT, Setup
from tests.research.variety.worlds import draw, log_of


def test_the_density_is_students():
    S = np.array([[0.3, 0.1], [0.1, 0.2]])
    for nu, scale in (([0.4, -1.0], 1.0), ([3.0, 0.2], 0.05)):
        d2 = float(nu @ np.linalg.solve(S, nu))
        ours = log_density(NoiseScale(scale, 1.0), d2, float(np.linalg.slogdet(S)[1]))
        assert ours == pytest.approx(multivariate_t.logpdf(nu, np.zeros(2), scale * S, df=FREEDOM))


@pytest.mark.parametrize("scale", [0.04, 1.0, 3.0])
def test_the_scale_of_students_squares_is_found(scale):
    rng = np.random.default_rng(0)
    noise = stated()
    for _ in range(3000):
        noise = learned(noise, scale * rng.chisquare(2, 2) / (rng.chisquare(FREEDOM, 2) / FREEDOM), np.ones(2))
    assert noise.scale == pytest.approx(scale, rel=0.1)


def test_what_is_believed_to_a_share_counts_as_that_share():
    squares = np.random.default_rng(2).chisquare(2, 4)
    whole = learned(stated(), squares, np.ones(4))
    halves = learned(stated(), np.repeat(squares, 2), np.full(8, 0.5))
    assert halves.scale == pytest.approx(whole.scale)
    assert halves.weight == whole.weight == stated().weight + 4.0
    assert learned(stated(), np.empty(0), np.empty(0)) == stated()


def test_noise_free_data_do_not_make_it_vanish():
    noise = stated()
    for _ in range(5000):
        noise = learned(noise, np.zeros(1), np.ones(1))
    assert noise.scale == LEAST_SCALE


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


@pytest.mark.parametrize("times", [Shares(3.0, 1.0, 1.0), Shares(1.0, 3.0, 1.0), Shares(1.0, 1.0, 3.0)])
def test_it_is_told_which_noise_is_understated(times):
    sensor = RangeBearing(max_range=6.0)
    shares = told(sensor, drive(sensor, times, 65, 1, clutter=1, detection=0.8))
    assert np.sqrt(shares) == pytest.approx(times, rel=0.25)


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


def test_pairs_are_each_others_nearest_neighbours():
    sensor = RangeBearing(max_range=6.0)
    before = readings(sensor, np.array([[2.0, 0.0], [3.0, 1.0]]))
    now = readings(sensor, np.array([[3.02, 1.0], [2.01, 0.0], [2.2, 0.0]]))
    (step,) = paired(sensor, [Consecutive(before, Increment(np.zeros(3), MOTION), now, 6.0)])
    assert sorted(step.nu[:, 0].tolist()) == pytest.approx([0.01, 0.02])
    # two readings in the disk of 36 pi m^2; a square metre at range r is r m rad
    assert sorted(step.chance.tolist()) == pytest.approx([2.01 * 2 / (36 * math.pi), 3.02 * 2 / (36 * math.pi)])


def test_the_noise_of_a_reading_turns_with_the_robot():
    sensor = RelativePoint(max_range=6.0)
    before = FrameObservations(np.array([[2.0, 0.0]]), np.diag([1.0, 1e-4])[None])
    # after a left turn it is expected at (0, -2), as uncertain along y as it was along x
    now = FrameObservations(np.array([[0.3, -2.0], [0.0, -2.8]]), np.tile(1e-4 * np.eye(2), (2, 1, 1)))
    turn = Increment(np.array([0.0, 0.0, math.pi / 2]), 1e-6 * np.eye(3))
    (step,) = paired(sensor, [Consecutive(before, turn, now, 6.0)])
    assert step.nu == pytest.approx(np.array([[0.0, -0.8]]))


@pytest.mark.parametrize("sensor", [RangeBearing(), RelativePoint()])
def test_shares_of_the_noise_scale_its_sigmas_along_and_across(sensor):
    observations = readings(sensor, np.array([[2.0, 0.5], [4.0, -2.0]]))
    more = with_shares(sensor, observations, Shares(4.0, 9.0, 1.0))
    T = axes(sensor, observations.z)
    before, after = (np.einsum("mij,mik,mkj->mj", T, s.R, T) for s in (observations, more))
    assert after == pytest.approx(before * [4.0, 9.0])
    assert more.z is observations.z


def test_the_fit_is_the_most_likely_one(monkeypatch):
    """Against a direct search for the largest likelihood, where every pair is right and nothing moves."""
    for name, value in (("DIFFERENCES_PRIOR", 1e-9), ("DIFFERENCES_ROUNDS", 300), ("DIFFERENCES_WIDE", 1.0)):
        monkeypatch.setattr(constants, name, value)
    rng = np.random.default_rng(8)
    steps, blocks = [], []
    for _ in range(40):
        H = rng.normal(size=(5, 2, 3))
        A, B = np.tile(np.diag([0.04, 0.0]), (5, 1, 1)), np.tile(np.diag([0.0, 0.01]), (5, 1, 1))
        nu = H @ (rng.normal(size=3) * 0.3) + rng.normal(size=(5, 2)) * [0.4, 0.05]
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


SENSOR = RangeBearing(max_range=5.0, min_angle=-1.0, max_angle=1.0)


def frames(times: float, n: int = 20):
    """A robot that stands still before ten landmarks; ranges are so many times noisier than stated."""
    rng = np.random.default_rng(0)
    polar = np.stack([np.linspace(1.0, 4.5, 10), np.linspace(-0.9, 0.9, 10)], axis=1)
    R = np.tile(np.diag([0.02**2, 0.01**2]), (10, 1, 1))
    for k in range(n):
        z = polar + np.array([0.02 * times, 0.01]) * rng.standard_normal((10, 2))
        motion = None if k == 0 else Increment(np.zeros(3), 1e-8 * np.eye(3))
        yield Frame(k, float(k), motion, FrameObservations(z, R), None, 10 * k)


def test_understated_noise_is_restated_where_it_is():
    restated = Restated(SENSOR)
    for frame in frames(4.0):
        last = restated.see(frame)
    assert np.sqrt(last.observations.R[:, 0, 0]) == pytest.approx(0.08, rel=0.2)
    assert np.sqrt(last.observations.R[:, 1, 1]) == pytest.approx(0.01)
    factor = restated.shares.range**0.5
    assert restated.notes() == [notice(Code.LARGER_SIGMAS, of=("range",), factors=(factor,))]


@pytest.mark.parametrize("times", [0.1, 1.0, 1.4])
def test_noise_that_is_not_clearly_larger_stays_as_stated(times):
    restated = Restated(SENSOR)
    for frame in frames(times):
        assert restated.see(frame) is frame
    assert restated.notes() == []


def test_the_view_holds_all_that_was_read():
    restated = Restated(SENSOR)
    assert restated.widened(SENSOR) == SENSOR
    z = np.array([[7.0, 0.2], [2.0, -1.5]])
    restated.see(Frame(0, 0.0, None, FrameObservations(z, np.tile(1e-4 * np.eye(2), (2, 1, 1))), None, 0))
    seen = restated.widened(SENSOR)
    assert (seen.max_range, seen.min_angle, seen.max_angle) == (7.0, -1.5, 1.0)


@pytest.mark.parametrize(
    "index", [42, *(pytest.param(i, marks=pytest.mark.slow) for i in (28, 32))]
)  # of range, of view, of both
@pytest.mark.slow
def test_landmarks_are_not_mapped_several_times_where_noise_or_view_are_understated(index):
    log = log_of(draw(index))
    run = step_by_step("ekf", log.inputs().without_map(), "slam", HINDSIGHT)
    visible = len(np.unique(log.truth.landmark_of[log.truth.landmark_of >= 0]))
    assert len(run.map) == pytest.approx(visible, rel=0.1)


def test_the_decider_moves_reads_and_pairs_with_the_noise_that_there_is(monkeypatch):
    inputs = named_log("arena:0:frames=20").inputs().without_map()
    first, second = inputs.frame(0), inputs.frame(1)

    def decided(shares):
        """Growth of the pose's variance by the motion, covariance of three landmarks, and S of the second frame."""
        monkeypatch.setattr(Restated, "fit", lambda *_: shares)
        mapper = MappingFrontEnd("ekf", HINDSIGHT, inputs, Setup())
        mapper.move(first)
        before = mapper.filter.estimate().covariance
        mapper.associate(first)
        known = mapper.filter.position(np.arange(3))[1]
        mapper.move(second)
        return np.trace(mapper.filter.estimate().covariance - before), known, mapper.associate(second).S

    plain, moving, reading = (decided(s) for s in (AS_STATED, Shares(1.0, 1.0, 9.0), Shares(4.0, 9.0, 1.0)))
    assert moving[0] > 3.0 * plain[0]
    # what NIS may be expected of pairings that passed a gate is said where the gate is by the stated noise
    assert plain[2] is not None
    assert moving[2] is None
    # a landmark is as uncertain as its reading, and as the pose, whose share stays as it is
    assert np.all(np.linalg.eigvalsh(reading[1] - plain[1]) > 0.0)
    assert np.trace(reading[1]) > 2.0 * np.trace(plain[1])
