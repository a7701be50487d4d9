"""Projection of spatial poses and 6x6 covariances to the plane; headers and samples of SQUARE files.

x, y and the yaw of Z-Y-X angles, atan2(R10, R00), are kept. Their covariance follows to first order from that of the
pose: with p the position, c the first column of R, and a small rotation w in the world's axes, dyaw = w_z - c_z (c_x
w_x + c_y w_y) / (c_x^2 + c_y^2).

SQUARE: `#%KEY value` lines declare columns and tangent; samples (`ensemble_se3`), a particle a line, are reduced to
mean and covariance in the plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data.errors import DataError
from data.formats.recordings.ros import rotation_of
from data.formats.results.path import (
    CAMERA,
    LEFT,
    LOCAL,
    WORLD,
    GivenPath,
    Manner,
    Outside,
    Text,
    in_order,
    numbers,
    require_order,
)
from data.se2 import Array, wrap_angle

LEVEL = 1e-9
"""m and rad, smallest reported extent outside the plane."""
UNIT = 0.01
"""Largest deviation of a quaternion from length 1, and of a rotation matrix from orthonormality."""
FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Robot axes from a camera's: forward is its z, left its -x, up its -y."""


@dataclass(frozen=True, eq=False)
class Spatial:
    """A trajectory in space as in a file.

    Attributes:
        file, kind: as of `GivenPath`.
        time: (n,) s, ascending.
        position: (n, 3) m.
        rotation: (n, 3, 3), world from body.
        covariance: (n, 6, 6), translation first, then rotation; rows NaN where unknown; None: none.
        frame: of the covariance, which the file itself may state (`declared`).
        place: place of row k, for messages.
        notes: sentences.
    """

    file: str
    kind: str
    time: Array
    position: Array
    rotation: Array
    covariance: Array | None
    frame: str
    place: Callable[[int], str]
    declared: bool = False
    notes: tuple[str, ...] = ()


def rotations(quaternion: Array, place: Callable[[int], str]) -> Array:
    """Rotation matrices (n, 3, 3) of quaternions x, y, z, w (n, 4); DataError for one without length 1."""
    length = np.sqrt(np.sum(quaternion**2, axis=1))
    bad = np.flatnonzero(~(np.abs(length - 1.0) < UNIT))
    if len(bad):
        k = int(bad[0])
        what = f"quaternion {quaternion[k].tolist()} has length {length[k]:.4g}; 1 is needed (order x, y, z, w)"
        raise DataError(f"{place(k)}: {what}")
    return rotation_of(quaternion)


def on_plane(spatial: Spatial, manner: Manner) -> GivenPath:
    """The trajectory in the plane; DataError for a contradicted covariance frame or an invalid covariance."""
    s, frame = spatial, spatial.frame
    if s.covariance is not None and manner.frame is not None:
        if s.declared and manner.frame != s.frame:
            raise DataError.at(s.file, f"its header states {s.frame} covariances; remove --cov-frame {manner.frame}")
        frame = manner.frame
    p, R, C = s.position, s.rotation, s.covariance
    if manner.axes == CAMERA:
        turn = np.kron(np.eye(2), FROM_CAMERA)
        p, R = p @ FROM_CAMERA.T, FROM_CAMERA @ R @ FROM_CAMERA.T
        C = None if C is None else turn @ C @ turn.T
    yaw = wrap_angle(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    pose = np.column_stack([p[:, :2], yaw])
    planar = None if C is None else _planar_covariance(p, R, C, frame)
    if planar is not None:
        require_covariances(planar, s.place)
    keep = in_order(s.time)
    notes = s.notes
    if len(keep) < len(s.time):
        notes += (
            f"{len(s.time) - len(keep)} of {len(s.time)} poses share their stamp with a later one, which is used",
        )
    kept, frame = (None, "") if planar is None else (planar[keep], frame)
    return GivenPath(s.file, s.kind, s.time[keep], pose[keep], kept, frame, _outside(p, R), notes)


def _planar_covariance(p: Array, R: Array, C: Array, frame: str) -> Array:
    """World-additive covariance (n, 3, 3) of x, y, yaw."""
    n = len(p)
    # from the file's tangent to position error and small rotation in the world's axes
    world = np.zeros((n, 6, 6))
    if frame == LOCAL:
        world[:, :3, :3] = R
        world[:, 3:, 3:] = R
    else:
        world[:] = np.eye(6)
        if frame == LEFT:  # w x p
            x, y, z = p.T
            world[:, 0, 4], world[:, 0, 5] = z, -y
            world[:, 1, 3], world[:, 1, 5] = -z, x
            world[:, 2, 3], world[:, 2, 4] = y, -x
    plane = np.zeros((n, 3, 6))
    plane[:, 0, 0] = plane[:, 1, 1] = plane[:, 2, 5] = 1.0
    c = R[:, :, 0]
    flat = c[:, 0] ** 2 + c[:, 1] ** 2
    tilted = flat > 0.0
    plane[tilted, 2, 3] = -c[tilted, 2] * c[tilted, 0] / flat[tilted]
    plane[tilted, 2, 4] = -c[tilted, 2] * c[tilted, 1] / flat[tilted]
    J = plane @ world
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


def _outside(p: Array, R: Array) -> Outside:
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))

    def ends(values: Array) -> tuple[float, float]:
        return float(values.min()), float(values.max())

    return Outside(ends(p[:, 2]), ends(roll), ends(pitch))


def projection(path: GivenPath) -> str:
    """The projection, in a sentence; empty without one."""
    o = path.outside
    if o is None:
        return ""
    degrees = math.degrees(1.0)
    parts = [("z", o.z, 1.0, "m"), ("roll", o.roll, degrees, "deg"), ("pitch", o.pitch, degrees, "deg")]
    there = [
        f"{name} {scale * ends[0]:.4g} to {scale * ends[1]:.4g} {unit}"
        for name, ends, scale, unit in parts
        if max(map(abs, ends)) >= LEVEL
    ]
    if not there:
        return ""
    text = f"projected to the plane: {', '.join(there)} ignored"
    flat = float(np.max(np.ptp(path.pose[:, :2], axis=0))) if len(path) else 0.0
    if o.z[1] - o.z[0] > flat:
        text += "; more than in the plane: if axes are a camera's (z forward), add --axes camera"
    return text


POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
CONVENTIONS = {"right_perturbation": LOCAL, "left_perturbation": LEFT}
ORDERS = ("translation_rotation", "rotation_translation")


@dataclass(frozen=True)
class Header:
    """Values of `#%KEY value` lines by key, each with its line."""

    values: dict[str, tuple[int, str]]

    def one_of(self, text: Text, key: str, allowed: tuple[str, ...]) -> str | None:
        """A value that must be one of a few; None if absent."""
        line, value = self.values.get(key, (0, ""))
        if key not in self.values:
            return None
        if value not in allowed:
            raise DataError.at(text.path, f"{key} {value!r}; one of {', '.join(allowed)} is needed", line=line)
        return value


def header_of(text: Text) -> Header:
    """The header of a SQUARE file or of a file of covariances; empty where there is none."""
    found: dict[str, tuple[int, str]] = {}
    for line, comment in text.comments:
        if comment.startswith("#%"):
            key, _, value = comment[2:].strip().partition(" ")
            if key.upper() in found:
                raise DataError.at(text.path, f"{key} is stated twice; once is needed", line=line)
            found[key.upper()] = line, value.strip()
    return Header(found)


def tangent(text: Text, header: Header) -> tuple[str | None, str | None]:
    """Frame and order that a header declares."""
    convention = header.one_of(text, "TANGENT_CONVENTION", tuple(CONVENTIONS))
    return None if convention is None else CONVENTIONS[convention], header.one_of(text, "TANGENT_ORDER", ORDERS)


FEWEST = 4
"""Fewest samples at an instant for a covariance of full rank."""


def read_samples(text: Text, header: Header, unit: float, manner: Manner) -> GivenPath:
    """Means and covariances of the particles at each stamp; heading by circular mean, weights normalized."""
    weighted = header.one_of(text, "WEIGHTED", ("true", "false")) == "true"
    logarithmic = header.one_of(text, "WEIGHT_FORMAT", ("linear", "log")) == "log"
    columns = ("t", "particle", *(("weight",) if weighted else ()), *POSE[1:])
    rows = numbers(text, columns)
    time = rows[:, 0] * unit
    require_order(text, time)
    file, first = str(text.path), 3 if weighted else 2
    R = rotations(rows[:, first + 3 :], text.place)
    stamps, start, count = np.unique(time, return_index=True, return_counts=True)
    # each particle is projected (with distinct stamps), then their moments are formed
    apart = Spatial(file, "", np.arange(len(rows), dtype=float), rows[:, first : first + 3], R, None, "", text.place)
    flat = on_plane(apart, Manner(axes=manner.axes))
    pose, covariance = np.empty((len(stamps), 3)), np.full((len(stamps), 3, 3), np.nan)
    for k, (i, n) in enumerate(zip(start.tolist(), count.tolist(), strict=True)):
        weight = np.full(n, 1.0 / n) if not weighted else rows[i : i + n, 2]
        if weighted and logarithmic:
            weight = np.exp(weight - weight.max())
        if weight.min() < 0.0 or not weight.sum() > 0.0:
            raise DataError.at(text.path, "weights of an instant must not be negative, nor all zero", line=text.line[i])
        pose[k], covariance[k] = _moments(flat.pose[i : i + n], weight / weight.sum())
    few = int((count < FEWEST).sum())
    covariance[count < FEWEST] = np.nan
    notes: tuple[str, ...] = (f"mean and covariance of {int(count.min())} to {int(count.max())} samples an instant",)
    if few:
        notes += (f"{few} instants have fewer than {FEWEST} samples, too few for a covariance",)
    outside: Outside | None = flat.outside
    return GivenPath(file, "SQUARE, ensemble_se3", stamps, pose, covariance, WORLD, outside, notes)


def _moments(pose: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) and unbiased covariance (3, 3) for normalized weights."""
    heading = np.arctan2(weight @ np.sin(pose[:, 2]), weight @ np.cos(pose[:, 2]))
    mean = np.array([*(weight @ pose[:, :2]), heading])
    off = pose - mean
    off[:, 2] = wrap_angle(off[:, 2])
    spare = 1.0 - float(weight @ weight)
    return mean, (off * weight[:, None]).T @ off / spare if spare > 0.0 else np.full((3, 3), np.nan)
