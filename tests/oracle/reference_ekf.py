"""A readable EKF with dense matrices, straight from the textbook: the oracle of the compiled kernels.

Shares no code with the filter: its own measurement models, Jacobians by complex-step-free central differences.
"""

import numpy as np

NEW = -1


def wrap(a):
    return np.arctan2(np.sin(a), np.cos(a))


def expected(kind, extrinsic, pose, landmark):
    """h(x): range and bearing, or the point, in the sensor frame p_s = R p_b + T."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    body = np.array([[c, s], [-s, c]]) @ (landmark - pose[:2])
    c, s = np.cos(extrinsic[0]), np.sin(extrinsic[0])
    point = np.array([[c, -s], [s, c]]) @ body + np.asarray(extrinsic[1:])
    return np.array([np.hypot(*point), np.arctan2(point[1], point[0])]) if kind == 0 else point


def landmark_from(kind, extrinsic, pose, z):
    point = z[0] * np.array([np.cos(z[1]), np.sin(z[1])]) if kind == 0 else np.asarray(z)
    c, s = np.cos(extrinsic[0]), np.sin(extrinsic[0])
    body = np.array([[c, -s], [s, c]]).T @ (point - np.asarray(extrinsic[1:]))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + np.array([[c, -s], [s, c]]) @ body


def difference(kind, a, b):
    d = np.asarray(a, float) - np.asarray(b, float)
    if kind == 0:
        d[1] = wrap(d[1])
    return d


def numeric_jacobian(f, x, subtract=np.subtract, h=1e-6):
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = h
        columns.append(subtract(f(x + step), f(x - step)) / (2 * h))
    return np.column_stack(columns)


def move(pose, d):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([pose[0] + c * d[0] - s * d[1], pose[1] + s * d[0] + c * d[1], pose[2] + d[2]])


def run(kind, extrinsic, prior, prior_cov, motions, motion_covs, frames, z, R, decisions, known=None, gate=np.inf):
    """Poses, covariances, NIS per frame, final state and covariance; decisions as in the package."""
    x, P = np.array(prior, float), np.array(prior_cov, float)
    out_x, out_P, out_nis = [], [], []
    for k, (u, M) in enumerate(zip(motions, motion_covs)):
        if k:
            n = len(x)
            F, G = np.eye(n), np.zeros((n, 3))
            F[:3, :3] = numeric_jacobian(lambda p: move(p, u), x[:3])
            G[:3] = numeric_jacobian(lambda v: move(x[:3], v), np.asarray(u, float))
            x = x.copy()
            x[:3] = move(x[:3], u)
            x[2] = wrap(x[2])
            P = F @ P @ F.T + G @ M @ G.T
        rows = np.flatnonzero(np.asarray(frames) == k)
        H, nu, Rs = [], [], []
        for i in rows:
            j = decisions[i]
            if j < 0:
                continue

            def h(state, j=j):
                target = known[j] if known is not None else state[3 + 2 * j : 5 + 2 * j]
                return expected(kind, extrinsic, state[:3], target)

            Hi = numeric_jacobian(h, x, lambda a, b: difference(kind, a, b))
            vi = difference(kind, z[i], h(x))
            if vi @ np.linalg.solve(Hi @ P @ Hi.T + R[i], vi) < gate:
                H.append(Hi), nu.append(vi), Rs.append(R[i])
        nis = 0.0
        if H:
            H, nu = np.vstack(H), np.concatenate(nu)
            big_R = np.zeros((len(nu), len(nu)))
            for i, Ri in enumerate(Rs):
                big_R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = Ri
            S = H @ P @ H.T + big_R
            K = P @ H.T @ np.linalg.inv(S)
            nis = float(nu @ np.linalg.solve(S, nu))
            x = x + K @ nu
            x[2] = wrap(x[2])
            A = np.eye(len(x)) - K @ H
            P = A @ P @ A.T + K @ big_R @ K.T
        for i in rows:
            if decisions[i] == NEW:
                n = len(x)
                Gx = np.zeros((2, n))
                Gx[:, :3] = numeric_jacobian(lambda p: landmark_from(kind, extrinsic, p, z[i]), x[:3])
                Gz = numeric_jacobian(lambda m: landmark_from(kind, extrinsic, x[:3], m), np.asarray(z[i], float))
                x = np.concatenate([x, landmark_from(kind, extrinsic, x[:3], z[i])])
                P = np.block([[P, P @ Gx.T], [Gx @ P, Gx @ P @ Gx.T + Gz @ R[i] @ Gz.T]])
        out_x.append(x[:3].copy()), out_P.append(P[:3, :3].copy()), out_nis.append(nis)
    return np.array(out_x), np.array(out_P), np.array(out_nis), x, P
