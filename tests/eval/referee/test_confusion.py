"""TP, TN, FP and FN counted by hand, landmarks like a neighbour; every metric and column is described once."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from data.inputs import LandmarkMap
from data.result import MapEstimate
from data.worlds.arena import Arena, simulate
from eval.referee import result_files
from eval.referee.ambiguity import NONE, ambiguous, neighbours, variance_of
from eval.referee.confusion import OUTCOMES, confuse, ground_truth, majority_agreement, share_within
from eval.referee.result_files import OF_DECISIONS, OF_ESTIMATES, Metric, heads, is_share, metric
from eval.referee.score import COUNTED
from eval.replay.run import compare

NEW, DISCARD = -1, -2


def test_decisions_are_counted_by_hand():
    # frame 0 initializes 7 and 9; frame 1: right, taken for the neighbour, taken for new, clutter paired and left out
    frame = np.array([0, 0, 1, 1, 1, 1, 1])
    true_id = np.array([7, 9, 7, 9, 7, -1, -1])
    decisions = np.array([NEW, NEW, 0, 0, NEW, 1, DISCARD])
    c = confuse(frame, true_id, decisions, np.array([0, 1, -1, -1, 2, -1, -1]), None)
    assert c.ground_truth.tolist() == [-1, -1, 0, 1, 0, -1, -1]
    assert (c.tp, c.tn, c.fp, c.fn) == (1, 3, 2, 1)
    assert (c.wrong, c.spurious, c.duplicate, c.missed) == (1, 1, 1, 0)
    assert (c.precision, c.recall) == (1 / 3, 1 / 2)
    frame, true_id = np.array([0, 1, 2]), np.array([5, 5, 5])
    c = confuse(frame, true_id, np.array([NEW, NEW, 1]), np.array([0, 1, -1]), None)
    assert c.outcome.tolist() == [1, 3, 2]
    assert c.wrong == 1
    gt = ground_truth(np.array([0, 0, 1]), np.array([5, 5, 5]), np.array([NEW, NEW, 0]), np.array([0, -1, -1]), None)
    assert gt.tolist() == [-1, -1, 0]
    # a revision pairs what was observed before the observation that names the landmark
    late, begun = np.array([DISCARD, 0, 0, NEW, 0]), np.array([-1, -1, -1, 0, -1])
    c = confuse(np.arange(5), np.array([5, 5, 6, 5, 5]), late, begun, None)
    assert c.ground_truth.tolist() == [-1, 0, -1, -1, 0]
    assert (c.tp, c.tn, c.fp, c.fn) == (2, 2, 1, 0)
    known = LandmarkMap(np.array([5, 6]), np.zeros((2, 2)))
    c = confuse(np.zeros(4, int), np.array([5, 6, 7, -1]), np.array([5, DISCARD, 6, DISCARD]), np.full(4, -1), known)
    assert c.ground_truth.tolist() == [5, 6, -1, -1]
    assert (c.tp, c.tn, c.fp, c.fn) == (1, 1, 1, 1)
    assert c.missed == 1
    assert confuse(np.array([0]), np.array([-2]), np.array([NEW]), np.array([0]), None) is None
    known = LandmarkMap(np.array([3, 5]), np.zeros((2, 2)))
    frame, true_id = np.arange(5), np.array([3, 3, 3, 5, 3])
    decisions, final = np.array([3, DISCARD, DISCARD, DISCARD, 5]), np.array([3, 3, DISCARD, 3, 3])
    nothing = np.full(5, -1)
    online = confuse(frame, true_id, decisions, nothing, known, None, final)
    assert (online.tp, online.fp, online.fn) == (1, 1, 3)
    assert (online.missed, online.deferred) == (1, 2)
    settled = confuse(frame, true_id, final, nothing, known)
    assert (settled.missed, settled.deferred) == (1, 0)


def test_a_pairing_is_near_if_its_landmark_is_near_the_right_one():
    places = LandmarkMap(np.array([3, 5, 9]), np.array([[0.0, 0.0], [0.0, 0.25], [4.0, 0.0]]))
    own = np.array([3, 3, 3, 9, -1, 3, 9])
    taken = np.array([3, 5, 9, 7, 3, -1, -2])
    # right, neighbour, far, without a position, person paired, initialized on a person; the last one is not paired
    decisions = np.array([0, 1, 2, 3, 0, 4, NEW])
    assert share_within(decisions, own, taken, places) == pytest.approx(2 / 6)
    assert np.isnan(share_within(decisions[-1:], own[-1:], taken[-1:], places))
    assert share_within(decisions[:2], own[:2], taken[:2], LandmarkMap(np.empty(0, int), np.empty((0, 2)))) == 0.0


def test_the_majority_agrees_where_a_neighbour_initialized_a_landmark_and_clutter_with_nothing():
    decisions, true_id = np.array([NEW, 0, 0, 0]), np.array([9, 7, 7, 7])
    assert confuse(np.arange(4), true_id, decisions, np.array([0, -1, -1, -1]), None).fp == 3
    assert majority_agreement(decisions, true_id) == 1.0
    assert majority_agreement(np.array([0, 0, 0, 1]), np.array([-1, -1, 7, 7])) == 0.5
    assert np.isnan(majority_agreement(np.array([NEW, DISCARD]), np.array([1, 1])))


@given(st.lists(st.tuples(st.integers(-2, 4), st.integers(-1, 4)), min_size=1))
def test_the_majority_is_counted_landmark_by_landmark(pairs):
    paired = [(d, t) for d, t in pairs if d >= 0]
    counts = {d: Counter(t for e, t in paired if e == d and t >= 0) for d, _ in paired}
    expected = sum(max(c.values(), default=0) for c in counts.values())
    found = majority_agreement(*np.array(pairs).T)
    assert np.isnan(found) if not paired else found == pytest.approx(expected / len(paired))


UNITS = {"_m": "m", "_deg": "deg", "_m2": "m²", "_rad": "rad"}
EVERY = (*OF_ESTIMATES, *OF_DECISIONS)


def test_the_columns_of_the_files_are_the_contracts():
    assert result_files.METRICS.names == (
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
    assert result_files.DECISION_COUNTS.names == (
        "log", "task", "estimator", "association", "phase", "tp", "tn", "fp", "fn", "precision", "recall", "wrong",
        "spurious", "duplicate", "missed", "deferred", "share_within", "within_m",
        "majority_agreement",
    )  # fmt: skip
    assert list(result_files.DECISION_COUNTS.names[5:-3]) == COUNTED
    assert result_files.DECISION_COUNTS.names[5:9] == OUTCOMES


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


FILE = result_files.File(
    "runs/small.csv",
    "small",
    (result_files.text("who", "name"), result_files.count("n", "how many"), result_files.Column("x", "where", "m")),
)


def test_every_column_is_described():
    with pytest.raises(ValueError, match="column 'n'"):
        result_files.count("n", " ")
    assert all(c.about for f in (*result_files.TOP, *result_files.OF_RUNS, *result_files.OF_LOGS) for c in f.columns)
    assert result_files.measured(Metric("rpe_m", "RPE over 1 m", "m")) == result_files.Column(
        "rpe_m", "RPE over 1 m", "m"
    )
    assert result_files.measured(Metric("n", "things", form="d", about="how many")) == result_files.count(
        "n", "how many"
    )


@pytest.mark.parametrize("columns", [["who", "n", "x", "more"], ["who", "n"], ["n", "who", "x"]])
def test_a_column_too_many_too_few_or_in_another_place_is_not_written(columns, tmp_path):
    with pytest.raises(AssertionError, match="has the columns who, n, x, not"):
        FILE.write(pd.DataFrame(columns=columns), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_rows_become_typed_columns_and_unknown_is_blank_in_the_file(tmp_path):
    table = FILE.table([{"who": "ekf", "n": 3, "x": 0.1}, {"who": None, "n": None, "x": float("nan")}, {}])
    assert pd.api.types.is_string_dtype(table["who"].dropna())
    assert [str(t) for t in table.dtypes[1:]] == ["Int64", "float64"]
    assert table["n"].isna().tolist() == [False, True, True]
    FILE.write(table, tmp_path)
    assert (tmp_path / "small.csv").read_text() == "who,n,x\nekf,3,0.1\n,,\n,,\n"
    assert [str(t) for t in FILE.table([]).dtypes[1:]] == ["Int64", "float64"]
    with pytest.raises(AssertionError, match=r"small.csv: columns \['m'\]"):
        FILE.table([{"m": 1}])


def map_of(xy, sigma=0.02, number=None):
    xy = np.asarray(xy, float)
    n = np.arange(len(xy)) if number is None else np.asarray(number)
    return MapEstimate(n, xy, np.tile(sigma**2 * np.eye(2), (len(xy), 1, 1)), np.zeros(len(xy)), np.ones(len(xy)))


def found(m, number, frame, sigma=0.1):
    return neighbours(m, np.full(len(m), sigma**2), np.array(number), np.array(frame)).tolist()


def test_two_inside_the_noise_without_a_common_frame_are_ambiguous():
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 1, 2]) == [1, 0]
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 0, 2]) == [NONE, NONE]
    m = map_of([[0.0, 0.0], [0.2, 0.0], [0.1, 0.0]], number=[3, 5, 9])
    assert found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 3] or found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 5]
    m = map_of([[0.0, 0.0], [2.0, 0.0], [9.0, 0.0]])
    wide = replace(m, covariance=m.covariance * np.array([1.0, 2500.0, 1.0])[:, None, None])
    assert found(m, [0, 1, 2], [0, 1, 2]) == [NONE] * 3
    assert found(wide, [0, 1, 2], [0, 1, 2]) == [1, 0, NONE]
    m = map_of([[0.0, 0.0], [5.0, 0.0]], number=[2, 4])
    assert variance_of(m, np.array([2, 2, 7]), np.array([1.0, 3.0, 9.0])).tolist() == [2.0, 0.0]


@pytest.mark.parametrize(("apart", "distinct"), [(0.309, False), (0.317, True)])
def test_the_gate_is_that_of_both_covariances_and_an_observation(apart, distinct):
    # sqrt(9.21 (2 * 0.02^2 + 0.1^2)) = 0.315; without the covariances 0.303
    assert (found(map_of([[0.0, 0.0], [apart, 0.0]]), [0, 1], [0, 1]) == [NONE, NONE]) is distinct


def test_nothing_is_ambiguous_with_labels_or_for_other_inputs():
    log = simulate(Arena(frames=60), 0)
    (run,) = compare(log.inputs(labels=True), "slam", ["ekf"])
    assert (ambiguous(run, log.recorded) == NONE).all()
    assert len(ambiguous(run, log.recorded)) == len(run.map)
    twin = replace(run.map, xy=run.map.xy * 0.0)
    assert (ambiguous(replace(run, map=twin, walls=True), log.recorded) == NONE).all()
    assert (ambiguous(replace(run, map=twin), simulate(Arena(frames=59), 0).recorded) == NONE).all()
    assert len(ambiguous(replace(run, map=None), log.recorded)) == 0
