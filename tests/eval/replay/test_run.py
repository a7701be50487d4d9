"""The replay with unknown labels: both estimators decide for themselves, the map is kept up, failures are told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from association.decide import METHODS
from data.errors import UsageError
from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Observations, Prior
from data.result import DISCARD, NEW
from data.sensors import RangeBearing, RelativePoint
from data.worlds.arena import Arena, simulate
from data.worlds.corridor import Corridor
from data.worlds.corridor import simulate as corridor
from ekf.filter import FilterOptions
from eval.referee.score import association_row, confusion_of
from eval.replay import run as replay
from eval.replay.frontend import FrontEnd
from eval.replay.map_management import MapManagement
from eval.replay.run import compare, filter_known, step_by_step
from eval.replay.settings import Setup

LAB = Setup(gate=0.99, new_gate=0.99)


@pytest.fixture(scope="module")
def lab():
    return corridor(Corridor(), 0)


@pytest.fixture(scope="module")
def crowded():
    return corridor(Corridor(people=True), 0)


def slam(log, *, labels=False):
    return log.inputs(labels=labels).without_map()


def linear_world(seed, frames=25):
    """SLAM with the heading known exactly and a Cartesian sensor: linear and Gaussian, landmarks 0.8 m apart."""
    rng = np.random.default_rng(seed)
    landmarks = np.array([(0.8 * i, 0.8 * j) for i in range(5) for j in range(4)])
    at, mean, frame, z = np.array([1.0, 1.0]), np.zeros((frames, 3)), [], []
    for k in range(frames):
        if k:
            step = rng.uniform(-0.5, 0.5, 2)
            at, mean[k, :2] = at + step, step + rng.normal(0.0, 0.05, 2)
        seen = np.flatnonzero(np.hypot(*(landmarks - at).T) < 2.0)
        frame += [k] * len(seen)
        z += list(landmarks[seen] - at + rng.normal(0.0, 0.08, (len(seen), 2)))
    covariance = np.tile(np.diag([0.05**2, 0.05**2, 1e-11]), (frames, 1, 1))
    covariance[0] = 0.0
    R = np.tile(0.08**2 * np.eye(2), (len(z), 1, 1))
    prior = Prior(np.array([1.0, 1.0, 0.0]), np.diag([0.01, 0.01, 1e-11]))
    return Inputs(
        prior, np.arange(frames, dtype=float), Increments(mean, covariance),
        Observations(np.array(frame, np.int64), np.array(z), R), RelativePoint(),
    )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [0, 1])
def test_on_a_linear_world_filter_and_smoother_decide_alike_over_the_whole_run(method, seed):
    inputs = linear_world(seed)
    ekf, isam2 = compare(inputs, "slam", ["ekf", "isam2"], method)
    assert ekf.failure is None
    assert isam2.failure is None
    np.testing.assert_array_equal(ekf.decisions, isam2.decisions)
    np.testing.assert_array_equal(ekf.created, isam2.created)
    assert (ekf.decisions >= 0).sum() > 20
    np.testing.assert_allclose(ekf.online.pose, isam2.online.pose, atol=1e-6)
    # iSAM2 updates a landmark only when it moves by more than a part of the relinearization threshold
    np.testing.assert_allclose(ekf.innovations.nis, isam2.innovations.nis, rtol=5e-3, atol=0.05)


def test_labels_are_withheld_from_every_method_but_known(lab):
    assert slam(lab, labels=True).without_labels().frame(0).label is None
    shuffled = replace(lab, truth=replace(lab.truth, landmark_of=lab.truth.landmark_of[::-1].copy()))
    a, b = (compare(x.inputs(labels=True), "slam", ["ekf"], "nn")[0] for x in (lab, shuffled))
    np.testing.assert_array_equal(a.decisions, b.decisions)


def test_known_without_labels_is_refused(lab):
    with pytest.raises(ValueError, match="not granted"):
        step_by_step("ekf", slam(lab), "slam")


def test_labels_frame_by_frame_make_the_decisions_of_the_whole_run(crowded):
    inputs = slam(crowded, labels=True)
    whole, steps = filter_known(inputs, "slam"), step_by_step("ekf", inputs, "slam")
    np.testing.assert_array_equal(whole.decisions, steps.decisions)
    np.testing.assert_array_equal(whole.created, steps.created)
    np.testing.assert_array_equal(whole.online.pose, steps.online.pose)


def test_a_batch_takes_the_decisions_of_isam2_or_of_the_filter_if_there_is_no_isam2(lab):
    inputs = slam(lab, labels=True)
    _, isam2, batch = compare(inputs, "slam", ["ekf", "isam2", "batch"], "nn")
    np.testing.assert_array_equal(batch.final_decisions, isam2.final_decisions)
    assert batch.notes == ("decisions made by isam2",)
    ekf, alone = compare(inputs, "slam", ["ekf", "batch"], "nn")
    np.testing.assert_array_equal(alone.decisions, ekf.decisions)
    assert alone.notes == ("decisions made by ekf",)
    assert not np.array_equal(ekf.decisions, isam2.decisions)


def test_localization_with_unknown_labels_never_founds_a_landmark():
    log = simulate(Arena(frames=60, landmarks=20), 3)
    for run in compare(log.inputs(labels=True), "localization", ["ekf", "isam2", "batch"], "jcbb"):
        assert run.failure is None
        assert (run.decisions != NEW).all()
        counts = confusion_of(run, log, "final")
        assert counts.tp > 0.98 * len(run.decisions)
        assert counts.tn == 0


def test_the_cut_to_what_is_in_view_asks_for_fewer_candidates_and_is_the_same_where_it_cuts_nothing(lab):
    inputs = slam(lab)
    asked = {}
    for in_view in (False, True):
        front, sizes = FrontEnd("ekf", "jcbb", inputs, Setup(in_view=in_view)), []
        for k in range(len(inputs)):
            front.move(inputs.frame(k))
            sizes.append(len(front.expect(inputs.sightings(k)).number))
            front.update(inputs.frame(k), front.associate(inputs.frame(k)))
        asked[in_view] = sizes
    assert max(asked[False]) == 88
    assert max(asked[True]) < 40


def test_map_maintenance_removes_what_was_seen_once_from_filter_and_graph(crowded):
    setup = Setup(maintain=True)
    for name in ("ekf", "isam2"):
        run = step_by_step(name, slam(crowded), "slam", "jcbb", setup)
        founded = np.flatnonzero(run.created >= 0)
        times = np.bincount(np.where(run.created >= 0, run.created, run.decisions)[run.decisions != DISCARD])
        frame = crowded.recorded.observations.frame
        last = len(crowded.recorded) - 1
        for i in founded:
            n = run.created[i]
            gone = run.removed[n]
            assert (gone == frame[i] + 3) == (times[n] == 1 and frame[i] + 3 <= last)
            assert (run.final_decisions[i] == DISCARD) == (gone >= 0)
            assert (n in run.map.number) == (gone < 0)
        assert (run.removed >= 0).sum() > 5
        np.testing.assert_array_equal(run.decisions[founded], NEW)


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


def test_a_filter_that_failed_decided_nothing_after_and_is_counted_nowhere(lab):
    inputs = slam(lab, labels=True)
    z = inputs.observations.z.copy()
    frame = inputs.observations.frame
    broken = replace(inputs, observations=replace(inputs.observations, z=np.where((frame == 9)[:, None], 1e200, z)))
    run = filter_known(broken, "slam")
    assert run.failure is not None
    after = frame >= run.failure.frame
    assert set(run.decisions[after]) == {DISCARD}
    assert (run.created[after] == -1).all()
    assert association_row(run, "final", lab) is None


def test_parked_landmarks_come_back_and_nothing_is_lost(lab):
    inputs = slam(lab, labels=True)
    whole = filter_known(inputs, "slam")
    run = step_by_step("ekf", inputs, "slam", setup=Setup(deactivate_after=5))
    assert run.state_size.max() < whole.state_size.max()
    np.testing.assert_array_equal(run.decisions, whole.decisions)
    np.testing.assert_allclose(run.online.pose, whole.online.pose, atol=1e-9)
    np.testing.assert_allclose(run.online.covariance, whole.online.covariance, atol=1e-11)
    np.testing.assert_allclose(run.map.xy, whole.map.xy, atol=1e-9)
    assert "taken back" in run.notes[0]


def test_parked_landmarks_are_candidates_again_when_they_may_be_seen(lab):
    inputs = slam(lab)
    whole = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True))
    run = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True, deactivate_after=5))
    np.testing.assert_array_equal(run.decisions, whole.decisions)
    np.testing.assert_allclose(run.online.pose, whole.online.pose, atol=1e-9)


def test_a_search_out_of_budget_is_told(lab, monkeypatch):
    real = replay.FrontEnd.decide
    monkeypatch.setattr(
        replay.FrontEnd, "decide", lambda self, e, method=None: real(self, e, method)._replace(complete=False)
    )
    run = step_by_step("ekf", slam(lab), "slam", "jcbb")
    assert "ran out of its 50000 nodes in 44 frames" in run.notes[0]


def test_a_singular_innovation_covariance_is_a_failure_with_frame_and_reason(lab):
    inputs = slam(lab)
    o = inputs.observations
    R = o.R.copy()
    R[o.frame == 7] = -np.eye(2)
    run = step_by_step("ekf", replace(inputs, observations=Observations(o.frame, o.z, R)), "slam", "nn")
    assert run.failure.status == "diverged"
    assert run.failure.frame == 7
    assert "positive definite" in run.failure.why
    assert np.isfinite(run.online.pose[:7]).all()


def test_association_goes_observation_by_observation_where_updates_do():
    log = simulate(Arena(frames=40, landmarks=12), 1)
    run = step_by_step("ekf", slam(log), "slam", "ml", options=FilterOptions(each=True))
    assert run.failure is None
    assert confusion_of(run, log, "online").tp > 0.8 * len(run.decisions)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["ekf", "isam2"])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_odd_frames_are_no_reason_to_stop(name, method, task):
    """Nothing seen, one landmark seen 60 times, two landmarks at one place, one at the robot, one beyond range."""
    n = 6
    landmarks = LandmarkMap(np.arange(4), np.array([[2.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 40.0]]))
    frame, z = [], []
    for k, ranges in enumerate(([2.0, 1e-3], [], [2.0] * 60, [2.0, 40.0], [1e-3], [2.0])):
        frame += [k] * len(ranges)
        z += [(r, 0.0 if r < 30 else math.pi / 2) for r in ranges]
    covariance = np.tile(1e-4 * np.eye(3), (n, 1, 1))
    covariance[0] = 0.0
    time = np.arange(n, dtype=float)
    o = Observations(np.array(frame), np.array(z), np.tile(np.diag([1e-2, 1e-3]), (len(z), 1, 1)))
    inputs = Inputs(
        Prior(np.zeros(3), 1e-4 * np.eye(3)),
        time,
        Increments(np.zeros((n, 3)), covariance),
        o,
        RangeBearing(),
        landmarks,
    )
    run = step_by_step(name, inputs if task == "localization" else inputs.without_map(), task, method)
    if run.failure is None:
        assert np.isfinite(run.online.pose).all()
        assert np.isfinite(run.online.covariance).all()
    else:
        assert run.failure.why
    assert len(run.decisions) == len(z)


def test_an_unknown_method_or_estimator_is_refused_by_name(lab):
    with pytest.raises(UsageError, match="nearest"):
        step_by_step("ekf", slam(lab), "slam", "nearest")
    with pytest.raises(UsageError, match="batch"):
        step_by_step("batch", slam(lab), "slam", "nn")
