"""A run that is lost while it maps says so, from when on; one that is not says nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from data.notice import Code, notice
from data.worlds.registry import named_log
from eval.replay.hindsight.kidnapping import Lost, Suspicion
from eval.replay.hindsight.ledger import Ledger
from eval.replay.run import compare, step_by_step
from tests.research.variety.goals import table
from tests.research.variety.measure import measure
from tests.research.variety.worlds import draw, log_of


def said(log):
    run = step_by_step("ekf", log.inputs().without_map(), "slam", "jcbb-hindsight")
    return [note for note in run.notes if note.code is Code.MAP_RESTARTED]


@pytest.mark.parametrize("index", [160, pytest.param(70, marks=pytest.mark.slow)])
def test_a_corridor_that_is_mapped_several_times_is_said_to_be(index):
    # odometry stated at a quarter, among people; RMSE is more than twice that of labels
    (note,) = said(log_of(draw(index)))
    assert note.frame >= 0
    assert note.named == {"over": None}


@pytest.mark.parametrize(
    "name", [pytest.param("corridor:0", marks=pytest.mark.slow), "corridor:0:people", "arena:0:frames=60"]
)
def test_where_all_is_well_nothing_is_said(name):
    run = step_by_step("ekf", named_log(name).inputs().without_map(), "slam", "jcbb-hindsight")
    assert not {Code.MAP_RESTARTED, Code.RETRACTED} & {note.code for note in run.notes}


@pytest.mark.slow
def test_a_map_most_of_which_was_not_found_again_is_said_to_be_no_map_or_that_of_jcbb_is_taken():
    # odometry stated at twice what it is, among people: the corridor is mapped anew on every lap
    run = step_by_step("ekf", log_of(draw(88)).inputs().without_map(), "slam", "jcbb-hindsight")
    said = {note.code for note in run.notes}
    assert said & {Code.RETRACTED, Code.MAP_FOLDED, Code.PLAIN_LIKELIER}


@pytest.mark.parametrize(
    ("often", "retracted", "share"),
    [
        ([1, 2, 3, 4], [3, 4, 5, 6], None),
        ([1, 2, 3, 4], [2, 3, 4], {"gone": 3, "often": 4}),
        ([1, 2, 3], [1, 2, 3], None),
        ([], [7], None),
    ],
)
def test_more_than_half_of_what_was_read_often_must_go(often, retracted, share):
    lost = Lost(Ledger(named_log("corridor:0").recorded.sensor))
    lost.end(often, np.array(retracted))
    assert [note.named for note in lost.notes()] == ([] if share is None else [share])


@pytest.mark.slow
def test_a_sensor_that_misses_half_of_what_is_there_is_not_lost():
    assert said(log_of(draw(34))) == []  # detection 0.54, clutter 18 %


@pytest.mark.slow
def test_the_benchmark_counts_who_said_it():
    log = log_of(draw(160))
    rows = [measure(log, 160, "corridor", method) for method in ("jcbb", "jcbb-hindsight", "known")]
    assert [r.said_lost for r in rows] == [0, 1, 0]
    assert table(rows)[-1].endswith("0 of 0 beyond 5 times, 1 of 1 between, 0 of 0 up to 1.5 times")


@pytest.mark.slow
def test_without_odometry_it_is_said_what_the_path_hangs_on():
    (run,) = compare(named_log("corridor:0:no-odometry").inputs(), "slam", ["ekf"], "jcbb-hindsight")
    assert [note.named["mostly"] for note in run.notes if note.code is Code.PLACED] == [True]


def test_before_the_first_frame_there_is_nothing_to_say():
    log = named_log("corridor:0")
    lost = Lost(Ledger(log.recorded.sensor))
    lost.see(log.inputs().without_labels().frame(0), np.array([-1, -1]), np.zeros(3))
    assert lost.notes() == []


class Looked:
    """From places, at frames of which the ledger says how many were paired and replaced."""

    def __init__(self):
        self.counts = (0, 1)
        self.lost = Lost(SimpleNamespace(range=20.0, replaced=lambda decisions: self.counts))

    def score(self, number, x, y=0.0, counts=(0, 1)):
        self.counts = counts
        self.lost.see(SimpleNamespace(number=number), np.array([-1]), np.array([x, y, 0.5]))
        return self.lost.suspicion.score


def test_frames_from_one_place_are_one():
    looked = Looked()
    first = looked.score(0, 0.0)
    assert first > 0.0
    # 5 % of 20 m; nearer frames count for nothing, those without evidence neither
    assert [looked.score(k, x, y) for k, (x, y) in enumerate([(0.9, 0.0), (0.0, 0.9), (-0.9, 0.0)], 1)] == [first] * 3
    assert looked.score(4, 0.8, -0.8, counts=(0, 0)) == first
    assert looked.score(5, 0.8, -0.8) == pytest.approx(2.0 * first), "the empty look before was none"
    assert looked.score(6, 0.0, 0.0) == pytest.approx(3.0 * first)
    assert looked.score(7, 3.0, counts=(1, 0)) == pytest.approx(max(0.0, 3.0 * first + np.log(0.2 / 0.5)))


def test_it_is_said_from_when_to_when():
    looked = Looked()
    looked.lost.suspicion = Suspicion(alarm=12, over=40)
    assert looked.lost.notes() == [notice(Code.MAP_RESTARTED, frame=12, over=40)]
    for alarm in (0, 3):
        looked.lost.suspicion = Suspicion(alarm=alarm)
        assert looked.lost.notes() == [notice(Code.MAP_RESTARTED, frame=alarm, over=None)]
    looked.lost.suspicion = Suspicion(score=6.0)
    assert looked.lost.notes() == []
