"""Metrics and columns are listed and described once, with units, types and directions."""

from __future__ import annotations

import pandas as pd
import pytest

from eval.referee.confusion import OUTCOMES
from eval.referee.metrics import OF_DECISIONS, OF_ESTIMATES, Metric, heads, is_share, metric
from eval.referee.result_files import (
    DECISION_COUNTS,
    METRICS,
    OF_LOGS,
    OF_RUNS,
    TOP,
    Column,
    File,
    count,
    measured,
    text,
)
from eval.referee.score import COUNTED

UNITS = {"_m": "m", "_deg": "deg", "_m2": "m²", "_rad": "rad"}
EVERY = (*OF_ESTIMATES, *OF_DECISIONS)


def test_the_columns_of_the_files_are_the_contracts():
    assert METRICS.names == (
        "log", "task", "estimator", "association", "phase", "status", "frames", "observations", "accepted", "rejected",
        "landmarks", "rmse_position_m", "rmse_heading_deg", "max_position_m", "rmse_aligned_m", "rmse_landmark_m",
        "rms_from_batch_m", "nees_pose", "nees_position", "nees_heading", "nis", "nis_lower", "nis_upper",
        "inside_3sigma", "rmse_time_m", "sse_position_m2", "sse_landmark_m2", "innovation_lag1", "innovation_lag1_se",
        "nis_expected", "nees_pose_median", "nees_left_out", "lost_frame", "lost_why", "rmse_position_lower",
        "rmse_position_upper", "nees_pose_lower", "nees_pose_upper", "log_score", "crps_x_m", "crps_y_m",
        "crps_heading_rad", "energy_score_m", "block_frames", "rmse_landmark_majority_m", "iterations",
        "last_step_sigma", "rpe_frame_m", "rpe_frame_deg", "rpe_1m_m", "rpe_1m_deg", "rpe_10m_m", "rpe_10m_deg",
        "matched", "unmatched",
    )  # fmt: skip
    assert DECISION_COUNTS.names == (
        "log", "task", "estimator", "association", "phase", "tp", "tn", "fp", "fn", "precision", "recall", "wrong",
        "spurious", "duplicate", "missed", "deferred", "share_within", "within_m",
        "majority_agreement",
    )  # fmt: skip
    assert list(DECISION_COUNTS.names[5:-3]) == COUNTED
    assert DECISION_COUNTS.names[5:9] == OUTCOMES


def test_metrics_are_listed_once_with_their_units_and_directions():
    assert len({m.column for m in EVERY}) == len({m.heading for m in EVERY}) == len(EVERY)
    for m in EVERY:
        assert all(m.unit == unit for suffix, unit in UNITS.items() if m.column.endswith(suffix))
        assert (m.better == "nearer") == (m.expected is not None)
        if m.column.startswith(("rmse", "rms_", "max_", "sse_", "crps_")):
            assert m.better == "smaller"


def test_a_name_says_unit_and_expected_value_in_tables_and_in_lines():
    assert heads(("log", "rmse_position_m", "nis", "inside_3sigma")) == {
        "log": "log", "rmse_position_m": "position RMSE [m]", "nis": "NIS per dof (expected 1)",
        "inside_3sigma": "inside 3σ (expected 98.9) [%]",
    }  # fmt: skip
    assert metric("nees_pose").line == "mean pose NEES (3 expected)"
    assert metric("inside_3sigma").line == "share of frames inside 3σ (0.989 expected)"
    assert metric("rmse_heading_deg").line == "heading RMSE [deg]"


def test_only_shares_are_shown_in_percent_and_a_column_that_is_no_metric_is_none():
    assert [is_share(c) for c in ("precision", "recall", "tp", "nees_pose", "log", "")] == [True, True, *[False] * 4]


FILE = File("runs/small.csv", "small", (text("who", "name"), count("n", "how many"), Column("x", "where", "m")))


def test_every_column_is_described():
    with pytest.raises(ValueError, match="column 'n'"):
        count("n", " ")
    assert all(c.about for f in (*TOP, *OF_RUNS, *OF_LOGS) for c in f.columns)
    assert measured(Metric("rpe_m", "RPE over 1 m", "m")) == Column("rpe_m", "RPE over 1 m", "m")
    assert measured(Metric("n", "things", form="d", about="how many")) == count("n", "how many")


@pytest.mark.parametrize("columns", [["who", "n", "x", "more"], ["who", "n"], ["n", "who", "x"]])
def test_a_column_too_many_too_few_or_in_another_place_is_not_written(columns, tmp_path):
    with pytest.raises(AssertionError, match="has the columns who, n, x, not"):
        FILE.write(pd.DataFrame(columns=columns), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_rows_become_typed_columns_and_unknown_is_blank_in_the_file(tmp_path):
    table = FILE.table([{"who": "ekf", "n": 3, "x": 0.1}, {"who": None, "n": None, "x": float("nan")}, {}])
    assert [str(t) for t in table.dtypes] == ["str", "Int64", "float64"]
    assert table["n"].isna().tolist() == [False, True, True]
    FILE.write(table, tmp_path)
    assert (tmp_path / "small.csv").read_text() == "who,n,x\nekf,3,0.1\n,,\n,,\n"
    assert [str(t) for t in FILE.table([]).dtypes] == ["str", "Int64", "float64"]
    with pytest.raises(AssertionError, match=r"small.csv: columns \['m'\]"):
        FILE.table([{"m": 1}])
