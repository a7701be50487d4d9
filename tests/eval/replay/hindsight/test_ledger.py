"""The ledger: a landmark's record from its initialization to where it is merged or dropped."""

import math

import numpy as np
import pytest

from association.expectation import Expectation
from data.inputs import Frame, FrameObservations, Increment
from data.result import DISCARD, NEW, Updated
from data.sensors import RelativePoint
from eval.replay.hindsight.ledger import MERGED, Epoch, Ledger

FAR = np.array([[5.0, 0.0], [5.0, 4.0], [5.0, -4.0]])


def frame(number, points, first):
    points = np.asarray(points, float).reshape(-1, 2)
    step = Increment(np.array([0.0, 1.0, 0.0]), np.zeros((3, 3)))
    seen = FrameObservations(points, np.tile(0.01 * np.eye(2), (len(points), 1, 1)))
    return Frame(number, float(number), None if number == 0 else step, seen, None, first)


class Story:
    """A robot that sees its frames in order; landmarks get numbers as a filter would give them."""

    def __init__(self):
        self.ledger, self.rows = Ledger(RelativePoint(max_range=20.0)), 0

    def see(self, decisions, points=FAR):
        ledger, decisions = self.ledger, np.array(decisions, np.int64)
        here = frame(ledger.frame + 1, points[: len(decisions)], self.rows)
        ledger.move(here)
        paired = np.flatnonzero(decisions >= 0)
        z_hat = here.observations.z[paired]
        e = Expectation.from_arrays(
            here.observations.z, z_hat, 0.01 * np.eye(2 * len(paired)), here.observations.R, number=decisions[paired]
        )
        ledger.judge(e, decisions, np.array([0.0, ledger.travelled, 0.0]))
        created = np.full(len(decisions), -1, np.int64)
        created[decisions == NEW] = ledger.created + np.arange((decisions == NEW).sum())
        nothing = np.full((len(decisions), 2), math.nan)
        done = Updated(decisions >= 0, created, 0.0, 0, 0.0, nothing)
        ledger.see(here, decisions, done, np.array([0.0, ledger.travelled, 0.0]))
        self.rows += len(decisions)
        return self


def test_a_record_holds_what_a_landmark_was_seen_as():
    ledger = Story().see([NEW, NEW]).see([0]).see([DISCARD, NEW]).ledger
    assert list(ledger.records) == [0, 1, 2]
    assert ledger.created == 3
    assert [r.observations for r in ledger.records.values()] == [[(0, NEW), (2, 0)], [(1, NEW)], [(4, NEW)]]
    assert [(r.first, r.last, r.times) for r in ledger.records.values()] == [
        (0.0, 1.0, 2),
        (0.0, 0.0, 1),
        (2.0, 2.0, 1),
    ]
    assert [r.covisible for r in ledger.records.values()] == [{1}, {0}, set()]
    assert ledger.frames == 3
    assert ledger.range == pytest.approx(math.hypot(5.0, 4.0))


def test_what_is_merged_leaves_all_it_had_to_the_other():
    ledger = Story().see([NEW, NEW]).see([NEW, NEW]).see([2]).ledger
    ledger.merge([(2, 0)])
    assert list(ledger.records) == [0, 1, 3]
    kept = ledger.records[0]
    assert kept.observations == [(0, NEW), (2, 0), (4, 0)]
    assert (kept.last, kept.times, kept.evidence.seen) == (2.0, 3, 3)
    assert [r.covisible for r in ledger.records.values()] == [{1, 3}, {0}, {0}]
    assert [(e.observation, e.old, e.new, e.why) for e in ledger.events] == [(2, NEW, 0, MERGED), (4, 2, 0, MERGED)]
    assert ledger.merged == [(2, 2, 0)]


def test_what_is_dropped_is_covisible_with_nobody():
    ledger = Story().see([NEW, NEW, NEW]).ledger
    ledger.drop(np.array([1]))
    assert [r.covisible for r in ledger.records.values()] == [{2}, {0}]
    assert ledger.events == []


def test_what_never_became_certain_is_taken_back_in_the_end():
    story = Story().see([NEW, NEW])
    for _ in range(5):
        story.see([0])
    ledger = story.ledger
    assert ledger.close({}).transient.tolist() == [1]
    assert list(ledger.records) == [0]
    assert [(e.frame, e.observation, e.old, e.new, e.why) for e in ledger.events] == [(5, 1, NEW, DISCARD, "uncertain")]


def expecting(decisions, expected=FAR[:1]):
    """What a frame expects that reads `decisions` far to the left, of a landmark that stands at `expected`."""
    seen = np.array([[4.0, 15.0]] * len(decisions)).reshape(-1, 2)
    R = np.tile(0.01 * np.eye(2), (len(seen), 1, 1))
    return Expectation.from_arrays(seen, expected, 1e-4 * np.eye(2 * len(expected)), R)


def looked(story, decisions, expected=FAR[:1], stride=1.0):
    """The same frame, taken in; `stride`: of the step before it, in ranges of a sensor that reads 6.4 m."""
    ledger, decisions = story.ledger, np.array(decisions, np.int64)
    ledger.judge(expecting(decisions, expected), decisions, np.zeros(3))
    here = frame(ledger.frame + 1, np.array([[4.0, 15.0]] * len(decisions)), story.rows)
    nothing = np.empty((len(decisions), 2))
    done = Updated(decisions >= 0, np.full(len(decisions), -1), 0.0, 0, 0.0, nothing)
    pose = np.array([stride * (ledger.frame + 1), 0.0, 0.0])
    ledger.move(here)
    ledger.see(here, decisions, done, pose)
    return story


def test_a_landmark_has_its_looks_from_different_places_in_their_order():
    story = Story().see([NEW, NEW, NEW])
    for decisions in ([0], [], [], [0]):
        looked(story, decisions, FAR[:1] if decisions else 0.9 * FAR[:1])
    assert bytes(story.ledger.records[0].opportunities) == bytes([1, 2, 2, 3]), "read elsewhere, it is looked at anew"
    looked(story, [], 0.9 * FAR[:1], stride=0.0)
    looked(story, [], 0.9 * FAR[:1], stride=0.0)
    assert bytes(story.ledger.records[0].opportunities) == bytes([1, 2, 2, 3, 2]), "from one place it is one look"


def test_a_miss_from_an_unfamiliar_viewpoint_is_noted_but_is_no_evidence():
    story = Story().see([NEW, NEW, NEW])
    looked(story, [], 0.4 * FAR[:1])  # nearer than it was ever seen
    assert (bytes(story.ledger.records[0].opportunities), story.ledger.records[0].evidence.missed) == (b"\0", 0)


def test_what_was_missed_while_it_was_read_as_another_one_was_seen():
    story = Story().see([NEW, NEW, NEW])
    records = story.ledger.records
    records[0].opportunities, records[2].opportunities = bytearray(b"\1\0\1\0\0\0"), bytearray(b"\1\0")
    story.ledger.merge([(2, 0)])
    assert bytes(records[0].opportunities) == b"\1\0\1" + b"\3" + b"\1\0"


def test_a_gate_is_judged_once_from_one_place():
    story = Story().see([NEW])
    ledger = story.ledger
    assert [ledger.gated_elsewhere(0, inside) for inside in (True, False, True)] == [True, True, False]
    story.see([0])
    assert ledger.gated_elsewhere(0, True)


def test_an_epoch_is_what_is_initialized_from_here_on():
    story = Story().see([NEW, NEW]).see([0])
    assert story.ledger.epoch == Epoch(-math.inf, 0)
    story.ledger.epoch = story.ledger.new_epoch()
    assert story.ledger.epoch == Epoch(1.0, 2)
    story.ledger.end_epoch()
    assert story.ledger.epoch == Epoch(-math.inf, 2)


def test_what_is_missed_is_replaced_only_where_something_newer_is_read():
    story = Story()
    for _ in range(4):
        story.see([NEW, NEW] if not story.rows else [0, 1])
    ledger = story.see([DISCARD, DISCARD, NEW]).see([DISCARD, DISCARD, 2]).ledger

    def replaced(*decisions):
        seen, expected = FAR[: len(decisions)] * [1.0, 0.0] + [4.0, 15.0], FAR[:2] * [1.0, 0.8]
        e = Expectation.from_arrays(
            seen, expected, 1e-4 * np.eye(4), np.tile(0.01 * np.eye(2), (len(seen), 1, 1)), number=np.array([0, 1])
        )
        chosen = np.array(decisions)
        ledger.judge(e, np.where(chosen > 1, DISCARD, chosen), np.zeros(3))
        return ledger.replaced(chosen)

    assert replaced(DISCARD, DISCARD) == (0, 0)
    assert replaced(0, DISCARD) == (1, 0)  # 1 was seen after 0 was initialized: a sensor that misses things
    assert replaced(DISCARD, 2)[1] == 2
    assert replaced(DISCARD, NEW) == (0, 2)
