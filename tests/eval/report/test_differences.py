"""The difference between filter and smoother in a table, in a sentence, and in the answer on a log."""

from __future__ import annotations

from eval.judgement.judgement import difference_of
from eval.referee import result_files
from eval.report.comparison import differences_table, missing_intervals
from eval.report.words import paragraph, say
from tests.eval.judged import run_of
from tests.eval.report.test_answer import FILTER, SMOOTHER

DIFFERENCES = result_files.DIFFERENCES

ROW = {
    "log": "arena", "task": "slam", "association": "known", "a": "ekf", "b": "batch", "phase_a": "online",
    "phase_b": "final", "rmse_position_m": 0.02, "rmse_position_lower": 0.0031, "rmse_position_upper": 0.0412,
    "rmse_position_p": 0.013, "nees_pose": -0.4, "nees_pose_lower": -0.9, "nees_pose_upper": 0.12, "nees_pose_p": 0.12,
    "block_frames": 14.2, "rmse_position_why": None, "nees_pose_why": None,
}  # fmt: skip
SILENT = dict.fromkeys(c for c in ROW if c.endswith(("_lower", "_upper", "_p"))) | {
    "rmse_position_why": "40 frames are too few", "nees_pose_why": "40 frames are too few",
}  # fmt: skip


def difference(**changed):
    return difference_of([ROW | changed], run_of(FILTER), run_of(SMOOTHER))


def sentence(**changed) -> str:
    return paragraph("comparison#difference", d=difference(**changed))


def test_the_sentence_says_by_how_much_with_interval_p_and_what_it_rests_on():
    assert sentence() == (
        "The smoother's aligned RMSE is lower by 0.0200 m, 95 % interval 0.0031 to 0.0412 m, p = 0.013. "
        "This holds for one log, with errors correlated over about 14 frames and one map."
    )
    assert sentence(task="localization").endswith("correlated over about 14 frames.")


def test_a_worse_smoother_is_higher_with_the_interval_turned_round():
    text = sentence(rmse_position_m=-0.02, rmse_position_lower=-0.0412, rmse_position_upper=0.0031, rmse_position_p=0.2)
    assert "is higher by 0.0200 m, 95 % interval −0.0031 to 0.0412 m, p = 0.200," in text
    assert text.endswith("frames and one map.")
    assert not difference().chance
    assert difference(rmse_position_p=0.06).chance
    assert difference(rmse_position_lower=-0.001).chance


def test_without_an_interval_it_says_why_and_no_number():
    text = sentence(**SILENT)
    assert text == "This log is too short to test whether the difference is chance: 40 frames are too few."


def test_only_the_pair_that_is_compared_is_spoken_of():
    assert difference(b="isam2") is difference(association="jcbb") is None
    assert difference_of([], run_of(FILTER), run_of(SMOOTHER)) is None


def test_the_table_has_a_row_for_each_pair_and_names_the_association_only_where_there_are_several():
    rows = DIFFERENCES.table([ROW, ROW | SILENT | {"b": "isam2"}])
    table = differences_table(rows)
    assert list(table.columns) == [
        "filter", "smoother", "aligned RMSE difference [m]", "its 95 % interval", "p", "NEES difference",
        "95 % interval of NEES", "p of NEES", "mean block [frames]",
    ]  # fmt: skip
    assert table.iloc[0].tolist() == [
        "ekf", "batch", 0.02, "0.0031 to 0.0412", "0.013", -0.4, "−0.900 to 0.120", "0.120", 14.2
    ]  # fmt: skip
    assert table.loc[1, "p"] is None
    both = differences_table(DIFFERENCES.table([ROW, ROW | {"association": "jcbb"}]))
    assert both["association"].tolist() == ["known", "jcbb"]


def test_reasons_for_missing_intervals_are_said_once_each():
    rows = DIFFERENCES.table([ROW, ROW | SILENT, ROW | SILENT | {"b": "isam2"}])
    why, pairs = "40 frames are too few", ["ekf and batch", "ekf and isam2"]
    assert missing_intervals(rows) == [("RMSE", pairs, why), ("NEES", pairs, why)]
    assert say("comparison#missing", intervals=missing_intervals(rows)[:1]) == (
        "* RMSE of ekf and batch, ekf and isam2: no interval; 40 frames are too few."
    )
    assert missing_intervals(DIFFERENCES.table([ROW])) == []
    decided = DIFFERENCES.table([ROW | SILENT, ROW | SILENT | {"association": "jcbb"}])
    assert missing_intervals(decided)[0][1] == ["ekf and batch (known)", "ekf and batch (jcbb)"]
