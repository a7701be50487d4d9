"""A tutorial's variant is of a recording that a log was converted from, and of no other log."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.errors import UsageError
from eval.plan.flags.options import read_options
from eval.plan.tutorials import ABOUT, is_tutorial, original_of, variant_log
from eval.referee.score import Trial
from tests.eval.handmade import circle_log

VARIANT = read_options(["--config", "tutorial-step1"]).variants[0]


def test_a_log_from_elsewhere_is_refused_with_how_to_make_one():
    with pytest.raises(UsageError, match="does not come from a UTIAS MRCLAM recording"):
        variant_log(circle_log(), VARIANT)


@pytest.mark.parametrize("key", ["file", "path"])
def test_a_recording_that_is_gone_is_said_to_be(key, tmp_path):
    gone = {"file": "gone.zip", "path": str(tmp_path / "gone.zip")}[key]
    log = replace(circle_log(), source={"kind": "mrclam", key: gone, "robot": 3})
    with pytest.raises(UsageError, match=r"gone\.zip, which log .* is neither here nor beside the log"):
        variant_log(log, VARIANT, [tmp_path])


def test_the_original_program_s_numbers_are_known_where_the_log_has_them():
    trial = Trial(replace(circle_log(), source={"original": [12.5, 0.3]}), "slam", ())
    assert original_of(trial) == (12.5, 0.3)
    assert original_of(Trial(circle_log(), "slam", ())) is None
    assert is_tutorial(replace(trial, about=ABOUT))
    assert not is_tutorial(trial)
