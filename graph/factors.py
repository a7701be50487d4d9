"""Inputs as gtsam factors: prior, increments, observations of landmarks.

Conventions that differ: gtsam's pose covariances are in the body frame of the pose (ours: world frame); noise of a
relative pose is at its end (ours: in the frame it starts from); bearing comes before range (ours: after), both in the
body frame. Keys: X(frame) for poses, L(number) for landmarks; in localization L(row of the observation).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.compiled import njit
from data.errors import DataError, SlamrefError
from data.inputs import IntArray, Prior
from data.se2 import Array, BoolArray, covariances_in_body, world_from_body
from data.sensors import RANGE_BEARING, RELATIVE_POINT, Sensor

NEAR = 3.0
"""Sigmas of a range below which an observation is taken as a point, see `is_point`. In parks with trees on the path,
searches got stuck with 1 and none with 2."""
UNMEASURED = 10.0  # multiples of the range, and m; a range sigma above both marks a bearing-only observation


def bearing_range(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """[bearing, range] (m, 2) in the body frame, gtsam's order, with covariances (m, 2, 2). A rotated sensor only
    shifts the bearing; one off the robot's centre is converted through the point, to first order.
    """
    if sensor.translation == (0.0, 0.0) or not sensor.locates:
        turn = sensor.rotation if sensor.translation == (0.0, 0.0) else 0.0
        return np.stack([z[:, 1] - turn, z[:, 0]], 1), R[:, ::-1, ::-1]
    p, _, G = sensor.inverse(np.zeros(3), z)
    r = np.hypot(p[:, 0], p[:, 1])
    A = np.stack([np.stack([-p[:, 1], p[:, 0]], 1) / r[:, None] ** 2, p / r[:, None]], 1) @ G
    return np.stack([np.arctan2(p[:, 1], p[:, 0]), r], 1), A @ R @ A.transpose(0, 2, 1)


def relative_point(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """Point (m, 2) in the body frame with covariances (m, 2, 2): exact for a sensor of points. Of ranges and bearings
    to first order in their noise, the bearing's at the expected squared range.
    """
    if sensor.kind == RELATIVE_POINT and sensor.rotation == 0.0 and sensor.translation == (0.0, 0.0):
        return z, R
    points, C = sensor.body_points(z, R)
    if sensor.kind == RANGE_BEARING:
        b = z[:, 1] + sensor.rotation
        across = np.stack([-np.sin(b), np.cos(b)], 1)
        C = C + (R[:, 0, 0] * R[:, 1, 1])[:, None, None] * across[:, :, None] * across[:, None, :]
    return points, C


def is_point(sensor: Sensor, z: Array, R: Array) -> BoolArray:
    """Which observations z (m, 2), R (m, 2, 2) become relative points: all of a sensor of points, and the nearest. A
    landmark that may coincide with the robot has a singular bearing, where a smoother could get stuck or diverge.
    """
    if sensor.kind != RANGE_BEARING:
        return np.full(len(z), sensor.locates)
    sigma = np.sqrt(R[:, 0, 0])
    return np.asarray((z[:, 0] < NEAR * sigma) & (sigma < UNMEASURED * np.maximum(z[:, 0], 1.0)))


noise = gtsam.noiseModel
Factor = gtsam.NonlinearFactor

EXACT = 1e-6
"""m, rad. Least sigma of the prior in a direction; all three smaller: the pose is held exactly. gtsam has no exact
noise in an arbitrary direction."""
BEACON = 1e7  # m. Distance of the beacons that represent the coordinates of a relative point; see `coordinate_factors`
SINGULAR = 1e-13  # m^2, rad^2. Variance of an increment below which its information matrix is not computed
HUBER, CAUCHY = 1.345, 1.0  # sigmas at which the losses bend: 95 % efficient on Gaussian noise, and the usual value
KERNELS = {"huber": noise.mEstimator.Huber.Create(HUBER), "cauchy": noise.mEstimator.Cauchy.Create(CAUCHY)}
LOSSES = ("gaussian", *KERNELS)
_HELD = noise.Constrained.All(2)


class UnderConstrained(SlamrefError):  # noqa: N818 - a condition of the problem, named as surveyors name it
    """The data do not determine the variable named in the message."""


def name_of(key: int) -> str:
    """`pose of frame 12` or `landmark 3`."""
    index = gtsam.symbolIndex(key)
    return f"pose of frame {index}" if gtsam.symbolChr(key) == ord("x") else f"landmark {index}"


@dataclass(frozen=True)
class ObservationFactors:
    """One observation as factors."""

    frame: int  # of the observation
    number: int  # landmark number (localization: the map's id)
    key: int | None  # the landmark's variable; None where the factor needs none
    measured: list[Factor]  # the factors of the measurement, two residuals in all; zero where nothing is measured
    pin: Factor | None = None  # holds a known landmark at its position in the map; None in SLAM
    xy: Array | None = None  # position of a known landmark; None in SLAM
    dims: int = 2  # numbers measured

    @property
    def factors(self) -> list[Factor]:
        """All factors."""
        return self.measured if self.pin is None else [*self.measured, self.pin]

    @property
    def own_variables(self) -> list[int]:
        """Variables of this observation alone: the copy of a known landmark."""
        return [] if self.key is None or self.xy is None else [self.key]

    @property
    def start_values(self) -> list[tuple[int, Array | gtsam.Pose2]]:
        """Start values of its own variables."""
        return [] if self.key is None or self.xy is None else [(self.key, self.xy)]

    def renumbered(self, number: int, *, opposite: bool = False) -> ObservationFactors:
        """The same observation (SLAM) of another landmark; `opposite` is for walls alone."""
        keys = [X(self.frame), L(number)]
        return replace(self, number=number, key=L(number), measured=[f.rekey(keys) for f in self.measured])


def pose2(pose: Array) -> gtsam.Pose2:
    """A pose (3,) as gtsam's."""
    return gtsam.Pose2(*pose.tolist())


def pose_array(pose: gtsam.Pose2) -> Array:
    """A pose of gtsam as (3,)."""
    return np.array([pose.x(), pose.y(), pose.theta()])


def root_information(covariance: Array) -> tuple[Array, Array]:
    """Upper triangular R (n, d, d) with R'R = C^-1 for C (n, d, d), and the smallest pivot (n,) of each C.

    A pivot is the variance of one coordinate given those after it; R is undefined where one is not positive. gtsam's
    own `Gaussian.Covariance` inverts C, which is inaccurate for nearly singular C (a rank-one prior of sigma 0.17,
    floored at 1e-6, came out as 0.002).
    """
    covariance = np.array(covariance, float, order="C")
    R, pivot = np.zeros(covariance.shape), np.full(len(covariance), np.inf)
    _roots(covariance, R, pivot)
    return R, pivot


@njit
def _roots(covariance: Array, R: Array, pivot: Array) -> None:
    """`root_information` of (n, d, d) into R (n, d, d), zero before, and pivot (n,), infinite before."""
    d = covariance.shape[1]
    for i in range(len(covariance)):
        U = np.zeros((d, d))  # C = U U'
        for c in range(d - 1, -1, -1):
            left = covariance[i, c, c]
            for q in range(c + 1, d):
                left -= U[c, q] * U[c, q]
            if not left >= pivot[i]:
                pivot[i] = left
            if not left > 0.0:
                break
            U[c, c] = np.sqrt(left)
            for r in range(c - 1, -1, -1):
                left = covariance[i, r, c]
                for q in range(c + 1, d):
                    left -= U[r, q] * U[c, q]
                U[r, c] = left / U[c, c]
        if not pivot[i] > 0.0:
            R[i] = np.nan
            continue
        for c in range(d):
            R[i, c, c] = 1.0 / U[c, c]
            for r in range(c - 1, -1, -1):
                total = 0.0
                for q in range(d):
                    total += U[r, q] * R[i, q, c]
                R[i, r, c] = -total / U[r, r]


def invertible_roots(covariance: Array, name: Callable[[int], str], remedy: str) -> tuple[Array, float]:
    """`root_information` (n, d, d), and the smallest pivot. DataError with `name` of a singular row and `remedy`."""
    roots, pivot = root_information(covariance)
    least = float(pivot.min(initial=np.inf))
    if not least > SINGULAR:
        bad = np.flatnonzero(~(pivot > SINGULAR))
        what = f"its covariance is singular (variance {pivot[bad[0]]:.3g} in some direction)"
        raise DataError(f"{name(int(bad[0]))}: {what}; a smoother needs {remedy}")
    return roots, least


def increment_roots(first_frame: int, covariance: Array) -> tuple[Array, float]:
    """`invertible_roots` of increments (n, 3, 3) into the frames from `first_frame` on."""
    remedy = "a covariance_floor of 1e-10 or so"
    return invertible_roots(covariance, lambda i: f"increment into frame {first_frame + i}", remedy)


def observation_roots(covariance: Array, R: Array, frame: IntArray) -> Array:
    """`root_information` (m, d, d) from R (m, 2, 2) of frames (m,). DataError: one is not positive definite."""
    roots, pivot = root_information(covariance)
    if not pivot.min(initial=np.inf) > 0.0:
        i = np.flatnonzero(~(pivot > 0.0))[0]
        raise DataError(f"frame {frame[i]}: measurement covariance {R[i].tolist()} is not positive definite")
    return np.asarray(roots, float)


def is_exact(prior: Prior) -> bool:
    """Whether the first pose is known exactly in every direction: a hard constraint in the graph."""
    return bool(np.linalg.eigvalsh(prior.covariance)[-1] < EXACT**2)


def prior_factor(prior: Prior) -> Factor:
    """Prior on the pose of frame 0; zero and singular covariances are allowed (see `EXACT`)."""
    B = world_from_body(prior.mean[2])
    body = B.T @ prior.covariance @ B
    variance, axes = np.linalg.eigh(body)
    model: gtsam.noiseModel.Base
    if is_exact(prior):
        model = noise.Constrained.All(3)
    else:
        if variance[0] < EXACT**2:
            body = axes @ np.diag(np.maximum(variance, EXACT**2)) @ axes.T
        model = noise.Gaussian.SqrtInformation(root_information(body[None])[0][0])
    return gtsam.PriorFactorPose2(X(0), pose2(prior.mean), model)


def between_factors(first_frame: int, mean: Array, covariance: Array) -> tuple[list[gtsam.BetweenFactorPose2], float]:
    """Motions (n, 3) with covariances (n, 3, 3) into the frames from `first_frame` on, and their smallest pivot;
    errors, additive in the previous body frame, are turned to the end pose for gtsam. DataError: a singular covariance.
    """
    roots, pivot = increment_roots(first_frame, covariances_in_body(mean[:, 2], covariance))
    frame = np.arange(first_frame, first_frame + len(mean))
    return factors_between(frame - 1, frame, mean, roots), pivot


def relative_factors(
    key1: IntArray, key2: IntArray, relative: Array, covariance: Array, name: Callable[[int], str],
    loss: str = "gaussian",
) -> tuple[list[gtsam.BetweenFactorPose2], float, Array]:  # fmt: skip
    """As `between_factors`, of any two poses, and the roots (n, 3, 3) at the ends. `name` of each for the DataError."""
    roots, pivot = invertible_roots(covariances_in_body(relative[:, 2], covariance), name, "its inverse")
    return factors_between(key1, key2, relative, roots, loss), pivot, roots


def factors_between(
    key1: IntArray, key2: IntArray, relative: Array, roots: Array, loss: str = "gaussian"
) -> list[gtsam.BetweenFactorPose2]:
    """Relative poses (n, 3) of poses key2 (n,) in the frames of key1 (n,), with the roots of their information."""
    return [
        gtsam.BetweenFactorPose2(X(a), X(b), gtsam.Pose2(*m), with_loss(noise.Gaussian.SqrtInformation(R), loss))
        for a, b, m, R in zip(key1.tolist(), key2.tolist(), relative.tolist(), roots, strict=True)
    ]


def with_loss(model: gtsam.noiseModel.Base, loss: str) -> gtsam.noiseModel.Base:
    """The noise model under a robust kernel: Huber, Cauchy, or none."""
    return model if loss == "gaussian" else noise.Robust.Create(KERNELS[loss], model)


def measured(sensor: Sensor, z: Array, R: Array, frame: IntArray) -> tuple[BoolArray, Array, Array]:
    """Which are points (m,), bearing and range or the point (m, 2), body frame; roots (m, 2, 2) of the information."""
    point = is_point(sensor, z, R)
    if point.all() or not point.any():
        h, C = (relative_point if point.any() else bearing_range)(sensor, z, R)
    else:
        h, C = np.empty((len(z), 2)), np.empty((len(z), 2, 2))
        for which, convert in ((point, relative_point), (~point, bearing_range)):
            h[which], C[which] = convert(sensor, z[which], R[which])
    roots = observation_roots(C, R, frame)
    for q in {0, 1} - set(sensor.measures):
        roots[:, 1 - q] = 0.0
    return point, h, roots


def coordinate_factors(pose: int, landmark: int, point: Array, root: Array, loss: str) -> list[Factor]:
    """A relative point (2,) as two independent scalars, one for each row of its root information (2, 2).

    gtsam's Python API has no Pose2-Point2 factor for a relative point. But a coordinate along an axis is the range to a
    beacon far behind on that axis, and that factor exists in C++. The range differs from the coordinate by y^2 / 2D: a
    micrometre for a residual of 1 m across at 20 m (D = `BEACON`), and its rounding is nanometres. A conversion to
    bearing and range is biased by 0.4 m of path on Victoria Park, more than a sigma. A robust kernel acts on each
    scalar.
    """
    factors: list[Factor] = []
    px, py = point.tolist()
    for rx, ry in root.tolist():
        weight = math.hypot(rx, ry)
        bx, by = -BEACON * rx / weight, -BEACON * ry / weight
        model = with_loss(noise.Isotropic.Sigma(1, 1.0 / weight), loss)
        distance = math.hypot(px - bx, py - by)
        factors.append(gtsam.RangeFactorWithTransform2D(pose, landmark, distance, model, gtsam.Pose2(bx, by, 0.0)))
    return factors


def bearing_range_factor(sensor: Sensor, pose: int, landmark: int, h: Array, model: gtsam.noiseModel.Base) -> Factor:
    """A factor of h = [bearing, range] (2,). Of a sensor off the robot's centre that measures only one of them, h is in
    the sensor's own frame; gtsam has no such factor of a bearing, so this one is evaluated in Python.
    """
    if sensor.locates or sensor.translation == (0.0, 0.0):
        return gtsam.BearingRangeFactor2D(pose, landmark, gtsam.Rot2(h[0]), h[1], model)
    z = h[::-1]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        at = pose_array(values.atPose2(pose))
        z_hat, Hx, Hl = (each[0] for each in sensor.linearize(at, values.atPoint2(landmark)[None]))
        if jacobians is not None:
            jacobians[0] = np.asfortranarray((Hx @ world_from_body(float(at[2])))[::-1])
            jacobians[1] = np.asfortranarray(Hl[::-1])
        return np.asarray(-sensor.residual(z, z_hat)[::-1])

    return gtsam.CustomFactor(model, [pose, landmark], error)


def landmark_factors(
    sensor: Sensor, z: Array, R: Array, frame: IntArray, number: IntArray, loss: str = "gaussian"
) -> list[ObservationFactors]:
    """SLAM: observations z (m, 2), R (m, 2, 2) of landmarks `number` (m,) from frames (m,)."""
    result, dims = [], len(sensor.measures)
    models = dict[bytes, gtsam.noiseModel.Base]()  # shared by observations of one covariance
    for f, n, point, h, root in zip(frame.tolist(), number.tolist(), *measured(sensor, z, R, frame), strict=True):
        pose, landmark = X(f), L(n)
        if point:
            factors = coordinate_factors(pose, landmark, h, root, loss)
        else:
            alike = root.tobytes()
            if alike not in models:
                models[alike] = with_loss(noise.Gaussian.SqrtInformation(root), loss)
            factors = [bearing_range_factor(sensor, pose, landmark, h, models[alike])]
        result.append(ObservationFactors(f, n, landmark, factors, dims=dims))
    return result


def known_landmark_factors(
    sensor: Sensor, z: Array, R: Array, frame: IntArray, number: IntArray, xy: Array, first_row: int,
    loss: str = "gaussian",
) -> list[ObservationFactors]:  # fmt: skip
    """Localization: observations z (m, 2), R (m, 2, 2) from frames (m,) of known landmarks at xy (m, 2).

    A relative point has a factor of its own. Range and bearing need a landmark variable, held at its position in the
    map. A copy for each observation (L(first_row), ...) keeps the graph a chain; shared variables would be ten times
    slower in iSAM2 and five times in gtsam's Marginals.
    """
    result = []
    seen = zip(frame.tolist(), number.tolist(), *measured(sensor, z, R, frame), xy, strict=True)
    for row, (f, n, point, h, root, at) in enumerate(seen, first_row):
        model = with_loss(noise.Gaussian.SqrtInformation(root), loss)
        if point:
            result.append(ObservationFactors(f, n, None, [gtsam.KnownLandmarkFactorPose2(X(f), at, h, model)], xy=at))
        else:
            factor = bearing_range_factor(sensor, X(f), L(row), h, model)
            pin, dims = gtsam.PriorFactorPoint2(L(row), at, _HELD), len(sensor.measures)
            result.append(ObservationFactors(f, n, L(row), [factor], pin, at, dims))
    return result


def graph_of(factors: Iterable[Factor]) -> gtsam.NonlinearFactorGraph:
    """A factor graph of these factors, in this order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
