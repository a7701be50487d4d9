"""The test whether what should be in view is there: it rises where newer things are read instead, and comes back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eval.replay.hindsight.kidnapping import Suspicion, suspect


def after(opportunities, s=None):
    s = Suspicion() if s is None else s
    for k, (paired, replaced) in enumerate(opportunities, start=s.since):
        s = suspect(s, k, paired, replaced)
    return s


def test_a_frame_counts_by_its_share_of_pairings_where_half_are_healthy_and_a_fifth_lost():
    paired, replaced = math.log(0.2 / 0.5), math.log(0.8 / 0.5)
    s = Suspicion(score=5.0, since=3)
    for counts, gain in (((1, 0), paired), ((0, 1), replaced), ((2, 6), (2 * paired + 6 * replaced) / 8)):
        assert suspect(s, 9, *counts) == s._replace(score=pytest.approx(5.0 + gain))
    assert suspect(s, 9, 0, 0) is s


@pytest.mark.parametrize(("score", "alarm"), [(6.5, None), (6.6, 3)])
def test_the_alarm_is_at_seven(score, alarm):
    assert suspect(Suspicion(score=score, since=3), 9, 0, 1).alarm == alarm


def test_what_is_paired_leaves_no_suspicion_and_a_sensor_that_fails_often_none_either():
    assert after([(3, 0)] * 50) == Suspicion(since=50)
    assert after([(0, 0)] * 50) == Suspicion()
    assert after([(2, 1), (1, 1)] * 50).alarm is None


def test_newer_landmarks_in_place_of_old_ones_raise_the_alarm_since_they_began():
    assert after([(3, 0)] * 20 + [(0, 4)] * 14).alarm is None
    s = after([(3, 0)] * 20 + [(0, 4)] * 15)
    assert (s.alarm, s.over) == (20, None)


def test_a_frame_is_one_piece_of_evidence_however_much_it_holds():
    assert after([(0, 100)]).score == pytest.approx(after([(0, 1)]).score)


def test_where_old_landmarks_are_paired_again_it_is_over_and_may_begin_anew():
    s = after([(0, 4)] * 20 + [(4, 0)] * 20)
    assert s.alarm == 0
    assert 20 < s.over < 40
    assert after([(0, 4)] * 20, s).over is None


def test_false_alarms_are_as_rare_as_walds_inequality_says():
    rng = np.random.default_rng(0)
    runs = [after([(1, 0) if seen else (0, 1) for seen in rng.random(400) < 0.6]) for _ in range(60)]
    assert sum(s.alarm is not None for s in runs) <= 2  # 60 * 400 * 1e-5 = 0.24 are expected at most
