"""Priors of systematic errors: one for every error, wide ones wider; what is stated is what is estimated."""

from __future__ import annotations

import pytest

from data.errors import UsageError
from data.inputs import ERRORS
from data.motion.priors import AUTO, PRIORS, read_errors, systematic, written


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


@pytest.mark.parametrize(
    ("value", "read"),
    [
        (True, (AUTO,)), (False, ()), ("auto", (AUTO,)), (["auto"], (AUTO,)), (" auto ,", (AUTO,)),
        ("bearing,scale", ("scale", "bearing")), (["bearing", "scale"], ("scale", "bearing")),
        (("range = 0.1,drift", "left"), ("left", "drift", "range=0.1")), (" , left,", ("left",)),
    ],
)  # fmt: skip
def test_names_come_as_one_text_or_as_a_list_and_are_put_in_their_order(value, read):
    assert read_errors("--calibrate", value) == read


NAMES = "scale, curvature, left, right, drift, range, bearing"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (3, f"calibrate 3: names are needed, of {NAMES}, or auto"),
        (["scale", 0.1], f"calibrate ['scale', 0.1]: names are needed, of {NAMES}, or auto"),
        ("", f"calibrate: a name is needed, of {NAMES}, or auto"),
        ("left,wheels", f"calibrate wheels: unknown; known: {NAMES}, each NAME or NAME=SIGMA; or auto"),
        ("left,range,left=2", "calibrate left,range,left=2: left is named twice"),
        ("left=0", "calibrate left=0: a positive prior sigma is needed"),
        ("left=wide", "calibrate left=wide: a positive prior sigma is needed"),
    ],
)
def test_what_cannot_be_read_is_said_with_what_would_be_right(value, said):
    with pytest.raises(UsageError) as wrong:
        read_errors("calibrate", value)
    assert str(wrong.value) == said
