"""Variants of the filter against what defines them: first estimates, exponentials of the group, optima of a frame."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.io import loadmat
from scipy.linalg import expm
from scipy.optimize import least_squares

from data.inputs import FrameObservations, Increment, LandmarkMap, Prior
from data.se2 import wrap_angle
from data.sensors import RangeBearing, RelativePoint
from data.worlds.arena import Arena, simulate
from ekf import updates
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.referee import consistency
from tests.ekf.lines.dense import Dense
from tests.quick import examples

J = np.array([[0.0, -1.0], [1.0, 0.0]])
FEJ = FilterOptions(first_estimates=True)


@pytest.fixture(scope="module")
def log():
    return simulate(Arena(frames=80, sensor="relative_point", detection=0.8), 5)


def test_every_step_is_that_of_a_dense_filter(log):
    inputs = log.inputs(labels=True).without_map()
    o = inputs.observations
    f, dense = EkfSlam(inputs.prior, inputs.sensor, FEJ), Dense(inputs.prior, inputs.sensor, first=True)
    number: dict[int, int] = {}
    for k in range(len(inputs)):
        rows = slice(inputs.start[k], inputs.start[k + 1])
        if k:
            f.predict(inputs.increment(k))
            dense.predict(*inputs.increment(k))
        ids = o.label[rows].tolist()
        if k == 40:
            gone = min(number)
            f.remove(np.array([number.pop(gone)]))
            dense.remove(gone)
        done = f.update(inputs.frame_observations(k), np.array([number.get(i, -1) for i in ids], np.int64))
        number.update((i, int(n)) for i, n in zip(ids, done.created, strict=True) if n >= 0)
        dense.update(o.z[rows], o.R[rows], ids)
        dense.x[2] = np.arctan2(np.sin(dense.x[2]), np.cos(dense.x[2]))
        np.testing.assert_allclose(f.mean, dense.x, atol=1e-9)
        np.testing.assert_allclose(f.covariance, dense.P, atol=1e-10)


def test_what_first_estimates_and_the_invariant_filter_exclude_is_refused():
    for more in ({"iterations": 3}, {"invariant": True}):
        with pytest.raises(ValueError, match="first estimates"):
            FilterOptions(first_estimates=True, **more)
    for options, why in ((FEJ, "first estimate"), (FilterOptions(invariant=True), "invariant")):
        f = EkfSlam(Prior(np.zeros(3), 0.01 * np.eye(3)), RelativePoint(), options)
        f.update(FrameObservations(np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None]), np.array([-1]))
        with pytest.raises(ValueError, match=why):
            f.park(np.array([0]))


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
    expected = group((angle, np.array([shift[i] - angle * J @ mean[i] for i in index])), points)
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


LANDMARKS = LandmarkMap(np.arange(3), np.array([[2.0, 1.0], [-1.0, 2.5], [1.0, -3.0]]))
PRIOR = Prior(np.array([0.4, -0.3, 0.5]), np.diag([0.5, 0.5, 0.3]))
R = np.tile(np.diag([0.01, 0.001]), (3, 1, 1))


def observations():
    return FrameObservations(RangeBearing().predict(np.array([-0.2, 0.3, 0.1]), LANDMARKS.xy), R)


def test_the_update_ends_at_the_least_cost_and_its_covariance_is_the_inverse_information_there():
    f = EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS, FilterOptions(iterations=50))
    f.update(observations(), np.arange(3))
    pose, P = f.estimate()
    W = np.linalg.inv(np.linalg.cholesky(R))
    W0 = np.linalg.inv(np.linalg.cholesky(PRIOR.covariance))

    def residuals(x):
        d = LANDMARKS.xy - x[:2]
        bearing = np.arctan2(d[:, 1], d[:, 0]) - x[2]
        nu = observations().z - np.stack([np.hypot(d[:, 0], d[:, 1]), bearing], axis=1)
        nu[:, 1] = wrap_angle(nu[:, 1])
        return np.concatenate([W0 @ (x - PRIOR.mean), np.einsum("nij,nj->ni", W, nu).ravel()])

    best = least_squares(residuals, PRIOR.mean, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(pose, best.x, atol=1e-6)
    np.testing.assert_allclose(P, np.linalg.inv(best.jac.T @ best.jac), rtol=1e-4, atol=1e-8)
    plain = EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS)
    plain.update(observations(), np.arange(3))
    cost = [np.sum(residuals(x) ** 2) for x in (plain.estimate().mean, pose)]
    assert cost[1] < 0.5 * cost[0]


def test_innovation_statistics_are_those_at_the_prediction():
    plain, iterated = (EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS, FilterOptions(iterations=n)) for n in (1, 9))
    a, b = (f.update(observations(), np.arange(3)) for f in (plain, iterated))
    assert (a.nis, a.dof) == pytest.approx((b.nis, b.dof), rel=1e-12)
    assert a.log_likelihood == pytest.approx(b.log_likelihood, rel=1e-12)
