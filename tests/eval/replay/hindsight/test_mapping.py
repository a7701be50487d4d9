"""SLAM over a window: after a round with wrong odometry, what was initialized again is recognized and merged; people in
the corridor are retracted in the end.
"""

from collections import Counter

import numpy as np
import pytest

from data import se2
from data.inputs import Increment, Systematic
from data.motion.systematic import CURVATURE, LEFT, RIGHT, SCALE, corrected
from data.notice import Code
from data.result import DISCARD, NEW, revised
from data.sensors import RangeBearing, RelativePoint
from data.worlds.registry import named_log
from eval.referee.score import confusion_of
from eval.replay.batch import batch
from eval.replay.hindsight.ledger import MERGED, REASSOCIATED
from eval.replay.hindsight.mapper import TIGHT, with_tight
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup
from tests.builders.logs import increments_of, inputs_of, observations_of, still
from tests.quick import slow

METHOD = "jcbb-hindsight"
PLACE = np.array([SCALE, CURVATURE, LEFT, RIGHT])
ERRORS = np.array([0.0, 0.0015, 0.04, 0.01])
M = np.diag([0.02, 0.01, 0.004]) ** 2
R = 0.3**2 * np.eye(2)


def park(seed, *, rounds=2.2, trees=90, seen=0.25, radius=55.0):
    """(Inputs, true poses (N, 3), true id of each observation (M,)): rounds of 350 m among trees, few seen at a time,
    with odometry that errs in system.
    """
    rng = np.random.default_rng(seed)
    sensor = RelativePoint(max_range=25.0, min_angle=-np.pi / 2, max_angle=np.pi / 2)
    frames = int(rounds * 2 * np.pi * radius)
    turn = np.full(frames, 1.0 / radius) + 0.03 * np.sin(np.arange(frames) / 17.0)
    truth, mean = [np.zeros(3)], [np.zeros(3)]
    for k in range(1, frames):
        step = np.array([1.0, 0.0, turn[k]])
        truth.append(se2.compose(truth[-1], step))
        A = corrected(Increment(step, M), np.zeros(4), PLACE, np.zeros(3)).A
        mean.append(step - A @ ERRORS + rng.multivariate_normal(np.zeros(3), M))
    truth = np.array(truth)
    xy = np.empty((0, 2))
    while len(xy) < trees:
        tree = truth[rng.integers(frames), :2] + rng.uniform(-18.0, 18.0, 2)
        if np.hypot(*(truth[:, :2] - tree).T).min() > 2.0 and np.all(np.hypot(*(xy - tree).T) > 2.0):
            xy = np.vstack([xy, tree])
    frame, z, who = [], [], []
    for k in range(frames):
        there = sensor.predict(truth[k], xy)
        looked = sensor.in_view(there) & (rng.random(trees) < seen)
        for i in np.flatnonzero(looked & (np.hypot(*there.T) < 20.0)):
            frame.append(k)
            z.append(there[i] + rng.multivariate_normal(np.zeros(2), R))
            who.append(i)
    return inputs_of(increments_of(mean, M), observations_of(frame, z, R), sensor), truth, np.array(who)


@pytest.fixture(scope="module")
def world():
    return park(2)


@pytest.fixture(scope="module")
def runs(world):
    return {"ekf": step_by_step("ekf", world[0], "slam", METHOD)}


@pytest.fixture(scope="module")
def both(world, runs):
    return runs | {"isam2": step_by_step("isam2", world[0], "slam", METHOD)}


def who_is_who(run, who):
    """Observations of each landmark by true id, final decisions."""
    number = np.where(run.final_decisions == NEW, run.initialized, run.final_decisions)
    return {n: Counter(who[number == n].tolist()) for n in np.unique(number[number >= 0]).tolist()}


def rmse(pose, truth):
    return np.sqrt(np.mean(np.sum((pose - truth)[:, :2] ** 2, axis=1)))


@pytest.mark.slow
def test_a_round_later_every_tree_is_one_landmark_again(world, both):
    inputs, _, who = world
    assert len(step_by_step("ekf", inputs, "slam", "jcbb").map) > 150
    for run in both.values():
        found = who_is_who(run, who)
        assert run.failure is None
        assert len(found) == len(run.map) <= 92
        assert len({c.most_common(1)[0][0] for c in found.values()}) >= 86
        assert sum(c.most_common(1)[0][1] for c in found.values()) >= 0.99 * sum(c.total() for c in found.values())


@pytest.mark.slow
def test_the_smoothers_path_is_mended_by_what_it_took_back(world, both):
    inputs, truth, _ = world
    run = both["isam2"]
    assert rmse(run.online.pose, truth) > 5.0
    assert rmse(run.final.pose, truth) < 1.5
    again = batch("batch", inputs, run)
    assert rmse(again.final.pose, truth) < 1.5
    np.testing.assert_allclose(again.final.pose, run.final.pose, atol=0.02)


def test_merged_landmarks_give_all_their_sightings_to_the_older_one(runs):
    run = runs["ekf"]
    merged = [e for e in run.events if e.why == MERGED]
    assert len(merged) > 20
    assert all(0 <= e.new < (e.old if e.old >= 0 else run.created[e.observation]) for e in merged)
    gone = {int(run.created[e.observation]) for e in merged if e.old == NEW}
    assert len(gone) >= 8
    assert not gone & set(run.map.number.tolist())
    assert all(run.removed[n] >= 0 for n in gone)
    assert np.array_equal(revised(run.decisions, run.events), run.final_decisions)
    left = run.initialized
    assert sorted(left[left >= 0]) == run.map.number.tolist()
    assert Code.MERGED in [note.code for note in run.notes]


def test_what_was_seen_in_one_frame_is_never_merged(world, runs):
    inputs, run = world[0], runs["ekf"]
    number = np.where(run.created >= 0, run.created, run.decisions)
    at = {}
    for e in run.events:
        if e.why == MERGED and e.old == NEW:
            at[int(run.created[e.observation])] = e.new
    frames = {n: set(inputs.observations.frame[number == n].tolist()) for n in np.unique(number[number >= 0]).tolist()}
    assert at
    assert all(not frames[a] & frames[b] for a, b in at.items())


def standing(frames, step, seen):
    """Inputs of a robot that moves by `step` [m] sideways to its view; `seen(k)` (n, 2): points it sees in frame k."""
    points = [(k, p - [0.0, k * step]) for k in range(frames) for p in seen(k)]
    observations = observations_of([k for k, _ in points], [p for _, p in points], 0.3**2)
    increments = increments_of(np.tile([0.0, step, 0.0], (frames, 1)), np.diag([1e-4, 1e-4, 1e-6]))
    return inputs_of(increments, observations, RelativePoint(max_range=40.0))


def test_a_point_that_comes_in_view_beside_another_is_a_landmark_of_its_own():
    """It stands 1 m from one that is known well by then, inside the gate of new landmarks; both are seen ever after."""
    both = np.array([[5.0, 0.0], [6.0, 0.2], [8.0, 6.0]])
    run = step_by_step("ekf", standing(30, 0.05, lambda k: both[[0, 2]] if k < 5 else both), "slam", METHOD)
    assert len(run.map) == 3
    np.testing.assert_allclose(run.map.xy[np.argsort(run.map.xy[:, 0])], both, atol=0.05)
    assert len(set(np.where(run.created >= 0, run.created, run.final_decisions)[-3:].tolist())) == 3


def test_what_was_seen_on_the_way_does_not_choose_among_old_landmarks():
    """Four new ones are followed after a slip of some metres; then comes a reading that the old one would explain."""
    old, new = np.array([[6.0, 0.0]]), np.array([[35.0, 4.0 * j] for j in (-3, -1, 1, 3)])
    other = np.array([[7.5, 1.0]])
    inputs = standing(12, 0.0, lambda k: old if k < 5 else new if k < 9 else np.vstack([new, other]))
    inputs.increments.covariance.flags.writeable = True
    inputs.increments.covariance[5] = np.diag([36.0, 36.0, 1e-8])
    run = step_by_step("ekf", inputs, "slam", METHOD)
    assert np.where(run.created >= 0, run.created, run.decisions)[-15:].tolist() == [1, 2, 3, 4, 5] * 3


def test_a_reading_at_no_range_at_all_is_a_reading():
    """Landmarks may stand where the robot drives: the range is zero then, and the bearing is of nothing."""
    near, frames = np.array([[0.0, 0.3], [6.0, 0.0], [6.0, 4.0], [6.0, -4.0]]), 6
    sensor = RangeBearing(max_range=20.0)
    z = np.concatenate([sensor.predict(np.zeros((4, 3)), near)] * frames)
    z[[8, 16], 0] = 0.0
    seen = observations_of(np.repeat(np.arange(frames), 4), z, np.diag([0.2, 0.05]) ** 2)
    run = step_by_step("ekf", inputs_of(still(frames), seen, sensor), "slam", METHOD)
    assert run.failure is None
    assert run.decisions[[8, 16]].tolist() == [0, 0]


@pytest.mark.parametrize(("step", "stays"), [(0.0, True), (0.6, False)])
def test_what_is_hidden_from_one_place_is_missed_once(step, stays):
    """Five frames with all points, then twenty without the last: from one place it is hidden, from others gone."""
    points = np.stack([np.full(9, 5.0), np.linspace(-12.0, 12.0, 9)], 1)
    points = np.vstack([points[:4], points[5:], points[4:5]])
    run = step_by_step("ekf", standing(25, step, lambda k: points if k < 5 else points[:8]), "slam", METHOD)
    assert set(range(8)) <= set(run.map.number.tolist())
    assert (8 in run.map.number) is stays


def test_who_decides_keeps_its_own_errors_beside_those_of_the_run():
    both = with_tight(Systematic(("curvature", "bearing"), np.array([0.05, 0.1])))
    assert both.names == ("scale", "curvature", "left", "right", "drift", "bearing")
    assert both.sigma.tolist() == [0.02, 0.05, 0.05, 0.05, 1.25e-3, 0.1]
    assert with_tight(None) is TIGHT


@pytest.fixture(scope="module", params=[(7,), pytest.param((4, 11), marks=pytest.mark.slow)], ids=str)
def people(request):
    return [named_log(f"corridor:{seed}:people") for seed in request.param]


@pytest.fixture(scope="module")
def laid(people):
    return {name: [compare(log.inputs(), "slam", [name], METHOD)[0] for log in people] for name in ("ekf", "isam2")}


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_people_are_retracted_and_points_are_kept(people, laid, name):
    for log, run in zip(people, laid[name]):
        online, final = confusion_of(run, log, "online"), confusion_of(run, log, "final")
        known = int((log.truth.landmark_of >= 0).sum()) - 88  # the first observation of each point initializes it
        assert online.fp > final.fp
        assert final.fp <= 8
        assert final.tp >= 0.96 * known
        assert 86 <= len(run.map) <= 90


def test_a_retracted_landmark_is_out_of_the_map_with_every_decision_for_it(laid):
    for run in laid["ekf"] + laid["isam2"]:
        gone = np.flatnonzero(run.removed >= 0)
        assert len(gone)
        assert not np.isin(run.map.number, gone).any()
        assert not np.isin(run.final_decisions, gone).any()
        left = run.initialized
        assert not np.isin(left, gone).any()
        # who is in the map was initialized once, and is seen as often as it says
        assert sorted(left[left >= 0]) == run.map.number.tolist()
        assert run.map.times_seen.tolist() == [(run.final_decisions == n).sum() + 1 for n in run.map.number]


def test_events_come_in_the_order_of_frames_and_name_their_reason(laid):
    for run in laid["ekf"]:
        frames = [e.frame for e in run.events]
        assert frames == sorted(frames)
        assert {e.why for e in run.events} <= {"moved", "missed", "uncertain", REASSOCIATED}
        assert {e.why for e in run.events if e.frame < frames[-1]} >= {"missed"}
        assert {e.new for e in run.events if e.why != REASSOCIATED} == {DISCARD}


@pytest.mark.parametrize(
    "setup", [Setup(maintain=True), slow(Setup(forget_after=8.0)), slow(Setup(deactivate_after=8.0))]
)
def test_hindsight_goes_with_the_other_ways_out_of_the_map(people, setup):
    log = people[0]
    plain, run = (compare(log.inputs(), "slam", ["ekf"], method, setup)[0] for method in ("jcbb", METHOD))
    assert run.failure is None
    assert confusion_of(run, log, "final").fp < 0.8 * confusion_of(plain, log, "final").fp
