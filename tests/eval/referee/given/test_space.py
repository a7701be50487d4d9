"""Consistency in space: NEES of named errors in every convention, alignments by independent formulas, proper scores."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from smfeval.format import TangentOrder
from smfeval.se3.lie import se3_exp

from data.formats.results.path import LEFT, LOCAL, MIXED, WORLD, Spatial, Stated
from data.formats.results.space import moved
from eval.referee.given.in_space import InSpace, Poses, aligning, relative_columns
from eval.referee.space_scores import columns_in_space
from tests.oracle.evo_numbers import paths_in_space as recorded
from tests.quick import slow

ORDER = TangentOrder.TRANS_ROT
ROOT = np.diag([0.3, 0.1, 0.2, 0.02, 0.03, 0.05]) @ (np.eye(6) + 0.3 * np.tril(np.ones((6, 6)), -1))
C = ROOT @ ROOT.T


def drawn(frame, n=1500, seed=0, size=1.0):
    """Means, and true poses drawn from the stated covariance by each convention's own definition."""
    rng = np.random.default_rng(seed)
    M_R, M_p = Rotation.random(n, random_state=seed).as_matrix(), rng.normal(0.0, 3.0, (n, 3))
    P = size**2 * C
    T_R, T_p = np.empty_like(M_R), np.empty_like(M_p)
    for k, xi in enumerate(size * rng.normal(size=(n, 6)) @ ROOT.T):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = M_R[k], M_p[k]
        if frame == LOCAL:
            T = T @ se3_exp(xi, ORDER)
        elif frame == LEFT:
            T = se3_exp(xi, ORDER) @ T
        else:
            turn = Rotation.from_rotvec(xi[3:]).as_matrix()
            T[:3, :3] = turn @ M_R[k] if frame == WORLD else M_R[k] @ turn
            T[:3, 3] = M_p[k] + xi[:3]
        T_R[k], T_p[k] = T[:3, :3], T[:3, 3]
    estimate = Spatial(
        "a", "", np.arange(n, dtype=float), M_p, M_R, np.tile(P, (n, 1, 1)), frame, str, Stated(convention=True)
    )
    return InSpace(estimate, Poses(T_p, T_R), estimate)


OWN = {LOCAL: "left_invariant", LEFT: "right_invariant", WORLD: "decoupled", MIXED: "decoupled"}


@pytest.mark.parametrize("frame", [LOCAL, WORLD, slow(LEFT), slow(MIXED)])
def test_nees_of_poses_drawn_by_a_convention_is_that_of_a_chi_square(frame):
    found = columns_in_space(drawn(frame))
    assert found[f"nees_3d_{OWN[frame]}"] == pytest.approx(6.0, abs=4.0 * math.sqrt(12.0 / 1500))
    if frame in (WORLD, MIXED):
        for part in ("position", "rotation"):
            assert found[f"nees_3d_{part}"] == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / 1500))
        assert found["inside_3sigma_x_3d"] == pytest.approx(0.9973, abs=0.006)


@pytest.mark.parametrize("frame", OWN)
def test_moving_estimate_and_truth_alike_changes_no_nees(frame):
    both = drawn(frame, n=30)
    R, t = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix(), np.array([3.0, -1.0, 2.0])
    estimate = moved(both.estimate, R, t)
    truth = Poses(both.truth.position @ R.T + t, R @ both.truth.rotation)
    before, after = columns_in_space(both), columns_in_space(InSpace(estimate, truth, estimate))
    for name in ("left_invariant", "right_invariant", "decoupled", "position", "rotation"):
        assert after[f"nees_3d_{name}"] == pytest.approx(before[f"nees_3d_{name}"], rel=1e-9)


def test_nees_of_openvins_by_its_own_formulas():
    """Rotation error -Log(R R_mean') of rotations to the body, position error in the world."""
    both = drawn(MIXED, n=50)
    e, truth = both.estimate, both.truth
    rotation, position = [], []
    for k in range(50):
        to_body, mean = truth.rotation[k].T, e.rotation[k].T
        error = -Rotation.from_matrix(to_body @ mean.T).as_rotvec()
        rotation.append(error @ np.linalg.solve(e.covariance[k, 3:, 3:], error))
        error = truth.position[k] - e.position[k]
        position.append(error @ np.linalg.solve(e.covariance[k, :3, :3], error))
    found = columns_in_space(both)
    assert found["nees_3d_rotation"] == pytest.approx(np.mean(rotation), rel=1e-9)
    assert found["nees_3d_position"] == pytest.approx(np.mean(position), rel=1e-9)


def test_yaw_alignment_is_the_best_over_a_search():
    (p, R), (q, S) = recorded()
    estimate, truth = Poses(q, S.as_matrix()), Poses(p, R.as_matrix())
    fit = aligning(estimate, truth, "yaw")
    assert fit.scale == 1.0
    assert fit.R[2] == pytest.approx([0.0, 0.0, 1.0])

    def rms(angle):
        turned = Rotation.from_euler("z", angle).apply(q)
        off = turned - turned.mean(axis=0) - (p - p.mean(axis=0))
        return math.sqrt(np.mean(np.sum(off**2, axis=1)))

    angle = math.atan2(fit.R[1, 0], fit.R[0, 0])
    assert math.sqrt(np.mean(np.sum((q @ fit.R.T + fit.t - p) ** 2, axis=1))) == pytest.approx(rms(angle))
    assert all(rms(angle) <= rms(other) for other in np.linspace(-math.pi, math.pi, 721))


def test_poses_on_a_line_are_turned_about_it_as_their_rotations_say():
    n = 10
    p = np.column_stack([np.arange(n, dtype=float), np.zeros(n), np.zeros(n)])
    R = Rotation.from_euler("x", np.linspace(0.0, 0.3, n)[:, None]).as_matrix()
    W = Rotation.from_rotvec([0.5, -1.0, 2.0]).as_matrix()
    fit = aligning(Poses(p @ W.T + 1.0, W @ R), Poses(p, R), "se3")
    assert pytest.approx(W.T) == fit.R
    still = aligning(Poses(np.ones((n, 3)), W @ R), Poses(np.zeros((n, 3)), R), "se3")
    assert pytest.approx(W.T) == still.R


def by_loops(distances, length, most):
    """For each pose the later one whose distance along the path is nearest to `length`, as both programs search it."""
    found = []
    for i, start in enumerate(distances):
        best, error = -1, most
        for j in range(i, len(distances)):
            if abs(distances[j] - (start + length)) < error:
                best, error = j, abs(distances[j] - (start + length))
        if best != -1:
            found.append((i, best))
    return found


@pytest.mark.parametrize(("pairs", "name", "share"), [("rpg", "30percent", 0.3), ("openvins", "16m", None)])
def test_relative_errors_of_others_pairs(pairs, name, share):
    (p, R), (q, S) = recorded()
    found = relative_columns(Poses(q, S.as_matrix()), Poses(p, R.as_matrix()), np.arange(float(len(p))), pairs)
    distances = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    length = 16.0 if share is None else share * distances[-1]
    off, turn = [], []
    for i, j in by_loops(distances, length, 0.5 if share is None else 0.2 * length):
        true, mine = (np.linalg.inv(T[i]) @ T[j] for T in (frames(p, R), frames(q, S)))
        error = np.linalg.inv(true) @ mine
        off.append(np.linalg.norm(error[:3, 3]))
        turn.append(math.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()))
    assert found[f"rpe_{name}_3d_m"] == pytest.approx(math.sqrt(np.mean(np.square(off))), rel=1e-9)
    assert found[f"rpe_{name}_3d_median_m"] == pytest.approx(np.median(off), rel=1e-9)
    assert found[f"rpe_{name}_3d_median_deg"] == pytest.approx(np.median(turn), rel=1e-9)


def test_the_mean_drift_of_kitti_is_that_of_its_segments():
    """Of every tenth pose and each length the first pose that is farther along the true path."""
    (p, R), (q, S) = recorded()
    p, q = 30.0 * p, 30.0 * q
    found = relative_columns(Poses(q, S.as_matrix()), Poses(p, R.as_matrix()), np.arange(float(len(p))), "kitti")
    way, drift = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]), []
    for i in range(0, len(p), 10):
        for length in range(100, 900, 100):
            if j := next((k for k in range(i, len(p)) if way[k] > way[i] + length), 0):
                true, mine = (np.linalg.inv(T[i]) @ T[j] for T in (frames(p, R), frames(q, S)))
                error = np.linalg.inv(mine) @ true
                turn = math.degrees(Rotation.from_matrix(error[:3, :3]).magnitude())
                drift.append((100.0 * np.linalg.norm(error[:3, 3]) / length, turn / length))
    assert len(drift) > 20
    assert (found["drift_3d_percent"], found["drift_3d_deg_per_m"]) == pytest.approx(tuple(np.mean(drift, axis=0)))


def frames(p, R):
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R.as_matrix(), p
    return T
