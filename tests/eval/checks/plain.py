"""A right EKF for localization and SLAM as a student writes it: the stock from which the zoo is bred.

It shares nothing with the filters of the package but the sensor's model.
"""

import numpy as np
from scipy.linalg import block_diag

from slamref import Expectation


def wrapped(a):
    return np.arctan2(np.sin(a), np.cos(a))


class Plain:
    exact = True

    def __init__(self, prior, sensor, *rest):
        self.x, self.P, self.sensor = prior.mean.copy(), prior.covariance.copy(), sensor
        self.known = rest[0] if len(rest) == 2 else None
        self.last = self.x[:3].copy()

    # motion
    def predict(self, increment):
        self.last = self.x[:3].copy()
        c, s = np.cos(self.x[2]), np.sin(self.x[2])
        u, v, w = increment.mean
        F, G = self.motion(c, s, u, v)
        M = G @ self.Q(increment.covariance) @ G.T
        self.x[:3] = self.moved(c, s, u, v, w)
        cross = self.carried(F, self.P[:3, 3:])
        self.P[:3, :3] = F @ self.P[:3, :3] @ F.T + M
        self.P[:3, 3:], self.P[3:, :3] = cross, cross.T

    def moved(self, c, s, u, v, w):
        x, y, a = self.x[:3]
        return x + c * u - s * v, y + s * u + c * v, wrapped(a + w)

    def motion(self, c, s, u, v):
        return np.array([[1, 0, -s * u - c * v], [0, 1, c * u - s * v], [0, 0, 1]]), self.G(c, s)

    def G(self, c, s):
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

    def carried(self, F, cross):
        return F @ cross

    def Q(self, M):
        return M

    # measurement
    def at(self):
        return self.x[:3]

    def model(self, numbers, pose=None):
        pose = self.at() if pose is None else pose
        xy = self.x[3:].reshape(-1, 2)[numbers] if self.known is None else self.known.positions(numbers)
        z_hat, (Hx, Hl) = self.sensor.predict(self.x[:3], xy), self.sensor.jacobians(pose, xy)
        H = np.zeros((2 * len(xy), len(self.x)))
        for i, n in enumerate(numbers):
            H[2 * i : 2 * i + 2, :3] = self.Hx(Hx[i])
            if self.known is None:
                H[2 * i : 2 * i + 2, 3 + 2 * n : 5 + 2 * n] = self.Hl(Hl[i])
        return z_hat, H

    def Hx(self, Hx):
        return Hx

    def Hl(self, Hl):
        return Hl

    def expect(self, o):
        numbers = np.arange((len(self.x) - 3) // 2) if self.known is None else self.known.id
        z_hat, H = self.model(numbers)
        return self.said(o, numbers, z_hat, H @ self.P @ H.T)

    def said(self, o, numbers, z_hat, joint):
        return Expectation.from_arrays(o.z, z_hat, joint, o.R, self.sensor.residual, number=numbers)

    def update(self, o, decisions):
        rows, nis = self.chosen(np.flatnonzero(decisions >= 0)), 0.0
        if len(rows):
            z_hat, H = self.model(decisions[rows])
            nu = self.innovation(o.z[rows], z_hat).ravel()
            R = block_diag(*self.R(o.R[rows]))
            S = self.S(H @ self.P @ H.T, R)
            K = self.gain(H, S)
            nis = self.nis(nu, S, R, rows)
            self.correct(K, nu, H, R, S)
        if self.known is None:
            for i in np.flatnonzero(decisions == -1):
                self.found(o.z[i], self.R_new(o.R[i]))
        return {"nis": nis, "dof": 2 * len(rows)}

    def chosen(self, rows):
        return rows

    def innovation(self, z, z_hat):
        return self.sensor.residual(z, z_hat)

    def R(self, R):
        return R

    def R_new(self, R):
        return R

    def S(self, HPH, R):
        return HPH + R

    def gain(self, H, S):
        return np.linalg.solve(S, H @ self.P).T

    def nis(self, nu, S, R, rows):
        return float(nu @ np.linalg.solve(S, nu))

    def correct(self, K, nu, H, R, S):
        self.x = self.x + self.step(K, nu)
        self.x[2] = wrapped(self.x[2])
        self.P = self.shrunk(K, H, R, S)

    def step(self, K, nu):
        return K @ nu

    def shrunk(self, K, H, R, S):
        A = np.eye(len(self.P)) - K @ H
        P = A @ self.P @ A.T + K @ R @ K.T
        return 0.5 * (P + P.T)

    # map
    def found(self, z, R):
        xy, Gx, Gz = (a[0] for a in self.sensor.inverse(self.x[:3], z[None]))
        cross, own = self.founded(self.Gx(Gx), Gz, R)
        self.x, self.P = np.append(self.x, xy), np.block([[self.P, cross.T], [cross, own]])

    def founded(self, Gx, Gz, R):
        return Gx @ self.P[:3], Gx @ self.P[:3, :3] @ Gx.T + Gz @ R @ Gz.T

    def Gx(self, Gx):
        return Gx

    def estimate(self):
        return self.x[:3].copy(), self.P[:3, :3].copy()

    def landmarks(self):
        n = (len(self.x) - 3) // 2
        blocks = [self.P[3 + 2 * i : 5 + 2 * i, 3 + 2 * i : 5 + 2 * i] for i in range(n)]
        return np.arange(n), self.x[3:].reshape(-1, 2).copy(), np.array(blocks).reshape(n, 2, 2)
