"""Model solution of the assignment `filter`."""

import numpy as np
from scipy.linalg import block_diag

from slamref import NEW, Expectation


def wrap(a):
    return (a + np.pi) % (2.0 * np.pi) - np.pi


def predicted(x, P, increment):
    u, Q, c, s = increment.mean, increment.covariance, np.cos(x[2]), np.sin(x[2])
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    step = B @ u
    F = np.eye(len(x))
    F[0, 2], F[1, 2] = -step[1], step[0]
    x, P = x.copy(), F @ P @ F.T
    x[:3] += step
    x[2] = wrap(x[2])
    P[:3, :3] += B @ Q @ B.T
    return x, P


def corrected(x, P, nu, H, R):
    S = H @ P @ H.T + block_diag(*R)
    K = P @ H.T @ np.linalg.inv(S)
    x = x + K @ nu.ravel()
    x[2] = wrap(x[2])
    return x, (np.eye(len(x)) - K @ H) @ P


class Localizer:
    def __init__(self, prior, sensor, known_map, options):
        self.x, self.P, self.sensor, self.map = prior.mean.copy(), prior.covariance.copy(), sensor, known_map

    def predict(self, increment):
        self.x, self.P = predicted(self.x, self.P, increment)

    def expect(self, observations):
        z_hat, Hx, _ = self.sensor.linearize(self.x, self.map.xy)
        H = Hx.reshape(-1, 3)
        joint = H @ self.P @ H.T
        z, R = observations
        return Expectation.from_arrays(z, z_hat, joint, R, self.sensor.residual, number=self.map.id)

    def update(self, observations, decisions):
        used = np.flatnonzero(decisions >= 0)
        if len(used):
            z_hat, Hx, _ = self.sensor.linearize(self.x, self.map.positions(decisions[used]))
            nu = self.sensor.residual(observations.z[used], z_hat)
            self.x, self.P = corrected(self.x, self.P, nu, Hx.reshape(-1, 3), observations.R[used])

    def estimate(self):
        return self.x.copy(), self.P.copy()


class Slam:
    def __init__(self, prior, sensor, options):
        self.x, self.P, self.sensor = prior.mean.copy(), prior.covariance.copy(), sensor

    def predict(self, increment):
        self.x, self.P = predicted(self.x, self.P, increment)

    def update(self, observations, decisions):
        used = np.flatnonzero(decisions >= 0)
        if len(used):
            number = decisions[used]
            z_hat, Hx, Hl = self.sensor.linearize(self.x[:3], self.x[3:].reshape(-1, 2)[number])
            H = np.zeros((2 * len(used), len(self.x)))
            for k, j in enumerate(number):
                H[2 * k : 2 * k + 2, :3] = Hx[k]
                H[2 * k : 2 * k + 2, 3 + 2 * j : 5 + 2 * j] = Hl[k]
            nu = self.sensor.residual(observations.z[used], z_hat)
            self.x, self.P = corrected(self.x, self.P, nu, H, observations.R[used])
        for i in np.flatnonzero(decisions == NEW):
            xy, Gx, Gz = (a[0] for a in self.sensor.inverse(self.x[:3], observations.z[i : i + 1]))
            cross = Gx @ self.P[:3]
            own = Gx @ self.P[:3, :3] @ Gx.T + Gz @ observations.R[i] @ Gz.T
            self.x = np.concatenate([self.x, xy])
            self.P = np.block([[self.P, cross.T], [cross, own]])

    def estimate(self):
        return self.x[:3].copy(), self.P[:3, :3].copy()

    def landmarks(self):
        xy = self.x[3:].reshape(-1, 2)
        blocks = [self.P[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k] for k in range(len(xy))]
        return np.arange(len(xy)), xy.copy(), np.array(blocks).reshape(-1, 2, 2)
