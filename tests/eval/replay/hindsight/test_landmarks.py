"""What speaks for a landmark and against it: counts, a chain of observations and misses, and shifts in the world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from association.expectation import Expectation
from data.sensors import RangeBearing
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import (
    INITIALIZED,
    Judgement,
    Visibility,
    add_miss,
    add_observation,
    confirmed,
    detection_rate,
    verdict,
)
from eval.replay.hindsight.opportunities import missing

ALWAYS = Visibility(seen_seen=10**6)
"""A sensor that sees whatever is in view."""


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


@pytest.mark.parametrize(
    ("before_missed", "seen", "counted"),
    [
        (False, True, (2, 2, 3, 4)),
        (False, False, (1, 3, 3, 4)),
        (True, True, (1, 2, 4, 4)),
        (True, False, (1, 2, 3, 5)),
    ],
)
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


def test_misses_in_a_row_are_independent_until_more_is_known():
    v = Visibility()
    assert [v.row(n, 0.8) for n in range(4)] == pytest.approx([1.0, 0.2, 0.04, 0.008])


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
    told = [verdict(e._replace(missed=n, row=n), v) for n in (0, needed - 1, needed)]
    assert told == ["", "", "missed"]


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
    return missing(e, np.array(decisions, np.int64), sensor).tolist()


def test_what_stands_clearly_inside_the_view_should_be_seen():
    margin = 3.0
    inside = [
        [10.0 - 0.1 * margin - 0.02, 0.0],
        [5.0, 1.0 - 0.01 * margin - 0.002],
        [5.0, -1.0 + 0.01 * margin + 0.002],
    ]
    outside = [
        [10.0 - 0.1 * margin + 0.02, 0.0],
        [5.0, 1.0 - 0.01 * margin + 0.002],
        [5.0, -1.0 + 0.01 * margin - 0.002],
    ]
    assert absent(inside + outside, [], []) == [True] * 3 + [False] * 3


def test_what_was_paired_was_not_missed():
    assert absent([[5.0, 0.0], [5.0, 0.5]], [[5.0, 0.0]], [10]) == [False, True]


@pytest.mark.parametrize(
    ("seen", "hidden"),
    [
        ([3.0, 0.9 * SHADOW], True),
        ([3.0, -0.9 * SHADOW], True),
        ([3.0, 1.1 * SHADOW], False),
        ([5.1, 0.0], False),
    ],
)
def test_what_is_nearer_in_the_same_direction_hides_it(seen, hidden):
    assert absent([[5.0, 0.0]], [[2.0, 0.7], seen], [-1, -1]) == [not hidden]


def test_directions_behind_the_robot_are_the_same_on_both_sides():
    around = RangeBearing(max_range=10.0)
    behind = math.pi - 0.2 * SHADOW
    assert absent([[5.0, behind]], [[3.0, -behind]], [-1], around, 1e-4) == [False]
    assert absent([[5.0, behind]], [[3.0, 0.0]], [-1], around, 1e-4) == [True]
