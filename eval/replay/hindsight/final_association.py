"""Final re-association: all observations of a log with known landmarks, from known poses.

Online decisions use the map and pose of their moment. After smoothing, the errors of path and map are small against the
noise of an observation.
"""

import math
from typing import NamedTuple

import numpy as np

from association.appearance import Evidence, Looks
from association.expectation import NOTHING, Expectation, gate_threshold
from association.methods import gnn
from association.truncated import of_places
from data.blocks import squared_norms
from data.compiled import njit
from data.inputs import IntArray, LandmarkMap, Observations
from data.result import CHI_SQUARE
from data.se2 import Array, BoolArray
from data.sensors import RANGE_BEARING, Sensor, measure, residual
from eval.replay.hindsight import constants

ANGLES = 16  # directions of a residual over which its tails are averaged


class Reassociation(NamedTuple):
    """Landmark (m,) of every observation, -1 for none; misfit (m,): squared distance from it, infinite for none, and
    the gate's is added inside another landmark's inner gate.
    """

    number: IntArray
    misfit: Array


def noise_share(sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> float:
    """Variance of observations (m) of the landmarks (m,), -1 for none, over the stated one; poses (N, 3).

    From a quantile of squared distances to often observed landmarks; the position of a landmark observed once follows
    from that observation. 1 without such landmarks, at least `LEAST_SCALE`.
    """
    times = np.bincount(number[number >= 0], minlength=1)
    often = (number >= 0) & (times[np.maximum(number, 0)] >= constants.REASSOCIATION_OBSERVATIONS)
    if not often.any():
        return 1.0
    d2 = distances(sensor, pose, known, seen, np.where(often, number, -1))
    share = float(np.quantile(d2, constants.REASSOCIATION_QUANTILE)) / gate_threshold(constants.REASSOCIATION_QUANTILE)
    return max(share, constants.LEAST_SCALE)


def nis_left(
    residual_share: Array, number: IntArray, dof: int, gate: float | None, right: Evidence = NOTHING
) -> tuple[float, float]:
    """Mean and variance per degree of freedom of a smoother's chi-square (`dof`) of what passed an online `gate` and
    the final one, by principal `residual_share` (m, 2) of `graph.optimum.Smoothed`; `right`: what appearance adds.

    The final gate g is that of the stated noise. Let x, chi-square with 2 dof, be what leaving an observation out takes
    from the cost, and l the principal shares of the noise in its residual. At an angle f its residual has the square x
    (l1 cos^2 f + l2 sin^2 f) if it is used, and x (cos^2 f / l1 + sin^2 f / l2) if it is not (Cook and Weisberg 1982,
    section 2.2). What was used stays, and what the online gate c refused returns, if this is below g. If innovations
    online and in the end are the same, the limit of x is c, but between these two. They are not quite, so a little less
    is left out.
    """
    times = np.bincount(number[number >= 0], minlength=1)
    angle = np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    axes, least = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2]), np.maximum(residual_share, constants.LEAST_SCALE)
    share, refused = least @ axes, (1.0 / least) @ axes
    if dof <= 0 or (times[number[number >= 0]] < constants.REASSOCIATION_OBSERVATIONS).all():
        return CHI_SQUARE
    final = of_places(constants.REASSOCIATION_GATE, 2, right=right)
    limit = np.clip(of_places(gate, 2, right=right), final / refused, final / share)
    out = np.exp(-0.5 * limit)
    inside = 1.0 - out.mean(axis=1)
    mean = (2.0 - ((limit + 2.0) * out).mean(axis=1)) / inside
    variance = (8.0 - ((limit**2 + 4.0 * limit + 8.0) * out).mean(axis=1)) / inside - mean**2
    checked = residual_share[:, 1] > constants.LEAST_SCALE  # what nothing else says leaves no residual
    return 1.0 - float((2.0 - mean)[checked].sum()) / dof, 2.0 - float((4.0 - variance)[checked].sum()) / dof


def distances(sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> Array:
    """Squared distances (r,) of those of observations (m) that have a landmark (m,), -1 for none; poses (N, 3)."""
    rows = np.flatnonzero(number >= 0)
    nu = sensor.residual(seen.z[rows], sensor.predict(pose[seen.frame[rows]], known.positions(number[rows])))
    return squared_norms(nu, seen.R[rows])


def reassociate(
    sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, looks: Looks | None = None, inner: float = 1.0
) -> Reassociation:
    """Global nearest neighbour in every frame, from exact poses (N, 3), for observations (m) ascending by frame.

    looks: what the landmarks look like, if the observations have an appearance; inner: share of the gate's squared
    distance inside which other landmarks make a pairing ambiguous.
    """
    begin = np.searchsorted(seen.frame, np.arange(len(pose) + 1))
    places = np.array(pose), np.array(known.xy), np.array(seen.frame), np.array(seen.z), np.array(seen.R)
    gate = gate_threshold(constants.REASSOCIATION_GATE)
    # landmarks as far as twice the sensor's range are compared
    limits = np.array([math.hypot(*sensor.translation) + 2.0 * sensor.max_range, gate, inner * gate])
    chosen, alone, clear = _nearest(sensor.kind, sensor.extrinsic, *places, limits)
    number = np.append(known.id, -1)[chosen]
    for k in np.unique(seen.frame if looks is not None else seen.frame[~clear[seen.frame]]).tolist():
        rows = slice(begin[k], begin[k + 1])
        near = np.flatnonzero(np.hypot(*(known.xy - pose[k, :2]).T) <= limits[0])
        exact, z_hat = np.zeros((2 * len(near),) * 2), sensor.predict(pose[k], known.xy[near])
        e = Expectation.from_arrays(seen.z[rows], z_hat, exact, seen.R[rows], sensor.residual, number=known.id[near])
        if looks is not None and seen.appearance is not None:
            e = e.with_appearance(looks.unlike(e.number, seen.appearance.only(rows)))
        threshold = e.threshold(constants.REASSOCIATION_GATE)
        number[rows] = gnn(e, constants.REASSOCIATION_GATE)
        alone[rows] = (e.individual_distances() < inner * threshold).sum(axis=1) <= 1
    misfit = np.where(number >= 0, np.where(alone, 0.0, gate), np.inf)
    misfit[number >= 0] += distances(sensor, pose, known, seen, number)
    return Reassociation(number, misfit)


@njit
def _nearest(
    kind: int, extrinsic: Array, pose: Array, xy: Array, frame: IntArray, z: Array, R: Array, limits: Array
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Nearest landmark of xy (n, 2) in each gate (m,), -1: none; whether it is alone there; frames without a choice."""
    m, n, (reach, gate, inner) = len(z), len(xy), limits
    chosen, alone, clear = np.full(m, -1), np.zeros(m, np.bool_), np.ones(len(pose), np.bool_)
    last, z_hat, Hx, Hl = np.full(n, -1), np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    for i in range(m):
        k, count, near = frame[i], 0, 0
        a, b, c = R[i, 0, 0], R[i, 0, 1], R[i, 1, 1]
        # a landmark within a gate is about as far from the robot as what was observed
        slack = math.hypot(extrinsic[1], extrinsic[2]) + 1.000001 * math.sqrt(max(gate, inner) * (a + c))
        r = z[i, 0] if kind == RANGE_BEARING else math.hypot(z[i, 0], z[i, 1])
        least, most = max(r - slack, 0.0) ** 2, min(r + slack, reach) ** 2
        for j in range(n):
            if not least <= (xy[j, 0] - pose[k, 0]) ** 2 + (xy[j, 1] - pose[k, 1]) ** 2 <= most:
                continue
            measure(kind, extrinsic, pose[k], xy[j, 0], xy[j, 1], z_hat, Hx, Hl)
            x, y = residual(kind, z[i, 0], z[i, 1], z_hat)
            d2 = x * x / a + (y - b / a * x) ** 2 / (c - b / a * b)
            near += d2 < inner
            if d2 < gate:
                clear[k] = clear[k] and count == 0 and last[j] != k
                count, chosen[i], last[j] = count + 1, j, k
        alone[i] = near <= 1
    return chosen, alone, clear


def beginnings(found: Reassociation) -> dict[int, int]:
    """The surest observation of each landmark, its first: an error there makes all right decisions wrong."""
    rows = np.lexsort((found.misfit, found.number))
    numbers, first = np.unique(found.number[rows], return_index=True)
    return {n: row for n, row in zip(numbers.tolist(), rows[first].tolist(), strict=True) if n >= 0}
