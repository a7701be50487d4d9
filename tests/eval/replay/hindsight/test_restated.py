"""What is stated of odometry and sensor is put right where a log shows more noise, or a wider view."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Frame, FrameObservations, Increment
from data.notice import Code, notice
from data.sensors import RangeBearing
from data.worlds.registry import named_log
from eval.replay.hindsight.mapper import MappingFrontEnd
from eval.replay.hindsight.noise import AS_STATED, Restated, Shares
from eval.replay.run import step_by_step
from eval.replay.settings import HINDSIGHT, Setup
from tests.research.variety.worlds import draw, log_of

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


def test_the_decider_moves_and_pairs_with_the_noise_that_there_is(monkeypatch):
    inputs = named_log("arena:0:frames=20").inputs().without_map()
    first, second = inputs.frame(0), inputs.frame(1)
    found = {}
    for motion in (1.0, 9.0):
        monkeypatch.setattr(Restated, "fit", lambda *_, motion=motion: Shares(1.0, 1.0, motion))
        mapper = MappingFrontEnd("ekf", HINDSIGHT, inputs, Setup())
        mapper.move(first)
        before = mapper.filter.estimate().covariance
        mapper.associate(first)
        mapper.move(second)
        grown = np.trace(mapper.filter.estimate().covariance - before)
        found[motion] = grown, mapper.associate(second).S
    assert found[9.0][0] > 3.0 * found[1.0][0]
    # what NIS may be expected of pairings that passed a gate is said where the gate is by the stated noise
    assert found[1.0][1] is not None
    assert found[9.0][1] is None


def test_the_decider_gets_readings_with_the_noise_that_there_is(monkeypatch):
    inputs = named_log("arena:0:frames=20").inputs().without_map()
    monkeypatch.setattr(Restated, "fit", lambda *_: Shares(4.0, 9.0, 1.0))
    mapper = MappingFrontEnd("ekf", HINDSIGHT, inputs, Setup())
    mapper.move(inputs.frame(0))
    wide = mapper.filter
    mapper.associate(inputs.frame(0))
    plain = MappingFrontEnd("ekf", HINDSIGHT, inputs, Setup())
    monkeypatch.setattr(Restated, "fit", lambda *_: AS_STATED)
    plain.move(inputs.frame(0))
    plain.associate(inputs.frame(0))
    known = [m.position(np.arange(3))[1] for m in (wide, plain.filter)]
    # a landmark is as uncertain as its reading, and as the pose, whose share stays as it is
    assert np.all(np.linalg.eigvalsh(known[0] - known[1]) > 0.0)
    assert np.trace(known[0]) > 2.0 * np.trace(known[1])


@pytest.mark.slow
def test_an_honest_log_is_decided_as_before():
    log = named_log("arena:0:frames=60")
    run = step_by_step("ekf", log.inputs().without_map(), "slam", HINDSIGHT)
    assert Code.LARGER_SIGMAS not in [note.code for note in run.notes]
