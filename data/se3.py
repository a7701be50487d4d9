"""Poses in space as plain arrays: exponential and logarithm of SO(3) and SE(3), interpolation, best fits.

Tangents have the translation first: xi = (rho, phi). Formulas: Barfoot, State Estimation for Robotics, 2017, part II.
"""

import numpy as np
import scipy  # whose parts are loaded where they are used

from data.se2 import Array


def skew(v: Array) -> Array:
    """Cross product matrices (..., 3, 3) of vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in [[o, -z, y], [z, o, -x], [-y, x, o]]], axis=-2)


def exp_rotation(phi: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    phi = np.array(phi, float)  # scipy before 1.15 takes no array that is read-only or empty
    if not phi.size:
        return np.zeros((*phi.shape, 3))
    return np.asarray(
        scipy.spatial.transform.Rotation.from_rotvec(phi.reshape(-1, 3)).as_matrix().reshape(*phi.shape, 3)
    )


def log_rotation(R: Array) -> Array:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), length at most pi."""
    R = np.array(R, float)
    if not R.size:
        return np.zeros(R.shape[:-1])
    return np.asarray(
        scipy.spatial.transform.Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])
    )


def angle_between(R: Array, S: Array) -> Array:
    """Angles (...) [rad] of the rotations from R to S (..., 3, 3)."""
    return np.asarray(np.linalg.norm(log_rotation(np.swapaxes(R, -1, -2) @ S), axis=-1))


def log_motion(R: Array, t: Array) -> Array:
    """Tangents (n, 6) of motions: rotations R (n, 3, 3), translations t (n, 3)."""
    phi = log_rotation(R)
    angle, K = np.linalg.norm(phi, axis=-1), skew(phi)
    far = np.where(angle < 1e-3, 1.0, angle)
    share = np.where(angle < 1e-3, 1.0 / 12.0 + angle**2 / 720.0, 1.0 / far**2 - 0.5 / (far * np.tan(0.5 * far)))
    turned = np.einsum("nij,nj->ni", K, t)
    return np.hstack([t - 0.5 * turned + share[:, None] * np.einsum("nij,nj->ni", K, turned), phi])


def between_rotations(R: Array, S: Array, share: Array) -> Array:
    """Rotations (n, 3, 3) a share (n,) of the way from R to S, at constant rate."""
    return np.asarray(R @ exp_rotation(share[..., None] * log_rotation(np.swapaxes(R, -1, -2) @ S)))


def rigid_fit(points: Array, onto: Array, *, scaled: bool) -> tuple[float, Array, Array, int]:
    """Scale s, rotation R and translation t of the best fit s R p + t of (K, 3) onto (K, 3), and the rank of the fit.
    Umeyama 1991. Rank 2 and 3 determine the rotation; with rank 1 (points on a line) it may turn about the line.
    """
    a, b = points.mean(axis=0), onto.mean(axis=0)
    U, d, Vt = np.linalg.svd((onto - b).T @ (points - a) / len(points))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ np.diag(sign) @ Vt
    spread = float(np.mean(np.sum((points - a) ** 2, axis=1)))
    s = float(d @ sign) / spread if scaled and spread > 0.0 else 1.0
    return s, R, b - s * R @ a, (int((d > 1e-9 * max(float(d[0]), 1e-300)).sum()) if d[0] > 0.0 else 0)


def about_axis(axis: Array, of: Array, onto: Array) -> Array:
    """The rotation (3, 3) about a unit axis (3,) that turns rotations `of` (K, 3, 3) best onto `onto` (chordal)."""
    M = np.einsum("kij,klj->il", onto, of)
    K = skew(axis)
    # tr(Exp(a u)' M) = const + sin a tr(K' M) + (1 - cos a) tr(K K M)
    sine, cosine = float(np.sum(K * M)), -float(np.sum((K @ K) * M))
    return np.asarray(exp_rotation(axis * np.arctan2(sine, cosine)))
