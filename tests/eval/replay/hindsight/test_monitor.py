"""The monitor of the innovations: silent on healthy frames, quick where the pose is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, poisson

from eval.replay.hindsight import constants
from eval.replay.hindsight.localizing_frontend import Health, recovered, watch


def alarms(frames, state=None):
    """Frames in which an alarm begins, and the last state; frames are (offered, paired, nis, dof)."""
    state, found = state or Health(), []
    for k, frame in enumerate(frames):
        before, state = state, watch(state, *frame)
        if state.lost and not before.lost:
            found.append(k)
            state = recovered(state)
    return found, state


def healthy_frames(rng, n, seen=(1, 9), share=0.99, scale=1.0):
    for _ in range(n):
        offered = int(rng.integers(*seen))
        paired = int(rng.binomial(offered, share))
        yield offered, paired, scale * rng.chisquare(2 * paired) if paired else 0.0, 2 * paired


@pytest.mark.parametrize(
    ("share", "scale"),
    [
        pytest.param(0.99, 1.0, id="plain", marks=pytest.mark.slow),
        pytest.param(0.99, 0.05, id="conservative", marks=pytest.mark.slow),
        pytest.param(0.9, 1.0, id="10%", marks=pytest.mark.slow),
        pytest.param(0.7, 1.0, id="30%"),
    ],
)
def test_false_alarms_stay_below_one_in_ten_thousand_frames(share, scale):
    found, _ = alarms(healthy_frames(np.random.default_rng(0), 40_000, share=share, scale=scale))
    assert len(found) <= 4


def test_being_lost_is_not_learned_to_be_normal():
    _, state = alarms([(4, 4, 8.0, 8)] * 50)
    for _ in range(5):
        state = watch(state, 4, 0, 0.0, 0)
    assert state.lost
    share = state.share
    for _ in range(100):
        state = watch(state, 4, 0, 0.0, 0)
    assert state.share == share > 0.85


def test_what_a_frame_adds_is_a_log_likelihood_ratio():
    p, q, r = 0.9, 0.9 * constants.LOST_SHARE, constants.LOST_SCALE
    before = Health(unpaired=5.0, misfit=4.0, share=p, strays=0.1)
    after = watch(before, 3, 1, 7.0, 2)
    assert after.unpaired == pytest.approx(5.0 + binom.logpmf(1, 3, q) - binom.logpmf(1, 3, p), rel=1e-12)
    clutter = watch(replace(before, strays=1.5), 3, 1, 7.0, 2)
    assert clutter.unpaired == pytest.approx(5.0 + poisson.logpmf(2, 3 * (1 - q)) - poisson.logpmf(2, 1.5), rel=1e-12)
    assert after.misfit == pytest.approx(4.0 + chi2.logpdf(7.0, 2, scale=r) - chi2.logpdf(7.0, 2), rel=1e-12)


def test_a_frame_without_observations_says_nothing():
    state = Health(unpaired=3.0)
    assert watch(state, 0, 0, 0.0, 0) == state


def test_after_recovery_there_is_no_suspicion_and_nothing_is_forgotten():
    state = Health(unpaired=20.0, misfit=3.0, share=0.8, scale=2.0, learned=500.0, lost=True)
    assert recovered(state) == Health(share=0.8, scale=2.0, learned=500.0)
