"""Section and table on a log without truth: what was objected to first, only numbers that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.result import Trajectory
from eval.plan.flags.table import Output
from eval.referee.attribution import NOISE
from eval.referee.score import Trial
from eval.referee.truth_free import Statistic
from eval.report.diagnosis import MOST, Terms, first_page_words, of_trial, statistic_words, trust_frame, trust_section
from eval.report.page.blocks import Folded, Table
from eval.report.publish import draw
from tests.eval.handmade import circle_log, run_with_error
from tests.eval.report.diagnosis.said_by_hand import MEASURED, TURN, blamed, said

POLAR = Terms()
ZERO = np.zeros(3)
LOG = circle_log(truth=False, landmarks=False, name="home")


def smoother(**more):
    made = run_with_error(ZERO, estimator="batch", phases=("final",), **more)
    return replace(made, final=Trajectory(made.final.pose, 0.25 * made.final.covariance))


FILTER = run_with_error(np.array([0.1, 0.0, 0.02]))
TRIAL = Trial(LOG, "slam", (FILTER, smoother()))


def test_what_is_objected_to_stands_first_with_what_the_twins_show():
    frame = trust_frame(blamed(TURN, cause=NOISE, objected=2), terms=POLAR)
    assert len(frame) <= MOST
    assert set(frame["statistic"][:2]) == {"NIS per degree of freedom", "median of dᵀ(P_f − P_s)⁻¹d"}
    first = frame[frame["statistic"].str.startswith("median")].iloc[0]
    assert (first["value"], first["expected"]) == ("30.3", "1.46")
    # 30.3, 30.31, ... 30.49
    assert first["twins' median"] == "30.4"
    assert first["twins, 5 to 95 %"] == "30.3 to 30.5"
    assert first["family-wise p"] == "0.048"


def test_what_is_furthest_from_its_twins_stands_first():
    trust = blamed(TURN, cause=NOISE, objected=2)
    # the twins have 0.91 to 1.10 and 30.3 to 30.49, so one spread is as large as the other
    for nis, median, first in ((0.2, 30.55, "NIS"), (1.2, 80.0, "median")):
        measured = trust.real.measured | {
            ("ekf", "nis"): Statistic(nis), ("ekf", "filter_smoother_median"): Statistic(median),
        }  # fmt: skip
        rows = [replace(r, measured=measured[r.estimator, r.statistic]) for r in trust.rows]
        frame = trust_frame(replace(trust, real=replace(trust.real, measured=measured), rows=tuple(rows)), terms=POLAR)
        assert frame["statistic"][0].startswith(first)


def test_without_twins_there_is_no_column_of_them():
    frame = trust_frame(said(), terms=POLAR)
    assert list(frame.columns) == ["estimator", "statistic", "value", "expected"]
    turn = frame[frame["statistic"] == "a wrong scale of the odometry's turns [%]"].iloc[0]
    assert turn["value"] == "−5.00 ± 0.10"
    assert not frame["statistic"].str.contains("ranges \\[%\\]").any()


def test_every_statistic_has_a_name_that_is_none_of_the_codes():
    for _, name in MEASURED:
        for terms in (POLAR, Terms(polar=False)):
            text, factor = statistic_words(name, terms)
            assert "_s" not in text.replace("P_s", "")
            assert factor > 0.0
    assert statistic_words("own_smoother_rms_x", POLAR)[0] == "RMS of d in x [σ], own final path"
    assert statistic_words("residual_odometry_theta_lag1", POLAR)[0] == (
        "residual of the odometry's heading, correlation at lag 1"
    )


def test_a_section_has_words_table_and_figure(tmp_path):
    trust = blamed(TURN, cause=NOISE, objected=2)
    picture = draw(tmp_path, TRIAL, "filter-smoother")
    (section,) = trust_section(tmp_path, Output(), TRIAL, [picture], [trust])
    words, table, more, shown = section.blocks
    assert section.heading == "Diagnosis without ground truth: home, slam"
    assert words.startswith("**Cause: the noise model.**")
    assert isinstance(more, Folded)
    assert len(words) < 450
    assert isinstance(table, Table)
    assert (tmp_path / "tables" / "home-slam-trust-known.csv").exists()
    assert shown is picture
    assert "association known" in picture.caption


def test_ways_of_association_are_told_apart_where_they_have_twins():
    jcbb = run_with_error(ZERO, association="jcbb")
    trial = replace(TRIAL, runs=(*TRIAL.runs, jcbb))
    both = [blamed(association="jcbb"), blamed()]
    assert [t.association for t in of_trial(trial, both)] == ["known", "jcbb"]
    assert [t.association for t in of_trial(trial, [said(association="jcbb"), said()])] == ["known"]
    assert of_trial(replace(TRIAL, variant_of="other"), both) == []


def test_a_log_with_truth_is_told_on_the_first_page_only_what_twins_say():
    measured = replace(TRIAL, log=circle_log(name="home"))
    assert first_page_words(measured, [said()]) == ""
    assert "found nothing**: none of 9" in first_page_words(measured, [blamed()])
    assert "`--twins`" in first_page_words(TRIAL, [said()])
