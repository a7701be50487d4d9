"""Our inputs as gtsam factors: prior, increments, sightings of landmarks.

Conventions that differ: gtsam's pose covariances live in the body frame of the pose they belong to (ours: world frame);
noise of a relative pose lives at its *end* (ours: in the frame it starts from); bearing comes before range (ours:
after). Keys: X(frame) for poses, L(number) for landmarks; in localization L(row of the observation).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.errors import DataError, SlamrefError
from data.inputs import IntArray, Prior
from data.se2 import Array, world_from_body
from data.sensors import RANGE_BEARING, Sensor

noise = gtsam.noiseModel
Factor = gtsam.NonlinearFactor

EXACT = 1e-6
"""m, rad. A direction in which the prior's sigma is smaller gets this one; all three smaller: the pose is held exactly.

gtsam has no noise that is exact in an arbitrary direction. The covariances of batch and finish do not depend on this.
"""
BEACON = 1e7
"""m. Distance of the beacons that stand for the coordinates of a relative point; see `coordinate_factors`."""
SINGULAR = 1e-13
"""m^2, rad^2. An increment whose covariance has an eigenvalue below this has no information matrix to speak of."""
KERNELS = {"huber": noise.mEstimator.Huber.Create(1.345), "cauchy": noise.mEstimator.Cauchy.Create(1.0)}
LOSSES = ("gaussian", *KERNELS)
_HELD = noise.Constrained.All(2)


class UnderConstrained(SlamrefError):  # noqa: N818 - a condition of the problem, named as surveyors name it
    """The data do not determine a variable; the message names it in plain words."""


def name_of(key: int) -> str:
    """`pose of frame 12` or `landmark 3`."""
    index = gtsam.symbolIndex(key)
    return f"pose of frame {index}" if gtsam.symbolChr(key) == ord("x") else f"landmark {index}"


@dataclass(frozen=True)
class Sighted:
    """One observation as factors.

    Attributes:
        frame: from which the landmark was seen.
        number: landmark number (localization: the map's id).
        key: the landmark's variable; None where the factor needs none.
        measured: the factors of the measurement, two residuals in all.
        pin: holds a known landmark where the map has it; None in SLAM.
        xy: where a known landmark is; None in SLAM.
    """

    frame: int
    number: int
    key: int | None
    measured: list[Factor]
    pin: Factor | None = None
    xy: Array | None = None

    @property
    def factors(self) -> list[Factor]:
        """All of them."""
        return self.measured if self.pin is None else [*self.measured, self.pin]


def pose2(pose: Array) -> gtsam.Pose2:
    """A pose (3,) as gtsam's."""
    return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def root_information(covariance: Array) -> Array:
    """Upper triangular R (n, d, d) with R'R = C^-1, from a Cholesky factor of C (n, d, d).

    gtsam's own `Gaussian.Covariance` inverts C instead: for a nearly singular C it gets the well-known direction right
    and the other one wrong (a rank-one prior of sigma 0.17, floored at 1e-6, came out as 0.002).
    """
    U = np.linalg.cholesky(covariance[:, ::-1, ::-1])[:, ::-1, ::-1]  # C = U U', U upper triangular
    return np.triu(np.linalg.inv(U))


def prior_factor(prior: Prior) -> Factor:
    """Prior on the pose of frame 0; zero and singular covariances are allowed (see `EXACT`)."""
    B = world_from_body(prior.mean[2])
    body = B.T @ prior.covariance @ B
    variance, axes = np.linalg.eigh(body)
    model: gtsam.noiseModel.Base
    if variance[-1] < EXACT**2:
        model = noise.Constrained.All(3)
    else:
        if variance[0] < EXACT**2:
            body = axes @ np.diag(np.maximum(variance, EXACT**2)) @ axes.T
        model = noise.Gaussian.SqrtInformation(root_information(body[None])[0])
    return gtsam.PriorFactorPose2(X(0), pose2(prior.mean), model)


def check_increments(first_frame: int, covariance: Array) -> Array:
    """Smallest eigenvalue (n,) of the covariances (n, 3, 3) of the motion into the frames from `first_frame` on.

    Raises DataError for a singular one: a smoother needs its inverse.
    """
    smallest = np.asarray(np.linalg.eigvalsh(covariance)[:, 0], float)
    bad = np.flatnonzero(~(smallest > SINGULAR))
    if len(bad):
        raise DataError(
            f"increment into frame {first_frame + bad[0]}: covariance is singular (smallest eigenvalue "
            f"{smallest[bad[0]]:.3g}); a smoother needs covariance_floor of 1e-10 or so"
        )
    return smallest


def between_factors(first_frame: int, mean: Array, covariance: Array) -> list[Factor]:
    """Motions (n, 3) with covariances (n, 3, 3) into the frames from `first_frame` on.

    Our increment's error is additive in the previous body frame, gtsam's sits at the end pose.
    """
    B = np.zeros_like(covariance)
    c, s = np.cos(mean[:, 2]), np.sin(mean[:, 2])
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = c, -s, s, c, 1.0
    roots = root_information(B.transpose(0, 2, 1) @ covariance @ B)
    return [
        gtsam.BetweenFactorPose2(X(k - 1), X(k), pose2(m), noise.Gaussian.SqrtInformation(R))
        for k, (m, R) in enumerate(zip(mean, roots, strict=True), first_frame)
    ]


def with_loss(model: gtsam.noiseModel.Base, loss: str) -> gtsam.noiseModel.Base:
    """The noise model under a robust kernel: Huber 1.345, Cauchy 1.0 (95 % efficient, and usual), or none."""
    return model if loss == "gaussian" else noise.Robust.Create(KERNELS[loss], model)


def in_body_frame(sensor: Sensor, z: Array) -> tuple[Array, Array]:
    """Points (m, 2) in the body frame and their Jacobians (m, 2, 2) to z: for a relative point, the rotation."""
    points, _, Gz = sensor.inverse(np.zeros(3), z)
    return points, Gz


def bearing_range(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """[bearing, range] (m, 2) in the body frame, gtsam's order, with the roots (m, 2, 2) of their information.

    A rotated sensor only shifts the bearing; one mounted off the robot's centre is converted through the point, to
    first order in the noise.
    """
    if sensor.translation == (0.0, 0.0):
        return np.stack([z[:, 1] - sensor.rotation, z[:, 0]], 1), root_information(R[:, ::-1, ::-1])
    p, G = in_body_frame(sensor, z)
    r = np.hypot(p[:, 0], p[:, 1])
    A = np.stack([np.stack([-p[:, 1], p[:, 0]], 1) / r[:, None] ** 2, p / r[:, None]], 1) @ G
    return np.stack([np.arctan2(p[:, 1], p[:, 0]), r], 1), root_information(A @ R @ A.transpose(0, 2, 1))


def _checked(R: Array, frame: IntArray) -> tuple[Array, Array]:
    """Principal variances (m, 2) and axes (m, 2, 2) of covariances R; raises DataError for one that is not definite."""
    variance, axes = np.linalg.eigh(R)
    bad = np.flatnonzero(~(variance[:, 0] > 0.0))
    if len(bad):
        i = bad[0]
        raise DataError(f"frame {frame[i]}: measurement covariance {R[i].tolist()} is not positive definite")
    return variance, axes


def coordinate_factors(pose: int, landmark: int, point: Array, variance: Array, axes: Array, loss: str) -> list[Factor]:
    """A relative point (2,) as two independent scalars along the principal axes (2, 2; columns) of its covariance.

    gtsam's Python API has no Pose2-Point2 factor for a relative point. But the coordinate of a point along an axis is
    its range to a beacon far behind on that axis, and that factor exists, in C++. The range differs from the
    coordinate by y^2 / 2D: a micrometre for a residual of 1 m across at 20 m (D = `BEACON`), and its rounding is
    nanometres. The usual conversion to bearing and range is biased instead: 0.4 m of path on Victoria Park, where
    that is more than a sigma. A robust kernel acts on each axis by itself.
    """
    factors: list[Factor] = []
    for i in range(2):
        bx, by = -BEACON * float(axes[0, i]), -BEACON * float(axes[1, i])
        model = with_loss(noise.Isotropic.Sigma(1, math.sqrt(variance[i])), loss)
        distance = math.hypot(float(point[0]) - bx, float(point[1]) - by)
        factors.append(gtsam.RangeFactorWithTransform2D(pose, landmark, distance, model, gtsam.Pose2(bx, by, 0.0)))
    return factors


def sight_landmarks(
    sensor: Sensor, z: Array, R: Array, frame: IntArray, number: IntArray, loss: str = "gaussian"
) -> list[Sighted]:
    """SLAM: observations z (m, 2), R (m, 2, 2) of landmarks `number` (m,) from frames (m,)."""
    variance, axes = _checked(R, frame)
    result = []
    if sensor.kind == RANGE_BEARING:
        for f, n, h, root in zip(frame.tolist(), number.tolist(), *bearing_range(sensor, z, R), strict=True):
            model = with_loss(noise.Gaussian.SqrtInformation(root), loss)
            result.append(Sighted(f, n, L(n), [gtsam.BearingRangeFactor2D(X(f), L(n), gtsam.Rot2(h[0]), h[1], model)]))
        return result
    points, turn = in_body_frame(sensor, z)
    for f, n, p, v, a in zip(frame.tolist(), number.tolist(), points, variance, turn @ axes, strict=True):
        result.append(Sighted(f, n, L(n), coordinate_factors(X(f), L(n), p, v, a, loss)))
    return result


def sight_known(
    sensor: Sensor,
    z: Array,
    R: Array,
    frame: IntArray,
    number: IntArray,
    xy: Array,
    first_row: int,
    loss: str = "gaussian",
) -> list[Sighted]:
    """Localization: observations z (m, 2), R (m, 2, 2) from frames (m,) of known landmarks at xy (m, 2).

    A relative point has a factor of its own. Range and bearing need a landmark variable, held where the map has it: a
    fresh copy for each observation (L(first_row), ...), so that the graph stays a chain. One variable per landmark
    would tie the whole past together: ten times slower in iSAM2, five times in gtsam's Marginals, the same numbers.
    """
    _checked(R, frame)
    result = []
    if sensor.kind == RANGE_BEARING:
        for i, (f, h, root) in enumerate(zip(frame.tolist(), *bearing_range(sensor, z, R), strict=True)):
            key = L(first_row + i)
            model = with_loss(noise.Gaussian.SqrtInformation(root), loss)
            factor = gtsam.BearingRangeFactor2D(X(f), key, gtsam.Rot2(h[0]), h[1], model)
            result.append(Sighted(f, int(number[i]), key, [factor], gtsam.PriorFactorPoint2(key, xy[i], _HELD), xy[i]))
        return result
    points, turn = in_body_frame(sensor, z)
    roots = root_information(turn @ R @ turn.transpose(0, 2, 1))
    for i, (f, p, root) in enumerate(zip(frame.tolist(), points, roots, strict=True)):
        model = with_loss(noise.Gaussian.SqrtInformation(root), loss)
        result.append(Sighted(f, int(number[i]), None, [gtsam.KnownLandmarkFactorPose2(X(f), xy[i], p, model)]))
    return result


def graph_of(factors: Iterable[Factor]) -> gtsam.NonlinearFactorGraph:
    """A factor graph of these factors, in this order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
