"""The headline never contradicts a number under it: properties over a grid of facts, and cases that users met."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.referee.headline import (
    NEES_LIMIT,
    WRONG_LIMIT,
    Claim,
    Headline,
    Objection,
    Preference,
    Verdict,
    headline,
    nearer,
    usable,
)
from tests.quick import examples

UNKNOWN = st.just(math.nan)
NEES = UNKNOWN | st.floats(0.01, 1000.0)
CLAIMS = st.builds(
    Claim,
    estimator=st.sampled_from(["ekf", "batch"]),
    status=st.sampled_from(["ok", "ok", "ok", "diverged", "incomplete", "implausible"]),
    lost_frame=UNKNOWN | st.integers(0, 500).map(float),
    idle=st.sampled_from([False, False, True]),
    nees=NEES,
    nees_lower=NEES,
    wrong=UNKNOWN | st.floats(0.0, 1.0),
    nis=UNKNOWN | st.floats(0.01, 100.0),
    overconfident=st.booleans(),
)
PREFERENCES = st.builds(Preference, st.floats(0.001, 50.0), st.floats(0.001, 50.0), UNKNOWN | st.floats(0.0, 1.0))
MAYBE = st.none() | CLAIMS


@settings(max_examples=examples(600), deadline=None)
@given(MAYBE, MAYBE, PREFERENCES, st.booleans(), st.booleans())
def test_a_tick_stands_where_no_number_objects(filtered, smoothed, preference, measured, caused):
    h = headline(filtered, smoothed, preference, measured=measured, caused=caused)
    if not h.sound:
        return
    trusted = [smoothed] if h.verdict is Verdict.SMOOTHER else [filtered, smoothed]
    for claim in trusted:
        assert claim is not None
        assert claim.status == "ok"
        assert not claim.idle
        assert not claim.wrong > WRONG_LIMIT
        if measured and math.isfinite(claim.nees):
            assert claim.nees <= NEES_LIMIT
        else:
            assert math.isnan(claim.lost_frame)
            assert not claim.overconfident


@settings(max_examples=examples(300), deadline=None)
@given(MAYBE, MAYBE, PREFERENCES, st.booleans(), st.booleans())
def test_an_estimate_that_stopped_is_never_the_one_to_trust(filtered, smoothed, preference, measured, caused):
    h = headline(filtered, smoothed, preference, measured=measured, caused=caused)
    if h.verdict in (Verdict.SMOOTHER, Verdict.EITHER):
        assert usable(smoothed, measured)
    if h.verdict in (Verdict.FILTER, Verdict.EITHER, Verdict.ONLY):
        assert usable(filtered, measured)
    if h.verdict is Verdict.NEITHER:
        assert h.objections


@settings(max_examples=examples(300), deadline=None)
@given(PREFERENCES)
def test_a_preference_is_significant_both_ways(of):
    turned = {Verdict.SMOOTHER: Verdict.FILTER, Verdict.FILTER: Verdict.SMOOTHER}
    assert nearer(Preference(of.smoother, of.filter, of.p)) == turned.get(nearer(of), nearer(of))
    if of.p > 0.05:
        assert nearer(of) is Verdict.EITHER


EQUAL, BETTER = (0.46, 0.46), (0.075, 0.026)
"""Errors of filter and smoother [m]."""


def decided(
    filtered: Claim, smoothed: Claim, errors: tuple[float, float] = BETTER, p: float = math.nan, measured: bool = True
) -> Headline:
    return headline(filtered, smoothed, Preference(*errors, p), measured=measured)


def test_nearest_neighbour_in_the_corridor_is_no_tick():
    h = decided(Claim("ekf", nees=136.0, nis=17.4, wrong=0.04), Claim("batch", nees=136.0), EQUAL)
    assert h.verdict is Verdict.EITHER
    assert not h.sound
    assert (h.objections[0].objection, h.objections[0].value) == (Objection.NEES, 136.0)


def test_bad_ground_truth_with_hundreds_of_nees_is_no_tick():
    assert not decided(Claim("ekf", nees=351.0), Claim("batch", nees=506.0), p=0.01).sound


def test_an_estimate_three_centimetres_off_is_not_lost():
    ekf, batch = Claim("ekf", nees=1.1, lost_frame=3), Claim("batch", nees=1.2, lost_frame=3)
    assert decided(ekf, batch, p=0.001) == Headline(Verdict.SMOOTHER)


def test_without_ground_truth_an_estimate_that_looks_lost_is():
    ekf, batch = Claim("ekf", lost_frame=3.0), Claim("batch", lost_frame=3.0)
    h = decided(ekf, batch, measured=False)
    assert (h.verdict, h.objections[0].objection) == (Verdict.NEITHER, Objection.LOST)


def test_six_percent_of_rmse_may_be_chance():
    assert decided(Claim("ekf", nees=3.0), Claim("batch", nees=3.0), (1.06, 1.0), p=0.43).verdict == "either"


def test_after_a_kidnapping_a_smoother_on_the_lost_filters_pairings_is_not_trusted():
    lost = Claim("ekf", nees=900.0, lost_frame=80.0)
    assert decided(lost, Claim("batch", nees=511.0)).verdict is Verdict.NEITHER
    assert decided(lost, Claim("batch", nees=3.0)) == Headline(Verdict.SMOOTHER)
    blind = Claim("ekf", lost_frame=80.0)
    assert decided(blind, Claim("batch", nis=6.0, overconfident=True), measured=False).verdict is Verdict.NEITHER


@pytest.mark.parametrize(("nees", "lower", "sound"), [(3.4, 2.8, True), (4.4, 3.9, False), (8.0, math.nan, True)])
def test_an_interval_clear_of_three_objects(nees, lower, sound):
    batch = Claim("batch", nees=nees, nees_lower=lower)
    assert decided(Claim("ekf", nees=3.0), batch, p=0.001).sound == sound


def test_one_wrong_pairing_in_ten_is_named():
    h = decided(Claim("ekf", nees=3.0), Claim("batch", nees=3.0, wrong=0.1), p=0.001)
    assert [(o.objection, o.estimator, o.value) for o in h.objections] == [(Objection.ASSOCIATION, "batch", 0.1)]
