"""Model solution of the assignment `utias`."""

import numpy as np


def wrap(a):
    return (a + np.pi) % (2.0 * np.pi) - np.pi


def move(pose, P, v, omega, dt, sigma):
    D, A, c, s = v * dt, omega * dt, np.cos(pose[2]), np.sin(pose[2])
    if abs(A) < 1e-4:
        along, across, d_along, d_across = 1.0 - A**2 / 6.0, A / 2.0, -A / 3.0, 0.5 - A**2 / 8.0
    else:
        along, across = np.sin(A) / A, (1.0 - np.cos(A)) / A
        d_along, d_across = (np.cos(A) - along) / A, (np.sin(A) - across) / A
    x, y = D * along, D * across
    G = np.array([[along, D * d_along], [across, D * d_across], [0.0, 1.0]])
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    step = B @ np.array([x, y, A])
    F = np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
    M = np.diag(sigma**2 * dt)
    moved = pose + step
    moved[2] = wrap(moved[2])
    return moved, F @ P @ F.T + B @ G @ M @ G.T @ B.T


def expected(pose, landmark):
    dx, dy = landmark - pose[:2]
    q = dx**2 + dy**2
    r = np.sqrt(q)
    z_hat = np.array([r, wrap(np.arctan2(dy, dx) - pose[2])])
    H = np.array([[-dx / r, -dy / r, 0.0], [dy / q, -dx / q, -1.0]])
    return z_hat, H


def correct(pose, P, landmark, z, R):
    z_hat, H = expected(pose, landmark)
    nu = z - z_hat
    nu[1] = wrap(nu[1])
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    pose = pose + K @ nu
    pose[2] = wrap(pose[2])
    return pose, (np.eye(3) - K @ H) @ P


def correspond(pose, P, landmarks, z, R):
    costs = []
    for landmark in landmarks:
        z_hat, H = expected(pose, landmark)
        nu = z - z_hat
        nu[1] = wrap(nu[1])
        S = H @ P @ H.T + R
        costs.append(nu @ np.linalg.solve(S, nu) + np.log(np.linalg.det(S)))
    return np.argmin(costs)


def initialize(pose, P, z, R):
    a = pose[2] + z[1]
    c, s = np.cos(a), np.sin(a)
    landmark = pose[:2] + z[0] * np.array([c, s])
    Gx = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
    Gz = np.array([[c, -z[0] * s], [s, z[0] * c]])
    return landmark, Gx @ P @ Gx.T + Gz @ R @ Gz.T, Gx @ P
