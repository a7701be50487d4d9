"""Poses of a result and its truth in space: matched at stamps, aligned, and their errors.

Alignments move the estimate from the left: T_k -> (s, R, t) T_k. Positions are fitted as in Umeyama 1991, `yaw` about
the vertical only, as in rpg_trajectory_evaluation and OpenVINS (`posyaw`). Positions on a line leave a turn about it
open, which the orientations decide.
"""

import math
from dataclasses import dataclass

import numpy as np

from data import se3
from data.errors import UsageError
from data.formats.results.path import Spatial
from data.formats.results.space import moved
from data.inputs import IntArray
from data.locked import Locked
from data.se2 import Array, BoolArray
from eval.referee.errors import pairs_by_way, pairs_over, rms, successive, without_gaps

NONE, FIRST, SHIFT, SE2, SE3, SIM3, YAW = "none", "first", "shift", "se2", "se3", "sim3", "yaw"
FITTED = (SE3, SIM3, YAW)
FLAT = 1e-6  # Largest height over width of a path in the plane


EVO, RPG, OPENVINS, KITTI = "evo", "rpg", "openvins", "kitti"
PAIRS = (EVO, RPG, OPENVINS, KITTI)  # Whose pairs relative errors are of; rpg_trajectory_evaluation's, KITTI odometry's
RPG_SHARES, RPG_TOLERANCE = (0.1, 0.2, 0.3, 0.4, 0.5), 0.2
"""Lengths as shares of the true path's, and tolerance as a share of the length."""
OPENVINS_LENGTHS, OPENVINS_TOLERANCE = (8.0, 16.0, 24.0, 32.0, 40.0), 0.5  # m
KITTI_LENGTHS, KITTI_STEP = tuple(100.0 * k for k in range(1, 9)), 10  # m; every so many poses begin a pair


@dataclass(frozen=True, eq=False)
class Poses(Locked):
    """Positions (n, 3) m and rotations (n, 3, 3); NaN where unknown."""

    position: Array
    rotation: Array

    @property
    def known(self) -> BoolArray:
        """Rows (n,) without NaN."""
        return np.asarray(self.placed & np.isfinite(self.rotation).all(axis=(1, 2)))

    @property
    def placed(self) -> BoolArray:
        """Rows (n,) whose positions are known."""
        return np.asarray(np.isfinite(self.position).all(axis=1))

    def of(self, rows: BoolArray | IntArray) -> "Poses":
        """The poses in some rows."""
        return Poses(self.position[rows], self.rotation[rows])


@dataclass(frozen=True, eq=False)
class InSpace:
    """An estimate as aligned, the truth at its stamps, and the estimate as it was."""

    estimate: Spatial
    truth: Poses
    original: Spatial
    pairs: str = EVO


@dataclass(frozen=True, eq=False)
class Similarity:
    """p -> scale R p + t."""

    scale: float
    R: Array
    t: Array

    def of(self, path: Spatial) -> Spatial:
        """The path moved."""
        return moved(path, self.R, self.t, self.scale)

    @property
    def planar(self) -> Array:
        """Its x [m], y [m] and yaw [rad] (3,)."""
        return np.array([self.t[0], self.t[1], math.atan2(self.R[1, 0], self.R[0, 0])])


def poses(path: Spatial) -> Poses:
    """Positions and rotations of a path."""
    return Poses(path.position, path.rotation)


def in_plane(pose: Array) -> Poses:
    """Poses (n, 3) of the plane in space."""
    turn = se3.exp_rotation(pose[:, 2:] * [0.0, 0.0, 1.0])
    return Poses(np.column_stack([pose[:, :2], 0.0 * pose[:, 0]]), turn)


def aligning(estimate: Poses, truth: Poses, how: str, *, plane: bool = False) -> Similarity | None:
    """The motion that aligns estimate and truth (n each); None for `none`, or without a match. `se2` is `se3` here,
    but `yaw` of paths that are flat, which no fit turns over; in the `plane` all others are, too.
    """
    rows, turned = np.flatnonzero(estimate.placed & truth.placed), bool((estimate.known & truth.known).any())
    rows = np.flatnonzero(estimate.known & truth.known) if turned and (how == FIRST or not plane) else rows
    if how == NONE or not len(rows):
        return None
    a, b = estimate.of(rows), truth.of(rows)
    flat = all(np.ptp(p.position[:, 2]) <= FLAT * np.ptp(p.position[:, :2], axis=0).max() for p in (a, b))
    how = YAW if how == SE2 and flat and not (turned and np.median(tilts(a, b)) > FLAT) else how
    begins, s, R = how in (FIRST, SHIFT) or len(rows) < 2, 1.0, np.eye(3)
    here, there = (p.position[0] if begins else p.position.mean(axis=0) for p in (a, b))
    off, onto = a.position - here, b.position - there
    if how != SHIFT and begins and a.known[0] and b.known[0]:
        R = b.rotation[0] @ a.rotation[0].T
        R = _yaw(R) if how == YAW else R
    elif how != SHIFT and (begins or how == YAW or plane):
        way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(onto, axis=0), axis=1)))
        some = 1 + int(np.searchsorted(way, BEGINNING * way[-1])) if begins else len(rows)
        C = onto[:some].T @ off[:some]
        if begins and not C.any():
            raise UsageError(
                f"--align {how}: no heading, and no way that tells one; --align shift moves without a turn"
            )
        R = _yaw(C)
        s = float(np.sum(onto * (off @ R.T)) / np.sum(off**2)) if how == SIM3 and off.any() else s
    elif how != SHIFT:
        s, R, _, rank = se3.rigid_fit(a.position, b.position, scaled=how == SIM3)
        if rank < 2 and turned:
            axis = np.linalg.svd(onto, full_matrices=False)[2][0]
            R = np.asarray(se3.about_axis(axis, R @ a.rotation, b.rotation) @ R)
        if rank == 0 and turned:  # all by the orientations
            U, _, Vt = np.linalg.svd(np.einsum("kij,klj->il", b.rotation, a.rotation))
            R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Similarity(s, R, there - s * R @ here)


BEGINNING = 0.1  # Share of the way that tells a heading where there are none


def _yaw(C: Array) -> Array:
    """The rotation about z that is nearest to a matrix (3, 3)."""
    return np.asarray(se3.exp_rotation(np.array([0.0, 0.0, math.atan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1])])))


def tilts(estimate: Poses, truth: Poses) -> Array:
    """Angles (n,) [rad] between the verticals of the two worlds, as each pair of poses has them."""
    return np.asarray(np.arccos(np.clip((truth.rotation @ np.swapaxes(estimate.rotation, -1, -2))[:, 2, 2], -1.0, 1.0)))


def distances(estimate: Poses, truth: Poses) -> Array:
    """Distances (n,) [m] of positions."""
    return np.asarray(np.linalg.norm(estimate.position - truth.position, axis=1))


def turns(estimate: Poses, truth: Poses) -> Array:
    """Angles (n,) [rad] between rotations."""
    found = np.full(len(estimate.position), np.nan)
    known = estimate.known & truth.known
    found[known] = se3.angle_between(truth.rotation[known], estimate.rotation[known])
    return found


def absolute_columns(estimate: Poses, truth: Poses) -> dict[str, float]:
    """Errors of positions [m] and rotations [deg]; the rotation part is the norm of R - I, as in evo."""
    d, angle = distances(estimate, truth), turns(estimate, truth)
    d, degrees = d[np.isfinite(d)], np.degrees(angle[np.isfinite(angle)])
    # the Frobenius norm of R - I is 2 sqrt(2) sin(angle / 2)
    part = 2.0 * math.sqrt(2.0) * np.sin(0.5 * angle[np.isfinite(angle)])
    of_rotation = {
        "rmse_rotation_3d_deg": rms(degrees), "max_rotation_3d_deg": float(degrees.max()),
        "rmse_rotation_part_3d": rms(part),
    } if len(part) else {}  # fmt: skip
    return {
        "rmse_position_3d_m": rms(d), "mean_position_3d_m": float(d.mean()),
        "median_position_3d_m": float(np.median(d)), "std_position_3d_m": float(d.std()),
        "min_position_3d_m": float(d.min()), "max_position_3d_m": float(d.max()),
        **of_rotation,
    }  # fmt: skip


def aligned_columns(path: Spatial, truth: Poses) -> dict[str, float]:
    """RMS errors of positions [m] and rotations [deg] after each fit, and the scale of Sim(3)."""
    found: dict[str, float] = {}
    turned = bool((poses(path).known & truth.known).any())
    if (poses(path).placed & truth.placed).sum() < 2:
        return found
    for how in FITTED:
        fit = aligning(poses(path), truth, how)
        assert fit is not None  # there are matches
        fitted = poses(fit.of(path))
        found[f"rmse_position_3d_{how}_m"] = rms(distances(fitted, truth))
        if turned:
            found[f"rmse_rotation_3d_{how}_deg"] = math.degrees(rms(turns(fitted, truth)))
        if how == SIM3:
            found["scale_sim3"] = fit.scale
    return found


def relative_columns(estimate: Poses, truth: Poses, time: Array, pairs: str = EVO) -> dict[str, float | None]:
    """RMS relative errors over a frame and over lengths of the true path in space; None: no pair. Of other pairs than
    evo's the median, too, which their programs show.
    """
    known = estimate.known & truth.known
    a, b = estimate.of(known), truth.of(known)
    found: dict[str, float | None] = {}
    every = {"frame": successive(int(known.sum()))} | _by_length(b.position, pairs)
    drift: list[Array] = []
    for name, (i, j) in without_gaps(every, time[known]).items():
        (Ra, ta), (Rb, tb) = _between(a, i, j), _between(b, i, j)
        some = len(i) > 0
        off, turn = np.linalg.norm(ta - tb, axis=1), np.degrees(se3.angle_between(Rb, Ra))
        found[f"rpe_{name}_3d_m"] = rms(off) if some else None
        found[f"rpe_{name}_3d_deg"] = rms(turn) if some else None
        if pairs != EVO and name != "frame" and some:
            found[f"rpe_{name}_3d_median_m"] = float(np.median(off))
            found[f"rpe_{name}_3d_median_deg"] = float(np.median(turn))
        if pairs == KITTI and name != "frame":
            drift.append(np.stack([100.0 * off, turn]) / float(name.removesuffix("m")))
    if drift:  # means over all pairs, as KITTI's table has them
        mean = np.concatenate(drift, axis=1).mean(axis=1) if any(each.size for each in drift) else (None, None)
        found |= dict(zip(("drift_3d_percent", "drift_3d_deg_per_m"), mean, strict=True))
    return found


def _by_length(position: Array, pairs: str) -> dict[str, tuple[IntArray, IntArray]]:
    """Pairs by length along the true positions (n, 3)."""
    if pairs == EVO:
        return pairs_over(position)
    if pairs == OPENVINS:
        return {f"{d:g}m": pairs_by_way(position, d, OPENVINS_TOLERANCE) for d in OPENVINS_LENGTHS}
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    if pairs == KITTI:
        way, first = np.append(0.0, np.cumsum(step)), np.arange(0, len(position), KITTI_STEP)
        ends = {d: np.searchsorted(way, way[first] + d, side="right") for d in KITTI_LENGTHS}
        return {f"{d:g}m": (first[last < len(way)], last[last < len(way)]) for d, last in ends.items()}
    length = float(step.sum())
    lengths = {f"{100.0 * share:.0f}percent": share * length for share in RPG_SHARES}
    return {name: pairs_by_way(position, d, RPG_TOLERANCE * d) for name, d in lengths.items()}


def _between(path: Poses, i: IntArray, j: IntArray) -> tuple[Array, Array]:
    back = np.swapaxes(path.rotation[i], -1, -2)
    return back @ path.rotation[j], np.einsum("nij,nj->ni", back, path.position[j] - path.position[i])


SAME_VERTICAL = math.radians(20.0)  # largest median tilt of two worlds with the same vertical


def plane_rmse(path: Spatial, truth: Poses) -> float:
    """RMS error [m] of x and y after the best rigid fit in space; NaN with fewer than two matches.

    A fit that turns the world over, though rotations have the same vertical, is that of a flat path that is mirrored;
    it is replaced by that of position and heading.
    """
    ours = poses(path)
    known = ours.known & truth.known
    fit = aligning(ours, truth, SE3)
    if fit is None or (ours.placed & truth.placed).sum() < 2:
        return math.nan
    if fit.R[2, 2] < 0.0 and known.any() and float(np.median(tilts(ours.of(known), truth.of(known)))) < SAME_VERTICAL:
        fit = aligning(ours, truth, YAW)
        assert fit is not None  # there are matches
    off = fit.of(path).position - truth.position
    return rms(np.hypot(off[:, 0], off[:, 1]))
