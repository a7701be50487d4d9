"""Poses in space, their covariances and frames, and their projection to the plane.

x, y and the yaw of Z-Y-X angles, atan2(R10, R00), are kept. Their covariance follows to first order from that of the
pose: with p the position, c the first column of R, and a small rotation w in the world's axes, dyaw = w_z - c_z (c_x
w_x + c_y w_y) / (c_x^2 + c_y^2).
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data import se3
from data.errors import DataError
from data.formats.recordings.ros import STILL, Tree, bare, rotation_of
from data.formats.results.path import CAMERA, LEFT, LOCAL, MIXED, ROTATION, WORLD, GivenPath, Manner, Spatial, in_order
from data.se2 import Array, wrap_angle

NO_POSE = "each of {} poses has a NaN; one without is needed; --columns NAME.x=COLUMN,... takes other columns"
LEVEL = 1e-9  # m and rad, smallest reported extent outside the plane
UNIT = 0.01  # Largest deviation of a quaternion from length 1, and of a rotation matrix from orthonormality
FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Robot axes from a camera's: forward is its z, left its -x, up its -y."""


def rotations(quaternion: Array, place: Callable[[int], str]) -> Array:
    """Rotation matrices (n, 3, 3) of quaternions x, y, z, w (n, 4), NaN for NaN; DataError for one without length 1."""
    length = np.sqrt(np.sum(quaternion**2, axis=1))
    bad = np.flatnonzero(~(np.abs(length - 1.0) < UNIT) & np.isfinite(length))
    if len(bad):
        k = int(bad[0])
        what = f"quaternion {quaternion[k].tolist()} has length {length[k]:.4g}; 1 is needed (order x, y, z, w)"
        raise DataError(f"{place(k)}: {what}")
    return rotation_of(quaternion)


def on_plane(spatial: Spatial, manner: Manner) -> GivenPath:
    """The trajectory in the plane, without rows with NaN. DataError: a bad or contradicted covariance, or no row."""
    s, frame, C = spatial, spatial.frame, spatial.covariance
    lost = "inverse poses" * bool(manner.inverse) or "axes with units of their own" * (len({*manner.scale}) > 1)
    if lost and C is not None:
        C, s = None, replace(s, covariance=None, notes=(*s.notes, f"covariances of {lost} are left out"))
    if manner.inverse:
        R = s.rotation.transpose(0, 2, 1)
        p = s.position if manner.inverse.endswith("rotations") else -np.einsum("nij,nj->ni", R, s.position)
        s = replace(s, position=p, rotation=R, stated=replace(s.stated, inverse=manner.inverse))
    if C is not None and manner.frame is not None:
        if s.stated.convention and manner.frame != s.frame:
            raise DataError.at(s.file, f"its header states {s.frame} covariances; remove --cov-frame {manner.frame}")
        frame = manner.frame
    if C is not None and manner.order is not None:
        if s.stated.order:
            raise DataError.at(s.file, f"its format states the order of covariances; remove --cov-order {manner.order}")
        C = translation_first(C) if manner.order == ROTATION else C
    sound = np.isfinite(s.time) & np.isfinite(s.position).all(axis=1) & np.isfinite(s.rotation).all(axis=(1, 2))
    rows, notes = np.flatnonzero(sound), s.notes
    if not len(rows):
        raise DataError.at(s.file, NO_POSE.format(len(s)))
    if len(rows) < len(s):
        first = int(np.flatnonzero(~sound)[0])
        notes += (f"{len(s) - len(rows)} of {len(s)} poses have a NaN and are left out, the first at {s.place(first)}",)
    keep = rows[in_order(s.file, s.time[rows], s.position[rows])]
    if len(keep) < len(rows):
        notes += (f"{len(rows) - len(keep)} of {len(rows)} poses share their stamp with a later one, which is used",)
    scale = np.append(manner.scale, np.ones(3))
    p, R = s.position[keep] * scale[:3], s.rotation[keep]
    C = None if C is None else C[keep] * np.outer(scale, scale)
    if (manner.axes or (CAMERA if s.stated.axes else "")) == CAMERA:
        turn = np.kron(np.eye(2), FROM_CAMERA)
        p, R = p @ FROM_CAMERA.T, FROM_CAMERA @ R @ FROM_CAMERA.T
        C = None if C is None else turn @ C @ turn.T

    def place(k: int) -> str:
        return s.place(int(keep[k]))

    stated = replace(s.stated, order=s.stated.order or manner.order is not None)
    stated = replace(stated, convention=stated.convention or manner.frame is not None)
    whole = replace(
        s, time=s.time[keep], position=p, rotation=R, covariance=C, frame=frame, place=place, notes=notes, stated=stated
    )
    return replace(flattened(whole), every=s.time if (np.diff(s.time) > 0.0).all() else None)


def flattened(s: Spatial) -> GivenPath:
    """A trajectory in a robot's axes, in the plane; DataError for an invalid covariance."""
    p, R, C = s.position, s.rotation, s.covariance
    pose = np.column_stack([p[:, :2], wrap_angle(np.arctan2(R[:, 1, 0], R[:, 0, 0]))])
    planar = None if C is None else _planar_covariance(p, R, C, s.frame)
    if planar is not None:
        require_covariances(planar, s.place)
    frame = "" if planar is None else s.frame
    roll, pitch = np.arctan2(R[:, 2, 1], R[:, 2, 2]), -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
    ends = {k: (float(v.min()), float(v.max())) for k, v in (("z", p[:, 2]), ("roll", roll), ("pitch", pitch))}
    return GivenPath(s.file, s.kind, s.time, pose, planar, frame, ends, s.notes, s.clock, s)


def to_world(p: Array, R: Array, frame: str) -> Array:
    """Jacobians (n, 6, 6) from a tangent of a frame to position error and small rotation, both in the world's axes."""
    J = np.tile(np.eye(6), (len(p), 1, 1))
    if frame == LOCAL:
        J[:, :3, :3] = R
    if frame in (LOCAL, MIXED):
        J[:, 3:, 3:] = R
    if frame == LEFT:  # w x p
        J[:, :3, 3:] = -se3.skew(p)
    return J


def in_world(s: Spatial) -> Array:
    """Covariances (n, 6, 6) of position and small rotation in the world's axes; a trajectory with covariance only."""
    assert s.covariance is not None  # the caller asked
    J = to_world(s.position, s.rotation, s.frame)
    return np.asarray(J @ s.covariance @ J.transpose(0, 2, 1))


def moved(s: Spatial, R: Array, t: Array, scale: float = 1.0) -> Spatial:
    """The trajectory moved from the left: positions scale R p + t, rotations R R_k, with R (3, 3) or (n, 3, 3).
    Covariances keep their frame: of the body they stay (the translation scaled), of the world they turn.
    """
    p = scale * np.einsum("...ij,...j->...i", R, s.position) + t
    C, size = s.covariance, np.diag([scale] * 3 + [1.0] * 3)
    if C is not None:
        rotation = np.broadcast_to(R, s.rotation.shape)
        J = np.tile(np.eye(6), (len(s), 1, 1))
        if s.frame != LOCAL:
            J[:, :3, :3] = rotation
        if s.frame in (WORLD, LEFT):
            J[:, 3:, 3:] = rotation
        J = J @ size
        if s.frame == LEFT:  # about the new origin
            J[:, :3, 3:] = se3.skew(np.broadcast_to(t, p.shape)) @ rotation
        C = J @ C @ J.transpose(0, 2, 1)
    return replace(s, position=p, rotation=R @ s.rotation, covariance=C)


def in_frame(path: GivenPath, of: str, frame: str, trees: tuple[Tree, ...], *, still: bool) -> GivenPath | None:
    """A trajectory in space in the stated `world` or `body` of another; None where the transform is unknown, or moves
    though it has to be `still`. Itself in the plane, and where one states none.
    """
    s = path.space
    own = "" if s is None else s.stated.world if of == "world" else s.stated.body
    if s is None or not frame or bare(own) in ("", bare(frame)):
        return path
    pair = (frame, own) if of == "world" else (own, frame)
    found = next((T for tree in trees if (T := tree.between(*pair, s.time)) is not None), None)
    if found is None or (still and np.ptp(found[1], axis=0).max(initial=0.0) > STILL):  # no mount: it moves
        return None
    made = moved(s, *found) if of == "world" else _seen_from(s, *found)
    stated = replace(s.stated, world=frame) if of == "world" else replace(s.stated, body=frame)
    made = replace(made, stated=stated, notes=(*made.notes, f"taken from the frame {own} to {frame} by tf"))
    return replace(flattened(made), transforms=path.transforms)


def _seen_from(s: Spatial, R: Array, t: Array) -> Spatial:
    """The trajectory of another frame of the body: its rotations (n, 3, 3) and positions (n, 3) in the present one."""
    arm = np.einsum("nij,nj->ni", s.rotation, t)
    C = s.covariance
    if C is not None:
        J = np.tile(np.eye(6), (len(s), 1, 1))
        J[:, :3, 3:] = -se3.skew(arm)
        C = J @ in_world(s) @ J.transpose(0, 2, 1)
    frame = s.frame if C is None else WORLD
    return replace(s, position=s.position + arm, rotation=s.rotation @ R, covariance=C, frame=frame)


def _planar_covariance(p: Array, R: Array, C: Array, frame: str) -> Array:
    """World-additive covariance (n, 3, 3) of x, y, yaw."""
    plane = np.zeros((len(p), 3, 6))
    plane[:, 0, 0] = plane[:, 1, 1] = plane[:, 2, 5] = 1.0
    c = R[:, :, 0]
    flat = c[:, 0] ** 2 + c[:, 1] ** 2
    tilted = flat > 0.0
    plane[tilted, 2, 3] = -c[tilted, 2] * c[tilted, 0] / flat[tilted]
    plane[tilted, 2, 4] = -c[tilted, 2] * c[tilted, 1] / flat[tilted]
    J = plane @ to_world(p, R, frame)
    P = J @ C @ J.transpose(0, 2, 1)
    return np.asarray(0.5 * (P + P.transpose(0, 2, 1)))


def require_covariances(P: Array, place: Callable[[int], str]) -> None:
    """DataError unless covariances (n, 3, 3) are positive semidefinite (tolerance 1e-12 trace); NaN: unknown."""
    known = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    least = np.linalg.eigvalsh(np.where(known[:, None, None], P, np.eye(3)))[:, 0]
    bad = np.flatnonzero(known & (least < -1e-12 * np.abs(np.trace(P, axis1=1, axis2=2))))
    if len(bad):
        k = int(bad[0])
        what = f"covariance of x, y, heading has the eigenvalue {least[k]:.3g}; none may be negative"
        raise DataError(f"{place(k)}: {what}")


def projection(path: GivenPath) -> str:
    """The projection, in a sentence; empty without one."""
    return f"projected to the plane: {said} ignored" if (said := ignored(path)) else ""


def ignored(path: GivenPath) -> str:
    """Ranges that the projection ignores; empty without one."""
    said = []
    for name, ends in path.outside.items():
        scale, unit = (1.0, "m") if name == "z" else (math.degrees(1.0), "deg")
        if max(map(abs, ends)) >= LEVEL:
            said.append(f"{name} {scale * ends[0]:.4g} to {scale * ends[1]:.4g} {unit}")
    return ", ".join(said)


ASYMMETRY = 1e-3  # Largest difference of mirrored entries, in products of sigmas; messages round to float32
SWAP = [3, 4, 5, 0, 1, 2]  # From rotation first to translation first, and back


def full(entries: Array, place: Callable[[int], str]) -> tuple[Array, tuple[str, ...]]:
    """Symmetric matrices (n, d, d) from all d*d entries, row by row, and notes. A matrix with zeros in all of one
    triangle and not in the other is mirrored; DataError for any other asymmetric one.
    """
    n, d = len(entries), round(entries.shape[1] ** 0.5)
    M = entries.reshape(n, d, d).copy()
    i, j = np.triu_indices(d, 1)
    upper, lower = M[:, i, j], M[:, j, i]
    known = np.isfinite(upper).all(axis=1) & np.isfinite(lower).all(axis=1)
    only_upper = known & ~lower.any(axis=1) & upper.any(axis=1)
    only_lower = known & ~upper.any(axis=1) & lower.any(axis=1)
    M[only_upper] = np.triu(M[only_upper]) + np.triu(M[only_upper], 1).transpose(0, 2, 1)
    M[only_lower] = np.tril(M[only_lower]) + np.tril(M[only_lower], -1).transpose(0, 2, 1)
    sigma = np.sqrt(np.abs(np.einsum("nii->ni", M)))
    off = np.abs(M[:, i, j] - M[:, j, i]) > ASYMMETRY * sigma[:, i] * sigma[:, j] + 1e-15
    bad = np.flatnonzero(known & off.any(axis=1))
    if len(bad):
        k = int(bad[0])
        a, b = int(i[off[k]][0]), int(j[off[k]][0])
        pair = f"entries ({a + 1}, {b + 1}) = {M[k, a, b]:.4g} and ({b + 1}, {a + 1}) = {M[k, b, a]:.4g}"
        raise DataError(f"{place(k)}: covariance is not symmetric: {pair}; a symmetric one, or one triangle, is needed")
    notes = []
    for which, name in ((only_upper, "upper"), (only_lower, "lower")):
        if which.any():
            notes.append(f"{int(which.sum())} of {n} covariances have only their {name} triangle, which is mirrored")
    return 0.5 * (M + M.transpose(0, 2, 1)), tuple(notes)


VAGUE = {3: (1e8, 1e8, 1e2), 6: (1e8, 1e8, 1e8, 1e2, 1e2, 1e2)}
"""m² and rad², variances from which on an axis is unknown: drivers write 1e6 or 99999 for that."""


def known_only(C: Array) -> tuple[Array | None, tuple[str, ...]]:
    """Covariances (n, d, d), NaN where unknown: all NaN or zero, or -1 first (ROS); None if none is known; and notes. A
    single variance of NaN, -1, or as large as `VAGUE` is that of an unknown axis: its row and column become zero.
    """
    variance = np.einsum("nii->ni", C)
    lost = (variance[:, 0] == -1.0) | ~np.isfinite(variance).any(axis=1) | ~np.nan_to_num(C).any(axis=(1, 2))
    open_axes = ~np.isfinite(variance) | (variance == -1.0) | (variance >= VAGUE[C.shape[1]])
    found = np.where(open_axes[:, :, None] | open_axes[:, None, :], 0.0, C)
    lost |= ~np.isfinite(found).all(axis=(1, 2)) | ~found.any(axis=(1, 2))
    found[lost] = np.nan
    notes = []
    if lost.any():
        notes.append(f"{int(lost.sum())} of {len(C)} poses state no covariance (NaN, zeros or -1)")
    partly = int((open_axes.any(axis=1) & ~lost).sum())
    if partly:
        notes.append(f"{partly} of {len(C)} covariances have an axis of unknown variance (NaN, -1 or huge)")
    return (None if lost.all() else found), tuple(notes)


def translation_first(C: Array) -> Array:
    """Covariances (n, 6, 6) of rotation-first tangents with the translation first."""
    return np.asarray(C[:, SWAP][:, :, SWAP])
