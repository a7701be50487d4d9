"""Worlds of walls for the smoothers' tests, and their exact solution by other means."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from data import se2
from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Prior
from data.sensors import Line
from tests.graph.worlds import MOTION_SIGMA, OFF_CENTRE

SENSORS = {"centred": Line(max_range=8.0), "off centre": Line(max_range=8.0, **OFF_CENTRE)}
WALLS = np.array([[6.0, 0.2], [5.0, 1.7], [7.0, 3.0], [4.0, -2.0], [5.5, -0.9]])
R = np.array([[1e-4, 8e-5], [8e-5, 4e-4]])


def walled(sensor, *, frames=50, noise=1.0, seed=0, see=0.5, R=R, P0=None, walls=WALLS):
    """(Inputs with a map of walls and labels, true poses); `noise` scales what is drawn, not what is stated."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((frames, 3))
    truth[0] = 2.0, -1.0, 0.4
    step = np.array([0.4, 0.03, 0.17])
    for k in range(1, frames):
        truth[k] = se2.compose(truth[k - 1], step)
    M = np.diag(MOTION_SIGMA**2)
    M[0, 2] = M[2, 0] = 0.4 * MOTION_SIGMA[0] * MOTION_SIGMA[2]
    mean = np.vstack([np.zeros(3), step + noise * rng.multivariate_normal(np.zeros(3), M, frames - 1)])
    covariance = np.vstack([np.zeros((1, 3, 3)), np.tile(M, (frames - 1, 1, 1))])
    frame, label = np.nonzero(rng.random((frames, len(walls))) < see)
    z = sensor.predict(truth[frame], walls[label]) + noise * rng.multivariate_normal(np.zeros(2), R, len(frame))
    z[:, 1] = se2.wrap_angle(z[:, 1])
    P0 = np.array([[0.02, 0.004, 0.001], [0.004, 0.01, 0.0], [0.001, 0.0, 0.005]]) if P0 is None else P0
    start = truth[0] + noise * rng.multivariate_normal(np.zeros(3), P0)
    inputs = Inputs(
        Prior(start, P0),
        np.arange(frames, dtype=float),
        Increments(mean, covariance),
        LabelledObservations(frame, z, np.tile(R, (len(z), 1, 1)), label),
        sensor,
        LandmarkMap(np.arange(len(walls)), walls),
    )
    return inputs, truth


def least_squares_solution(inputs, decisions, created, start, walls):
    """Poses, walls, covariances (N, 3, 3) and (L, 2, 2), and the cost: scipy's, with numeric derivatives only."""
    n, slam = len(inputs), inputs.map is None
    o, number = inputs.observations, np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    white = [np.linalg.cholesky(np.linalg.inv(C)).T for C in inputs.increments.covariance[1:]]
    white_z = np.linalg.cholesky(np.linalg.inv(o.R[used])).transpose(0, 2, 1)
    white_0 = np.linalg.cholesky(np.linalg.inv(inputs.prior.covariance)).T

    def residuals(x):
        pose = x[: 3 * n].reshape(n, 3)
        lines = x[3 * n :].reshape(-1, 2)[number[used]] if slam else inputs.map.positions(number[used])
        moved = se2.between(pose[:-1], pose[1:])
        # gtsam's residual: the logarithm of what was measured and what is
        gone = [logarithm(se2.between(m, p)) for m, p in zip(inputs.increments.mean[1:], moved)]
        turn = inputs.increments.mean[1:, 2]
        motion = [W @ se2.world_from_body(t) @ g for W, t, g in zip(white, turn, gone)]
        first = white_0 @ se2.world_from_body(inputs.prior.mean[2]) @ logarithm(se2.between(inputs.prior.mean, pose[0]))
        nu = -inputs.sensor.residual(o.z[used], inputs.sensor.predict(pose[o.frame[used]], lines))
        return np.concatenate([first, np.concatenate(motion), np.einsum("mij,mj->mi", white_z, nu).ravel()])

    x0 = np.concatenate([start.ravel(), walls.ravel() if slam else []])
    found = least_squares(residuals, x0, jac="3-point", method="trf", xtol=1e-15, ftol=1e-15, gtol=1e-12, x_scale="jac")
    C = np.linalg.inv(found.jac.T @ found.jac)
    blocks = np.array([C[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    of_walls = np.array([C[k : k + 2, k : k + 2] for k in range(3 * n, len(C), 2)]).reshape(-1, 2, 2)
    return found.x[: 3 * n].reshape(n, 3), found.x[3 * n :].reshape(-1, 2), blocks, of_walls, 2.0 * found.cost


def logarithm(pose):
    """Of SE(2), of a pose (3,)."""
    x, y, theta = pose
    theta = se2.wrap_angle(theta)
    a = 1.0 if abs(theta) < 1e-9 else 0.5 * theta / np.tan(0.5 * theta)
    return np.array([a * x + 0.5 * theta * y, a * y - 0.5 * theta * x, theta])
