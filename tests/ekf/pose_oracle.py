"""A dense filter that keeps every pose, with the four corrections, written from the papers; and logs to compare on."""

import numpy as np
from scipy.linalg import expm

from data.inputs import Increment
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from ekf.filter import FilterOptions

VARIANTS = {
    "plain": FilterOptions(), "iterated": FilterOptions(iterations=10), "fej": FilterOptions(first_estimates=True),
    "invariant": FilterOptions(invariant=True),
}  # fmt: skip
ENTRIES = {FixKind.POSITION: [0, 1], FixKind.HEADING: [2], FixKind.POSE: [0, 1, 2]}
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def spd(rng, n, size):
    A = rng.normal(0.0, size, (n, n))
    return A @ A.T + 0.2 * size**2 * np.eye(n)


def fixes_of(rows, sources):
    """`Fixes` of (frame, kind, source, z, covariance), z and covariance of what is measured."""
    z, C = np.zeros((len(rows), 3)), np.zeros((len(rows), 3, 3))
    for i, (_, kind, _, value, covariance) in enumerate(rows):
        z[i, ENTRIES[kind]] = value
        C[i][np.ix_(ENTRIES[kind], ENTRIES[kind])] = covariance
    return Fixes(*[np.array([row[c] for row in rows], np.int64) for c in range(3)], z, C, sources)


def closures_of(rows):
    """`Closures` of (frame1, frame2, relative, covariance), ordered by the later frame."""
    rows = sorted(rows, key=lambda row: max(row[:2]))
    columns = [np.array([row[c] for row in rows]) for c in range(4)]
    return Closures(*columns, np.zeros(len(rows), np.int64), ("matcher",))


class Dense:
    """State: all poses so far, the newest first."""

    def __init__(self, prior, variant):
        self.x, self.P, self.variant = prior.mean.copy(), prior.covariance.copy(), variant
        self.first = prior.mean.copy()  # first estimates of all poses

    def predict(self, motion, M):
        C = np.eye(3)
        C[:2, :2] = rotation(self.x[2])
        new = self.x[:3] + C @ motion
        F = np.eye(3)
        F[:2, 2] = J @ (new[:2] - (self.first[:2] if self.variant == "fej" else self.x[:2]))
        A = np.zeros((len(self.x) + 3, len(self.x)))
        A[:3, :3], A[3:, :] = F, np.eye(len(self.x))
        self.P = A @ self.P @ A.T
        self.P[:3, :3] += C @ M @ C.T
        self.x, self.first = np.concatenate([new, self.x]), np.concatenate([new, self.first])

    def at(self, frame):
        return len(self.x) - 3 * (frame + 1)

    def fix(self, kind, source, z, R):
        entries, lever = ENTRIES[kind], np.array(source.lever)

        def measure(x):
            H = np.zeros((3, len(x)))
            H[:, :3] = np.eye(3)
            H[:2, 2] = J @ rotation(x[2]) @ lever
            return np.array([*(x[:2] + rotation(x[2]) @ lever), x[2] + source.rotation])[entries], H[entries]

        self.update(measure, z, R, kind != FixKind.POSITION)

    def close(self, frame1, frame2, z, R):
        a, b = self.at(frame1), self.at(frame2)

        def measure(x):
            C, off = rotation(x[a + 2]).T, x[b : b + 2] - x[a : a + 2]
            H = np.zeros((3, len(x)))
            H[:2, a : a + 2], H[:2, b : b + 2], H[:2, a + 2] = -C, C, -C @ J @ off
            H[2, a + 2], H[2, b + 2] = -1.0, 1.0
            return np.array([*(C @ off), x[b + 2] - x[a + 2]]), H

        self.update(measure, z, R, True)

    def update(self, measure, z, R, heading):
        def innovation(x):
            nu = z - measure(x)[0]
            if heading:
                nu[-1] = wrapped(nu[-1])
            return nu

        point, H = self.x, measure(self.first if self.variant == "fej" else self.x)[1]
        for _ in range(30 if self.variant == "iterated" else 1):
            K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
            shift = K @ (innovation(point) - H @ (self.x - point))
            last = H
            point = self.x + shift
            H = measure(point)[1]
        P = self.P - K @ last @ self.P
        if self.variant == "invariant":
            self.retract(shift, P)
        else:
            self.x, self.P = point, P

    def retract(self, shift, P):
        """Each pose X <- exp(xi) X in SE(2); P is of xi in between."""
        to_xi, back, x = np.zeros_like(P), np.zeros_like(P), self.x.copy()
        for i in range(0, len(x), 3):
            own = slice(i, i + 3)
            to_xi[own, own] = np.linalg.inv(adjoint(self.x[own]))
            xi = to_xi[own, own] @ shift[own]
            hat = np.zeros((3, 3))
            hat[:2, :2], hat[:2, 2] = xi[2] * J, xi[:2]
            moved = expm(hat)
            x[i : i + 2] = moved[:2, :2] @ self.x[i : i + 2] + moved[:2, 2]
            x[i + 2] = self.x[i + 2] + xi[2]
            back[own, own] = adjoint(x[own])
        self.x, self.P = x, back @ to_xi @ P @ to_xi.T @ back.T

    def newest(self):
        return np.array([*self.x[:2], wrapped(self.x[2])]), self.P[:3, :3]


def adjoint(pose):
    """Additive error of a pose (3,) from its right-invariant one, for small errors."""
    A = np.eye(3)
    A[:2, 2] = J @ pose[:2]
    return A


SOURCE = FixSource("antenna", (0.3, -0.2), 0.1)


def wandering(rng, frames, prior, scale=1.0):
    """Motions, fixes and closures in both orders about one path, ends before the last frame; `scale`: of all sigmas."""
    heading, at = prior.mean[2], prior.mean[:2]
    path, motions = [np.array([*at, heading])], [None]
    for _ in range(frames - 1):
        d = np.array([*rng.normal([0.5, 0.0], 0.2), rng.normal(0.0, 0.4)])
        at, heading = at + rotation(heading) @ d[:2], heading + d[2]
        path.append(np.array([*at, heading]))
        motions.append(Increment(d + scale * rng.normal(0.0, 0.03, 3), spd(rng, 3, 0.05 * scale)))
    fixes, closures = [], []
    for k in range(1, frames, 3):
        kind = list(FixKind)[k // 3 % 3]
        p = path[k]
        whole = np.array([*(p[:2] + rotation(p[2]) @ SOURCE.lever), p[2] + SOURCE.rotation])
        z = (whole + scale * rng.normal(0.0, 0.05, 3))[ENTRIES[kind]]
        fixes.append((k, kind, 0, z, spd(rng, len(z), 0.1 * scale)))
    for _ in range(frames):
        a, b = rng.choice(frames - 2, 2, replace=False)
        off = rotation(path[a][2]).T @ (path[b][:2] - path[a][:2])
        z = np.array([*off, wrapped(path[b][2] - path[a][2])]) + scale * rng.normal(0.0, 0.05, 3)
        closures.append((a, b, z, spd(rng, 3, 0.1 * scale)))
    return motions, fixes, closures, (SOURCE,)
