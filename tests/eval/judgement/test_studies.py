"""The word on an estimator of a study follows from the marks of its table, on every surface."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.referee.consistency import CONSISTENT, FIT, MARKS, MIN_RUNS, OVERCONFIDENT, TOO_FEW, WHITE
from eval.referee.score import score
from eval.report import calls, comparison
from eval.report.terminal import groups_of, lines
from eval.report.words import say
from eval.studies.montecarlo import UNEVEN, Sample, consistency_table, judge, judge_estimators, study_of
from eval.studies.scenario import load_scenario
from tests.quick import examples

ARENA = load_scenario("arena")
KEY = ("localization", "ekf", "known", "online")
DOF = {"pose": 3, "position": 2, "heading": 1, "landmarks": 2, "nis": 1}


def study(factors: dict[str, float], runs: int = 60, failed: int = 0, whiteness: float = 0.0, uneven: bool = False):
    """Runs whose means are chi-square times a factor of each quantity."""
    rng = np.random.default_rng(0)
    results = []
    for k in range(runs):
        if k < failed:
            results.append({KEY: Sample(failure="frame 3: lost")})
            continue
        means = {q: factors.get(q, 1.0) * float(rng.chisquare(40 * d) / 40) for q, d in DOF.items()}
        means["whiteness"] = whiteness + 0.02 * float(rng.standard_normal())
        over_time = np.where(np.arange(40) % 2, 0.2, 1.8) * 3.0 if uneven else rng.chisquare(3, 40)
        results.append({KEY: Sample(means, squares={"position": 0.01, "heading": 0.0}, nees_pose=over_time)})
    return study_of(ARENA.only(("ekf",)), range(runs), results)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.dictionaries(st.sampled_from(list(DOF)), st.sampled_from([0.5, 1.0, 1.7])),
    st.sampled_from([10, 60, 60]),
    st.sampled_from([0, 0, 3]),
    st.sampled_from([0.0, 0.0, 0.3, -0.3]),
)
def test_terminal_table_and_rows_agree_with_the_word(factors, runs, failed, whiteness):
    found = study(factors, runs + failed, failed, whiteness)
    judged = judge(found)
    (e,) = judge_estimators(found, judged)
    rows = consistency_table(judged)
    marked = {r.quantity for r in rows.itertuples() if r.verdict in MARKS and not r.quantity.startswith("coverage")}
    assert set(e.marks) == marked
    assert (e.word == CONSISTENT) == (not marked and runs >= MIN_RUNS)
    assert e.word in {*rows["verdict"], UNEVEN}
    assert calls.Study(found).verdicts.equals(rows)
    table = comparison.verdicts_table(rows[~rows["quantity"].str.startswith("coverage")])
    cells = {head: str(table[head].iloc[0]) for head in table.columns}
    assert {h.split(" (")[0] for h, text in cells.items() if text.endswith(("(+)", "(−)"))} == marked
    shown = "\n".join(lines(groups_of((), score([]), [found], judged)))
    assert re.search(rf"ekf, online .* {re.escape(e.word)}$", shown, re.MULTILINE)
    words = say("studies#words", found=[e])
    assert f"`ekf` (localization, known, online): {e.word}" in words
    for quantity, mark in e.marks.items():
        for text in (words, shown):
            assert re.search(rf"{quantity} \S+ \({re.escape(mark)}\)", text)


def test_a_heading_that_is_too_sure_is_not_consistent():
    """Seen: "consistent" beside heading 1.81 (+) and landmarks 2.91 (+)."""
    found = study({"heading": 1.81, "landmarks": 1.45})
    (e,) = judge_estimators(found, judge(found))
    assert (e.word, e.marks) == (OVERCONFIDENT, {"heading": "+", "landmarks": "+"})


def test_a_covariance_that_is_right_on_average_alone_is_not_consistent():
    """Seen: a filter with a stale covariance looked best by its mean of 2.84, with 56 % of the instants outside."""
    found = study({}, uneven=True)
    (e,) = judge_estimators(found, judge(found))
    assert (e.word, e.outside) == (UNEVEN, 1.0)
    assert "ekf: 100 % of the instants" in "\n".join(lines(groups_of((), score([]), [found], judge(found))))
    assert judge_estimators(study({}), judge(study({})))[0].outside < 0.2


def test_innovations_that_fit_do_not_make_an_estimator_without_covariances_consistent():
    found = study(dict.fromkeys(("pose", "position", "heading", "landmarks"), math.nan))
    (e,) = judge_estimators(found, judge(found))
    assert (e.word, {j.verdict.word for j in e.judged}) == ("", {FIT, WHITE})


@pytest.mark.parametrize("runs", [1, 20])
def test_few_runs_have_no_word_but_that(runs):
    found = study({}, runs)
    (e,) = judge_estimators(found, judge(found))
    assert e.word == TOO_FEW
    assert math.isfinite(e.rmse)
