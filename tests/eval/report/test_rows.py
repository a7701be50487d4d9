"""The word on one log: NEES before innovations, correlation before size, replicates before the chi-square law."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eval.judgement.runs import judged_runs
from eval.referee.truth_free import Statistic
from eval.report.log_sections import answer
from eval.report.terminal import Group, MainNumbers, lines
from eval.studies.diagnosis import Trust
from eval.studies.sampled import Sample
from tests.eval.judged import judgement, run_of
from tests.eval.report.test_answer import FILTER, SMOOTHER

BATCH = SMOOTHER | {"nis": 1.0}
CORRELATED = {"innovation_lag1": 0.72, "innovation_lag1_se": 0.06}


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({}, "innovations fit"),
        ({"nees_pose": 46.0}, "overconfident"),
        ({"nees_pose": 46.0, "nis": 0.1}, "overconfident"),
        ({"nees_pose": 6.5, "nees_pose_lower": 4.2, "nis": 0.1}, "overconfident"),
        ({"nees_pose": 8.4, **CORRELATED}, "correlated"),
        ({"nees_pose": 8.4, "nis": 0.1, **CORRELATED}, "correlated"),
        ({"nis": 1.9}, "NIS too large"),
        ({"nis": None}, ""),
        ({"status": "diverged", "nees_pose": 46.0}, "diverged"),
    ],
)
def test_nees_speaks_before_correlation_and_this_before_nis(changed, word):
    assert run_of(FILTER | changed).verdict == word


def test_a_smoother_has_the_correlated_innovations_of_its_filter():
    """Seen: batch with NEES 8.4 "conservative", after a fit "consistent", lag-1 +0.72 ± 0.06 beside it."""
    rows = judged_runs([FILTER | CORRELATED, BATCH, BATCH | {"association": "jcbb"}])
    assert [r.verdict for r in rows] == ["correlated", "correlated", "innovations fit"]
    lost = FILTER | CORRELATED | {"lost_why": "0 used", "lost_frame": 3}
    assert judged_runs([lost, BATCH])[1].verdict == "innovations fit", "the filter's fault"


def replicates(nis, lag1=0.0) -> Trust:
    rng = np.random.default_rng(0)
    drawn = [
        Sample({
            ("ekf", "nis"): Statistic(nis + 0.03 * rng.standard_normal()),
            ("batch", "nis"): Statistic(nis - 0.1 + 0.03 * rng.standard_normal()),
            ("ekf", "innovation_lag1"): Statistic(lag1 + 0.02 * rng.standard_normal()),
        })
        for _ in range(60)
    ]  # fmt: skip
    return Trust("arena", "slam", "known", Sample({}), tuple(drawn), ())


def test_where_there_are_replicates_the_word_is_by_their_distribution():
    """On strongly nonlinear logs NIS of a right filter is above 1: 7 of 84 sound logs were rejected by chi-square."""
    rows = [FILTER | {"nis": 1.2}, BATCH | {"nis": 1.2}]
    assert [r.verdict for r in judged_runs(rows)] == ["NIS too large"] * 2
    filtered, smoothed = judged_runs(rows, diagnoses=[replicates(1.2)])
    assert (filtered.verdict, smoothed.verdict) == ("innovations fit", "NIS too large")
    assert (filtered.twins, filtered.nis_expected) == (60, pytest.approx(1.2, abs=0.02))
    assert judged_runs(rows, diagnoses=[replicates(1.4)])[0].verdict == "NIS too small"
    assert judged_runs([rows[0] | {"association": "jcbb"}], diagnoses=[replicates(1.2)])[0].verdict == "NIS too large"


def test_correlation_that_replicates_have_too_is_the_geometrys():
    rows = [FILTER | CORRELATED]
    assert judged_runs(rows, diagnoses=[replicates(1.0, lag1=0.7)])[0].verdict == "innovations fit"
    assert judged_runs(rows, diagnoses=[replicates(1.0, lag1=0.2)])[0].verdict == "correlated"


def test_the_answer_says_what_the_bounds_are_of_and_correlation_first():
    def said(rows, *trust):
        return answer(judgement(*rows, trust=next(iter(trust), None)))

    assert "assume independent innovations and nearly linear models" in said([FILTER, SMOOTHER])
    twins = said([FILTER, SMOOTHER], replicates(1.0))
    assert "of 60 bootstrap replicates): innovations fit" in twins
    assert "assume" not in twins
    text = said([FILTER | CORRELATED | {"nis": 0.1}, SMOOTHER])
    assert text.index("correlated: lag-1 +0.72 ± 0.06") < text.index("NIS per dof is")
    assert "is not to be believed" in text
    assert "noise model, which is too large" not in text
    assert "Overconfident: ekf." in said([FILTER | {"nees_pose": 46.0}, SMOOTHER])


def row(name: str, nis: float, word: str, expected: float) -> MainNumbers:
    return MainNumbers(0, name, "online", "jcbb", math.nan, math.nan, nis, word, expected=expected)


def shown(*rows: MainNumbers) -> str:
    return "\n".join(lines([Group("park", "slam", rows, 0)]))


def test_the_terminal_prints_the_nis_that_is_expected_behind_the_gate():
    """Seen: NIS 0.764 "overconfident" under 0.886 "conservative", "expected 1"."""
    differing = shown(row("ekf", 0.764, "NIS too large", 0.712), row("batch", 0.886, "NIS too small", 0.9535))
    assert "0.764 (0.71)  NIS too large" in differing
    assert "0.886 (0.95)  NIS too small" in differing
    assert "(NIS: of innovations, expected in brackets)" in differing
    assert "innovations, expected 0.954)" in shown(*[row("ekf", 0.764, "NIS too small", 0.9535)] * 2)
    assert "innovations, expected 1)" in shown(row("ekf", 1.0, "innovations fit", 1.0))
