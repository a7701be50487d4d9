"""What NIS says of a filter: a verdict by its bounds, and everything that weakens the test."""

from __future__ import annotations

import math

import pytest

from data.words import number
from eval.referee.consistency import innovations_word
from eval.report.words import environment, one_line
from tests.eval.judged import run_of
from tests.eval.report.test_answer import FILTER


def innovations(**changed) -> str:
    row = run_of(FILTER | {"nis_lower": 0.97, "nis_upper": 1.03} | changed)
    return one_line(environment().get_template("answer.md.j2").make_module(EMPTY).innovations(row))


EMPTY = {
    "association": "known", "several": False, "outcome": "none ran", "filtered": None, "smoothed": None,
    "trust": "", "methods": None, "linearized": False, "verdict": "nothing ran",
}  # fmt: skip


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.09912, "0.0991"),
        (3.0, "3.00"),
        (12.345, "12.3"),
        (1234.5, "1234"),
        (2e7, "2.00e+07"),
        (0.0, "0"),
        (-0.5, "-0.500"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(("nis", "word"), [(1.9, "NIS too large"), (0.1, "NIS too small"), (1.0, "innovations fit")])
def test_nis_is_judged_by_its_bounds(nis, word):
    assert innovations_word(nis, 0.97, 1.03) == word
    assert run_of(FILTER | {"nis": nis}).nis_verdict == word
    assert f"bounds 0.97–1.03): {word}. The bounds assume independent" in innovations(nis=nis)


def test_behind_a_gate_less_is_expected():
    text = innovations(nis=0.95, nis_lower=0.91, nis_upper=0.99, nis_expected=0.9535)
    assert "NIS per dof is 0.950 (expected 0.954 behind the gates, 95 % bounds 0.91–0.99)" in text


def test_whatever_weakens_the_nis_test_is_said():
    text = innovations(rejected=28, association="jcbb")
    assert "28 observations were left out" in text
    assert "Wrong pairings that fit each other do not show in it;" in text
    assert innovations(nis=math.nan) == ""
