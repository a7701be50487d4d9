"""Batch smoothing: all poses and landmarks of a log from all its data, for given decisions."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from data.errors import UsageError
from data.inputs import Inputs, IntArray, LandmarkMap
from data.motion.systematic import sensor_frame
from data.se2 import Array, BoolArray, between, pose_error
from graph.factors import LOSSES, ObservationFactors, between_factors, known_landmark_factors, landmark_factors
from graph.optimum import Smoothed, optimize
from graph.pose_factors import PoseFactor, closure_factors, fix_factors
from graph.problem import Problem, landmark_priors, refuse
from graph.systematic import Calibrated, refuse_pose_measurements
from graph.walls import line_factors


class Start(NamedTuple):
    """Initial estimate."""

    pose: Array  # (N, 3)
    landmark: Array  # (L, 2) points or walls, row = landmark number, or that of an uncertain map
    errors: Array | None = None  # (N, p) systematic errors by frame, where some are estimated; None: zero


class Rejected(NamedTuple):
    """Fixes (F,) and closures (K,) that take no part; None: all do."""

    fixes: BoolArray | None = None
    closures: BoolArray | None = None


NONE_REJECTED = Rejected()


def smooth(
    inputs: Inputs,
    decisions: IntArray,
    created: IntArray,
    start: Start,
    *,
    loss: str = "gaussian",
    rejected: Rejected = NONE_REJECTED,
    with_shares: bool = False,
) -> Smoothed:
    """Maximum a posteriori path (and map): a minimum reached from `start`.

    Inputs with a map: localization, decisions (M,) are map ids or `DISCARD`; landmarks of an uncertain map are
    estimated. Without: SLAM, decisions are landmark
    numbers, `NEW` or `DISCARD`, and `created` (M,) is the number of the landmark an observation initialized (-1: none).
    `loss`: gaussian, huber or cauchy, on measurements only; fixes and closures are such. `with_shares`: see `optimize`.
    Raises `UnderConstrained` (`NotConvergedError` if no minimum was reached), and DataError for a singular covariance.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    problem = build(inputs, decisions, created, loss, rejected)
    found = optimize(problem, start_values(problem, start), loss=loss, with_shares=with_shares)
    cut = None if loss != "cauchy" else _far_closures(inputs, found.trajectory.pose, rejected.closures)
    if cut is None:
        return found
    problem = build(inputs, decisions, created, loss, rejected._replace(closures=cut))
    places = start.landmark
    if found.map is not None:
        places = start.landmark.copy()
        places[found.map.number if inputs.map is None else _rows_of(inputs.map, found.map.number)] = found.map.xy
    end = Start(found.trajectory.pose, places, None if found.systematic is None else found.systematic.mean)
    again = optimize(problem, start_values(problem, end), loss=loss, with_shares=with_shares)
    done = again.closures
    if done is None:
        return again
    # no gate rejected them: it is the loss that gives them no weight
    gated = np.zeros(len(done.used), bool) if rejected.closures is None else rejected.closures
    return replace(again, closures=done._replace(used=done.used | (cut & ~gated)))


CUT = 30.0
"""sigma. At Cauchy's optimum a closure further off is left out. There it has a pull of 3 % of a sigma, but two hundred
false ones add up: in grids of corridors with as many false loop closures as true ones they changed the path's error by
up to a third, cut by less than 2 %. Cut at 10, true ones were lost, too."""


def _far_closures(inputs: Inputs, pose: Array, rejected: BoolArray | None) -> BoolArray | None:
    """Closures (K,) that take no part, with those beyond `CUT` at poses (N, 3); None: there are none of these."""
    c = inputs.closures
    if c is None:
        return None
    off = pose_error(between(pose[c.frame1], pose[c.frame2]), c.relative)
    far = np.einsum("ki,ki->k", off, np.linalg.solve(c.covariance, off[:, :, None])[:, :, 0]) > CUT**2
    far = far if rejected is None else far & ~rejected
    return None if not far.any() else far if rejected is None else far | rejected


def landmark_starts(known: LandmarkMap | None) -> Array:
    """Start (L, 2) of the landmarks of an uncertain map, by row; none without one."""
    return known.xy.copy() if known is not None and known.sigma is not None else np.zeros((0, 2))


def start_values(problem: Problem, start: Start) -> gtsam.Values:
    """The initial estimate as gtsam values; raises ValueError if a variable has none, or none that is finite."""
    at = dict(zip(problem.numbers.tolist(), problem.rows.tolist(), strict=True))
    missing = [n for n, r in at.items() if r >= len(start.landmark) or not np.isfinite(start.landmark[r]).all()]
    if missing or start.pose.shape != (len(problem.motion) + 1, 3) or not np.isfinite(start.pose).all():
        what = f"no position for landmark {missing[0]}" if missing else "not a finite pose for every frame"
        raise ValueError(f"start: {what}")
    return problem.values(start.pose, {n: start.landmark[r] for n, r in at.items()}, start.errors)


def build(
    inputs: Inputs,
    decisions: IntArray,
    created: IntArray,
    loss: str = "gaussian",
    rejected: Rejected = NONE_REJECTED,
) -> Problem:
    """The factors of a log under given decisions."""
    calibrated, sensor = None, inputs.sensor
    refuse(inputs.systematic, inputs.map, sensor)
    exact = inputs.map is not None and inputs.map.sigma is None
    of_poses = _of_poses(inputs, loss, rejected)
    if inputs.systematic is None:
        motion, _ = between_factors(1, inputs.increments.mean[1:], inputs.increments.covariance[1:])
    else:
        frame = sensor_frame(inputs.systematic, inputs.sensor, inputs.prior)
        calibrated, sensor = Calibrated(inputs.systematic, frame, inputs.increments), frame.sensor(inputs.sensor)
        if of_poses:
            refuse_pose_measurements(frame)
        motion = calibrated.motion()
    number = np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    o = inputs.observations
    at = None if inputs.map is None else inputs.map.xy[_rows_of(inputs.map, number[used])]
    priors = landmark_priors(inputs.map, np.unique(number[used]))
    if o.sensor is not None:
        several = _of_several(inputs, used, number, loss)
        return Problem(inputs.prior, motion, several, exact, None, None, of_poses, priors)
    seen = (sensor, o.z[used], o.R[used], o.frame[used], number[used])
    if not sensor.sees_points:
        about = inputs.prior.mean[:2]
        factors = line_factors(*seen, about, loss, at)
        return Problem(inputs.prior, motion, factors, at is not None, calibrated, about, of_poses)
    factors = known_landmark_factors(*seen, at, 0, loss) if exact and at is not None else landmark_factors(*seen, loss)
    return Problem(inputs.prior, motion, factors, exact, calibrated, None, of_poses, priors)


def _of_poses(inputs: Inputs, loss: str, rejected: Rejected) -> list[PoseFactor]:
    """Fixes and closures as factors."""
    found = list[PoseFactor]()
    if (f := inputs.fixes) is not None:
        found += _without(fix_factors(f.frame.tolist(), f, f.sources, loss), rejected.fixes)
    if (c := inputs.closures) is not None:
        found += _without(closure_factors(c, loss), rejected.closures)
    return found


def _without(factors: list[PoseFactor], rejected: BoolArray | None) -> list[PoseFactor]:
    if rejected is None:
        return factors
    return [p.left_out() if out else p for p, out in zip(factors, rejected.tolist(), strict=True)]


def _of_several(inputs: Inputs, used: IntArray, number: IntArray, loss: str) -> list[ObservationFactors]:
    """The observations `used` (m,) of a log with several sensors, of landmarks `number` (M,), by ascending frame.

    Raises UsageError where systematic errors are to be estimated, or a sensor observes walls.
    """
    o, found = inputs.observations, list[ObservationFactors]()
    assert o.sensor is not None
    if inputs.systematic is not None or not all(s.sees_points for s in inputs.sensors):
        raise UsageError("a log with several sensors: they must observe points, without systematic errors to estimate")
    for i, sensor in enumerate(inputs.sensors):
        rows = used[o.sensor[used] == i]
        seen = (sensor, o.z[rows], o.R[rows], o.frame[rows], number[rows])
        if inputs.map is None or inputs.map.sigma is not None:
            found += landmark_factors(*seen, loss)
        else:
            at = inputs.map.xy[_rows_of(inputs.map, number[rows])]
            found += known_landmark_factors(*seen, at, len(found), loss)
    return sorted(found, key=lambda s: s.frame)


def _rows_of(known: LandmarkMap, ids: IntArray) -> IntArray:
    """Row of the map for each id; raises UsageError for one the map does not have."""
    rows = known.rows(ids)
    bad = np.flatnonzero(rows < 0)
    if len(bad):
        raise UsageError(f"decision {ids[bad[0]]}: the map has no landmark of this id")
    return rows
