"""Walls as landmarks: in SLAM by iSAM2 as poses with gtsam's own factors, else as vectors with exact factors.

gtsam's Python API has no line in the plane. In SLAM by iSAM2, which should relinearize without calls of Python, a wall
is a pose W on it whose x axis is the wall's normal. A prior of its own holds its unobservable position along the wall.
The direction of an observation is a difference of headings; its distance is that to a beacon far behind the wall, as
for relative points (`graph.factors.coordinate_factors`). A single factor between the poses would couple the position
along the wall to the error of the direction, by the rows of the logarithm.

Batch problems, and known walls, have custom factors of a vector of two, in Python. These are exact, and cheap in
`graph.qr`; gtsam's own optimizers would copy all values in every call.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import FrameObservations, IntArray
from data.se2 import Array, wrap_angle
from data.sensors import Sensor, about
from graph import factors


def line_factors(
    sensor: Sensor, z: Array, R: Array, frame: IntArray, number: IntArray, point: Array, loss: str = "gaussian",
    known: Array | None = None,
) -> list[factors.ObservationFactors]:  # fmt: skip
    """Observations z (m, 2), R (m, 2, 2) of walls `number` (m,) from frames (m,), each one factor.

    SLAM: of poses and walls, vectors [rho, alpha] about a point (2,); `known` (m, 2): positions of the walls, about the
    origin. A loss acts on each observation as a whole.
    """
    result = []
    roots = factors.observation_roots(R, R, frame)
    for i, (f, n, root) in enumerate(zip(frame.tolist(), number.tolist(), roots, strict=True)):
        model = factors.with_loss(factors.noise.Gaussian.SqrtInformation(root), loss)
        if known is None:
            keys = [X(f), L(n)]
            factor = gtsam.CustomFactor(model, keys, _error(sensor, z[i], keys, point, None))
            result.append(factors.ObservationFactors(f, n, L(n), [factor]))
        else:
            factor = gtsam.CustomFactor(model, [X(f)], _error(sensor, z[i], [X(f)], point, about(known[i], point)[0]))
            result.append(factors.ObservationFactors(f, n, None, [factor], xy=known[i]))
    return result


def _error(
    sensor: Sensor, z: Array, keys: list[int], point: Array, line: Array | None
) -> Callable[[gtsam.CustomFactor, gtsam.Values, Any], Array]:
    """Expected minus measured (2,) with Jacobians, for the nearer normal; beyond the wall the distance is negative."""
    rotation, tx, ty = sensor.extrinsic.tolist()
    ax, ay = point.tolist()
    distance, direction = z.tolist()

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> Array:
        pose = values.atPose2(keys[0])
        rho, alpha = values.atPoint2(keys[1]) if line is None else line
        x, y = pose.x() - ax, pose.y() - ay
        c, s = math.cos(alpha), math.sin(alpha)
        across = alpha - pose.theta()
        cp, sp = math.cos(across + rotation), math.sin(across + rotation)
        d, arm = rho - c * x - s * y + cp * tx + sp * ty, cp * ty - sp * tx
        turn = math.remainder(across + rotation - direction, math.tau)
        side = 1.0
        if abs(turn) > 0.5 * math.pi:
            side, turn = -1.0, math.remainder(turn - math.pi, math.tau)
        if H is not None:
            ca, sa = math.cos(across), math.sin(across)
            H[0] = np.array([[-side * ca, -side * sa, -side * arm], [0.0, 0.0, -1.0]])
            if line is None:
                H[1] = np.array([[side, side * (s * x - c * y + arm)], [0.0, 1.0]])
        return np.array([side * d - distance, turn])

    return error


SHARE = 0.3
"""Share of a distance's sigma at the point of the robot from which it is measured, unless that is the robot's origin.
The range has the rest."""
ALONG = 1.0  # m. Sigma of the prior that holds a wall's pose along the wall
CENTRED = 1e-9  # m. A point of the robot nearer to its origin is its origin
JOINED = 1e-4  # rad; standard deviation of the difference of two merged walls


@dataclass(frozen=True, kw_only=True)
class WallObservation(factors.ObservationFactors):
    """One observation of a wall as gtsam's own factors."""

    sensor: Sensor  # that measured it
    z: Array  # (2,)
    R: Array  # (2, 2)
    name: int  # 0 where the wall's normal is the one measured, 1 where it is the opposite one
    point: tuple[int, Array] | None = None  # variable and start value (2,) of the robot's point of the distance
    wall: gtsam.Pose2 | None = None  # start value of the wall, where this is its first observation

    @property
    def start_values(self) -> list[tuple[int, Array | gtsam.Pose2]]:
        """Start values of its own variables."""
        found = super().start_values
        found += [] if self.point is None else [self.point]
        return found if self.wall is None or self.key is None else [*found, (self.key, self.wall)]

    @property
    def own_variables(self) -> list[int]:
        """Variables of this observation alone."""
        return super().own_variables + ([] if self.point is None else [self.point[0]])

    def renumbered(self, number: int, *, opposite: bool = False) -> "WallObservation":
        """The same observation (SLAM) of another wall; `opposite`: one with the opposite normal."""
        row = 0 if self.point is None else gtsam.symbolIndex(self.point[0])
        other = replace(self, number=number, key=L(number), name=self.name ^ opposite, wall=None)
        return replace(other, measured=_slam_factors(other, row))


def _body_point(sensor: Sensor, z: Array, R: Array) -> Array:
    """The body's point (2,) whose distance from the wall is independent of the direction's error."""
    rotation, tx, ty = sensor.extrinsic.tolist()
    c, s = math.cos(rotation), math.sin(rotation)
    phi, off = float(z[1]) - rotation, float(R[0, 1] / R[1, 1])
    return np.array([-c * tx - s * ty - off * math.sin(phi), s * tx - c * ty + off * math.cos(phi)])


def _slam_factors(s: WallObservation, row: int) -> list[factors.Factor]:
    """Direction and distance of a wall W; the robot's point is variable `row`, unless it is the robot's origin."""
    # sigma of the distance given the direction, and of the direction
    sigma, sigma_phi = math.sqrt(s.R[0, 0] - s.R[0, 1] ** 2 / s.R[1, 1]), math.sqrt(s.R[1, 1])
    model: gtsam.noiseModel.Base = factors.noise.Gaussian.SqrtInformation(np.diag([0.0, 0.0, 1.0 / sigma_phi]))
    normal = gtsam.Pose2(0, 0, float(s.z[1]) - s.sensor.rotation + s.name * math.pi)  # its direction in the body frame
    found: list[factors.Factor] = [gtsam.BetweenFactorPose2(X(s.frame), L(s.number), normal, model)]
    beacon, far = gtsam.Pose2(factors.BEACON, 0.0, 0.0), factors.BEACON + (-float(s.z[0]) if s.name else float(s.z[0]))
    if s.point is None:
        model = factors.noise.Isotropic.Sigma(1, sigma)
        return [*found, gtsam.RangeFactorWithTransformPose2(L(s.number), X(s.frame), far, model, beacon)]
    model = factors.noise.Isotropic.Sigma(1, sigma * math.sqrt(1.0 - SHARE**2))
    key = point_key(row)
    found.append(gtsam.RangeFactorWithTransform2D(L(s.number), key, far, model, beacon))
    root = np.eye(2) / (SHARE * sigma)
    return found + factors.coordinate_factors(X(s.frame), key, _body_point(s.sensor, s.z, s.R), root, "gaussian")


def point_key(row: int) -> int:
    """Variable of the robot's point that the distance of an observation is measured from."""
    return int(gtsam.symbol("p", row))


def wall_factors(
    sensor: Sensor, seen: FrameObservations, frame: IntArray, number: IntArray, pose: Array,
    lines: Mapping[int, Array], first_row: int,
) -> list[WallObservation]:  # fmt: skip
    """SLAM: observations (m) of walls `number` (m,) from frames (m,) at about `pose` (m, 3).

    `lines`: (rho, alpha) by number of walls in the graph; others start at their first observation. The robot's points
    are variables p(first_row), ...
    """
    result, alpha = [], {n: float(line[1]) for n, line in lines.items()}
    made = partial(WallObservation, sensor=sensor)
    factors.observation_roots(seen.R, seen.R, frame)
    for i, (f, n) in enumerate(zip(frame.tolist(), number.tolist(), strict=True)):
        z, R, wall, own = seen.z[i], seen.R[i], None, list[factors.Factor]()
        if n not in alpha:
            near = pose[i, :2]  # the wall's point nearest to it
            rho, direction = about(sensor.inverse(pose[i], z[None])[0][0], near)[0].tolist()
            wall = gtsam.Pose2(near[0] + rho * math.cos(direction), near[1] + rho * math.sin(direction), direction)
            # a prior holds it along the wall
            model = factors.noise.Gaussian.SqrtInformation(np.diag([0.0, 1.0 / ALONG, 0.0]))
            alpha[n], own = wall.theta(), [gtsam.PriorFactorPose2(L(n), wall, model)]
        body = _body_point(sensor, z, R)
        at = gtsam.Pose2(*pose[i].tolist()).transformFrom(body)
        point = None if np.hypot(*body) < CENTRED else (point_key(first_row + i), at)
        # 1 where the normal that was measured is the opposite of the landmark's
        turn = math.remainder(alpha[n] - pose[i, 2] + sensor.rotation - float(z[1]), math.tau)
        s = made(f, n, L(n), [], z=z, R=R, name=int(abs(turn) > 0.5 * math.pi), point=point, wall=wall)
        result.append(replace(s, measured=_slam_factors(s, first_row + i) + own))
    return result


def same_wall(merged: int, kept: int, pose: Sequence[gtsam.Pose2], sigma: float) -> factors.Factor:
    """Factor that equates two walls at about these two poses, with a standard deviation [m] of their distance."""
    between = pose[0].between(pose[1])
    along = gtsam.Pose2(0.0, between.y(), math.pi if abs(between.theta()) > 0.5 * math.pi else 0.0)
    root = np.diag([1.0 / sigma, 0.0, 1.0 / JOINED])
    return gtsam.BetweenFactorPose2(L(merged), L(kept), along, factors.noise.Gaussian.SqrtInformation(root))


def lines_of(poses: Sequence[gtsam.Pose2]) -> tuple[Array, Array]:
    """Walls as lines (n, 2), [rho, alpha] about the origin, with Jacobians (n, 2, 3) to their tangent coordinates."""
    found = np.array([factors.pose_array(p) for p in poses], float).reshape(-1, 3)
    c, s = np.cos(found[:, 2]), np.sin(found[:, 2])
    J = np.zeros((len(found), 2, 3))
    J[:, 0, 0] = J[:, 1, 2] = 1.0
    J[:, 0, 2] = c * found[:, 1] - s * found[:, 0]
    return np.stack([c * found[:, 0] + s * found[:, 1], wrap_angle(found[:, 2])], 1), J


def as_vectors(values: gtsam.Values, numbers: IntArray, point: Array) -> None:
    """Convert walls (n,) among `values` from poses to the vectors of a `Problem`, about a point (2,)."""
    lines, _ = lines_of([values.atPose2(L(n)) for n in numbers.tolist()])
    for n, line in zip(numbers.tolist(), about(lines, point), strict=True):
        values.erase(L(n))
        values.insert(L(n), line)
