"""EKF-SLAM and localization with walls or points, written from the formulas: dense matrices, numerical Jacobians."""

import numpy as np

from data import se2
from data.sensors import LINE

STEP = 1e-3


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def jacobian(f, x):
    """Differences of fourth order; f gives lengths and one angle, the last of each pair, which do not wrap here."""
    columns = []
    for e in STEP * np.eye(len(x)):
        near, far = f(x + e) - f(x - e), f(x + 2.0 * e) - f(x - 2.0 * e)
        near[-1], far[-1] = wrapped(near[-1]), wrapped(far[-1])
        columns.append((8.0 * near - far) / (12.0 * STEP))
    return np.stack(columns, 1)


def moved(x):
    """Pose and increment (6,) to pose (3,)."""
    c, s = np.cos(x[2]), np.sin(x[2])
    return np.array([x[0] + c * x[3] - s * x[4], x[1] + s * x[3] + c * x[4], x[2] + x[5]])


def mounted(sensor, x):
    """Points (n, 2) of the world, from a pose (3,), and back."""
    R = se2.rotation(x[2]) @ se2.rotation(sensor.rotation).T
    t = x[:2] - R @ np.array(sensor.translation)
    return (lambda xy: R.T @ (xy - t)), (lambda z: R @ z + t)


def read(sensor, x):
    """Pose and landmark (5,) to what a sensor of walls, or of points in Cartesian coordinates, reads (2,)."""
    return read_wall(sensor, x) if sensor.kind == LINE else mounted(sensor, x)[0](x[3:])


def found(sensor, x):
    """Pose and reading (5,) to landmark (2,)."""
    return found_wall(sensor, x) if sensor.kind == LINE else mounted(sensor, x)[1](x[3:])


def read_wall(sensor, x):
    """Pose and wall (5,) to distance and direction (2,), by the two points of the wall next to the sensor's feet."""
    c, s = np.cos(x[2]), np.sin(x[2])
    ce, se = np.cos(sensor.rotation), np.sin(sensor.rotation)
    mount = np.array([[ce, -se], [se, ce]])
    normal = np.array([np.cos(x[4]), np.sin(x[4])])
    ends = x[3] * normal + np.array([[-1.0], [1.0]]) * np.array([-normal[1], normal[0]])
    body = (ends - x[:2]) @ np.array([[c, -s], [s, c]])
    a, b = body @ mount.T + np.array(sensor.translation)
    way = (b - a) / np.linalg.norm(b - a)
    foot = a - (a @ way) * way
    return np.array([np.linalg.norm(foot), np.arctan2(foot[1], foot[0])])


def found_wall(sensor, x):
    """Pose and reading (5,) to wall (2,): the foot, carried to the world."""
    e, (tx, ty) = sensor.rotation, sensor.translation
    foot = x[3] * np.array([np.cos(x[4]), np.sin(x[4])]) - np.array([tx, ty])
    foot = np.array([[np.cos(e), np.sin(e)], [-np.sin(e), np.cos(e)]]) @ foot
    c, s = np.cos(x[2]), np.sin(x[2])
    point = x[:2] + np.array([[c, -s], [s, c]]) @ foot
    alpha = x[2] + x[4] - e
    return np.array([point @ np.array([np.cos(alpha), np.sin(alpha)]), alpha])


class Dense:
    """The filter about the world's origin; `first`: with Jacobians at first estimates."""

    def __init__(self, prior, sensor, *, first=False, known=None):
        self.x, self.P, self.sensor, self.first = prior.mean.copy(), prior.covariance.copy(), sensor, first
        self.at, self.slot, self.known = prior.mean.copy(), {}, known

    def predict(self, motion, M):
        """`at` is where Jacobians are taken: first estimates, or the state."""
        d = len(self.x)
        J = jacobian(moved, np.append(self.x[:3], motion))
        pose = moved(np.append(self.x[:3], motion))
        F = np.eye(d)
        F[:3, :3] = J[:, :3]
        if self.first:
            F[0, 2], F[1, 2] = self.at[1] - pose[1], pose[0] - self.at[0]
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += J[:, 3:] @ M @ J[:, 3:].T
        self.x[:3] = pose
        self.at[:3] = pose

    def update(self, z, R, ids):
        d = len(self.x)
        H, nu, noise = [], [], []
        for zi, Ri, n in zip(z, R, ids, strict=True):
            if self.known is None and n not in self.slot:
                continue
            s = None if self.known is not None else self.slot[n]
            wall = self.known[n] if s is None else self.x[s : s + 2]
            at = self.at if self.first else self.x
            J = jacobian(lambda y: read(self.sensor, y), np.append(at[:3], wall if s is None else at[s : s + 2]))
            row = np.zeros((2, d))
            row[:, :3] = J[:, :3]
            if s is not None:
                row[:, s : s + 2] = J[:, 3:]
            difference = zi - read(self.sensor, np.append(self.x[:3], wall))
            H.append(row)
            nu.append([difference[0], wrapped(difference[1])])
            noise.append(Ri)
        if H:
            H = np.concatenate(H)
            S = H @ self.P @ H.T
            for i, Ri in enumerate(noise):
                S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += Ri
            K = self.P @ H.T @ np.linalg.inv(S)
            self.x = self.x + K @ np.concatenate(nu)
            self.P = self.P - K @ S @ K.T
        for zi, Ri, n in zip(z, R, ids, strict=True):
            if self.known is not None or n in self.slot:
                continue
            d, y = len(self.x), np.append(self.x[:3], zi)
            J, wall = jacobian(lambda y: found(self.sensor, y), y), found(self.sensor, y)
            G = np.zeros((2, d))
            G[:, :3] = J[:, :3]
            if self.first and self.sensor.kind == LINE:  # turning everything about the origin leaves rho as it is
                G[0, 2] = np.cos(wall[1]) * self.at[1] - np.sin(wall[1]) * self.at[0]
            elif self.first:
                G[:, 2] = self.at[1] - wall[1], wall[0] - self.at[0]
            P = np.zeros((d + 2, d + 2))
            P[:d, :d], P[d:, :d], P[:d, d:] = self.P, G @ self.P, (G @ self.P).T
            P[d:, d:] = G @ self.P @ G.T + J[:, 3:] @ Ri @ J[:, 3:].T
            self.x, self.P, self.at = np.append(self.x, wall), P, np.append(self.at, wall)
            self.slot[n] = d

    def remove(self, n):
        s = self.slot.pop(n)
        stay = np.delete(np.arange(len(self.x)), [s, s + 1])
        self.x, self.P, self.at = self.x[stay], self.P[np.ix_(stay, stay)], self.at[stay]
        self.slot = {m: i - 2 * (i > s) for m, i in self.slot.items()}


def about(walls, covariance, origin):
    """Walls (n, 2) with covariances (n, 2, 2), of a world whose origin stands at `origin`."""
    out = [w + [origin @ [np.cos(w[1]), np.sin(w[1])], 0.0] for w in walls]
    J = [jacobian(lambda w: w + [origin @ [np.cos(w[1]), np.sin(w[1])], 0.0], w) for w in walls]
    return np.array(out), np.array([j @ C @ j.T for j, C in zip(J, covariance, strict=True)])
