"""First-estimates Jacobians: a dense filter written from the paper as oracle; no false certainty in the heading."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import FrameObservations, Prior
from data.sensors import RelativePoint
from data.worlds.arena import Arena, simulate
from ekf.filter import FilterOptions
from ekf.slam import EkfSlam
from eval.replay.run import compare

J = np.array([[0.0, -1.0], [1.0, 0.0]])
FEJ = FilterOptions(first_estimates=True)


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


class Dense:
    """FEJ-EKF of Huang, Mourikis and Roumeliotis 2010 with dense matrices; state [x, y, theta, landmarks]."""

    def __init__(self, prior):
        self.x, self.P = prior.mean.copy(), prior.covariance.copy()
        self.predicted, self.initialized, self.slot = prior.mean.copy(), [], {}

    def predict(self, motion, M):
        d = len(self.x)
        before = self.predicted.copy()
        B = np.eye(3)
        B[:2, :2] = rotation(self.x[2])
        self.x[:3] = self.x[:3] + B @ motion
        F = np.eye(d)
        F[:2, 2] = J @ (self.x[:2] - before[:2])
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += B @ M @ B.T
        self.predicted = self.x[:3].copy()

    def update(self, z, R, ids):
        rows, nu, noise = [], [], []
        d = len(self.x)
        for zi, Ri, n in zip(z, R, ids, strict=True):
            if n not in self.slot:
                continue
            s = self.slot[n]
            C = rotation(self.predicted[2])
            H = np.zeros((2, d))
            H[:, :2] = -C.T
            H[:, 2] = -C.T @ J @ (self.initialized[s] - self.predicted[:2])
            H[:, 3 + 2 * s : 5 + 2 * s] = C.T
            rows.append(H)
            nu.append(zi - rotation(self.x[2]).T @ (self.x[3 + 2 * s : 5 + 2 * s] - self.x[:2]))
            noise.append(Ri)
        if rows:
            H, k = np.concatenate(rows), len(noise)
            S = H @ self.P @ H.T
            for i in range(k):
                S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += noise[i]
            K = self.P @ H.T @ np.linalg.inv(S)
            self.x = self.x + K @ np.concatenate(nu)
            self.P = self.P - K @ S @ K.T
        for zi, Ri, n in zip(z, R, ids, strict=True):
            if n in self.slot:
                continue
            d = len(self.x)
            C = rotation(self.x[2])
            xy = self.x[:2] + C @ zi
            G = np.zeros((2, d))
            G[:, :2], G[:, 2] = np.eye(2), J @ (xy - self.predicted[:2])
            full = np.zeros((d + 2, d + 2))
            full[:d, :d], full[d:, :d], full[:d, d:] = self.P, G @ self.P, (G @ self.P).T
            full[d:, d:] = G @ self.P @ G.T + C @ Ri @ C.T
            self.x, self.P = np.concatenate([self.x, xy]), full
            self.slot[n] = len(self.initialized)
            self.initialized.append(xy)


@pytest.fixture(scope="module")
def log():
    return simulate(Arena(frames=80, sensor="relative_point", detection=0.8), 5)


def test_every_step_is_that_of_a_dense_filter(log):
    inputs = log.inputs(labels=True).without_map()
    o = inputs.observations
    f, dense = EkfSlam(inputs.prior, inputs.sensor, FEJ), Dense(inputs.prior)
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
            s = dense.slot.pop(gone)
            stay = np.delete(np.arange(len(dense.x)), [3 + 2 * s, 4 + 2 * s])
            dense.x, dense.P = dense.x[stay], dense.P[np.ix_(stay, stay)]
            del dense.initialized[s]
            dense.slot = {n: i - (i > s) for n, i in dense.slot.items()}
        done = f.update(inputs.frame_observations(k), np.array([number.get(i, -1) for i in ids], np.int64))
        number.update((i, int(n)) for i, n in zip(ids, done.created, strict=True) if n >= 0)
        dense.update(o.z[rows], o.R[rows], ids)
        dense.x[2] = np.arctan2(np.sin(dense.x[2]), np.cos(dense.x[2]))
        np.testing.assert_allclose(f.mean, dense.x, atol=1e-9)
        np.testing.assert_allclose(f.covariance, dense.P, atol=1e-10)


def test_the_expectation_is_formed_with_the_jacobians_of_the_update(log):
    inputs = log.inputs(labels=True).without_map()
    f = EkfSlam(inputs.prior, inputs.sensor, FEJ)
    n = len(inputs.frame_observations(0).z)
    f.update(inputs.frame_observations(0), np.full(n, -1))
    for k in range(1, 4):
        f.predict(inputs.increment(k))
        f.update(
            FrameObservations(inputs.frame_observations(0).z + 0.05 * k, inputs.frame_observations(0).R), np.arange(n)
        )
    f.predict(inputs.increment(5))
    e = f.expect(inputs.frame_observations(5))
    S = e.joint(np.arange(n))
    for i in range(n):
        np.testing.assert_allclose(S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], e.HPHt[i], atol=1e-12)
    H = np.zeros((2 * n, f.size))
    first = f._first
    C = rotation(first[2])
    for i in range(n):
        a = 3 + 2 * i
        H[2 * i : 2 * i + 2, :2], H[2 * i : 2 * i + 2, a : a + 2] = -C.T, C.T
        H[2 * i : 2 * i + 2, 2] = -C.T @ J @ (first[a : a + 2] - first[:2])
    np.testing.assert_allclose(S, H @ f.covariance @ H.T, atol=1e-12)


def test_the_heading_is_as_uncertain_as_the_smoothers_where_the_plain_filter_is_too_certain():
    names = ["ekf", "ekf-fej", "ekf-invariant", "isam2"]
    *filters, isam2 = compare(simulate(Arena(), 0).inputs(labels=True), "slam", names)
    plain, *others = (np.median(r.online.covariance[50:, 2, 2] / isam2.online.covariance[50:, 2, 2]) for r in filters)
    assert plain < 0.95
    assert others == pytest.approx([1.0, 1.0], abs=0.03)
    off = [np.abs(r.online.pose - isam2.online.pose)[:, :2].max() for r in filters]
    assert off[2] < 0.25 * off[0]


def test_what_first_estimates_exclude_is_refused():
    for more in ({"iterations": 3}, {"invariant": True}):
        with pytest.raises(ValueError, match="first estimates"):
            FilterOptions(first_estimates=True, **more)
    f = EkfSlam(Prior(np.zeros(3), 0.01 * np.eye(3)), RelativePoint(), FEJ)
    f.update(FrameObservations(np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None]), np.array([-1]))
    with pytest.raises(ValueError, match="first estimate"):
        f.park(np.array([0]))
