"""Priors of systematic errors: one for every error, wide ones wider; what is stated is what is estimated."""

from __future__ import annotations

import pytest

from data.inputs import ERRORS
from data.motion.priors import PRIORS, read_errors, systematic, written


def test_every_error_has_a_wide_and_a_tight_prior_with_a_reason():
    assert list(PRIORS) == list(ERRORS)
    assert all(0.0 < p.tight < p.wide and p.why for p in PRIORS.values())


def test_a_stated_sigma_counts_and_else_the_wide_prior():
    found = systematic(read_errors("--calibrate", "bearing,scale=0.03"))
    assert found.names == ("scale", "bearing")
    assert found.sigma.tolist() == [0.03, PRIORS["bearing"].wide]


@pytest.mark.parametrize("tight", [True, False])
def test_what_is_written_is_read_again(tight):
    text = written(["drift", "left"], tight=tight)
    assert read_errors("", ",".join(text)) == text
    sigma = systematic(text).sigma.tolist()
    assert sigma == [getattr(PRIORS[n], "tight" if tight else "wide") for n in ("left", "drift")]
