"""RMSE, alignment, landmark errors, proper scores, and errors against reference relations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from data.inputs import LandmarkMap
from data.sensors import Line, RangeBearing
from data.truth import Relations, Truth
from data.worlds.arena import Arena, simulate
from eval.referee import errors
from eval.referee.consistency import crps, energy_score, log_score, mean_scores
from eval.referee.relations import at_stamps, errors as of_relations, nearest_frames, relation_errors

TRUTH = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])


def test_errors_over_frames_with_truth_are_those_computed_by_hand():
    pose = TRUTH + [[3, 4, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert errors.rms(errors.position_distance(pose, TRUTH)) == pytest.approx(math.sqrt(25 / 4))
    hidden = TRUTH.copy()
    hidden[1:3] = np.nan
    assert errors.rms(errors.position_distance(pose, hidden)) == pytest.approx(math.sqrt(25 / 2))
    nothing = np.full_like(TRUTH, np.nan)
    assert math.isnan(errors.rms(errors.position_distance(TRUTH, nothing)))
    assert math.isnan(errors.aligned_rmse(TRUTH, nothing))
    assert math.isnan(errors.time_weighted_rmse(TRUTH, nothing, np.arange(4.0)))
    pose = TRUTH + [0, 0, math.radians(359)]
    assert errors.heading_rmse_deg(pose, TRUTH) == pytest.approx(1.0)
    time = np.array([0.0, 0.1, 0.2, 10.0])
    pose = TRUTH + [[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]]
    weights = np.array([0.05, 0.1, 4.95, 4.9])
    assert errors.frame_weights(time) == pytest.approx(weights)
    assert errors.time_weighted_rmse(pose, TRUTH, time) == pytest.approx(math.sqrt(5.1 / 10.0))


def test_alignment_undoes_a_rigid_motion_but_not_a_mirror_or_a_scale():
    truth = np.column_stack([np.random.default_rng(0).normal(size=(30, 2)), np.zeros(30)])
    c, s = math.cos(2.0), math.sin(2.0)
    moved = truth.copy()
    moved[:, :2] = truth[:, :2] @ np.array([[c, -s], [s, c]]).T + [5, -7]
    assert errors.aligned_rmse(moved, truth) < 1e-12
    assert errors.aligned_rmse(truth * [1, -1, 1], truth) > 0.3
    assert errors.aligned_rmse(truth * [2, 2, 1], truth) > 0.3


def test_landmarks_are_compared_by_the_true_id_of_their_founding_observation():
    truth = Truth(
        landmarks=LandmarkMap(np.array([3, 8]), np.array([[1.0, 1], [2, 2]])), landmark_of=np.array([8, 3, 8, -1, 99])
    )
    ids = errors.landmark_true_ids(np.array([0, 1, -1, 2, 3]), truth, np.array([0, 1, 2, 3]))
    assert ids.tolist() == [8, 3, -1, 99]
    off = errors.landmark_errors(np.array([[2.0, 3], [1, 1], [0, 0], [9, 9]]), ids, truth, RangeBearing())
    assert off[:2].tolist() == [[0, 1], [0, 0]]
    assert np.isnan(off[2:]).all(), "clutter and ids without a surveyed position have no error"
    assert np.isnan(errors.landmark_errors(np.array([[2.0, 3]]), ids[:1], truth, Line())).all(), "nor have walls"


@pytest.mark.parametrize(
    ("sensed", "true", "ids"), [(False, None, [8, 3, 3]), (True, None, None), (False, [3, 8, 8], [3, 8, 8])]
)
def test_labels_of_the_author_stand_for_missing_true_ids(sensed, true, ids):
    log = simulate(Arena(frames=3, landmarks=4), 0)
    truth = replace(log.truth, landmark_of=None if true is None else np.array(true))
    found = errors.identified(
        replace(log, truth=truth, label=np.array([8, 3, 3]), labels_are_sensed=sensed)
    ).landmark_of
    assert (found if ids is None else found.tolist()) == ids


RIGHT = math.pi / 2


def test_an_error_of_heading_moves_by_the_length_of_the_relation():
    """Found 10 m ahead, turned left; the reference says 10 m ahead, not turned."""
    a, b = np.zeros((1, 3)), np.array([[10.0, 0.0, RIGHT]])
    relative = np.array([[10.0, 0.0, 0.0]])
    np.testing.assert_allclose(of_relations(a, b, relative), [[10.0, -10.0, RIGHT]], atol=1e-12)


PATH = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.1], [4.0, 0.0, 0.0]])


def test_relations_are_scored_by_mean_std_and_maximum_in_metres_and_degrees():
    relative = np.array([[1.0, 0.0, 0.0], [1.0, 0.4, 0.0], [2.0, 0.0, 0.0]])
    relations = Relations(np.array([0, 0, 2]), np.array([1, 1, 4]), relative, np.array([1, 0, 1]))
    got = relation_errors(PATH, relations, np.arange(5.0))
    assert got.relations == 3
    assert got.trans_mean_m == pytest.approx(0.4 / 3)
    assert got.trans_std_m == pytest.approx(0.4 * math.sqrt(2.0) / 3)
    assert got.trans_max_m == pytest.approx(0.4)
    assert (got.rot_mean_deg, got.rot_max_deg) == (0.0, 0.0)
    exact = relation_errors(PATH, relations, np.arange(5.0), subset="exact")
    assert (exact.relations, exact.trans_max_m) == (2, 0.0)
    relations = Relations(np.array([2, 3]), np.array([3, 4]), np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    got = relation_errors(PATH, relations, np.arange(5.0))
    assert got.rot_mean_deg == got.rot_max_deg == pytest.approx(math.degrees(0.1))
    assert got.rot_std_deg == pytest.approx(0.0, abs=1e-12)


def test_relations_that_say_nothing_of_stamps_or_of_exactness_are_not_asked_for_it_and_lost_poses_not_counted():
    relations = Relations(np.array([0, 1]), np.array([1, 2]), np.array([[1.0, 0.0, 0.0]] * 2))
    time = np.arange(5.0)
    assert relation_errors(PATH, relations, time, tie="time") is None
    assert relation_errors(PATH, relations, time, subset="exact") is None
    lost = PATH.copy()
    lost[2] = np.nan
    assert relation_errors(lost, relations, time).relations == 1
    nothing = relation_errors(np.full((5, 3), np.nan), relations, time)
    assert nothing.relations == 0
    assert math.isnan(nothing.trans_mean_m)


def test_a_stamp_between_two_frames_is_between_their_poses_and_headings_take_the_shorter_way():
    path = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0], [3.0, 2.0, -3.0]])
    got = at_stamps(path, np.array([0.0, 1.0, 2.0]), np.array([0.25, 0.75, 1.0, 1.5, -4.0, 9.0]))
    turn = 2.0 * (math.pi - 3.0)
    np.testing.assert_allclose(got[0], [0.25, 0.5, 3.0 + 0.25 * turn], atol=1e-12)
    np.testing.assert_allclose(got[1], [0.75, 1.5, -3.0 - 0.25 * turn], atol=1e-12)
    np.testing.assert_allclose(got[2:], [path[1], [2.0, 2.0, -3.0], path[0], path[2]], atol=1e-12)


def test_stamps_that_come_in_bursts_and_go_back_are_tied_to_the_nearest_frame_by_line_order():
    """Frames 1 to 3 were stamped together, frame 4 before them."""
    path = np.array([[float(k), 0.0, 0.0] for k in range(6)])
    stamp = np.array([0.0, 1.0, 1.0, 1.0, 0.9, 2.0])
    assert nearest_frames(stamp, np.array([1.0, 0.91, 0.96, 1.4, 1.6])).tolist() == [1, 4, 1, 1, 5]
    assert nearest_frames(np.array([2.0, 1.0]), np.array([1.5])).tolist() == [0]  # half way: the first in line order
    got = at_stamps(path, stamp, np.array([1.0, 0.92, 0.98, 1.4, 1.6]))
    # 0.92: nearest is frame 4; the next one (2.0) is on that side: 0.02 of 1.1 on. 1.4: nearest is frame 1, whose
    # neighbours (1.0 and 0.0) are not on that side: the frame's own pose
    np.testing.assert_allclose(got[:, 0], [1.0, 4.0 + 0.02 / 1.1, 0.98, 1.0, 4.0 + 0.7 / 1.1], atol=1e-12)


def test_by_time_the_recorded_stamps_count_and_not_the_logs_time():
    recorded = np.array([0.0, 1.0, 1.0, 3.0, 4.0])
    relations = Relations(
        np.array([0]), np.array([4]), np.array([[2.5, 0.0, 0.0]]), stamp=np.array([[0.5, 3.0]]), frame_stamp=recorded
    )
    by_time = relation_errors(PATH, relations, np.arange(5.0), tie="time")
    assert by_time.trans_mean_m == pytest.approx(math.hypot(0.0, 0.25), abs=0.01)
    assert relation_errors(PATH, relations, np.arange(5.0)).trans_mean_m == pytest.approx(1.5)


P = np.array([[0.09, 0.02, 0.004], [0.02, 0.04, -0.003], [0.004, -0.003, 0.0025]])


def test_the_log_score_is_the_negative_log_density():
    e = np.array([[0.1, -0.3, 0.02], [0.0, 0.0, 0.0], [3.0, 1.0, -0.2]])
    found = log_score(e, np.tile(P, (3, 1, 1)))
    assert found == pytest.approx(-stats.multivariate_normal(np.zeros(3), P).logpdf(e), rel=1e-12)


def test_the_crps_is_the_integral_of_the_squared_difference_of_distributions():
    """Matheson & Winkler 1976: of the distribution functions of belief and truth, the latter a step."""
    for e, s in ((0.0, 1.0), (0.7, 0.4), (-2.0, 0.5), (1e-3, 2.0)):
        below = integrate.quad(lambda x, s=s: stats.norm.cdf(x, scale=s) ** 2, -20.0 * s, e)[0]
        above = integrate.quad(lambda x, s=s: stats.norm.sf(x, scale=s) ** 2, e, e + 20.0 * s)[0]
        assert float(crps(np.array(e), np.array(s))) == pytest.approx(below + above, rel=1e-8)


def distance_by_integration(y, S):
    """E|X - y| for X from N(0, S), over radius and direction of the whitened plane."""
    L = np.linalg.cholesky(S)

    def integrand(a, r):
        x = r * (L @ np.array([math.cos(a), math.sin(a)])) - y
        return math.hypot(*x) * r * math.exp(-0.5 * r * r) / (2.0 * math.pi)

    return integrate.dblquad(integrand, 0.0, 9.0, 0.0, 2.0 * math.pi, epsabs=1e-8)[0]


@pytest.mark.parametrize("y", [(0.0, 0.0), (0.3, -0.2), (1.5, 0.9)], ids=str)
def test_the_energy_score_is_that_of_numeric_integration(y):
    S = P[:2, :2]
    expected = distance_by_integration(np.array(y), S) - 0.5 * distance_by_integration(np.zeros(2), 2.0 * S)
    assert energy_score(np.array([y]), S[None])[0] == pytest.approx(expected, rel=1e-6)


def test_the_energy_score_of_a_belief_without_width_is_the_distance_and_of_a_line_the_crps():
    assert energy_score(np.array([[3.0, 4.0]]), 1e-14 * np.eye(2)[None])[0] == pytest.approx(5.0, rel=1e-6)
    for y in (0.0, 0.5, -2.0):
        line = energy_score(np.array([[y, 0.0]]), np.diag([0.25, 1e-14])[None])[0]
        assert line == pytest.approx(float(crps(np.array(y), np.array(0.5))), rel=1e-5)


def test_scores_of_a_path_are_means_over_its_frames_with_truth_and_a_regular_covariance():
    pose, truth = np.array([[0.0, 0.0, math.pi - 0.01]]), np.array([[0.0, 0.0, -math.pi + 0.01]])
    near = mean_scores(np.array([[0.0, 0.0, -0.02]]), P[None], np.zeros((1, 3)), np.ones(1, bool))
    assert mean_scores(pose, P[None], truth, np.ones(1, bool)) == pytest.approx(near)
    pose, truth = np.array([[0.1, -0.3, 0.02], [0.0, 0.4, -0.1]]), np.zeros((2, 3))
    both = mean_scores(pose, np.tile(P, (2, 1, 1)), truth, np.ones(2, bool))
    each = [mean_scores(pose[k : k + 1], P[None], truth[:1], np.ones(1, bool)) for k in range(2)]
    assert both == pytest.approx({name: 0.5 * (each[0][name] + each[1][name]) for name in both})
    assert each[0]["crps_y_m"] == pytest.approx(float(crps(np.array(-0.3), np.array(0.2))))
    pose = np.array([[0.1, 0.0, 0.0], [9.0, 9.0, 1.0], [0.1, 0.0, 0.0]])
    scored = np.array([True, False, False])
    covariance = np.stack([P, np.zeros((3, 3)), np.full((3, 3), np.nan)])
    truth = np.zeros((3, 3))
    assert mean_scores(pose, covariance, truth, scored) == mean_scores(pose[:1], P[None], truth[:1], scored[:1])
    assert mean_scores(pose, covariance, truth, np.zeros(3, bool)) == {}
    assert np.isnan(energy_score(np.array([[np.nan, 0.0]]), P[None, :2, :2])).all()
