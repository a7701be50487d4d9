"""SLAM whose decisions are revised: people in the corridor, retracted in the end."""

import numpy as np
import pytest

from data.result import DISCARD
from data.worlds.registry import named_log
from eval.referee.score import confusion_of
from eval.replay.hindsight.ledger import REASSOCIATED
from eval.replay.run import compare
from eval.replay.settings import Setup
from tests.quick import slow

METHOD = "jcbb-hindsight"


@pytest.fixture(scope="module", params=[(7,), pytest.param((4, 11), marks=pytest.mark.slow)], ids=str)
def people(request):
    return [named_log(f"corridor:{seed}:people") for seed in request.param]


@pytest.fixture(scope="module")
def runs(people):
    return {name: [compare(log.inputs(), "slam", [name], METHOD)[0] for log in people] for name in ("ekf", "isam2")}


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_people_are_retracted_and_points_are_kept(people, runs, name):
    for log, run in zip(people, runs[name]):
        online, final = confusion_of(run, log, "online"), confusion_of(run, log, "final")
        known = int((log.truth.landmark_of >= 0).sum()) - 88  # the first observation of each point initializes it
        assert online.fp > final.fp
        assert final.fp <= 8
        assert final.tp >= 0.96 * known
        assert 86 <= len(run.map) <= 90


def test_a_retracted_landmark_is_out_of_the_map_with_every_decision_for_it(runs):
    for run in runs["ekf"] + runs["isam2"]:
        gone = np.flatnonzero(run.removed >= 0)
        assert len(gone)
        assert not np.isin(run.map.number, gone).any()
        assert not np.isin(run.final_decisions, gone).any()
        left = run.initialized
        assert not np.isin(left, gone).any()
        # who is in the map was initialized once, and is seen as often as it says
        assert sorted(left[left >= 0]) == run.map.number.tolist()
        assert run.map.times_seen.tolist() == [(run.final_decisions == n).sum() + 1 for n in run.map.number]


def test_events_come_in_the_order_of_frames_and_name_their_reason(runs):
    for run in runs["ekf"]:
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
