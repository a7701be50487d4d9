"""Wrong estimators, each a right one with one mistake, and what the check should suspect; and sound approximations."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from eval.checks.kalman import Bug
from slamref import Expectation
from tests.eval.checks.plain import Plain, wrapped


def mutant(**methods):
    """A class with other methods."""
    return type("Mutant", (Plain,), methods)


def blocks(A):
    return A * np.kron(np.eye(len(A) // 2), np.ones((2, 2)))


def said(self, o, numbers, z_hat, joint, R=None, residual=None):
    R, residual = o.R if R is None else R, residual or self.sensor.residual
    return Expectation.from_arrays(o.z, z_hat, joint, R, residual, number=numbers)


def permuted(A):
    """The covariances between candidates belong to the neighbours; each candidate's own is right."""
    order = np.roll(np.arange(len(A)), 2)
    return A[np.ix_(order, order)] - blocks(A[np.ix_(order, order)]) + blocks(A)


def shifted(A):
    order = np.roll(np.arange(len(A)), 2)
    return A[np.ix_(order, order)]


def pinned(self, nu, S, R, rows):
    return float(nu @ np.linalg.pinv(S) @ nu)


def half_cross(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    return 0.5 * cross, own


def no_cross(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    return 0.0 * cross, own


def pose_alone(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    cross[:, 3:] = 0.0
    return cross, own


def noise_alone(self, Gx, Gz, R):
    return Plain.founded(self, Gx, Gz, R)[0], Gz @ R @ Gz.T


def unturned(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    return cross, own - Gz @ R @ Gz.T + R


def single(self, K, H, R, S):
    """Single precision, and nothing keeps the matrix symmetric."""
    A = (np.eye(len(self.P)) - K @ H).astype(np.float32)
    return (A @ self.P.astype(np.float32)).astype(float)


def lower(self, K, H, R, S):
    """Only the lower triangle is updated."""
    return np.tril(Plain.shrunk(self, K, H, R, S)) + np.triu(self.P, 1)


def simplified_joseph(self, K, H, R, S):
    A = np.eye(len(self.P)) - K @ H
    return A @ self.P @ A.T


def one_by_one_from_the_same_prior(self, K, H, R, S):
    P = self.P.copy()
    for i in range(0, len(H), 2):
        h = H[i : i + 2]
        P -= self.P @ h.T @ np.linalg.solve(h @ self.P @ h.T + R[i : i + 2, i : i + 2], h @ self.P)
    return 0.5 * (P + P.T)


def body(self):
    c, s = np.cos(self.x[2]), np.sin(self.x[2])
    B = block_diag([[c, -s], [s, c]], 1.0)
    return self.x[:3].copy(), B.T @ self.P[:3, :3] @ B


def only_pose(self, K, nu):
    return np.append((K @ nu)[:3], np.zeros(len(K) - 3))


def stale_cross(self, K, H, R, S):
    P = Plain.shrunk(self, K, H, R, S)
    P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
    return P


def before(self, o):
    """The expectation is formed at the pose of the frame before."""
    now, self.x = self.x, np.append(self.last, self.x[3:])
    e = Plain.expect(self, o)
    self.x = now
    return e


MUTANTS = {
    "no-R": (mutant(S=lambda s, HPH, R: HPH, gain=lambda s, H, S: s.P @ H.T @ np.linalg.pinv(S), nis=pinned), None),
    "R-doubled": (mutant(R=lambda s, R: 2 * R, R_new=lambda s, R: 2 * R), Bug.R_DOUBLED),
    "R-doubled-in-the-update": (mutant(R=lambda s, R: 2 * R), Bug.R_DOUBLED),
    "R-halved": (mutant(R=lambda s, R: R / 2, R_new=lambda s, R: R / 2), Bug.R_HALVED),
    "R-squared": (mutant(R=lambda s, R: R**2, R_new=lambda s, R: R**2), Bug.R_SQUARED),
    "R-is-sigma": (mutant(R=lambda s, R: np.sign(R) * np.abs(R) ** 0.5), Bug.R_ROOT),
    "R-of-the-first": (mutant(R=lambda s, R: np.repeat(R[:1], len(R), 0)), Bug.R_OF_THE_FIRST),
    "R-diagonal": (mutant(R=lambda s, R: R * np.eye(2), R_new=lambda s, R: R * np.eye(2)), Bug.R_DIAGONAL),
    "R-off-by-a-tenth": (mutant(R=lambda s, R: 1.1 * R), None),
    "no-Q": (mutant(Q=lambda s, M: 0 * M), Bug.Q_NONE),
    "Q-doubled": (mutant(Q=lambda s, M: 2 * M), Bug.Q_DOUBLED),
    "Q-halved": (mutant(Q=lambda s, M: M / 2), Bug.Q_HALVED),
    "Q-is-sigma": (mutant(Q=lambda s, M: np.sign(M) * np.abs(M) ** 0.5), Bug.Q_ROOT),
    "Q-squared": (mutant(Q=lambda s, M: M**2), Bug.Q_SQUARED),
    "Q-in-the-world-frame": (mutant(G=lambda s, c, n: np.eye(3)), Bug.Q_NOT_TURNED),
    "motion-in-the-world-frame": (
        mutant(moved=lambda s, c, n, u, v, w: (s.x[0] + u, s.x[1] + v, wrapped(s.x[2] + w))),
        Bug.MOTION_NOT_TURNED,
    ),
    "no-motion-Jacobian": (mutant(motion=lambda s, c, n, u, v: (np.eye(3), s.G(c, n))), Bug.MOTION_JACOBIAN_NONE),
    "motion-Jacobian-transposed": (
        mutant(motion=lambda s, c, n, u, v: (Plain.motion(s, c, n, u, v)[0].T, s.G(c, n))),
        None,
    ),
    "cross-covariance-not-predicted": (mutant(carried=lambda s, F, cross: cross), Bug.CROSS_NOT_PREDICTED),
    "stale-Jacobians": (mutant(at=lambda s: s.last), Bug.JACOBIAN_STALE),
    "Jacobian-without-heading": (mutant(Hx=lambda s, H: H * [1, 1, 0]), Bug.JACOBIAN_NO_HEADING),
    "Jacobian-sign": (mutant(Hx=lambda s, H: H * [1, 1, -1]), Bug.JACOBIAN_SIGN_OF_HEADING),
    "Jacobian-without-landmark": (mutant(Hl=lambda s, H: 0 * H), Bug.JACOBIAN_NO_LANDMARK),
    "no-wrap": (mutant(innovation=lambda s, z, z_hat: z - z_hat), Bug.INNOVATION_NOT_WRAPPED),
    "wrap-to-0-2pi": (
        mutant(innovation=lambda s, z, h: s.sensor.residual(z, h) % [1e9, 2 * np.pi] if s.sensor.kind == 0 else z - h),
        None,
    ),
    "S-in-blocks": (mutant(S=lambda s, HPH, R: blocks(HPH) + R), Bug.OBSERVATIONS_UNCORRELATED),
    "gain-with-a-stale-S": (mutant(gain=lambda s, H, S: 0.9 * Plain.gain(s, H, S)), None),
    "covariance-not-updated": (mutant(shrunk=lambda s, K, H, R, S: s.P), Bug.COVARIANCE_NOT_UPDATED),
    "Joseph-without-KRK": (mutant(shrunk=simplified_joseph), Bug.JOSEPH_WITHOUT_NOISE),
    "one-by-one-from-the-same-prior": (mutant(shrunk=one_by_one_from_the_same_prior), None),
    "single-precision": (mutant(shrunk=single), None),
    "not-symmetric": (mutant(shrunk=lower), None),
    "mean-not-updated": (mutant(step=lambda s, K, nu: 0 * K[:, 0]), Bug.MEAN_NOT_UPDATED),
    "map-not-corrected": (mutant(step=only_pose), Bug.MEAN_OF_MAP_NOT_UPDATED),
    "cross-covariance-not-updated": (mutant(shrunk=stale_cross), Bug.CROSS_NOT_UPDATED),
    "new-without-cross-covariance": (mutant(founded=no_cross), Bug.NEW_WITHOUT_CROSS),
    "new-with-half-the-cross-covariance": (mutant(founded=half_cross), Bug.NEW_HALF_CROSS),
    "new-without-cross-to-landmarks": (mutant(founded=pose_alone), Bug.NEW_CROSS_TO_POSE_ONLY),
    "new-without-R": (mutant(R_new=lambda s, R: 0 * R), Bug.NEW_WITHOUT_NOISE),
    "new-with-R-alone": (mutant(founded=noise_alone), Bug.NEW_WITHOUT_POSE),
    "new-with-R-unturned": (mutant(founded=unturned), Bug.NEW_NOISE_NOT_TURNED),
    "new-without-heading": (mutant(Gx=lambda s, G: G * [1, 1, 0]), Bug.NEW_NO_HEADING),
    "first-dropped": (mutant(chosen=lambda s, rows: rows[1:]), Bug.FIRST_DROPPED),
    "last-dropped": (mutant(chosen=lambda s, rows: rows[:-1]), Bug.LAST_DROPPED),
    "every-second-dropped": (mutant(chosen=lambda s, rows: rows[::2]), Bug.EVERY_SECOND_DROPPED),
    "at-most-three-used": (mutant(chosen=lambda s, rows: rows[:3]), None),
    "body-frame": (mutant(estimate=body), Bug.POSE_IN_BODY_FRAME),
    "covariance-too-small": (mutant(estimate=lambda s: (s.x[:3].copy(), 0.8 * s.P[:3, :3])), None),
    "joint-uncorrelated": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, blocks(J))), Bug.JOINT_UNCORRELATED),
    "joint-permuted": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, permuted(J))), Bug.JOINT_PERMUTED),
    "candidates-permuted": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, shifted(J))), None),
    "R-added-twice": (
        mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J + np.kron(np.eye(len(n)), o.R[0]))),
        Bug.EXPECTED_WITH_NOISE,
    ),
    "expectation-without-R": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J, R=1e-6 * o.R)), None),
    "expectation-not-wrapped": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J, residual=np.subtract)), None),
    "numbers-shifted": (mutant(said=lambda s, o, n, z, J: said(s, o, np.roll(n, 1), z, J)), None),
    "expected-before-the-motion": (mutant(expect=before), Bug.EXPECTED_BEFORE_MOTION),
    "NIS-is-dof": (mutant(nis=lambda s, nu, S, R, rows: 2.0 * len(rows)), Bug.NIS_IS_DOF),
    "NIS-without-R": (mutant(nis=lambda s, nu, S, R, rows: nu @ np.linalg.pinv(S - R) @ nu), Bug.NIS_WITHOUT_NOISE),
    "NIS-with-R-alone": (mutant(nis=lambda s, nu, S, R, rows: nu @ np.linalg.solve(R, nu)), Bug.NIS_WITHOUT_STATE),
    "NIS-per-dof": (mutant(nis=lambda s, nu, S, R, rows: Plain.nis(s, nu, S, R, rows) / len(nu)), None),
}
"""Name, class, and the mistake that is named; None: it has no name, and the first number that is off is said."""


class UnscentedSlam(Plain):
    """A UKF-SLAM with the usual weights (alpha 0.1, beta 2, kappa 0) and the usual jitter: sound, not exact."""

    exact = False

    def points(self, x, P):
        n = len(x)
        lam = 0.01 * n - n
        L = np.linalg.cholesky((n + lam) * (P + 1e-9 * np.eye(n)))
        wm = np.full(2 * n + 1, 0.5 / (n + lam))
        wc = wm.copy()
        wm[0], wc[0] = lam / (n + lam), lam / (n + lam) + 1.0 - 0.01 + 2.0
        return np.vstack([np.zeros(n), L.T, -L.T]), wm, wc

    def predict(self, increment):
        d = len(self.x)
        off, wm, wc = self.points(np.append(self.x, increment.mean), block_diag(self.P, increment.covariance))
        pose, u = self.x[:3] + off[:, :3], increment.mean + off[:, d:]
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        step = np.column_stack([c * u[:, 0] - s * u[:, 1], s * u[:, 0] + c * u[:, 1], u[:, 2]])
        moved = off[:, :d].copy()
        moved[:, :3] += step
        mean = wm @ moved
        self.x = self.x + mean
        self.x[2] = wrapped(self.x[2])
        self.P = (wc[:, None] * (moved - mean)).T @ (moved - mean)

    def seen(self, numbers):
        off, wm, wc = self.points(self.x, self.P)

        def h(x):
            xy = x[3:].reshape(-1, 2)[numbers] if self.known is None else self.known.positions(numbers)
            return self.sensor.predict(x[:3], xy)

        center = h(self.x)
        each = np.array([self.sensor.residual(h(self.x + o), center).ravel() for o in off])
        mean = wm @ each
        spread = each - mean
        return center + mean.reshape(-1, 2), (wc[:, None] * spread).T @ spread, (wc[:, None] * spread).T @ off

    def expect(self, o):
        numbers = np.arange((len(self.x) - 3) // 2) if self.known is None else self.known.id
        if not len(numbers):
            return self.said(o, numbers, np.empty((0, 2)), np.empty((0, 0)))
        z_hat, HPH, _ = self.seen(numbers)
        return self.said(o, numbers, z_hat, HPH)

    def update(self, o, decisions):
        rows = np.flatnonzero(decisions >= 0)
        if len(rows):
            z_hat, HPH, HP = self.seen(decisions[rows])
            K = np.linalg.solve(HPH + block_diag(*o.R[rows]), HP).T
            self.x = self.x + K @ self.sensor.residual(o.z[rows], z_hat).ravel()
            self.P = self.P - K @ HP
        if self.known is None:
            for i in np.flatnonzero(decisions == -1):
                self.found(o.z[i], o.R[i])
