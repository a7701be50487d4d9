"""Where a landmark is that was only observed by bearings or ranges, each from another pose: delayed initialization.

The observations of a landmark wait until they determine its place well enough to linearize there (Bailey, "Constrained
initialisation for bearing-only SLAM", ICRA 2003). All is relative to the newest pose: an error that all poses share
moves the landmark with them, and does not affect the linearization.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from data.blocks import block_diagonal
from data.pose_measurements import expected_closure
from data.se2 import Array, BoolArray, compose, wrap_angle
from data.sensors import MIN_RANGE, EachSensor, Sensor

SECOND_ORDER = 0.25
"""Largest second-order term of an observation, for a place off by its largest standard deviation, in standard
deviations of the innovation: half the squared sigma over the range, or over its square for a bearing. With twice as
much, ranges begin some landmarks at the wrong end of an arc (docs/notes/several-sensors.md)."""
STEPS = 30  # of Gauss-Newton
RIVAL = 2.0 * np.log(1000.0)
"""Least difference of squared distances to another solution, such as the mirrored one of ranges: odds of 1000."""
GATE = 0.999  # chi-square probability of the observations at the place found


class Place(NamedTuple):
    """A landmark in the world (2,), and in the frame of the newest pose its covariance (2, 2) and squared distance."""

    xy: Array
    covariance: Array
    squared: float


def triangulate(sensors: Sequence[Sensor], pose: Array, covariance: Array, z: Array, R: Array) -> Place | None:
    """The place that observations z (m, 2), R (m, 2, 2) from poses (m, 3), the newest last, of `covariance` (3m, 3m),
    world frame, agree on; None: not determined well enough yet, or they contradict each other.
    """
    m, dof = len(z), sum(len(s.measures) for s in sensors) - 2
    if dof < 1:
        return None
    each = EachSensor(tuple(sensors), np.arange(m))
    relative, P = _relative(pose, covariance)
    found = [p for start in _starts(each, relative, z) if (p := _search(each, relative, P, z, R, start)) is not None]
    if not found:
        return None
    found.sort(key=lambda p: p.squared)
    best = found[0]
    if best.squared > gate_threshold(GATE, dof) or _second_order(each, relative, P, R, best) > SECOND_ORDER:
        return None
    for other in found[1:]:
        apart = other.xy - best.xy
        far = apart @ np.linalg.solve(best.covariance + other.covariance, apart) > gate_threshold(GATE)
        if far and other.squared - best.squared < RIVAL:
            return None
    return best._replace(xy=compose(pose[-1], np.array([*best.xy, 0.0]))[:2])


def _second_order(each: EachSensor, pose: Array, P: Array, R: Array, place: Place) -> float:
    """Largest second-order term of the observations, in standard deviations of their innovations (`SECOND_ORDER`)."""
    m = len(pose)
    _, Hx, _ = each.linearize(pose, np.repeat(place.xy[None], m, axis=0))
    own = P.reshape(m, 3, m, 3)[np.arange(m), :, np.arange(m), :]
    sigma = np.sqrt(np.einsum("mii->mi", Hx @ own @ Hx.transpose(0, 2, 1) + R))
    r = np.maximum(np.hypot(*(pose[:, :2] - place.xy).T), MIN_RANGE)
    term = 0.5 * np.linalg.eigvalsh(place.covariance)[-1] / np.stack([r, r**2], 1)
    return float((term / sigma)[np.array([[q in s.measures for q in (0, 1)] for s in each.sensors])].max())


def _relative(pose: Array, covariance: Array) -> tuple[Array, Array]:
    """Poses (m, 3) in the frame of the last one, and their covariance (3m, 3m)."""
    m = len(pose)
    found, J = np.empty((m, 3)), np.zeros((3 * m, 3 * m))
    for i in range(m):
        found[i], to_last, to_own = expected_closure(pose[-1], pose[i])
        rows = slice(3 * i, 3 * i + 3)
        J[rows, rows] += to_own
        J[rows, -3:] += to_last
    return found, J @ covariance @ J.T


def _starts(each: EachSensor, pose: Array, z: Array) -> list[Array]:
    """Places that two of the observations have in common, for the two that are farthest apart, and for all bearings."""
    m = len(z)
    starts: list[Array] = []
    own = [s.inverse(pose[i], np.array([[0.0, 0.0]]))[0][0] for i, s in enumerate(each.sensors)]  # of the sensors
    centre = np.array(own)
    ranges = [i for i in range(m) if 0 in each.sensors[i].measures]
    if len(ranges) >= 2:
        i, j = max(itertools.combinations(ranges, 2), key=lambda p: float(np.hypot(*(centre[p[0]] - centre[p[1]]))))
        starts += _circles(centre[i], z[i, 0], centre[j], z[j, 0])
    bearings = [i for i in range(m) if 1 in each.sensors[i].measures]
    if len(bearings) >= 2:
        angle = np.array([z[i, 1] - each.sensors[i].rotation + pose[i, 2] for i in bearings])
        normal = np.stack([-np.sin(angle), np.cos(angle)], 1)
        A = normal.T @ normal
        if np.linalg.eigvalsh(A)[0] > 1e-6:
            starts.append(np.linalg.solve(A, normal.T @ np.einsum("mi,mi->m", normal, centre[bearings])))
    if len(ranges) == 1 and bearings:
        i, b = ranges[0], bearings[-1]
        angle_b = float(z[b, 1] - each.sensors[b].rotation + pose[b, 2])
        starts.append(centre[b] + z[i, 0] * np.array([np.cos(angle_b), np.sin(angle_b)]))
    return starts


def _circles(a: Array, ra: float, b: Array, rb: float) -> list[Array]:
    """Where two circles meet, or where they come nearest to it."""
    apart = b - a
    d = float(np.hypot(*apart))
    if d < 1e-9:
        return []
    along = (d * d + ra * ra - rb * rb) / (2.0 * d)
    aside = np.sqrt(max(ra * ra - along * along, (0.1 * min(ra, rb)) ** 2))
    u = apart / d
    foot, across = a + along * u, np.array([-u[1], u[0]])
    return [foot + aside * across, foot - aside * across]


def _search(each: EachSensor, pose: Array, P: Array, z: Array, R: Array, start: Array) -> Place | None:
    """Gauss-Newton from a start, each innovation weighted with the noise and the uncertainty of the poses."""
    m, xy = len(z), start.astype(float)
    step = np.full(2, np.inf)
    for _ in range(STEPS):
        z_hat, Hx, Hl = each.linearize(pose, np.repeat(xy[None], m, axis=0))
        H = block_diagonal(Hx)
        S = H @ P @ H.T + block_diagonal(R)
        try:
            L = np.linalg.cholesky(0.5 * (S + S.T))
        except np.linalg.LinAlgError:
            return None
        nu = np.linalg.solve(L, each.residual(z, z_hat).ravel())
        J = np.linalg.solve(L, Hl.reshape(-1, 2))
        information = J.T @ J
        if np.linalg.cond(information) > 1e12:
            return None
        if np.abs(step).max() < 1e-9 * (1.0 + np.abs(xy).max()):
            break
        step = np.linalg.solve(information, J.T @ nu)
        reach = float(np.hypot(*(pose[:, :2] - xy).T).max())
        size = float(np.hypot(*step))
        xy = xy + step * min(1.0, 0.5 * reach / size if size > 0.0 else 1.0)
    else:
        return None
    return Place(xy, np.linalg.inv(information), float(nu @ nu))


AROUND, TRIED, REACH = 300, 5, (0.03, 30.0)  # places tried for each of so many measurements; on a ray in path's sizes


class Sights(NamedTuple):
    """Ranges and bearings of a landmark."""

    centre: Array  # (m, d) from where
    z: Array  # (m,) what; bearings in the world's axes
    ray: BoolArray  # (m,) whether it is a bearing
    root: Array  # (m,) of the information


def misfit(s: Sights, place: Array) -> Array:
    """Sum of the residuals' sizes (K,), in sigmas, of places (K, d)."""
    apart = place[:, None] - s.centre
    off = np.where(s.ray, np.arctan2(apart[..., 1], apart[..., 0]), np.linalg.norm(apart, axis=2)) - s.z
    return np.asarray(np.abs(np.where(s.ray, wrap_angle(off), off) * s.root).sum(1))


def met(s: Sights) -> Array:
    """The place of least misfit, of those at the range of some poses or along their rays."""
    way = np.random.default_rng(0).normal(size=(AROUND, s.centre.shape[1]))
    way /= np.linalg.norm(way, axis=1)[:, None]
    along, place = np.geomspace(*REACH, AROUND) * (np.ptp(s.centre, axis=0).max() or 1.0), list[Array]()
    for m in np.unique(np.linspace(0, len(s.z) - 1, TRIED).astype(int)).tolist():
        place.extend(s.centre[m] + (np.outer(along, [np.cos(s.z[m]), np.sin(s.z[m])]) if s.ray[m] else s.z[m] * way))
    return place[np.argmin(misfit(s, np.array(place)))]
