"""A plain numpy EKF localizer with switches for the classic faults; without a fault it is a second oracle."""

from __future__ import annotations

import numpy as np

FAULTS = ("none", "unwrapped bearing", "stale Jacobian", "body-frame covariance", "process noise halved", "P times 0.8")


def run(inputs, fault="none"):
    """Poses (N, 3) and covariances (N, 3, 3) of range-bearing localization in a known map, labels granted."""
    assert fault in FAULTS
    o, landmarks = inputs.observations, inputs.map.xy
    x, P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    first_H = {}
    poses, covariances = [], []
    for k in range(len(inputs)):
        if k:
            u, M = inputs.increment(k)
            M = 0.5 * M if fault == "process noise halved" else M
            c, s = np.cos(x[2]), np.sin(x[2])
            F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
            B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            P = F @ P @ F.T + B @ M @ B.T
            x = x + B @ u
            x[2] = (x[2] + np.pi) % (2 * np.pi) - np.pi
        rows = slice(inputs.start[k], inputs.start[k + 1])
        labels = o.label[rows]
        if len(labels):
            d = landmarks[labels] - x[:2]
            r = np.hypot(*d.T)
            nu = o.z[rows] - np.stack([r, np.arctan2(d[:, 1], d[:, 0]) - x[2]], 1)
            if fault != "unwrapped bearing":
                nu[:, 1] = (nu[:, 1] + np.pi) % (2 * np.pi) - np.pi
            H = np.zeros((len(r), 2, 3))
            H[:, 0, 0], H[:, 0, 1] = -d[:, 0] / r, -d[:, 1] / r
            H[:, 1, 0], H[:, 1, 1], H[:, 1, 2] = d[:, 1] / r**2, -d[:, 0] / r**2, -1
            if fault == "stale Jacobian":  # every landmark keeps the Jacobian of its first observation
                H = np.array([first_H.setdefault(int(j), h) for j, h in zip(labels, H, strict=True)])
            H = H.reshape(-1, 3)
            R = np.zeros((len(H), len(H)))
            for i, Ri in enumerate(o.R[rows]):
                R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = Ri
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = x + K @ nu.ravel()
            A = np.eye(3) - K @ H
            P = A @ P @ A.T + K @ R @ K.T
        poses.append(x.copy())
        out = P
        if fault == "P times 0.8":
            out = 0.8 * P
        if fault == "body-frame covariance":
            c, s = np.cos(x[2]), np.sin(x[2])
            B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            out = B.T @ P @ B
        covariances.append(out)
    return np.array(poses), np.array(covariances)
