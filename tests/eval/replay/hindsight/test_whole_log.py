"""The end of a log in hindsight: all is paired anew on the smoothed path, by all estimators alike."""

from dataclasses import replace

import numpy as np
import pytest

from association.expectation import gate_threshold
from data.inputs import Frame, FrameObservations, Increment, Prior
from data.notice import Code, notice
from data.result import CHI_SQUARE, DISCARD, NEW, MapState, revised
from data.sensors import RangeBearing
from data.worlds import park
from data.worlds.registry import named_log
from eval.referee.consistency import gated, nis_bounds
from eval.referee.score import confusion_of, nis_of
from eval.replay.hindsight import constants, whole_log
from eval.replay.hindsight.final_association import nis_left
from eval.replay.hindsight.ledger import REASSOCIATED, UNREAD, Record
from eval.replay.hindsight.noise import Restated, Shares
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Beginning, Setup
from graph.factors import UnderConstrained
from tests.builders.logs import inputs_of, observations_of, still
from tests.research.variety.worlds import draw, log_of

METHOD = "jcbb-hindsight"
SPARSE = "frames=150+landmarks=8+max_range=6+sigma_v=0.3+sigma_omega=0.1"
"""An arena in which an observation or two say most of a pose, so that residuals are much smaller than the noise."""


@pytest.fixture(scope="module")
def crowded():
    """A simulated world of 600 readings, a sixth of which is paired wrongly at first."""
    log = log_of(draw(82))
    return log, compare(log.inputs(labels=False).without_map(), "slam", ["ekf", "isam2", "batch"], METHOD)


def test_all_estimators_get_the_same(crowded):
    first, *others = crowded[1]
    for run in others:
        assert np.array_equal(run.final_decisions, first.final_decisions)
        assert np.array_equal(run.initialized, first.initialized)
        assert run.map.number.tolist() == first.map.number.tolist()


def test_isam2_ends_where_batch_does_with_the_last_decisions(crowded):
    _, isam2, batch = crowded[1]
    np.testing.assert_allclose(isam2.final.pose, batch.final.pose, atol=1e-3)
    np.testing.assert_allclose(isam2.map.xy, batch.map.xy, atol=1e-3)
    assert isam2.total_nis == pytest.approx(batch.total_nis, rel=1e-4)


def test_each_landmark_of_the_map_begins_once_and_is_there_from_its_first_reading_on(crowded):
    for run in crowded[1]:
        begun = run.initialized
        assert sorted(begun[begun >= 0]) == run.map.number.tolist()
        assert np.array_equal(begun >= 0, run.final_decisions == NEW)
        frames = crowded[0].recorded.observations.frame
        first = [frames[(begun == n) | (run.final_decisions == n)].min() for n in run.map.number]
        assert run.map.first_frame.tolist() == first
        assert run.map.times_seen.tolist() == [(run.final_decisions == n).sum() + 1 for n in run.map.number]


def test_events_lead_from_what_was_decided_to_the_end_and_each_begins_where_the_last_one_ended(crowded):
    run = crowded[1][0]
    now = run.decisions.copy()
    for e in run.events:
        assert now[e.observation] == e.old
        assert e.old != e.new
        now[e.observation] = e.new
    assert np.array_equal(now, run.final_decisions)
    assert np.array_equal(revised(run.decisions, run.events), run.final_decisions)
    late = {e.frame for e in run.events if e.why in (REASSOCIATED, UNREAD)}
    assert late == {int(run.online.pose.shape[0]) - 1}


def test_a_path_that_cannot_be_smoothed_leaves_decisions_as_they_are_and_says_so(monkeypatch):
    inputs = log_of(draw(10)).inputs(labels=False).without_map()

    def fails(*_, **__):
        raise UnderConstrained("landmark 3 hangs in the air")

    monkeypatch.setattr(whole_log, "smooth", fails)
    run = step_by_step("ekf", inputs, "slam", METHOD)
    assert all(e.why != REASSOCIATED for e in run.events)
    assert notice(Code.NO_REASSOCIATION, text="landmark 3 hangs in the air") in run.notes


def ran(name, estimators=("batch",)):
    log = named_log(name)
    return log, compare(log.inputs(labels=False).without_map(), "slam", estimators, METHOD)


@pytest.mark.parametrize("name", [
    "arena:1:frames=80", "corridor:3", f"arena:0:{SPARSE}", pytest.param("park:0:frames=500", marks=pytest.mark.slow),
])  # fmt: skip
def test_the_nis_of_the_end_is_as_expected_where_the_noise_is_as_stated(name):
    _, (run,) = ran(name)
    total, dof = nis_of(run, "final")
    lower, upper = nis_bounds(dof, gated(run, "final"))
    assert lower < total / dof < upper
    assert 0.93 < gated(run, "final")[0] < 1.0


def test_gates_leave_of_residuals_what_simulated_ones_have():
    """Used ones stay below the final gate, and those that the online gate refused return below it."""
    rng, share = np.random.default_rng(0), np.tile([0.6, 0.9], (300, 1))
    number, dof, online = np.repeat(np.arange(60), 5), 500, gate_threshold(0.99)
    a = rng.normal(size=(400_000, 2))
    x, residual, refused = (a**2).sum(axis=1), (a**2 * share[0]).sum(axis=1), (a**2 / share[0]).sum(axis=1)
    stays = x[np.where(x < online, residual, refused) < gate_threshold(constants.REASSOCIATION_GATE)]
    mean, variance = nis_left(share, number, dof, 0.99)
    assert mean == pytest.approx(1.0 - 300 * (2.0 - stays.mean()) / dof, abs=3e-3)
    assert variance == pytest.approx(2.0 - 300 * (4.0 - stays.var()) / dof, abs=2e-2)
    assert nis_left(share, number, dof, None)[0] > mean
    once = np.concatenate([share, np.zeros((9, 2))]), np.concatenate([number, 60 + np.arange(9)])
    assert nis_left(*once, dof, 0.99) == pytest.approx((mean, variance))
    assert nis_left(share[:1], np.zeros(1, np.int64), dof, 0.99) == CHI_SQUARE  # nothing is observed often


@pytest.mark.parametrize("setup", [Setup(), Setup(maintain=True), Setup(forget_after=30.0)], ids=str)
def test_only_where_landmarks_were_forgotten_nothing_is_paired_anew(setup):
    run = step_by_step("ekf", log_of(draw(10)).inputs(labels=False).without_map(), "slam", METHOD, setup)
    assert run.removed is not None
    assert any(e.why == REASSOCIATED for e in run.events) == (setup.forget_after is None)


def pair_of_rounds(share=1.0):
    """A robot that stands among five landmarks and reads all of them twenty times; `share` of variances stated."""
    rng = np.random.default_rng(5)
    xy = np.array([[3.0, 0.0], [3.0, 2.0], [-2.0, 3.0], [-3.0, -2.0], [1.0, -4.0]])
    sensor, frames = RangeBearing(max_range=10.0), 20
    z = np.concatenate([sensor.predict(np.zeros(3), xy)] * frames)
    z += rng.standard_normal(z.shape) * [0.05, 0.01]
    seen = observations_of(np.repeat(np.arange(frames), 5), z, np.diag([0.05, 0.01]) ** 2 * share)
    return inputs_of(still(frames, 1e-8), seen, sensor, spread=1e-8)


def test_the_path_is_smoothed_with_the_noise_there_is_and_without_a_motion_that_nobody_knows(monkeypatch):
    asked = []

    def smooth(log, *_, **__):
        asked.append(log)
        raise UnderConstrained("enough")

    monkeypatch.setattr(whole_log, "smooth", smooth)
    sensor, M, more = RangeBearing(), np.diag([0.1, 0.2, 0.3]), np.diag([9.0, 9.0, 1.0])
    whole = whole_log.WholeLog(Beginning(Prior(np.zeros(3), np.eye(3)), sensor), 0.99)
    seen = FrameObservations(np.array([[2.0, 0.5]]), np.diag([0.04, 0.01])[None])
    for k in range(4):
        whole.move(Frame(k, float(k), Increment(np.array([1.0, 0.0, 0.1]), M) if k else None, seen, None, k))
        if k == 2:
            whole.loosen(more)
        whole.end_frame(np.zeros(3))
    restated = Restated(sensor)
    restated.shares = Shares(4.0, 9.0, 2.0)
    record = Record([(0, NEW), (1, 0), (3, 0)], (0.0, 0.0), 0.0, 0.0)
    landmarks = MapState(np.array([0]), np.ones((1, 2)), np.eye(2)[None])
    failed = whole.reassociate({0: record}, landmarks, whole_log.Assumed(sensor, restated, None))
    (log,) = asked
    np.testing.assert_allclose(log.increments.covariance[1:], [2.0 * M, 2.0 * M + more, 2.0 * M])
    np.testing.assert_allclose(log.increments.mean[1:], [[1.0, 0.0, 0.1]] * 3)
    np.testing.assert_allclose(log.observations.R, np.tile(np.diag([0.16, 0.09]), (4, 1, 1)))
    assert log.observations.frame.tolist() == [0, 1, 2, 3]
    assert failed.named["text"].endswith("enough")
    frames, stated, number = whole.settled({0: record})
    assert frames.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(stated.R, np.tile(seen.R, (4, 1, 1)))
    assert number.tolist() == [0, 0, DISCARD, 0]


def test_a_reading_that_nothing_explains_is_discarded_whatever_it_was_paired_with():
    """Two of a hundred readings, three metres off."""
    inputs = pair_of_rounds(share=100.0)
    z = inputs.observations.z.copy()
    z[[47, 88], 0] += 3.0
    run = step_by_step("ekf", replace(inputs, observations=replace(inputs.observations, z=z)), "slam", METHOD)
    assert run.final_decisions[[47, 88]].tolist() == [DISCARD, DISCARD]
    assert (run.final_decisions != DISCARD).sum() >= 96


@pytest.mark.slow
def test_half_of_the_wrong_pairings_of_a_drive_of_kilometres_are_not_made_in_hindsight():
    """The first quarter of a park of 600 trees: loops of 250 m and more, closed with two metres of doubt."""
    log = park.simulate(park.Park(frames=2000, revisits=0.75, spacing=3.9, sigma_omega=0.002), 1)
    wrong = {}
    for method in ("jcbb", "jcbb-hindsight"):
        run = step_by_step("ekf", log.inputs().without_map(), "slam", method)
        found = confusion_of(run, log, "final")
        assert run.failure is None
        assert found is not None
        wrong[method] = found.fp
    assert 2 * wrong["jcbb-hindsight"] <= wrong["jcbb"]
