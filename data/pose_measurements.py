"""Measurements of the pose with covariance and named source: absolute fixes, and closures between two frames' poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from data import se2
from data.locked import IntArray, Locked
from data.se2 import Array, wrap_angle


class FixKind(IntEnum):
    """What a fix measures."""

    POSITION = 0
    HEADING = 1
    POSE = 2


MEASURED = {FixKind.POSITION: (0, 1), FixKind.HEADING: (2,), FixKind.POSE: (0, 1, 2)}
"""Entries of (x, y, theta) that a kind of fix measures."""


@dataclass(frozen=True)
class FixSource:
    """A source of fixes, such as a GPS antenna or a compass."""

    name: str  # unique in a log
    lever: tuple[float, float] = (0.0, 0.0)  # m, its place in the body frame: it measures p + R(theta) lever
    rotation: float = 0.0  # rad, its direction in the body frame: it measures theta + rotation


@dataclass(frozen=True, eq=False)
class _Known(Locked):
    """Measurements of a log, each known at one frame, ascending; row (K,): of each in the log, None: all are here."""

    row: IntArray = field(default_factory=lambda: np.empty(0, np.int64), kw_only=True)

    def __post_init__(self) -> None:
        if len(self.row) != len(self):
            object.__setattr__(self, "row", np.arange(len(self)))
        super().__post_init__()

    def __len__(self) -> int:
        return len(self.later)

    @property
    def later(self) -> IntArray:
        """The frame (K,) at which each is known."""
        raise NotImplementedError

    def of(self, frame: int) -> Self | None:
        """Those known at a frame; None: there are none."""
        a, b = np.searchsorted(self.later, (frame, frame + 1)).tolist()
        return None if a == b else self.only(slice(a, b))

    def before(self, frame: int) -> Self:
        return self.only(slice(int(np.searchsorted(self.later, frame))))


@dataclass(frozen=True, eq=False)
class Fixes(_Known):
    """Absolute measurements of the pose, or of part of it: of a log, or of one of its frames."""

    frame: IntArray  # (F,) ascending
    kind: IntArray  # (F,) of `FixKind`
    source: IntArray  # (F,) row in `sources`
    z: Array  # (F, 3) x, y [m], theta [rad] in the world frame, zero in the entries that its kind does not measure
    covariance: Array  # (F, 3, 3) of z in the world frame, zero in the rows and columns that are not measured
    sources: tuple[FixSource, ...]  # where they come from

    @property
    def later(self) -> IntArray:
        """The frame (F,) of each."""
        return self.frame

    @property
    def placed(self) -> tuple[IntArray, Array, float]:
        """Frames and positions of those that have some, and their usual standard deviation [m]."""
        rows = np.flatnonzero(self.kind != FixKind.HEADING)
        return self.frame[rows], self.z[rows, :2], math.sqrt(np.median(self.covariance[rows, 0, 0])) if len(rows) else 0

    @property
    def dof(self) -> IntArray:
        """Degrees of freedom (F,) of each."""
        return np.array([len(MEASURED[FixKind(kind)]) for kind in self.kind.tolist()], np.int64)


def expected_fix(pose: Array, kind: int, source: FixSource) -> tuple[Array, Array]:
    """What a fix of this kind measures of a pose (3,): its entries (d,), and their Jacobian (d, 3) to the pose."""
    c, s = float(np.cos(pose[2])), float(np.sin(pose[2]))
    x, y = source.lever
    arm = np.array([c * x - s * y, s * x + c * y])
    z_hat = np.array([pose[0] + arm[0], pose[1] + arm[1], wrap_angle(float(pose[2]) + source.rotation)])
    H = np.eye(3)
    H[0, 2], H[1, 2] = -arm[1], arm[0]
    rows = list(MEASURED[FixKind(kind)])
    return z_hat[rows], H[rows]


@dataclass(frozen=True, eq=False)
class Closures(_Known):
    """Measured relative poses of two frames: loop closures, scan matches, edges of a pose graph, a second odometry.
    Those of a log, or those that are known at one of its frames.
    """

    frame1: IntArray  # frame1, frame2: (K,) different frames, in either order; ascending by the later one
    frame2: IntArray
    relative: Array  # (K, 3) pose of frame2 in the frame of frame1 [m, m, rad]
    covariance: Array  # (K, 3, 3) of its additive error, in the frame of frame1
    source: IntArray  # (K,) row in `sources`
    sources: tuple[str, ...]  # names of where they come from

    @property
    def later(self) -> IntArray:
        """The later frame (K,) of each, at which it is known."""
        return np.maximum(self.frame1, self.frame2)

    @property
    def earlier(self) -> IntArray:
        """The earlier frame (K,) of each."""
        return np.minimum(self.frame1, self.frame2)

    def last_use(self) -> dict[int, int]:
        """The frame at which each earlier frame is used last: a filter keeps its pose until then."""
        order = np.argsort(self.later, kind="stable")
        return dict(zip(self.earlier[order].tolist(), self.later[order].tolist(), strict=True))


def expected_closure(pose1: Array, pose2: Array) -> tuple[Array, Array, Array]:
    """Pose (3,) of pose2 in the frame of pose1, and its Jacobians (3, 3) to pose1 and to pose2 (both world frame)."""
    c, s = float(np.cos(pose1[2])), float(np.sin(pose1[2]))
    dx, dy = float(pose2[0] - pose1[0]), float(pose2[1] - pose1[1])
    x, y = c * dx + s * dy, -s * dx + c * dy
    z_hat = np.array([x, y, wrap_angle(float(pose2[2] - pose1[2]))])
    H1 = np.array([[-c, -s, y], [s, -c, -x], [0.0, 0.0, -1.0]])
    return z_hat, H1, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


Expected = Callable[[Array], tuple[Array, Array]]  # Expected measurement (d,) of poses (q,), and its Jacobian (d, q)


class GaussianMeasurement(NamedTuple):
    """One measurement of some poses."""

    entries: tuple[int, ...]  # measured ones (d,) of x, y, theta
    z: Array  # (d,)
    R: Array  # (d, d)
    expected: Expected

    def innovation(self, poses: Array) -> tuple[Array, Array]:
        """Measured minus expected (d,) at the poses (q,), and the Jacobian (d, q) of the expectation."""
        z_hat, H = self.expected(poses)
        nu = self.z - z_hat
        if self.entries[-1] == 2:
            nu[-1] = wrap_angle(float(nu[-1]))
        return nu, H


def fixes_of(fixes: Fixes, sources: tuple[FixSource, ...]) -> list[GaussianMeasurement]:
    """The fixes (f) of a frame as measurements of its pose."""
    found = []
    for kind, source, z, C in zip(fixes.kind.tolist(), fixes.source.tolist(), fixes.z, fixes.covariance, strict=True):
        entries = MEASURED[FixKind(kind)]
        rows = list(entries)

        def expected(pose: Array, kind: int = kind, source: int = source) -> tuple[Array, Array]:
            return expected_fix(pose, kind, sources[source])

        found.append(GaussianMeasurement(entries, z[rows], C[np.ix_(rows, rows)], expected))
    return found


def closure_of(relative: Array, covariance: Array, a: int, b: int, size: int) -> GaussianMeasurement:
    """A relative pose (3,) of two among stacked poses (size,), which begin at `a` and `b`."""

    def expected(poses: Array) -> tuple[Array, Array]:
        z_hat, H1, H2 = expected_closure(poses[a : a + 3], poses[b : b + 3])
        H = np.zeros((3, size))
        H[:, a : a + 3], H[:, b : b + 3] = H1, H2
        return z_hat, H

    return GaussianMeasurement((0, 1, 2), relative, covariance, expected)


class PoseUpdated(NamedTuple):
    """What an estimator did with the fixes, or the closures, of a frame, or of a log."""

    used: NDArray[np.bool_]  # (F,) accepted
    nis: Array  # (F,) normalized innovation squared of each by itself, at its turn; NaN: not formed, or not reached
    dof: IntArray  # (F,) its degrees of freedom
    white: Array  # (F, 3) innovations whitened by their covariance's Cholesky factor; NaN: not measured or formed
    S: Array  # (F, 3, 3) covariance of the innovations; NaN: not measured, not formed, or not kept
    gate: float | None = None  # chi-square probability of the gate; None: there was none

    def enter(self, rows: IntArray | NDArray[np.bool_], part: PoseUpdated) -> None:
        """Enter what became of the measurements in some rows."""
        for into, own in ((self.used, part.used), (self.nis, part.nis), (self.white, part.white), (self.S, part.S)):
            into[rows] = own

    def of(self, rows: IntArray | NDArray[np.bool_]) -> PoseUpdated:
        """What became of the measurements in some rows."""
        return PoseUpdated(self.used[rows], self.nis[rows], self.dof[rows], self.white[rows], self.S[rows], self.gate)


def not_used(dof: IntArray | Sequence[int]) -> PoseUpdated:
    """The result of an update with measurements (f,) of these degrees of freedom before any is used."""
    f = len(dof)
    nothing = np.full((f, 3), np.nan)
    return PoseUpdated(
        np.zeros(f, np.bool_), nothing[:, 0].copy(), np.array(dof, np.int64), nothing, np.full((f, 3, 3), np.nan)
    )


CLEAR = 15.0  # Reach of fixes (root of the sum of their distances²) over their sigma that tells the heading to 4 deg
FAR, LOOSE = 1.0, math.radians(10.0)  # m, way from the start that tells its heading; rad, least deviation of that


class Start(NamedTuple):
    """A first pose (3,) and its standard deviations (3,)."""

    pose: Array
    sigma: Array
    onto: str = "odometry to the fixes"  # what it takes there

    def said(self, *, fits: bool = True) -> str:
        """As flags, in a note; `fits`: from there the odometry leads to the fixes, else the start is assumed."""
        (x, y, turn), (sx, sy, st) = self.pose.tolist(), self.sigma.tolist()
        x, y = (f"{value:.{max(4, len(f'{abs(value):.0f}') + 2)}g}" for value in (x, y))
        flags = f"--prior={x},{y},{math.degrees(turn):.3g}deg --prior-sigma {sx:.3g},{sy:.3g},"
        how, why = ("inferred", f", which takes {self.onto}") if fits else ("assumed", "")
        return f"{how}: {flags}{math.degrees(st):.3g}deg{why}"


def onto_fixes(fixes: Fixes, mean: Array, covariance: Array) -> Start | None:
    """The first pose that takes increments, mean (N, 3), to the first fixes of places, if these tell its heading."""
    rows = np.flatnonzero(fixes.kind != FixKind.HEADING)
    if not len(rows):
        return None
    path = se2.dead_reckoned(np.zeros(3), mean)
    way = np.append(0.0, np.hypot(*np.diff(path[:, :2], axis=0).T).cumsum())[fixes.frame[rows]]
    lever = np.array([(*source.lever, 0.0) for source in fixes.sources])[fixes.source[rows]]
    path = se2.compose(path[fixes.frame[rows]], lever)[:, :2]
    sigma = fixes.placed[2]
    z = fixes.z[rows, :2]
    fits = []
    for first in range(0, len(rows), 1 + len(rows) // TRIED):  # those of a receiver that starts cold are off
        if (last := _far(path[first:], way[first:], sigma)) is None:
            break
        part = slice(first, first + last + 1)
        pose = se2.rigid_fit(path[part], z[part])
        off = se2.transform_points(np.tile(pose, (last + 1, 1)), path[part]) - z[part]
        fits.append((pose, first + last, float(np.sqrt((off**2).mean())), first))
        if fits[-1][2] <= ODD * sigma:
            break
    if not fits:
        return None
    pose, last, error, first = fits[-1] if fits[-1][2] <= ODD * sigma else fits[0]
    drift = float(covariance[: fixes.frame[rows[last]] + 1, 2, 2].sum())
    turn = math.sqrt(LOOSE**2 + drift / 3.0)  # a third of it is in the mean of the way
    place = max(sigma, error) + turn * float(np.hypot(*path[first])) * (first > 0)
    return Start(pose, np.array([place, place, turn]))


TRIED, ODD = 40, 3.0  # Most starts that are tried; root mean square of a fit over the sigma of fixes that excludes it


def _far(path: Array, way: Array, sigma: float) -> int | None:
    """The first row of places (M, 2) until which these tell the heading of fixes with that sigma; None: none."""
    new = np.diff(way // max(FAR, sigma), prepend=-1.0) > 0.0  # errors at one place are alike: they count once
    new[0] = True
    count = np.maximum(np.cumsum(new), 1)
    spread = np.cumsum(new[:, None] * path**2, axis=0) - np.cumsum(new[:, None] * path, axis=0) ** 2 / count[:, None]
    far = np.flatnonzero((spread.sum(axis=1) > (CLEAR * sigma) ** 2) & (np.hypot(*(path - path[0]).T) > FAR))
    return int(far[0]) if len(far) else None
