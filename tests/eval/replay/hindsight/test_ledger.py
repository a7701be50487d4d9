"""The ledger: a landmark's record, what speaks for it and against it, and what is made of all of them."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from association.expectation import Expectation
from data.inputs import Frame, FrameObservations, Increment
from data.notice import Code, notice
from data.result import DISCARD, NEW, Updated
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import (
    INITIALIZED,
    Judgement,
    Ledger,
    Visibility,
    add_miss,
    add_observation,
    confirmed,
    detection_rate,
    verdict,
)
from eval.replay.hindsight.opportunities import BEFORE, BEHIND, DETECTED, FAMILIAR, _codes, beside, cell, missing

PLACES = np.array([[5.0, 0.0], [5.0, 4.0], [5.0, -4.0], [3.0, 1.0], [3.0, -1.0]])
REACH = math.hypot(5.0, 4.0)  # m, the farthest that is read; places are as far apart as SAME_PLACE of it


class Robot:
    """It sees landmarks where it expects them, from where it is told to be."""

    def __init__(self):
        self.ledger, self.rows, self.x = Ledger(RelativePoint(max_range=20.0)), 0, np.zeros(3)

    def sees(self, *decisions, missing=(), step=(1.0, 0.0)):
        """Reads `decisions` at the first places; `missing` stand where others were read, and are not."""
        ledger, chosen, n = self.ledger, np.array(decisions, np.int64), len(decisions)
        move = np.array([*step, 0.0])[:3] if ledger.frame >= 0 else None
        self.x = self.x + (0.0 if move is None else move)
        z, R = PLACES[:n], np.tile(0.01 * np.eye(2), (n, 1, 1))
        increment = None if move is None else Increment(move, np.zeros((3, 3)))
        here = Frame(ledger.frame + 1, 0.0, increment, FrameObservations(z, R), None, self.rows)
        ledger.move(here)
        ledger.judge(self.expects(chosen, missing), chosen, self.x)
        created = np.full(n, -1, np.int64)
        created[chosen == NEW] = ledger.created + np.arange((chosen == NEW).sum())
        ledger.see(here, chosen, Updated(chosen >= 0, created, 0.0, 0, 0.0, np.full((n, 2), math.nan)), self.x)
        self.rows += n
        return self

    @staticmethod
    def expects(chosen, missing=()):
        """What is paired where it is read, and what is missing, between all that is."""
        paired = np.flatnonzero(chosen >= 0)
        bearing = 0.06 + 0.03 * np.arange(len(missing))
        z_hat = np.concatenate([PLACES[paired], 4.6 * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)])
        R = np.tile(0.01 * np.eye(2), (len(chosen), 1, 1))
        number = np.concatenate([chosen[paired], np.array(missing, np.int64)])
        return Expectation.from_arrays(
            PLACES[: len(chosen)], z_hat, 1e-4 * np.eye(2 * len(z_hat)), R, number=number.astype(np.int64)
        )


def test_what_is_dropped_is_covisible_with_nobody():
    ledger = Robot().sees(NEW, NEW, NEW).ledger
    ledger.drop(np.array([1]))
    assert [r.covisible for r in ledger.records.values()] == [{2}, {0}]
    assert ledger.events == []


def test_what_never_became_certain_is_taken_back_in_the_end():
    story = Robot().sees(NEW, NEW)
    for _ in range(5):
        story.sees(0)
    ledger = story.ledger
    assert ledger.close({}).transient.tolist() == [1]
    assert list(ledger.records) == [0]
    assert [(e.frame, e.observation, e.old, e.new, e.why) for e in ledger.events] == [(5, 1, NEW, DISCARD, "uncertain")]


def test_what_was_missed_while_it_was_read_as_another_one_was_seen():
    story = Robot().sees(NEW, NEW, NEW)
    records = story.ledger.records
    records[0].opportunities, records[2].opportunities = bytearray(b"\1\0\1\0\0\0"), bytearray(b"\1\0")
    story.ledger.merge([(2, 0)])
    assert bytes(records[0].opportunities) == b"\1\0\1" + b"\3" + b"\1\0"


def known(visibility, **evidence):
    """One landmark of whom so much is known, among others that say how often landmarks are seen."""
    robot = Robot().sees(NEW, NEW)
    ledger = robot.ledger
    ledger._visibility = visibility
    one = ledger.records[0]
    one.evidence = one.evidence._replace(**evidence)
    return robot


def misses(robot, *numbers):
    """A frame is judged that reads nothing, and should have read these."""
    nothing = np.empty(0, np.int64)
    robot.ledger.judge(robot.expects(nothing, numbers), nothing, robot.x)
    return robot.ledger


MISSED = b"\2"  # from a familiar viewpoint
OFTEN = Visibility(180, 10, 5, 5)  # Seen in 185 of 200 looks


@pytest.mark.parametrize(("opportunities", "missed", "row", "rate"), [
    (300, 0, 0, 186 / 202),  # its own would be higher
    (12, 8, 0, 13 / 22),  # its own is lower
    (12, 9, 1, 13 / 22),  # without the row that is not over
    (12, 10, 2, 13 / 22),
])  # fmt: skip
def test_a_miss_surprises_by_how_much_likelier_it_is_of_a_robot_that_is_elsewhere(opportunities, missed, row, rate):
    robot = known(OFTEN, seen=20, opportunities=opportunities, missed=missed, row=row)
    prior = constants.INDEPENDENT_MISSES
    again = max((5 + prior * (1.0 - rate)) / (10 + prior), 1.0 - rate)
    here, elsewhere = again if row else 1.0 - rate, 1.0 - constants.ELSEWHERE_SHARE * rate
    assert misses(robot, 0).surprise() == pytest.approx(math.log(elsewhere / here))


def test_surprises_of_all_certain_landmarks_add_up_and_no_other_counts():
    robot = known(OFTEN, seen=20, opportunities=300)
    one = misses(robot, 0).surprise()
    assert one > 0.0
    assert misses(robot, 0, 1).surprise() == one, "the other one is not confirmed"
    records = robot.ledger.records
    records[1].evidence = records[0].evidence
    assert misses(robot, 0, 1).surprise() == pytest.approx(2.0 * one)
    assert misses(robot).surprise() == 0.0


@pytest.mark.parametrize("opportunities", [constants.ENOUGH_OPPORTUNITIES - 1, constants.ENOUGH_OPPORTUNITIES])
def test_nothing_surprises_before_it_is_known_how_often_landmarks_are_missed(opportunities):
    surprise = misses(known(Visibility(seen_seen=opportunities), seen=20, opportunities=300), 0).surprise()
    assert (surprise > 0.0) == (opportunities == constants.ENOUGH_OPPORTUNITIES)


@pytest.mark.parametrize(("paired", "judged"), [(1, 0), (2, 0), (3, 1), (4, 1)])
def test_a_pairing_is_judged_by_two_others_at_least(paired, judged):
    """Two readings leave one coordinate beside the three of a pose."""
    robot = Robot().sees(*[NEW] * paired).sees(*range(paired))
    assert [r.evidence.judged for r in robot.ledger.records.values()] == [judged] * paired


@pytest.mark.parametrize(
    ("step", "elsewhere"), [((0.31, 0.0), False), ((0.0, 0.31), False), ((0.33, 0.0), True), ((-0.24, 0.24), True)]
)
def test_a_landmark_is_looked_at_again_only_from_another_place(step, elsewhere):
    assert pytest.approx(0.3202, abs=1e-3) == constants.SAME_PLACE * REACH
    robot = Robot().sees(NEW, NEW, NEW).sees(0).sees(0, step=step)
    one = robot.ledger.records[0]
    assert one.evidence.seen == 3
    assert one.evidence.opportunities == 2 + elsewhere
    assert len(one.opportunities) == 1 + elsewhere
    robot.sees(0, step=(1.0, 0.0)).sees(missing=[0], step=step)
    assert one.evidence.missed == elsewhere


@pytest.mark.parametrize(("bearing", "look"), [(2.0, False), (-1.7, False), (-0.3, True)])
def test_a_miss_counts_from_the_side_from_which_a_landmark_was_seen(bearing, look):
    assert Ledger(RelativePoint()).range == 0.0
    ledger = Ledger(RelativePoint(max_range=20.0))
    z, R, nothing = PLACES[[0, 2]], np.tile(0.01 * np.eye(2), (2, 1, 1)), np.empty(0, np.int64)  # at 0 and -0.67 rad
    none = Updated(np.zeros(2, np.bool_), np.array([0, 1]), 0.0, 0, 0.0, np.empty((2, 2)))
    ledger.see(Frame(0, 0.0, None, FrameObservations(z, R), None, 0), np.array([NEW, NEW]), none, np.zeros(3))
    there = 4.8 * np.array([[math.cos(bearing), math.sin(bearing)]])
    e = Expectation.from_arrays(np.empty((0, 2)), there, 1e-6 * np.eye(2), np.empty((0, 2, 2)))
    ledger.judge(e, nothing, np.zeros(3))
    empty = FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2)))
    done = Updated(nothing >= 0, nothing, 0.0, 0, 0.0, np.empty((0, 2)))
    ledger.see(Frame(1, 1.0, None, empty, None, 2), nothing, done, np.array([9.0, 0.0, 0.0]))
    assert ledger.records[0].evidence.missed == look
    assert bytes(ledger.records[0].opportunities) == (MISSED if look else b"\0")


def test_certain_landmarks_tell_how_often_landmarks_in_view_are_seen():
    robot = Robot().sees(NEW, NEW, NEW)
    for _ in range(6):
        robot.sees(0)
    seen = robot.ledger._visibility
    assert seen == Visibility(seen_seen=seen.seen_seen)
    assert 2 <= seen.seen_seen <= 5, "not before it is confirmed"
    robot.sees(missing=[0]).sees(missing=[0]).sees(0).sees(0)
    assert robot.ledger._visibility == Visibility(seen.seen_seen + 1, 1, 1, 1)
    before = robot.ledger._visibility
    robot.sees(1, missing=[2])
    assert robot.ledger._visibility == before, "those that are not confirmed tell nothing"


def test_rates_are_common_once_a_landmark_is_certain_and_its_own_before():
    robot = known(OFTEN, seen=20, opportunities=30, missed=30)
    records = robot.ledger.records
    records[1].evidence = records[1].evidence._replace(seen=2, opportunities=2, missed=1)
    assert robot.ledger.rates(np.array([1, 0])) == pytest.approx([3 / 5, OFTEN.rate])
    assert robot.ledger.confirmed().tolist() == [0]


def test_what_is_missed_too_often_is_taken_back_once_and_only_when_it_was_looked_at():
    robot = Robot().sees(NEW, NEW, NEW)
    robot.ledger._visibility = Visibility(seen_seen=98)  # 99 %
    ledger = robot.sees(0, 1, missing=[2]).ledger
    assert ledger.contradicted().tolist() == []
    ledger = robot.sees(0, 1, missing=[2]).ledger
    ledger._touched.discard(2)
    assert ledger.contradicted().tolist() == [], "nothing new was learned of it"
    assert robot.sees(0, 1, missing=[2]).ledger.contradicted().tolist() == [2]
    assert [(e.frame, e.observation, e.old, e.new, e.why) for e in ledger.events] == [(3, 2, NEW, DISCARD, "missed")]
    assert ledger.contradicted().tolist() == []


def test_what_is_merged_adds_up():
    ledger = Robot().sees(NEW, NEW, NEW).sees(NEW, NEW).sees(0, 3, missing=[1, 4]).sees(1, 0).ledger
    kept, away = ledger.records[0], ledger.records[3]
    kept.evidence = kept.evidence._replace(seen=5, opportunities=4, missed=3, row=2, judged=2, squares=7.0)
    away.evidence = away.evidence._replace(seen=20, opportunities=10, missed=6, row=1, judged=1, squares=1.0)
    from_where = away.place
    ledger.merge([(3, 0)])
    e = ledger.records[0].evidence
    assert (e.seen, e.opportunities, e.missed, e.row, e.judged, e.squares) == (25, 14, 9, 0, 2, 7.0)
    assert (kept.first, kept.last, kept.times) == (0.0, 3.0, 3 + 2)
    assert kept.place == from_where
    assert kept.covisible == {1, 2, 4}
    assert ledger.records[4].covisible == {0}


def test_the_ledgers_notes_count_what_was_undone_and_what_was_made_instead():
    ledger = Robot().sees(NEW, NEW).sees(0, 1).sees(NEW).sees(2).ledger
    assert ledger.notes() == ledger.merge_notes() == []
    ledger.merge([(2, 0)])
    assert ledger.notes() == [notice(Code.REVISED, undone=1, again=2)]
    assert ledger.merge_notes() == [notice(Code.MERGED, landmarks=1, first=3)]
    ledger._retract({1: "moved"})
    assert ledger.notes() == [notice(Code.REVISED, undone=2, again=2)]


ALWAYS = Visibility(seen_seen=10**6)  # A sensor that sees whatever is in view


def test_sightings_and_misses_are_counted_and_a_sighting_ends_a_row():
    assert INITIALIZED[:6] == (1, 1, 0, 0, 0, 0.0)
    e = add_miss(add_miss(add_observation(add_observation(INITIALIZED, None, True), None, False)))
    assert (e.seen, e.opportunities, e.missed, e.row, e.judged) == (3, 2, 2, 2, 0)
    e = add_miss(add_observation(e, None, True))
    assert (e.seen, e.opportunities, e.missed, e.row) == (4, 3, 3, 1)


def test_shifts_are_summed_in_the_world_weighed_by_their_information():
    rng, e = np.random.default_rng(0), INITIALIZED
    information, pull, squares = np.zeros((2, 2)), np.zeros(2), 0.0
    for k in range(1, 4):
        G, nu, L = rng.normal(size=(2, 2)), rng.normal(size=2), rng.normal(size=(2, 2))
        S = L @ L.T + np.eye(2)
        e = add_observation(e, Judgement(nu, np.linalg.inv(S), G), True)
        there = np.linalg.inv(G @ S @ G.T)
        information, pull, squares = information + there, pull + there @ (G @ nu), squares + nu @ np.linalg.solve(S, nu)
        assert e.judged == k
        assert e.information == pytest.approx(information[[0, 0, 1], [0, 1, 1]])
        assert e.pull == pytest.approx(pull)
        assert e.squares == pytest.approx(squares)


@pytest.mark.parametrize(("before_missed", "seen", "counted"), [
    (False, True, (2, 2, 3, 4)), (False, False, (1, 3, 3, 4)), (True, True, (1, 2, 4, 4)),
    (True, False, (1, 2, 3, 5)),
])  # fmt: skip
def test_looks_are_counted_by_what_was_before(before_missed, seen, counted):
    assert tuple(Visibility(1, 2, 3, 4).counting(before_missed, seen)) == counted


@pytest.mark.parametrize(("row", "left"), [(0, (9, 2, 3, 4)), (1, (9, 1, 3, 4)), (3, (9, 1, 3, 2)), (9, (9, 1, 3, 0))])
def test_a_row_that_is_not_over_is_one_miss_after_a_sighting_and_the_others_after_misses(row, left):
    assert tuple(Visibility(9, 2, 3, 4).without(row)) == left
    assert tuple(Visibility().without(row)) == (0, 0, 0, 0)


def test_a_rate_is_the_mean_of_its_beta_distribution():
    assert detection_rate(0, 0) == 0.5
    assert detection_rate(7, 1) == pytest.approx(0.8)
    assert Visibility(5, 1, 2, 2).rate == pytest.approx(2 / 3)


@pytest.mark.parametrize(("missed_seen", "missed_missed"), [(10, 30), (30, 10), (1, 0), (40, 0)])
def test_what_was_missed_is_missed_again_as_often_as_it_was_but_no_less_than_at_first(missed_seen, missed_missed):
    v = Visibility(100, 20, missed_seen, missed_missed)
    worth = constants.INDEPENDENT_MISSES
    again = max((missed_missed + worth * 0.3) / (missed_missed + missed_seen + worth), 0.3)
    assert [v.row(n, 0.7) for n in range(4)] == pytest.approx([1.0, 0.3, 0.3 * again, 0.3 * again**2])


@pytest.mark.parametrize(
    ("v", "needed"), [(ALWAYS, 4), (Visibility(74, 24), 3), (Visibility(49, 49), 2), (Visibility(0, 98), 2)]
)
def test_a_landmark_is_certain_once_it_was_seen_as_often_as_four_times_in_view_give(v, needed):
    assert [confirmed(INITIALIZED._replace(seen=n), v) for n in (needed - 1, needed)] == [False, True]


@pytest.mark.parametrize(
    ("dof", "probability", "one_way"), [(2, constants.MOVED, True), (8, constants.RESTLESS, False)]
)
@pytest.mark.parametrize(("times", "expected"), [(0.98, ""), (1.02, "moved")])
def test_a_landmark_moved_if_all_shifts_point_one_way_or_are_too_large_together(
    dof, probability, one_way, times, expected
):
    e, size = INITIALIZED, math.sqrt(chi2.ppf(probability, dof) * times / 4)
    for k in range(4):
        nu = size * (np.array([0.6, 0.8]) / 2.0 if one_way else np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[k])
        # four shifts one way: their mean has a quarter of the covariance of each
        e = add_observation(e, Judgement(2.0 * nu if one_way else nu, np.eye(2), np.eye(2)), True)
    assert verdict(e, ALWAYS) == expected


@pytest.mark.parametrize(
    # seen in 7 of 8 looks; of a confirmed landmark the row that is not over does not count: in 7 of 7
    ("seen", "power", "rate"),
    [(2, 1, 0.8), (20, constants.UNLIKELY_POWER, 8 / 9)],
)
def test_a_landmark_is_not_there_if_so_many_misses_in_a_row_are_unlikely_of_a_certain_one_more_so(seen, power, rate):
    v, e = Visibility(seen_seen=7, seen_missed=1), INITIALIZED._replace(seen=seen, opportunities=200)
    assert confirmed(e, v) == (power > 1)
    needed = math.ceil(power * math.log(constants.UNLIKELY) / math.log(1.0 - rate))
    assert [verdict(e._replace(missed=n, row=n), v) for n in (0, needed - 1, needed)] == ["", "", "missed"]


def test_a_certain_landmark_has_its_own_rate_if_that_is_lower():
    often, seldom = (
        INITIALIZED._replace(seen=20, opportunities=opportunities, missed=20, row=0) for opportunities in (10**6, 18)
    )
    assert verdict(add_miss(add_miss(often)), ALWAYS) == "missed"
    assert verdict(add_miss(add_miss(seldom)), ALWAYS) == ""
    # by its own rate, 19 / 40, misses before this row counted: 22 in a row are as unlikely as need be
    own = math.ceil(constants.UNLIKELY_POWER * math.log(constants.UNLIKELY) / math.log(21 / 40))
    for row, expected in ((own - 1, ""), (own, "missed")):
        assert verdict(seldom._replace(missed=20 + row, row=row), ALWAYS) == expected


SHADOW = math.radians(0.5)
SENSOR = RangeBearing(max_range=10.0, min_angle=-1.0, max_angle=1.0)


def absent(expected, seen, decisions, sensor=SENSOR, bearing=0.01):
    """Of landmarks known to 0.1 m and 0.01 rad."""
    n, seen = len(expected), np.array(seen, float).reshape(-1, 2)
    R = np.tile(1e-4 * np.eye(2), (len(seen), 1, 1))
    e = Expectation.from_arrays(
        seen, expected, np.kron(np.eye(n), np.diag([1e-2, bearing**2])), R, number=10 + np.arange(n)
    )
    return missing(e, np.array(decisions, np.int64), sensor)[0].tolist()


@pytest.mark.parametrize(("seen", "hidden"), [
    ([3.0, 0.9 * SHADOW], True), ([3.0, -0.9 * SHADOW], True), ([3.0, 1.1 * SHADOW], False), ([5.1, 0.0], False),
])  # fmt: skip
def test_what_is_nearer_in_the_same_direction_hides_it(seen, hidden):
    assert absent([[5.0, 0.0]], [[2.0, 0.7], seen], [-1, -1]) == [not hidden]


def test_directions_behind_the_robot_are_the_same_on_both_sides():
    around = RangeBearing(max_range=10.0)
    behind = math.pi - 0.2 * SHADOW
    assert absent([[5.0, behind]], [[3.0, -behind]], [-1], around, 1e-4) == [False]
    assert absent([[5.0, behind]], [[3.0, 0.0]], [-1], around, 1e-4) == [True]


@pytest.mark.parametrize("seed", range(4))
def test_opportunities_are_counted_as_the_sets_of_familiar_viewpoints_say(seed):
    rng, cells = np.random.default_rng(seed), (constants.VIEW_RING, constants.VIEW_SIDES)
    owner, found, behind = rng.integers(0, 6, 600), rng.random(600) < 0.4, rng.random(600) < 0.3
    pose = np.cumsum(rng.normal(0.0, [0.3, 0.3, 0.2], (600, 3)), 0)
    polar = np.column_stack([rng.uniform(0.0, 20.0, 600), rng.uniform(-3.0, 3.0, 600)])
    record = [{"familiar": set(), "told": [], "at": (math.inf, math.inf), "cell": None} for _ in range(6)]
    expected = np.full(600, -1)
    for q, (i, (x, y, heading), (r, b)) in enumerate(zip(owner, pose, polar, strict=True)):
        one = record[i]
        elsewhere, here = math.dist(one["at"], (x, y)) >= 1.0, cell(r, heading + b)
        if not (found[q] or elsewhere):
            continue
        if one["familiar"] and (elsewhere or one["told"][-1:] in ([], [BEFORE])):
            seen_from = BEHIND if behind[q] else FAMILIAR if here in one["familiar"] else 0
            one["told"].append(DETECTED * int(found[q]) + seen_from)
            expected[q] = one["told"][-1]
        elif not (one["familiar"] or found[q]):
            one["told"].append(BEFORE)
            expected[q] = BEFORE
        if found[q] and here != one["cell"]:
            one["cell"] = here
            one["familiar"] |= beside(here)
        one["at"] = (x, y) if elsewhere else one["at"]
    np.testing.assert_array_equal(_codes(owner, found, behind, pose, polar, 1.0, *cells), expected)
    assert len(set(expected.tolist())) >= 6
