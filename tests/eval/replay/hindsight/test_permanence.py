"""Landmarks that stay and landmarks that go: the likelihoods against plain sums, and a fit of logs that were drawn."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import betaln

from eval.replay.hindsight import constants
from eval.replay.hindsight.record import Persistence, kept_at_end, persistence, persistent

SHARES = st.floats(0.02, 0.98)
DRAWN = st.builds(Persistence, SHARES, SHARES, SHARES, SHARES, SHARES)
LOOKS = st.lists(st.integers(0, 1), max_size=12).map(bytes)


def likelihood_of_what_stays(opportunities, p):
    """Beta-binomial, the order of looks as it was: rates drawn once for each landmark."""
    counts = {(before, now): 0 for before in (0, 1) for now in (0, 1)}
    for before, now in zip(b"\1" + opportunities, opportunities, strict=False):
        counts[before, now] += 1
    total = 0.0
    for before, mean in ((1, p.seen), (0, p.again)):
        a, b = constants.PERSISTENCE_OWN * mean, constants.PERSISTENCE_OWN * (1 - mean)
        total += betaln(a + counts[before, 1], b + counts[before, 0]) - betaln(a, b)
    return math.exp(total)


def likelihood_of_what_goes(opportunities, p):
    """Forward through the looks, in two states: still there, gone."""
    there, gone = 1 - p.at_once, p.at_once
    for seen in opportunities:
        there, gone = there * (1 - p.later), gone + there * p.later
        there *= p.seen if seen else 1 - p.seen
        gone *= constants.PERSISTENCE_CHANCE if seen else 1 - constants.PERSISTENCE_CHANCE
    return there + gone


def plain(opportunities, p):
    stays, goes = (
        p.persistent * likelihood_of_what_stays(opportunities, p),
        (1 - p.persistent) * likelihood_of_what_goes(opportunities, p),
    )
    return stays / (stays + goes)


def drawn(rng, count, p):
    """Looks at landmarks, up to thirty at each, by the model; and which of them stay."""
    every, stays = [], rng.random(count) < p.persistent
    for stay in stays:
        opportunities, before, there = [], 1, bool(stay or rng.random() > p.at_once)
        for _ in range(rng.integers(31)):
            there = there and bool(stay or rng.random() > p.later)
            rate = constants.PERSISTENCE_CHANCE if not there else p.seen if before or not stay else p.again
            before = int(rng.random() < rate)
            opportunities.append(before)
        every.append(bytes(opportunities))
    return every, stays


@given(st.lists(LOOKS, min_size=1, max_size=5), DRAWN)
def test_it_is_bayes_rule_for_the_two_kinds(opportunities, p):
    assert persistent(opportunities, p) == pytest.approx([plain(s, p) for s in opportunities], rel=1e-9, abs=1e-12)


def test_a_landmark_that_was_never_looked_at_is_of_the_kind_that_most_are():
    p = Persistence(0.3, 0.5, 0.2, 0.9, 0.5)
    assert persistent([b""], p) == pytest.approx([0.3])
    assert persistent([], p).shape == (0,)


@pytest.mark.parametrize(
    "p",
    [
        Persistence(0.6, 0.6, 0.3, 0.95, 0.8),
        Persistence(0.2, 0.3, 0.25, 0.9, 0.6),
        Persistence(0.5, 0.8, 0.2, 0.7, 0.4),
    ],
)
def test_what_a_log_is_like_is_found_again(p):
    opportunities, stays = drawn(np.random.default_rng(1), 1500, p)
    found = persistence(opportunities)
    assert found.persistent == pytest.approx(p.persistent, abs=0.05)
    assert found.at_once == pytest.approx(p.at_once, abs=0.1)
    assert found.later == pytest.approx(p.later, abs=0.05)
    assert found.seen == pytest.approx(p.seen, abs=0.05)  # misses at the end are left out, of short rows some too many
    assert found.again == pytest.approx(p.again, abs=0.1)
    told = persistent(opportunities, found)
    assert np.mean((told > 0.5) == stays) > 0.9
    sure = (told > 0.8) & (told < 0.95)
    assert np.mean(stays[sure]) == pytest.approx(np.mean(told[sure]), abs=0.1), "probabilities are what they say"


def test_of_no_landmarks_the_prior_is_known():
    assert persistence([]) == pytest.approx(constants.PERSISTENCE_MEANS)


def test_one_step_of_the_fit_is_the_expected_counts_by_hand(monkeypatch):
    """Two landmarks, one round: everything that can be counted, weighed by what is believed before."""
    monkeypatch.setattr(constants, "PERSISTENCE_ROUNDS", 1)
    before = Persistence(*constants.PERSISTENCE_MEANS)
    worth = constants.PERSISTENCE_WORTH
    opportunities = [bytes([1, 0, 1, 0, 0]), b""]
    (a, b), own = persistent(opportunities, before), 1.0
    chance, c = constants.PERSISTENCE_CHANCE, before.seen
    # of the first one, if it goes: weights of having gone at once, and before look 0, 1, ... 4, never
    gone = [chance if s else 1 - chance for s in opportunities[0]]
    here = [c if s else 1 - c for s in opportunities[0]]
    later = [
        (1 - before.at_once) * before.later * (1 - before.later) ** k * math.prod(here[:k]) * math.prod(gone[k:])
        for k in range(5)
    ]
    never = (1 - before.at_once) * (1 - before.later) ** 5 * math.prod(here)
    at_once = before.at_once * math.prod(gone)
    total = at_once + sum(later) + never
    lasted = (sum(k * w for k, w in enumerate(later)) + 5 * never) / total
    left = sum(later) / total
    expected = [
        (worth[0] * before.persistent + a + b) / (worth[0] + 2),
        (worth[1] * before.at_once + (1 - a) * at_once / total) / (worth[1] + (1 - a) * own),
        (worth[2] * before.later + (1 - a) * left) / (worth[2] + (1 - a) * (left + lasted)),
        (worth[3] * before.seen + a) / (worth[3] + 2 * a),  # seen, missed: the row at the end does not count
        (worth[4] * before.again + a) / (worth[4] + a),
    ]
    expected[2] = max(expected[2], constants.PERSISTENCE_LATER_LEAST)
    assert list(persistence(opportunities)) == pytest.approx(expected, rel=1e-9)


def test_misses_at_the_end_do_not_tell_how_often_landmarks_are_missed():
    """They may be gone: people who were read ten times each, and long since missed, leave the others' rates alone."""
    stay, people = [bytes([1] * 20)] * 30, [bytes([1] * 5 + [0] * 40)] * 30
    found = persistence([*stay, *people])
    assert found.seen > 0.95
    told = persistent([stay[0], people[0]], found)
    assert told[0] > 0.9
    assert told[1] < 0.01


def test_what_goes_does_not_take_longer_than_can_be_told():
    opportunities = [bytes([1] * 30)] * 20 + [bytes([1] * 29 + [0])] * 20
    assert persistence(opportunities).later == constants.PERSISTENCE_LATER_LEAST


def test_of_a_map_stays_what_stays_by_odds_of_two_to_one():
    real, clutter = [bytes([1] * 10)] * 10, [bytes([0] * 6)] * 10
    keep = kept_at_end([*real, *clutter], [], np.full(20, 9))
    assert keep.tolist() == [True] * 10 + [False] * 10
    assert kept_at_end([], [], np.ones(0, np.int64)).tolist() == []


def test_what_was_read_once_does_not_stay():
    opportunities = [bytes([1] * 10)] * 10 + [b""]
    assert kept_at_end(opportunities, [], np.full(11, 2))[-1]
    assert not kept_at_end(opportunities, [], np.array([2] * 10 + [1]))[-1]


@pytest.mark.parametrize(("others", "needed"), [(2, 2), (3, 3), (4, 4), (30, 4)])
def test_where_most_are_read_often_two_sightings_are_too_few(others, needed):
    opportunities = [bytes([1] * 10)] * 40 + [b"\1"]
    keep = [kept_at_end(opportunities, [], np.array([others] * 40 + [n]))[-1] for n in (1, 2, 3, 4)]
    assert keep == [n >= needed for n in (1, 2, 3, 4)]


def test_the_fewest_of_those_that_stay_do_not_tell_how_many_sightings_are_needed():
    opportunities = [bytes([1] * 10)] * 40
    assert kept_at_end(opportunities, [], np.array([2] + [9] * 39)).tolist() == [False] + [True] * 39
    assert kept_at_end(opportunities, [], np.array([2] * 4 + [9] * 36)).all()


def test_what_was_retracted_before_tells_what_the_rest_is_like():
    opportunities = [b"\1"] * 8
    mixed = [*[b"\1" * 12] * 3, *opportunities]
    told = [persistent(opportunities, persistence([*mixed, *[b"\0" * 6] * n]))[0] for n in (0, 5, 40)]
    assert told[0] > told[1] > told[2]


def test_where_it_is_not_known_which_stay_the_likeliest_do_as_many_as_are_expected():
    """Looks so few that none stays by odds of two to one: an empty map would be the one thing that is surely wrong."""
    opportunities = [b"\1"] * 30 + [b"\1\0"] * 10
    former = [b"\0\0\0"] * 20 + [b"\1\1\0\0\0\0"] * 30
    often = np.full(len(opportunities), 3)
    told = persistent(opportunities, persistence([*opportunities, *former]))
    assert told.max() < constants.PERSISTENT_PROBABILITY
    keep = kept_at_end(opportunities, former, often)
    assert keep.sum() == round(told.sum())
    assert told[keep].min() >= told[~keep].max()
