"""The judgement of a log and of a study's estimators never contradicts a number under it, on any surface."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from data.words import number
from eval.judgement.judgement import Difference, Judgement, Tone, Verdict, conclusion, nearer
from eval.judgement.runs import WRONG_LIMIT, Counts, Objected, Objection, RunJudgement, methods_of
from eval.referee.consistency import CONSISTENT, FIT, MARKS, MIN_RUNS, NEES_LIMIT, OVERCONFIDENT, TOO_FEW, WHITE
from eval.referee.score import Trial, score
from eval.report import calls, comparison
from eval.report.overview import in_short, introduction, overview, trust_mark
from eval.report.terminal import groups_of, lines, trust_line
from eval.report.words import say
from eval.report.writing import answer, as_json
from eval.studies.montecarlo import UNEVEN, Sample, consistency_table, judge, judge_estimators, study_of
from eval.studies.scenario import load_scenario
from tests.eval.judged import BLIND, LOG, judgement
from tests.quick import examples

FINE = {"association": "jcbb", "status": "ok", "rmse_position_m": 0.1, "rmse_aligned_m": 0.1, "nees_pose": 3.0,
        "nis": 1.0, "nis_lower": 0.9, "nis_upper": 1.1, "nis_expected": 1.0}  # fmt: skip
EKF, BATCH = FINE | {"estimator": "ekf", "phase": "online"}, FINE | {"estimator": "batch", "phase": "final"}
OWN = FINE | {"estimator": "MySlam", "phase": "online"}

UNKNOWN = st.none()
CHANGES = st.fixed_dictionaries({
    "status": st.sampled_from(["ok", "ok", "ok", "diverged", "incomplete", "implausible"]),
    "lost_frame": UNKNOWN | st.integers(0, 500), "rmse_position_m": st.floats(0.001, 50.0),
    "nees_pose": UNKNOWN | st.floats(0.01, 1000.0), "nees_pose_lower": UNKNOWN | st.floats(0.01, 10.0),
    "nis": UNKNOWN | st.floats(0.01, 100.0),
})  # fmt: skip


@st.composite
def judgements(draw) -> Judgement:
    """Filter, smoother and an estimator of somebody else, each perhaps missing, with and without truth."""
    rows, outcomes = [], []
    for base in (EKF, BATCH, OWN):
        if not draw(st.integers(0, 4)):
            continue
        row = base | draw(CHANGES)
        if row["lost_frame"] is not None:
            row["lost_why"] = "3 of 30 observations were used"
        row["rmse_aligned_m"] = row["rmse_position_m"]
        rows.append(row)
        tp, fp = draw(st.integers(0, 100)), draw(st.integers(0, 30))
        outcomes.append(base | {"tp": tp, "tn": 5, "fp": fp, "fn": 2})
    measured = draw(st.booleans())
    if not measured:
        rows = [r | dict.fromkeys(("rmse_position_m", "rmse_aligned_m", "nees_pose")) for r in rows]
    idle = frozenset((r["estimator"], "jcbb") for r in rows if not draw(st.integers(0, 6)))
    return judgement(*rows, log=LOG if measured else BLIND, outcomes=outcomes, idle=idle)


@settings(max_examples=examples(600), deadline=None)
@given(judgements())
def test_a_tick_stands_where_no_number_objects(j):
    if j.tone is not Tone.GOOD:
        return
    trusted = [j.compared.smoothed] if j.verdict is Verdict.SMOOTHER else j.compared.pair
    assert j.covariances
    for run in trusted:
        assert run.status == "ok"
        assert not run.idle
        assert not (run.counts is not None and run.counts.wrong > WRONG_LIMIT)
        if j.measured and math.isfinite(run.nees):
            assert run.nees <= NEES_LIMIT
        else:
            assert not run.lost_why
            assert not run.nis > run.nis_upper


@settings(max_examples=examples(300), deadline=None)
@given(judgements())
def test_an_estimate_that_is_of_no_use_is_never_the_one_to_use(j):
    filtered, smoothed = j.usable
    if j.verdict in (Verdict.SMOOTHER, Verdict.EITHER):
        assert smoothed
    if j.verdict in (Verdict.FILTER, Verdict.EITHER, Verdict.ONLY):
        assert filtered
    if j.verdict is Verdict.NEITHER:
        assert j.objections
        assert not j.covariances


SAYS = {
    Verdict.SMOOTHER: r"use the smoother('s path)?", Verdict.FILTER: r"use the filter('s path)?",
    Verdict.EITHER: r"use either( path)?", Verdict.NEITHER: r"use neither", Verdict.ONLY: r"only \w+",
    Verdict.UNKNOWN: r"unknown", Verdict.NOTHING: r"nothing ran",
}  # fmt: skip


@settings(max_examples=examples(300), deadline=None)
@given(judgements())
def test_every_surface_says_the_same(j):
    mark, line, short = trust_mark(j), trust_line(j), in_short(j)
    said = SAYS[j.verdict]
    assert re.match(f"{re.escape(j.name)}: {said}", line)
    assert re.search(rf"\*\*{said}", short, re.IGNORECASE)
    doubted = "not its covariances"
    preferred = j.verdict in (Verdict.SMOOTHER, Verdict.FILTER, Verdict.EITHER)
    for text in (line, short):
        assert (doubted in text) == (preferred and not j.covariances)
        assert mark.note in text
    assert mark.word.startswith("path: ") == (preferred and not j.covariances)
    assert mark.word.removeprefix("path: ") == j.verdict.value or j.verdict is Verdict.ONLY
    found = conclusion([j])  # the overview of all logs
    if j.measured:
        where = (Verdict.SMOOTHER, Verdict.EITHER, Verdict.FILTER, Verdict.NEITHER)
        assert [v for v in where if found[v.value]] == [j.verdict] * (j.verdict in where)
        assert bool(found["paths"]) == (preferred and not j.covariances)
    else:
        assert re.search(said, introduction([j]))
    facts = as_json(j)  # the table of the report, and the one of the terminal
    (row,) = overview([(Trial(LOG, "slam", ()), j)], Path("nowhere"), drawn=False).rows
    unusable = [f"{r.estimator} {r.association}" for r in j.last if not r.usable]
    assert row.cells[-1].text == (f"{len(unusable)} of {len(j.last)}" if unusable else "0")
    assert all(name in row.cells[-1].note for name in unusable[:2])
    shown = "\n".join(lines(groups_of([(Trial(LOG, "slam", ()), j)], score([]), (), ())))
    for run in j.last:
        assert re.search(rf"{run.estimator}, {run.phase} .*{re.escape(run.verdict)}", shown)
    assert facts["verdict"] == j.verdict.value
    assert [o["objection"] for o in facts["objections"]] == [o.objection.value for o in j.objections]
    assert "Offline, use the smoother" not in answer(j) or j.verdict is Verdict.SMOOTHER


@settings(max_examples=examples(300), deadline=None)
@given(st.floats(0.001, 50.0), st.floats(0.001, 50.0), st.none() | st.floats(0.0, 1.0))
def test_a_preference_is_significant_both_ways(filtered, smoothed, p):
    size = filtered - smoothed
    ends = (0.5 * size, 1.5 * size)
    found = None if p is None else Difference(size, min(ends), max(ends), p, 1.0, False, "")
    turned = {Verdict.SMOOTHER: Verdict.FILTER, Verdict.FILTER: Verdict.SMOOTHER}
    one = nearer(filtered, smoothed, found)
    assert nearer(smoothed, filtered, found) == turned.get(one, one)
    if p is not None and p > 0.05:
        assert one is Verdict.EITHER


EQUAL, BETTER = (0.46, 0.46), (0.075, 0.026)
"""Errors of filter and smoother [m]."""


def decided(ekf: dict, batch: dict, errors: tuple[float, float] = BETTER, *, measured: bool = True) -> Judgement:
    rows = []
    for base, changed, rmse in ((EKF, ekf, errors[0]), (BATCH, batch, errors[1])):
        known = {"rmse_position_m": rmse, "rmse_aligned_m": rmse}
        unknown = dict.fromkeys(("rmse_position_m", "rmse_aligned_m", "nees_pose"))
        lost = {"lost_why": "0 used"} if "lost_frame" in changed else {}
        rows.append(base | (known if measured else unknown) | lost | changed)
    return judgement(*rows, log=LOG if measured else BLIND)


@pytest.mark.parametrize(("nees", "why"), [(1507.0, "observations 1 s late"), (66258.0, "the truth's yaw in degrees")])
def test_estimates_ten_sigma_from_the_truth_are_of_no_use_on_any_surface(nees, why):
    """Seen: terminal "do not use them", report "Use: either"."""
    j = decided({"nees_pose": nees}, {"nees_pose": nees}, EQUAL)
    assert (j.verdict, j.tone) == (Verdict.NEITHER, Tone.BAD), why
    assert [o.objection for o in j.objections] == [Objection.ASTRAY] * 2
    for text in (trust_line(j), in_short(j)):
        assert "use neither" in text.lower()
        assert f"pose NEES {number(nees)}" in text
    assert "use neither on home" in introduction([j]).lower()
    assert [r.estimator for r in j.unusable] == ["ekf", "batch"]


def test_a_nis_of_seventeen_without_truth_recommends_nothing():
    """Seen: "use the smoother" at NIS 17.1."""
    j = decided({"nis": 17.1}, {"nis": 17.1}, measured=False)
    assert j.verdict is Verdict.NEITHER
    assert "NIS of ekf is too large: 17.1" in trust_line(j)
    slight = decided({"nis": 1.6}, {"nis": 1.6}, measured=False)
    assert (slight.verdict, slight.covariances) == (Verdict.UNKNOWN, False)


def test_an_estimator_of_somebody_else_with_wrong_covariances_is_named_in_every_sentence():
    """Seen: one with NEES 57.5 beside `ekf` and `batch` named nowhere."""
    j = judgement(EKF, BATCH, OWN | {"nees_pose": 57.5})
    assert [r.estimator for r in j.others] == ["MySlam"]
    for text in (trust_line(j), in_short(j), trust_mark(j).note):
        assert "MySlam is overconfident: pose NEES 57.5" in text
    assert not judgement(EKF, BATCH, OWN).others


def test_an_estimate_three_centimetres_off_is_not_lost():
    j = decided({"nees_pose": 1.1, "lost_frame": 3}, {"nees_pose": 1.2, "lost_frame": 3})
    assert (j.verdict, j.objections) == (Verdict.SMOOTHER, ())


def test_without_ground_truth_an_estimate_that_looks_lost_is():
    j = decided({"lost_frame": 3}, {"lost_frame": 3}, measured=False)
    assert (j.verdict, j.objections[0].objection) == (Verdict.NEITHER, Objection.LOST)


def test_after_a_kidnapping_a_smoother_on_the_lost_filters_pairings_is_not_trusted():
    lost = {"nees_pose": 900.0, "lost_frame": 80}
    assert decided(lost, {"nees_pose": 211.0}).verdict is Verdict.NEITHER
    right = decided(lost, {})
    assert (right.verdict, right.objections) == (Verdict.SMOOTHER, ())
    assert decided({"lost_frame": 80}, {"nis": 6.0}, measured=False).verdict is Verdict.NEITHER


@pytest.mark.parametrize(("nees", "lower", "tone"), [(3.4, 2.8, "good"), (4.4, 3.9, "fair"), (8.0, None, "good")])
def test_an_interval_clear_of_three_objects(nees, lower, tone):
    assert decided({}, {"nees_pose": nees, "nees_pose_lower": lower}).tone == tone


def test_one_wrong_pairing_in_ten_is_named_and_the_path_is_of_no_use():
    j = judgement(EKF, BATCH, outcomes=[BATCH | {"tp": 90, "tn": 0, "fp": 10, "fn": 0}])
    assert j.objections[0] == Objected(Objection.ASSOCIATION, "batch", 0.1)
    assert j.verdict is Verdict.NEITHER


def test_two_estimators_with_the_same_method_do_not_dispute_about_methods():
    def run(estimator, association, phase, rmse):
        return RunJudgement(estimator, association, phase, rmse=rmse, counts=Counts(500, 40, 0, 0))

    one = [run("ekf", "jcbb", "online", 2.42e-3), run("isam2", "jcbb", "final", 2.27e-3)]
    assert methods_of(one).nearest is None
    other = run("isam2", "nn", "final", 2.0e-3)
    assert methods_of([*one, other]).nearest == other


ARENA = load_scenario("arena")
KEY = ("localization", "ekf", "known", "online")
DOF = {"pose": 3, "position": 2, "heading": 1, "landmarks": 2, "nis": 1}


def study(factors: dict[str, float], runs: int = 60, failed: int = 0, whiteness: float = 0.0, uneven: bool = False):
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
