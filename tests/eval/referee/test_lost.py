"""Lost estimators are detected without truth; healthy ones are not; the first frame, for runs written by hand."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data.inputs import Inputs, Observations
from data.log import Log
from data.logs import open_log
from data.notice import Code, notice, stopped
from data.result import DISCARD, Innovations, MapEstimate, Run, Trajectory
from data.sensors import RangeBearing
from eval.referee.lost import former_observations, lost
from eval.replay.run import compare
from tests.builders.logs import inputs_of, map_of, observations_of, still
from tests.eval.handmade import FRAMES, LANDMARKS, circle_log, run_with_error
from tests.eval.referee import wrecks
from tests.quick import slow


@cache
def world(name: str) -> Log:
    return open_log(name)


def found(log: Log, task: str, association: str, estimator: str = "ekf"):
    (run,) = compare(log.inputs(labels=association == "known"), task, [estimator], association)
    inputs = log.recorded if task == "localization" else log.recorded.without_map()
    return lost(run, inputs, log.granted if association == "known" else None)


@pytest.mark.parametrize("association", ["known", "jcbb"])
@pytest.mark.parametrize("way", wrecks.LOCALIZATION)
def test_localization_in_a_wrong_world_is_lost(way, association):
    assert found(wrecks.LOCALIZATION[way](world("arena:0")), "localization", association) is not None


@pytest.mark.parametrize("association", ["known", pytest.param("jcbb", marks=pytest.mark.slow)])
@pytest.mark.parametrize("way", wrecks.SLAM)
def test_slam_with_wrong_observations_is_lost(way, association):
    assert found(wrecks.LOCALIZATION[way](world("arena:0")), "slam", association) is not None


@pytest.mark.parametrize("way", ["map_rotated", "bearings_mirrored"])
def test_a_smoother_of_wrong_pairings_is_lost(way):
    assert found(wrecks.LOCALIZATION[way](world("arena:0")), "localization", "jcbb", "batch") is not None


def test_a_kidnapped_robot_is_lost_from_there_on():
    log = wrecks.kidnapped(world("arena:0"))
    for task, association in (("localization", "jcbb"), ("slam", "jcbb"), ("localization", "known")):
        assert found(log, task, association).frame == 100


@pytest.mark.parametrize("factor", [slow(0.7), slow(1.0), 1.5])
@pytest.mark.parametrize("association", ["known", "jcbb", "nn"])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_a_healthy_run_is_not_lost_whatever_its_stated_noise(task, association, factor):
    assert found(wrecks.stated(world("arena:1"), factor), task, association) is None


@pytest.mark.parametrize("name", [
    "corridor:1:people", *(pytest.param(name, marks=pytest.mark.slow) for name in ("corridor:0", "corridor:2:people"))
])  # fmt: skip
@pytest.mark.parametrize("association", ["known", "jcbb", "jcbb-hindsight"])
def test_new_places_and_people_in_the_way_are_no_reason_to_be_lost(name, association):
    assert found(world(name), "slam", association) is None


@pytest.mark.slow
def test_a_park_with_occluded_trees_is_not_lost():
    assert found(world("victoria-park"), "slam", "known") is None


LONG = 100


def inputs(each: int = 1, known_map: bool = True) -> Inputs:
    """A robot at rest that sees landmark 0, 2 m ahead, so many times in every frame."""
    frame = np.repeat(np.arange(LONG), each)
    seen = observations_of(frame, np.tile([2.0, 0.0], (len(frame), 1)))
    known = map_of([2.0, 0.0]) if known_map else None
    return inputs_of(still(LONG), seen, RangeBearing(max_range=8.0), known, spread=0.01)


def run(used, task: str = "localization", white=None, **fields) -> Run:
    """A run that used these observations, as landmark 0."""
    decisions = np.where(used, 0, DISCARD)
    path = Trajectory(np.zeros((LONG, 3)), np.tile(1e-4 * np.eye(3), (LONG, 1, 1)))
    m = len(decisions)
    if white is not None:
        nothing = np.full(LONG, np.nan)
        fields["innovations"] = Innovations(nothing, np.zeros(LONG, np.int64), nothing, white)
    return Run("ekf", "jcbb", task, path, None, None, decisions, decisions, np.full(m, -1), **fields)


def until(frame: int, each: int = 1):
    return np.repeat(np.arange(LONG), each) < frame


def test_the_first_frame_is_that_of_thirty_observations_of_which_less_than_a_tenth_is_used():
    found = lost(run(until(50)), inputs())
    assert found is not None
    assert found == notice(Code.UNPAIRED, 48, did=2, could=30.0, last=77)
    assert lost(run(np.arange(LONG) % 10 == 0), inputs()) is None
    assert lost(run(np.arange(LONG) % 11 == 10), inputs()) is not None
    found = lost(run(until(50, each=6)), inputs(each=6))
    assert found == notice(Code.UNPAIRED, 50, did=0, could=60.0, last=59)
    assert lost(run(until(LONG - 12)), inputs()) is None
    assert lost(run(until(LONG - 29)), inputs()).frame == LONG - 31  # 2 and 28, or so
    assert lost(run(until(50)), inputs(), label=np.where(until(50), 0, 77)) is None


def test_a_mapper_is_judged_after_its_first_frames_over_all_whatever_its_map():
    slam = inputs(known_map=False)
    assert lost(run(until(10), "slam"), slam) == notice(Code.HARDLY_USED, 10, share=0.0, after=10)
    assert lost(run(until(19), "slam"), slam) is None  # 9 of 90
    assert lost(run(until(18), "slam"), slam) is not None
    assert lost(run(until(50), "slam"), inputs()) is None


@pytest.mark.parametrize(("squared", "is_lost"), [(99.0, False), (101.0, True)])
def test_three_innovations_beyond_ten_sigma_in_a_row_are_absurd(squared, is_lost):
    white = np.zeros((LONG, 2))
    white[[20, 40, 41, 60, 61, 62]] = np.sqrt([0.25 * squared, 0.75 * squared])
    found = lost(run(np.ones(LONG, bool), white=white), inputs())
    assert (found is not None) == is_lost
    if is_lost:
        assert found == notice(Code.TEN_SIGMA, 60, innovations=3)


def test_in_a_row_are_those_that_were_used():
    white = np.zeros((LONG, 2))
    white[[20, 22, 24]], white[[21, 23]] = 10.0, np.nan
    assert lost(run(np.ones(LONG, bool), white=white), inputs()).frame == 20


@pytest.mark.parametrize(
    ("total", "is_lost"), [((0.0, 0), False), ((5.0, 0), False), ((990.0, 10), False), ((1010.0, 10), True)]
)
def test_a_whole_cost_of_a_hundred_per_degree_of_freedom_is_absurd(total, is_lost):
    found = lost(run(np.ones(LONG, bool), total_nis=total), inputs())
    assert found == (notice(Code.NIS, 0, per_dof=101.0, over_run=False) if is_lost else None)


GATED = (0.9, 1.5)
CHANCE = (1.8 * 0.9 * 100 + 1.0, 100)


@pytest.mark.parametrize(("share", "total", "gated", "is_lost"), [
    (50, CHANCE, GATED, True),
    (100, CHANCE, GATED, False),  # nearly all are used
    (50, (1.8 * 0.9 * 100 - 1.0, 100), GATED, False),
    (50, (CHANCE[0] * 0.29, 29), GATED, False),  # too few
    (50, (CHANCE[0] * 0.30, 30), GATED, True),
    (50, CHANCE, (1.0, 2.0), False),  # no gate, so no chance that it was filled by
    (50, None, GATED, False),
])  # fmt: skip
def test_few_pairings_that_fill_the_gate_are_by_chance(share, total, gated, is_lost):
    used = np.arange(LONG) % 100 < 100
    used[np.arange(LONG) % 2 == 1] = share == 100
    assert (lost(run(used, total_nis=total, gated=gated), inputs()) is not None) == is_lost
    assert lost(run(np.zeros(0), total_nis=total, gated=gated), inputs(each=0)) is None


def test_dead_reckoning_and_those_that_stopped_are_not_lost():
    from dataclasses import replace

    from data.result import Failure

    nothing = run(until(0))
    assert lost(nothing, inputs()) is not None
    assert lost(replace(nothing, association="none"), inputs()) is None
    assert lost(replace(nothing, failure=Failure("diverged", 3, stopped("so"))), inputs()) is None


PER_FRAME = 3


def observing(*, known_map=True):
    log = circle_log(known_map=known_map)
    r = log.recorded
    frame = np.repeat(np.arange(FRAMES), PER_FRAME)
    z = np.concatenate([np.tile(r.sensor.predict(p, LANDMARKS.xy[:1]), (PER_FRAME, 1)) for p in log.truth.pose])
    return replace(r, observations=Observations(frame, z, np.tile(0.01 * np.eye(2), (len(z), 1, 1))))


M = PER_FRAME * FRAMES


def slam(decisions=None, *, times_seen=3, first=0):
    """A run that has landmark 0 in its map where it is."""
    run = run_with_error(np.zeros(3), association="nn")
    found = MapEstimate(
        np.array([0]), LANDMARKS.xy[:1], 0.01 * np.eye(2)[None], np.array([first]), np.array([times_seen])
    )
    decisions = np.zeros(M, int) if decisions is None else decisions
    return replace(run, map=found, decisions=decisions, final_decisions=decisions, created=np.full(M, -1))


def test_a_landmark_is_expected_twenty_frames_after_it_was_made_if_it_was_seen_three_times():
    inputs = observing(known_map=False)
    could, did, looked = former_observations(slam(first=5), inputs)
    assert looked.all()
    # well inside: 0.9 of 8 m; the robot is at most 10 m from (6, 0) on its circle of 4 m
    away = np.linalg.norm(circle_log().truth.pose[:, :2] - LANDMARKS.xy[0], axis=1)
    assert could.tolist() == ((away < 7.2) & (np.arange(FRAMES) >= 25)).astype(float).tolist()
    assert did.tolist() == [3 * (k >= 25) for k in range(FRAMES)]
    seldom, done, _ = former_observations(slam(times_seen=2), inputs)
    assert not seldom.any()
    assert not done.any()
