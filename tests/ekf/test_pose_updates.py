"""Fixes and closures in the filter, against dense oracles: linear least squares over all poses, and a filter that keeps
every pose.
"""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Increment, LandmarkMap, Prior
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import wrap_angle
from data.sensors import RelativePoint
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer

VARIANTS = {
    "plain": FilterOptions(),
    "iterated": FilterOptions(iterations=10),
    "fej": FilterOptions(first_estimates=True),
    "invariant": FilterOptions(invariant=True),
}
J = np.array([[0.0, -1.0], [1.0, 0.0]])
NOWHERE = LandmarkMap(np.array([0]), np.array([[5.0, 5.0]]))
SENSOR = RelativePoint(max_range=50.0)


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def spd(rng, n, size):
    A = rng.normal(0.0, size, (n, n))
    return A @ A.T + 0.2 * size**2 * np.eye(n)


def fixes_of(rows, sources):
    """`Fixes` of (frame, kind, source, z, covariance), z and covariance as measured."""
    z, C = np.zeros((len(rows), 3)), np.zeros((len(rows), 3, 3))
    for i, (_, kind, _, value, covariance) in enumerate(rows):
        entries = {FixKind.POSITION: [0, 1], FixKind.HEADING: [2], FixKind.POSE: [0, 1, 2]}[kind]
        z[i, entries] = value
        C[i][np.ix_(entries, entries)] = covariance
    columns = [np.array([row[c] for row in rows], np.int64) for c in range(3)]
    return Fixes(*columns, z, C, sources)


def closures_of(rows):
    """`Closures` of (frame1, frame2, relative, covariance), sorted by the later frame."""
    rows = sorted(rows, key=lambda row: max(row[:2]))
    columns = [np.array([row[c] for row in rows]) for c in range(4)]
    return Closures(*columns, np.zeros(len(rows)), ("matcher",))


def through(filter_, motions, fixes=None, closures=None, gate=None):
    """The filter after all frames, and what it did with the fixes and closures of each."""
    done = []
    if closures is not None:
        filter_.keep(closures.last_use())
    for k, motion in enumerate(motions):
        if k:
            filter_.predict(motion)
        if fixes is not None and (now := fixes.of(k)) is not None:
            done.append(filter_.fix(now, fixes.sources, gate))
        if closures is not None and (now := closures.of(k)) is not None:
            done.append(filter_.close_loops(now, gate))
    return done


class LeastSquares:
    """Linear least squares over the positions of all poses, whose headings are known exactly."""

    def __init__(self, frames):
        self.A, self.b, self.n = [], [], 2 * frames

    def add(self, z, covariance, *terms):
        """z = sum of H p_k + noise for terms (k, H)."""
        row = np.zeros((len(z), self.n))
        for k, H in terms:
            row[:, 2 * k : 2 * k + 2] += H
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        self.A.append(W @ row)
        self.b.append(W @ z)

    def last(self):
        A, b = np.concatenate(self.A), np.concatenate(self.b)
        P = np.linalg.inv(A.T @ A)
        return (P @ A.T @ b)[-2:], P[-2:, -2:]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("kind", ["position", "pose", "closure"])
def test_the_last_pose_is_that_of_least_squares_where_headings_are_known(kind, variant):
    rng = np.random.default_rng(3)
    frames, turn = 12, rng.uniform(-0.5, 0.5, 12)
    turn[0] = 0.0
    heading = 0.4 + np.cumsum(turn)
    source = FixSource("antenna", (0.3, -0.2), 0.1)
    prior = Prior(np.array([1.0, 2.0, 0.4]), np.zeros((3, 3)))
    prior.covariance.setflags(write=True)
    prior.covariance[:2, :2] = spd(rng, 2, 0.3)
    oracle, motions = LeastSquares(frames), [None]
    oracle.add(prior.mean[:2], prior.covariance[:2, :2], (0, np.eye(2)))
    for k in range(1, frames):
        d, M = rng.normal(0.0, 0.7, 2), np.zeros((3, 3))
        M[:2, :2] = spd(rng, 2, 0.2)
        C = rotation(heading[k - 1])
        oracle.add(C @ d, C @ M[:2, :2] @ C.T, (k - 1, -np.eye(2)), (k, np.eye(2)))
        motions.append(Increment(np.array([*d, turn[k]]), M))
    fixes, closures = [], []
    if kind == "closure":
        for a, b in [(0, 4), (5, 1), (3, 5), (2, 7), (8, 2), (0, 8), (6, 7)]:
            z, R = rng.normal(0.0, 1.0, 2), np.zeros((3, 3))
            R[:2, :2], R[2, 2] = spd(rng, 2, 0.3), 0.1
            closures.append((a, b, np.array([*z, heading[b] - heading[a]]), R))
            C = rotation(heading[a]).T
            oracle.add(z, R[:2, :2], (a, -C), (b, C))
    else:
        for k in [0, 2, 2, 5, 9]:
            z, R = rng.normal(0.0, 2.0, 2), spd(rng, 2, 0.4)
            oracle.add(z - rotation(heading[k]) @ source.lever, R, (k, np.eye(2)))
            if kind == "pose":
                z, R = np.array([*z, wrap_angle(heading[k] + 0.1)]), np.diag([0.0, 0.0, 0.2]) + np.pad(R, (0, 1))
            fixes.append((k, FixKind[kind.upper()], 0, z, R))
    filter_ = EkfLocalizer(prior, SENSOR, NOWHERE, VARIANTS[variant])
    through(
        filter_, motions, fixes_of(fixes, (source,)) if fixes else None, closures_of(closures) if closures else None
    )
    mean, P = oracle.last()
    np.testing.assert_allclose(filter_.estimate().mean, [*mean, wrap_angle(heading[-1])], atol=1e-9)
    np.testing.assert_allclose(filter_.estimate().covariance, np.pad(P, (0, 1)), atol=1e-9)
    assert not filter_._clones.frames or kind != "closure"
