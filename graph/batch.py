"""Batch smoothing: all poses and landmarks of a log from all its data, for given decisions."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.errors import UsageError
from data.inputs import Inputs, IntArray, LandmarkMap
from data.se2 import Array, BoolArray, between, pose_error
from graph.factors import LOSSES, ObservationFactors, known_landmark_factors, landmark_factors
from graph.optimum import STEP, Smoothed, optimize
from graph.pose_factors import PoseFactor, closure_factors, fix_factors
from graph.problem import Problem, Start, landmark_priors, refuse
from graph.systematic import errors_of
from graph.walls import line_factors


class Rejected(NamedTuple):
    """Fixes (F,) and closures (K,) that take no part; None: all do."""

    fixes: BoolArray | None = None
    closures: BoolArray | None = None


NONE_REJECTED = Rejected()


def smooth(
    inputs: Inputs, decisions: IntArray, created: IntArray, start: Start, *, loss: str = "gaussian",
    rejected: Rejected = NONE_REJECTED, with_shares: bool = False, enough: float = STEP,
) -> Smoothed:  # fmt: skip
    """Maximum a posteriori path (and map): a minimum reached from `start`.

    Inputs with a map: localization, decisions (M,) are map ids or `DISCARD`; landmarks of an uncertain map are
    estimated. Without: SLAM, decisions are landmark numbers, `NEW` or `DISCARD`, and `created` (M,) is the number of
    the landmark an observation initialized (-1: none). `loss`: gaussian, huber or cauchy, on measurements only; fixes
    and closures are such. `with_shares`, `enough`: see `optimize`. Raises `UnderConstrained` (`NotConvergedError` if no
    minimum was reached), and DataError for a singular covariance.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    problem = build(inputs, decisions, created, loss, rejected)
    found = optimize(problem, problem.values(start), loss=loss, with_shares=with_shares, enough=enough)
    cut = None if loss != "cauchy" else _far_closures(inputs, found.trajectory.pose, rejected.closures)
    if cut is None:
        return found
    problem = build(inputs, decisions, created, loss, rejected._replace(closures=cut))
    end = end_of(found, start.landmark, inputs.map)
    again = optimize(problem, problem.values(end), loss=loss, with_shares=with_shares, enough=enough)
    done = again.closures
    if done is None:
        return again
    # no gate rejected them: it is the loss that gives them no weight
    gated = np.zeros(len(done.used), bool) if rejected.closures is None else rejected.closures
    return replace(again, closures=done._replace(used=done.used | (cut & ~gated)))


def end_of(found: Smoothed, others: Array, known: LandmarkMap | None) -> Start:
    """A solution as a start; landmarks that are not in it as in `others` (L, 2), so that they may return."""
    places = others.copy()
    if found.map is not None:
        places[found.map.number if known is None else known.rows(found.map.number)] = found.map.xy
    return Start(found.trajectory.pose, places, None if found.systematic is None else found.systematic.mean)


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


def build(
    inputs: Inputs, decisions: IntArray, created: IntArray, loss: str = "gaussian", rejected: Rejected = NONE_REJECTED
) -> Problem:
    """The factors of a log under given decisions."""
    refuse(inputs.systematic, inputs.map, inputs.sensor)
    errors, of_poses = errors_of(inputs.systematic, inputs.sensor, inputs.prior), _of_poses(inputs, loss, rejected)
    if of_poses:
        errors.refuse_pose_measurements()
    motion = errors.along(inputs.increments)
    number = np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    o, walls = inputs.observations, not inputs.sensor.sees_points
    sensors = [errors.frame.sensor(inputs.sensor)] if o.sensor is None else [*inputs.sensors]
    if len(sensors) > 1 and (motion.names or not all(s.sees_points for s in sensors)):
        raise UsageError("a log with several sensors: they must observe points, without systematic errors to estimate")
    exact, about = inputs.map is not None and inputs.map.sigma is None, inputs.prior.mean[:2]
    found = list[ObservationFactors]()
    for i, sensor in enumerate(sensors):
        rows = used if o.sensor is None else used[o.sensor[used] == i]
        seen = (sensor, o.z[rows], o.R[rows], o.frame[rows], number[rows])
        at = None if inputs.map is None else inputs.map.xy[_rows_of(inputs.map, number[rows])]
        if walls:
            found += line_factors(*seen, about, loss, at)
        elif at is not None and exact:
            found += known_landmark_factors(*seen, at, len(found), loss)
        else:
            found += landmark_factors(*seen, loss)
    found.sort(key=lambda s: s.frame)
    priors = landmark_priors(inputs.map, np.unique(number[used]))
    return Problem(inputs.prior, motion, found, exact, about if walls else None, of_poses, priors)


def _of_poses(inputs: Inputs, loss: str, rejected: Rejected) -> list[PoseFactor]:
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


def _rows_of(known: LandmarkMap, ids: IntArray) -> IntArray:
    """Row of the map for each id; raises UsageError for one the map does not have."""
    rows = known.rows(ids)
    bad = np.flatnonzero(rows < 0)
    if len(bad):
        raise UsageError(f"decision {ids[bad[0]]}: the map has no landmark of this id")
    return rows
