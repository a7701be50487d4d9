"""Landmarks that stay, leave or pass: likelihoods against plain sums, and fits of logs that were drawn."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import betaln

from eval.replay.hindsight import constants, opportunities as module
from eval.replay.hindsight.opportunities import Detections, Kept, Persistence


def four(least, most):
    return st.lists(st.floats(least, most), min_size=4, max_size=4).map(np.array)


DRAWN = st.builds(Persistence, four(0.02, 0.98), four(0.1, 20.0), four(0.1, 20.0))
CHANCE = constants.PERSISTENCE_CHANCE
SEEN, MISSED = b"\3", b"\2"
"""From a familiar viewpoint; two less from another one, two more behind another landmark."""
BEFORE = b"\6"
LOOKS = st.builds(
    lambda before, after: BEFORE * before + bytes(after), st.integers(0, 4), st.lists(st.integers(0, 5), max_size=12)
)


def kept_at_end(opportunities, observations, spans=None) -> Kept:
    """All landmarks are observed from the beginning to the end of the log, if nothing else is said."""
    n = len(opportunities)
    every = [Detections(s) for s in opportunities]
    return module.remaining(every, observations, np.tile([0, 1000], (n, 1)) if spans is None else np.array(spans))


def persistence(opportunities):
    return module.persistence([Detections(s) for s in opportunities])


def kinds(opportunities, p, chance=CHANCE):
    return module.kinds([Detections(s, chance) for s in opportunities], p)


def mean(p):
    """Detection probabilities by viewpoint, and before the first detection."""
    return p.seen / (p.seen + p.missed)


def likelihood_of_what_is_there(opportunities, p):
    """Beta-binomial: rates drawn once for each landmark and kind of viewpoint."""
    total = 0.0
    for kind in range(3):
        seen = sum(o == 2 * kind + 1 for o in opportunities)
        missed = sum(o == 2 * kind for o in opportunities)
        a, b = p.seen[kind], p.missed[kind]
        total += betaln(a + seen, b + missed) - betaln(a, b)
    return math.exp(total)


def chance(opportunities, c):
    """Of what has gone."""
    return math.prod(c if o % 2 else 1 - c for o in opportunities)


def likelihood_of_what_passes(opportunities, p, c):
    """Forward through the looks, in two states: still there, gone."""
    there, gone = 1 - p.shares[1], p.shares[1]
    for o in opportunities:
        there, gone = there * (1 - p.shares[2]), gone + there * p.shares[2]
        rate = mean(p)[o // 2]
        there *= rate if o % 2 else 1 - rate
        gone *= chance([o], c)
    return there + gone


def plain(opportunities, p, c):
    """Misses before the first detection, which ends them: beta-binomial for real landmarks."""
    before = opportunities.count(BEFORE)
    opportunities = opportunities.lstrip(BEFORE)
    leaving, n = constants.PERSISTENCE_LEAVING, len(opportunities)
    a, b = p.seen[3], p.missed[3]
    real = p.shares[0] * math.exp(betaln(a + 1, b + before) - betaln(a, b))
    transient = (1 - p.shares[0]) * p.shares[3] * (1 - p.shares[3]) ** before
    stays = real * (1 - leaving) ** n * likelihood_of_what_is_there(opportunities, p)
    left = real * sum(
        leaving * (1 - leaving) ** k * likelihood_of_what_is_there(opportunities[:k], p) * chance(opportunities[k:], c)
        for k in range(n)
    )
    weights = np.array([stays, left, transient * likelihood_of_what_passes(opportunities, p, c)])
    return weights / weights.sum()


def drawn(rng, count, p):
    """Looks at landmarks, up to thirty at each, by the model; and which of them stay."""
    every, stays, (_, at_once, later, appearing) = [], rng.random(count) < p.shares[0], p.shares
    for stay in stays:
        opportunities, there = [], bool(stay or rng.random() > at_once)
        own = rng.beta(p.seen, p.missed) if stay else mean(p)
        for _ in range(rng.integers(31)):
            there = there and bool(stay or rng.random() > later)
            viewpoint = rng.integers(3)
            rate = own[viewpoint] if there else CHANCE
            opportunities.append(2 * viewpoint + int(rng.random() < rate))
        every.append(BEFORE * (int(rng.geometric(own[3] if stay else appearing)) - 1) + bytes(opportunities))
    return every, stays


@given(st.lists(LOOKS, min_size=1, max_size=5), DRAWN, st.floats(1e-6, 0.2))
def test_it_is_bayes_rule_for_the_three_kinds(opportunities, p, c):
    found = np.array(kinds(opportunities, p, c)).T
    assert found == pytest.approx(np.array([plain(s, p, c) for s in opportunities]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("shares", "rates", "spread"), [
    ((0.6, 0.6, 0.4, 0.5), (0.8, 0.95, 0.6, 0.9), 30.0), ((0.2, 0.3, 0.4, 0.5), (0.3, 0.9, 0.6, 0.5), 30.0),
    ((0.5, 0.8, 0.5, 0.4), (0.05, 0.7, 0.3, 0.2), 10.0), ((0.7, 0.8, 0.5, 0.4), (0.3, 0.7, 0.3, 0.4), 2.0),
])  # fmt: skip
def test_what_a_log_is_like_is_found_again(shares, rates, spread):
    p = Persistence(np.array(shares), spread * np.array(rates), spread * (1.0 - np.array(rates)))
    opportunities, stays = drawn(np.random.default_rng(1), 1500, p)
    found = persistence(opportunities)
    assert found.shares[0] == pytest.approx(p.shares[0], abs=0.05)
    assert found.shares[1:3] == pytest.approx(p.shares[1:3], abs=0.15)  # some are missed before they vanish
    assert mean(found)[:2] == pytest.approx(mean(p)[:2], abs=0.08)  # misses at the end are left out, some too many
    assert (found.seen[1] + found.missed[1] < 8.0) == (spread == 2.0)
    told = 1.0 - kinds(opportunities, found).transient
    assert np.mean((told > 0.5) == stays) > 0.9
    sure = (told > 0.8) & (told < 0.95)
    assert np.mean(stays[sure]) == pytest.approx(np.mean(told[sure]), abs=0.1), "probabilities are what they say"


def test_misses_at_the_end_do_not_tell_how_often_landmarks_are_missed():
    """They may be gone: people who were read ten times each, and long since missed, leave the others' rates alone."""
    assert mean(persistence([SEEN * 20] * 30 + [SEEN * 5 + MISSED * 40] * 30))[1] > 0.95


def test_what_passes_does_not_take_longer_than_can_be_told():
    assert persistence([SEEN * 30] * 20 + [SEEN * 29 + MISSED] * 20).shares[2] >= constants.PERSISTENCE_LATER_LEAST


def test_misses_from_where_nothing_is_ever_seen_take_no_landmark_out():
    """Trees behind trees: seen from one side, and never from the others."""
    hidden = [(SEEN * 2 + b"\0" * 20) * 3] * 20
    keep = kept_at_end([*hidden, *[MISSED * 6] * 20], np.full(40, 6))
    assert keep.stays.tolist() == [True] * 20 + [False] * 20
    assert not keep.left.any()


def test_what_was_seen_often_and_then_never_again_left_and_stays_in_the_map():
    keep = kept_at_end([*[SEEN * 40] * 20, SEEN * 20 + MISSED * 20], np.full(21, 20))
    assert keep.stays.all()
    assert keep.left.tolist() == [False] * 20 + [True]
    assert not keep.folded


@pytest.mark.parametrize("folded", [True, False])
def test_a_map_where_as_many_appear_as_leave_is_folded_but_not_in_new_surroundings(folded):
    """The same landmarks, initialized again elsewhere: missed there before they were detected first. What left is
    dropped.
    """
    looks = [*[SEEN * 40] * 10, *[SEEN * 20 + MISSED * 20] * 6, *[BEFORE * 20 * folded + SEEN * 20] * 7]
    keep = kept_at_end(looks, np.full(23, 20), [*[(0, 900)] * 10, *[(0, 400)] * 6, *[(450, 900)] * 7])
    assert keep.folded == folded
    assert keep.stays.tolist() == [True] * 10 + [not folded] * 6 + [True] * 7
    assert not folded or (keep.left == ~keep.stays).all()


def test_what_was_missed_before_it_was_detected_is_a_person_unless_landmarks_are_missed_so():
    person = BEFORE * 6 + SEEN * 2
    passing = [BEFORE * 6 + MISSED * 4] * 15
    for before, least, most in ((0, 0.9, 1.0), (5, 0.0, 0.1)):
        looks = [*[BEFORE * before + SEEN * 10] * 60, *passing, person]
        assert least < kinds(looks, persistence(looks)).transient[-1] < most


def test_what_was_read_once_does_not_stay():
    opportunities = [SEEN * 10] * 10 + [b""]
    assert kept_at_end(opportunities, np.full(11, 2)).stays[-1]
    assert not kept_at_end(opportunities, np.array([2] * 10 + [1])).stays[-1]


@pytest.mark.parametrize(("others", "needed"), [(2, 2), (3, 3), (4, 4), (30, 4)])
def test_where_most_are_read_often_two_sightings_are_too_few(others, needed):
    opportunities = [SEEN * 10] * 40 + [SEEN]
    keep = [kept_at_end(opportunities, np.array([others] * 40 + [n])).stays[-1] for n in (1, 2, 3, 4)]
    assert keep == [n >= needed for n in (1, 2, 3, 4)]


def test_the_fewest_of_those_that_stay_do_not_tell_how_many_sightings_are_needed():
    opportunities = [SEEN * 10] * 40
    assert kept_at_end(opportunities, np.array([2] + [9] * 39)).stays.tolist() == [False] + [True] * 39
    assert kept_at_end(opportunities, np.array([2] * 9 + [9] * 31)).stays.all()


def test_people_who_came_by_at_the_end_do_not_vouch_for_each_other():
    """Every tenth landmark, but one observation in fifty."""
    keep = kept_at_end([SEEN * 10] * 36 + [SEEN] * 4, np.array([11] * 36 + [2] * 4))
    assert keep.stays.tolist() == [True] * 36 + [False] * 4
    assert keep.few.tolist() == [False] * 36 + [True] * 4  # but they are probably real


def test_a_map_that_most_landmarks_left_is_folded():
    def folded(gone):
        looks = [SEEN * 20 + MISSED * 20] * gone + [SEEN * 20] * (20 - gone)
        return kept_at_end(looks, np.full(20, 20), [(0, 400)] * 20).folded

    assert [folded(gone) for gone in (0, 5, 10, 11, 15)] == [False, False, False, True, True]


def test_in_a_folded_map_leaving_is_no_longer_rare():
    """A miss at the end tells nothing where landmarks stay, and much where most leave."""
    short = SEEN * 6 + MISSED
    stay = kept_at_end([*[SEEN * 10] * 20, short], np.full(21, 9))
    assert stay.stays[-1]
    assert not stay.left[-1]
    looks = [*[SEEN * 20 + MISSED * 20] * 20, *[BEFORE * 20 + SEEN * 20] * 21, short]
    folded = kept_at_end(looks, np.full(42, 9), [*[(0, 400)] * 20, *[(450, 900)] * 21, (0, 400)])
    assert folded.folded
    assert folded.stays.tolist() == [False] * 20 + [True] * 21 + [False]
