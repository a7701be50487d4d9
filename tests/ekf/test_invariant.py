"""The right-invariant correction: exponential of the group, a stored run of others, no false certainty in heading."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat
from scipy.linalg import expm

from data.inputs import FrameObservations, Increment, Prior
from data.sensors import RelativePoint
from ekf import updates
from ekf.filter import FilterOptions
from ekf.slam import EkfSlam
from eval.referee import consistency
from tests.quick import examples

J = np.array([[0.0, -1.0], [1.0, 0.0]])


def group(xi, points):
    """Points (n, 2) moved by exp of the algebra element xi = (angle, rho (n, 2)): a matrix exponential, no formula."""
    angle, rho = xi
    n = len(points)
    A = np.zeros((2 + n, 2 + n))
    A[:2, :2], A[:2, 2:] = angle * J, rho.T
    chi = np.eye(2 + n)
    chi[:2, 2:] = points.T
    return (expm(A) @ chi)[:2, 2:].T


@given(seed=st.integers(0, 10**6), angle=st.sampled_from([0.0, 1e-9, -3e-5, 2e-4, 0.3, -1.2]))
@settings(max_examples=examples(60), deadline=None)
def test_pose_and_landmarks_move_by_the_exponential_and_the_covariance_goes_along(seed, angle):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 4))
    base = 3 + int(rng.integers(0, 4))
    d = base + 2 * n
    mean, shift = rng.normal(0.0, 5.0, d), rng.normal(0.0, 0.3, d)
    shift[2] = angle
    root = rng.normal(0.0, 1.0, (d, d))
    P = root @ root.T
    index = [np.array([0, 1]), *(np.array([base, base + 1]) + 2 * i for i in range(n))]
    points = np.array([mean[i] for i in index])
    rho = np.array([shift[i] - angle * J @ mean[i] for i in index])
    expected = group((angle, rho), points)
    N = np.eye(d)
    for i, before, after in zip(index, points, expected, strict=True):
        N[i, 2] += J @ (after - before)
    moved, Q = mean.copy(), P.copy()
    updates.move(moved, Q, d, shift, base, 0, 0)
    np.testing.assert_allclose(np.array([moved[i] for i in index]), expected, atol=1e-11)
    assert moved[2] == mean[2] + angle
    np.testing.assert_allclose(moved[3:base], mean[3:base] + shift[3:base], atol=1e-14)  # errors are no points
    np.testing.assert_allclose(Q, N @ P @ N.T, atol=1e-9 * np.abs(P).max())
    np.testing.assert_array_equal(Q, Q.T)


@pytest.mark.parametrize(("invariant", "stored", "tolerance"), [(False, "neesR_std", 1e-9), (True, "neesR_iekf", 1e-5)])
def test_a_stored_run_of_others_is_replayed_step_by_step(shared_data, invariant, stored, tolerance):
    """Second run of the file, from its inputs and measurements alone (Brossard, Barrau, Bonnabel 2019)."""
    m = loadmat(shared_data / "esde" / "results.mat")
    v, omega, z, truth = m["v_m"].ravel(), m["omega_m"].ravel(), m["z"], m["xR_true"][:, :, 1]
    sigma = 0.03
    Q = np.diag([(sigma / np.sqrt(2.0)) ** 2, 0.0, (2.0 * np.sqrt(2.0) * sigma) ** 2])
    f = EkfSlam(Prior(np.zeros(3), np.zeros((3, 3))), RelativePoint(), FilterOptions(invariant=invariant))
    number: dict[int, int] = {}
    nees = np.full(400, np.nan)
    for k in range(1, 400):
        B = np.eye(3)
        if invariant:  # that program turns the column of the speed's noise by the heading after the step
            c, s = np.cos(omega[k - 1]), np.sin(omega[k - 1])
            B[:2, :2] = [[c, -s], [s, c]]
        f.predict(Increment(np.array([v[k - 1], 0.0, omega[k - 1]]), B @ Q @ B.T))
        slots = np.flatnonzero(z[2, :, k] > 0)
        ids = z[2, slots, k].astype(int).tolist()
        R = np.tile(0.01 * np.eye(2), (len(slots), 1, 1))
        done = f.update(FrameObservations(z[:2, slots, k].T, R), np.array([number.get(i, -1) for i in ids], np.int64))
        number.update((i, int(n)) for i, n in zip(ids, done.created, strict=True) if n >= 0)
        pose, P = f.estimate()
        nees[k] = consistency.nees(pose[None], P[None], truth[:, k][None], "pose")[0]
    ours, theirs = nees[4:], m[stored][0, 4:, 1]
    np.testing.assert_allclose(ours, theirs, rtol=tolerance)


def test_landmarks_of_the_invariant_filter_cannot_be_parked():
    f = EkfSlam(Prior(np.zeros(3), 0.01 * np.eye(3)), RelativePoint(), FilterOptions(invariant=True))
    f.update(FrameObservations(np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None]), np.array([-1]))
    with pytest.raises(ValueError, match="invariant"):
        f.park(np.array([0]))
