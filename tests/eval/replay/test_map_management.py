"""The map is kept up during a run: landmarks seen once are removed, old ones forgotten or parked."""

from __future__ import annotations

import numpy as np

from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Prior
from data.notice import Code
from data.result import DISCARD, NEW
from data.sensors import RangeBearing
from eval.referee.score import confusion_of
from eval.replay import run as replay
from eval.replay.map_management import MapManagement
from eval.replay.run import compare, filter_known, step_by_step
from eval.replay.settings import Setup
from tests.eval.replay.worlds import slam


def test_map_maintenance_removes_what_was_seen_once_from_filter_and_graph(crowded):
    setup = Setup(maintain=True)
    for name in ("ekf", "isam2"):
        run = step_by_step(name, slam(crowded), "slam", "jcbb", setup)
        initialized = np.flatnonzero(run.created >= 0)
        times = np.bincount(np.where(run.created >= 0, run.created, run.decisions)[run.decisions != DISCARD])
        frame = crowded.recorded.observations.frame
        last = len(crowded.recorded) - 1
        for i in initialized:
            n = run.created[i]
            gone = run.removed[n]
            assert (gone == frame[i] + 3) == (times[n] == 1 and frame[i] + 3 <= last)
            assert (run.final_decisions[i] == DISCARD) == (gone >= 0)
            assert (n in run.map.number) == (gone < 0)
        assert (run.removed >= 0).sum() > 5
        np.testing.assert_array_equal(run.decisions[initialized], NEW)


def test_a_batch_after_map_maintenance_knows_nothing_of_what_was_removed(crowded):
    isam2, batch = compare(slam(crowded), "slam", ["isam2", "batch"], "jcbb", Setup(maintain=True))
    np.testing.assert_array_equal(batch.map.number, isam2.map.number)
    np.testing.assert_allclose(batch.final.pose, isam2.final.pose, atol=1e-5)
    np.testing.assert_array_equal(batch.final_decisions, isam2.final_decisions)
    assert batch.total_nis[1] == isam2.total_nis[1]


def test_a_removed_landmark_is_founded_again_under_a_new_number_with_labels_too():
    """One landmark seen in frames 0 and 9 only, another in all: the first is removed in between."""
    n = 12
    landmarks = LandmarkMap(np.array([4, 9]), np.array([[3.0, 1.0], [2.0, -1.0]]))
    frame, label = [], []
    for k in range(n):
        frame.append(k)
        label.append(9)
        if k in (0, 9):
            frame.append(k)
            label.append(4)
    sensor = RangeBearing()
    z = np.array([sensor.predict(np.zeros(3), landmarks.xy[np.searchsorted(landmarks.id, [i])])[0] for i in label])
    covariance = np.tile(1e-4 * np.eye(3), (n, 1, 1))
    covariance[0] = 0.0
    time = np.arange(n, dtype=float)
    o = LabelledObservations(np.array(frame), z, np.tile(1e-3 * np.eye(2), (len(z), 1, 1)), np.array(label))
    inputs = Inputs(Prior(np.zeros(3), 1e-4 * np.eye(3)), time, Increments(np.zeros((n, 3)), covariance), o, sensor)
    for name in ("ekf", "isam2"):
        run = step_by_step(name, inputs, "slam", setup=Setup(maintain=True))
        assert run.created[run.created >= 0].tolist() == [0, 1, 2]
        assert run.removed.tolist() == [-1, 3, -1]
        assert run.map.number.tolist() == [0, 2]


def test_a_forgotten_landmark_is_gone_from_the_state_but_its_pairings_stay(lab):
    inputs = slam(lab, labels=True)
    run = step_by_step("ekf", inputs, "slam", setup=Setup(forget_after=5))
    whole = filter_known(inputs, "slam")
    assert run.state_size.max() < 3 + 2 * 60 < whole.state_size.max()
    assert (run.removed >= 0).sum() > 30
    np.testing.assert_array_equal(run.decisions, run.final_decisions)
    counts = confusion_of(run, lab, "final")
    assert counts.fp == counts.fn == 0
    batch = replay.batch("batch", inputs, run)
    assert batch.failure is None
    assert len(batch.map) == (run.created >= 0).sum()


def test_forgetting_is_the_filters_alone_and_leaves_the_graph_whole(lab):
    inputs = slam(lab, labels=True)
    (whole,) = compare(inputs, "slam", ["isam2"])
    (run,) = compare(inputs, "slam", ["isam2"], setup=Setup(forget_after=5))
    np.testing.assert_array_equal(run.online.pose, whole.online.pose)
    assert len(run.map) == len(whole.map)


def test_a_parked_landmark_that_was_taken_back_unseen_is_still_forgotten_in_time():
    management = MapManagement(Setup(deactivate_after=2.0, forget_after=6.0))

    def leaving_after(k):
        management.begin(k, float(k))
        return management.leaving()

    management.see(np.array([0]))
    assert [leaving_after(k).parked.tolist() for k in range(4)] == [[], [], [], [0]]
    management.begin(4, 4.0)
    management.restored(np.array([0]))
    assert leaving_after(6).parked.tolist() == []
    leaving = leaving_after(7)
    assert (leaving.parked.tolist(), leaving.forgotten.tolist()) == ([], [0])


def test_parked_landmarks_come_back_and_nothing_is_lost(lab):
    inputs = slam(lab, labels=True)
    whole = filter_known(inputs, "slam")
    run = step_by_step("ekf", inputs, "slam", setup=Setup(deactivate_after=5))
    assert run.state_size.max() < whole.state_size.max()
    np.testing.assert_array_equal(run.decisions, whole.decisions)
    np.testing.assert_allclose(run.online.pose, whole.online.pose, atol=1e-9)
    np.testing.assert_allclose(run.online.covariance, whole.online.covariance, atol=1e-11)
    np.testing.assert_allclose(run.map.xy, whole.map.xy, atol=1e-9)
    assert run.notes[0].code is Code.PARKED
    assert run.notes[0].named["restored"] > 0


def test_parked_landmarks_are_candidates_again_when_they_may_be_seen(lab):
    inputs = slam(lab)
    whole = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True))
    run = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True, deactivate_after=5))
    np.testing.assert_array_equal(run.decisions, whole.decisions)
    np.testing.assert_allclose(run.online.pose, whole.online.pose, atol=1e-9)
