"""Can it be so at all? A run with a number that no honest run gives is marked, without a look at the truth.

Asked are only questions that nobody needs a statistical test for: innovations ten times as large as claimed on the
average, a path longer than the robot can have driven, landmarks where the sensor cannot have seen them, and a doubt
larger than the whole world. Being wrong is none of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from data import se2
from data.inputs import Inputs, IntArray, LabelledObservations
from data.notice import Code, Notice, Severity, Value, notice
from data.result import DISCARD, Failure, Run, Trajectory
from data.se2 import Array
from ekf.whole_run import run_filter
from graph.optimum import SUSPECT

IMPLAUSIBLE = "implausible"
"""The status word."""
ABSURD = 100.0
"""NIS per degree of freedom: innovations of 10 sigma on the average. Sigmas stated at half give 4, and the worst run
that knows where it is has 2.6 (the corridor without odometry); lost ones have 400 and more."""
SIGMAS = 3.0
"""Each increment may be so many of its sigmas longer than it says, all of them at once: the robot got no farther."""
MARGIN = 2.0
"""Of the way driven, of the sensor's range, and of the doubt of dead reckoning. Arena, circle, corridor with and
without odometry, park and linear world use at most 0.44, 1.0 and 0.23 of them, with labels and without; a wheel that
slips or a scale that is wrong by half stays within."""
WILD = 10.0
"""Sigmas of a reading's own noise that a landmark may stand beyond the range, besides."""


LEFT_OUT = 0.1
"""Share of the labelled readings that a gate left out, likewise: of recordings with misread labels at most 0.0012."""


def judged(runs: Sequence[Run], inputs: Inputs) -> list[Run]:
    """The runs on these inputs, each with its doubt if there is one, and with what may be doubted in its notes."""
    tested = [with_plausibility(r, inputs) for r in runs]
    return [replace(r, notes=(*r.notes, *suspicions(r, inputs))) for r in tested]


def suspicions(run: Run, inputs: Inputs) -> Iterator[Notice]:
    """Numbers that an honest run can give, and hardly does."""
    if run.failure is not None:
        return
    total, o = run.total_nis, inputs.observations
    if run.final is not None and total is not None and total[0] > SUSPECT * total[1] > 0:
        yield notice(Code.COST, per_dof=total[0] / total[1])
    if run.association == "known" and isinstance(o, LabelledObservations):
        named = o.label >= 0
        share = float(np.mean(run.final_decisions[named] == DISCARD)) if named.any() else 0.0
        if share > LEFT_OUT:
            yield notice(Code.LABELS_LEFT_OUT, share=share)


def with_plausibility(run: Run, inputs: Inputs) -> Run:
    """The run, marked if an honest run gives no such number; `inputs` as it had them, in SLAM perhaps with a map."""
    found = doubt(run, inputs)
    return run if found is None else replace(run, implausible=found)


def doubt(run: Run, inputs: Inputs) -> Failure | None:
    """What is impossible about a run, and from which frame on: the first such frame; None if nothing is.

    A run that failed has no numbers to doubt, and dead reckoning is what others are compared with.
    """
    if run.failure is not None or run.association == "none":
        return None
    if run.task == "slam":
        inputs = inputs.without_map()
    found = list(_innovations(run, inputs))
    reach = _reach(inputs)
    found += _path(run, inputs, reach)
    found += _landmarks(run, inputs, reach)
    found += _covariances(run, inputs, reach)
    return min(found, key=lambda f: f.frame, default=None)


def _innovations(run: Run, inputs: Inputs) -> Iterator[Failure]:
    """Innovations of a front end, or the least cost of a smoother, that no noise explains."""
    if run.innovations is not None:
        nis, dof = run.innovations.nis, run.innovations.dof
        formed = np.isfinite(nis) & (dof > 0)
        share = float(nis[formed].sum()) / max(int(dof[formed].sum()), 1)
        if share > ABSURD:
            first = int(np.argmax(formed & (nis > ABSURD * np.maximum(dof, 1))))
            yield _failure(first, Code.NIS, per_dof=share, over_run=True)
            return
    total = run.total_nis
    if total is not None and total[1] > 0 and total[0] / total[1] > ABSURD:
        yield _failure(first_misfit(run, inputs), Code.NIS, per_dof=total[0] / total[1], over_run=False)


def first_misfit(run: Run, inputs: Inputs) -> int:
    """First frame in which prior, odometry or readings are more than 10 sigma from the run's last path and map.

    Where none is, the frame of the worst misfit.
    """
    path = run.trajectory(run.phases[-1]).pose
    worst = np.zeros(len(inputs))
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    off[:, 2] = se2.wrap_angle(off[:, 2])
    worst[1:] = _squared(off, inputs.increments.covariance[1:]) / 3.0
    rows, xy = _sighted(run, inputs)
    if len(rows):
        o = inputs.observations
        nu = inputs.sensor.residual(o.z[rows], inputs.sensor.predict(path[o.frame[rows]], xy))
        np.maximum.at(worst, o.frame[rows], _squared(nu, o.R[rows]) / 2.0)
    wild = worst > ABSURD
    return int(np.argmax(wild)) if wild.any() else int(np.argmax(worst))


def _squared(off: Array, covariance: Array) -> Array:
    """Squared distances (n,) under covariances that may be singular, infinite where a misfit is not finite."""
    size, axes = np.linalg.eigh(covariance)
    along = np.einsum("nji,nj->ni", axes, np.nan_to_num(off))
    known = size > 0.0
    squared: Array = np.sum(np.where(known, along**2 / np.where(known, size, 1.0), 0.0), axis=1)
    return np.where(np.isfinite(off).all(axis=1), squared, np.inf)


def _sighted(run: Run, inputs: Inputs) -> tuple[IntArray, Array]:
    """Observations (m,) that show a landmark of the run's last map, by its last decisions, and where that is (m, 2)."""
    created = run.initialized
    number = np.where(created >= 0, created, run.final_decisions)
    if inputs.map is not None:
        identity, places = inputs.map.id, inputs.map.xy
    elif run.map is not None:
        identity, places = run.map.number, run.map.xy
    else:
        return np.empty(0, np.int64), np.empty((0, 2))
    order = np.argsort(identity)
    rows = np.flatnonzero(np.isin(number, identity)).astype(np.int64)
    return rows, places[order[np.searchsorted(identity, number[rows], sorter=order)]]


def _reach(inputs: Inputs) -> Array:
    """How far (N,) the robot can be by each frame from where the prior says that it was [m]."""
    step = np.hypot(inputs.increments.mean[:, 0], inputs.increments.mean[:, 1])
    way = np.cumsum(step + SIGMAS * _longest(inputs.increments.covariance))
    way += SIGMAS * float(_longest(inputs.prior.covariance[None])[0])
    if inputs.map is not None and len(inputs.map.id):  # a robot that was moved is found again anywhere in its map
        corner = 1.0 if inputs.sensor.sees_points else math.sqrt(2.0)
        way += corner * float(_landmark_distance(inputs.map.xy, inputs).max())
    return way


def _longest(covariance: Array) -> Array:
    """Standard deviation (n,) along the least certain direction of the plane; covariances (n, d, d), x and y first."""
    xx, yy, xy = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
    return np.sqrt(np.maximum(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy), 0.0))


def _distance(xy: Array, inputs: Inputs) -> Array:
    """Distances (n,) from where the prior says that the robot was."""
    distance: Array = np.hypot(xy[:, 0] - inputs.prior.mean[0], xy[:, 1] - inputs.prior.mean[1])
    return distance


def _landmark_distance(landmarks: Array, inputs: Inputs) -> Array:
    """Distances (n,) of landmarks (n, 2), points or walls, from there."""
    if inputs.sensor.sees_points:
        return _distance(landmarks, inputs)
    return _from_walls(landmarks, inputs.prior.mean)


def _from_walls(walls: Array, pose: Array) -> Array:
    """Distances (n,) of walls (n, 2) from a pose (3,), or one for each (n, 3)."""
    rho, alpha = walls.T
    away: Array = np.abs(rho - np.cos(alpha) * pose[..., 0] - np.sin(alpha) * pose[..., 1])
    return away


def sight(inputs: Inputs) -> float:
    """How far [m] a landmark can be from the robot that sees it: the sensor's range, or the longest reading."""
    longest = float(inputs.sensor.polar(inputs.observations.z)[:, 0].max(initial=0.0))
    most = inputs.sensor.max_range
    sigma = math.sqrt(float(inputs.observations.R[:, 0, 0].max(initial=0.0)))
    return MARGIN * max(longest, most if math.isfinite(most) else 0.0) + WILD * sigma


def _path(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Poses farther from the start than was driven until then, and one may be wrong by what is seen from it besides."""
    for phase in run.phases:
        away = _distance(run.trajectory(phase).pose, inputs)
        beyond = away > MARGIN * reach + sight(inputs)
        if beyond.any():
            k = int(np.argmax(beyond))
            yield _failure(k, Code.PATH_TOO_FAR, phase=phase, away=float(away[k]), driven=float(reach[k]))


def _landmarks(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Landmarks beyond what the sensor can have seen: of a smoother from its own poses, else from the way driven.

    A filter's past poses stay as they were when later loops moved the map, so they tell nothing.
    """
    m = run.map
    if inputs.map is not None or m is None or not len(m):
        return
    seen, first = sight(inputs), np.maximum(m.first_frame, 0)
    away = _landmark_distance(m.xy, inputs)
    beyond = ~(away <= MARGIN * reach[-1] + seen)
    if beyond.any():
        k = int(first[beyond].min())
        many, farthest = int(beyond.sum()), float(away[beyond].max())
        yield _failure(k, Code.LANDMARKS_TOO_FAR, landmarks=many, away=farthest, driven=float(reach[-1]))
    if run.final is None:
        return
    rows, xy = _sighted(run, inputs)
    order = np.argsort(m.number)
    created = run.initialized
    number = np.where(created >= 0, created, run.final_decisions)[rows]
    slot = order[np.searchsorted(m.number, number, sorter=order)]
    nearest = np.full(len(m), np.inf)
    frame = inputs.observations.frame[rows]
    at = run.final.pose[frame]
    near = np.hypot(*(xy - at[:, :2]).T) if inputs.sensor.sees_points else _from_walls(xy, at)
    np.minimum.at(nearest, slot, near)
    unseen = np.isfinite(nearest) & (nearest > seen)
    if unseen.any():
        k = int(first[unseen].min())
        many, farthest = int(unseen.sum()), float(nearest[unseen].max())
        yield _failure(k, Code.LANDMARKS_UNSEEN, landmarks=many, away=farthest)


def _covariances(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Doubt larger than all of the world, and than dead reckoning's, which knows less than anybody else."""
    largest = MARGIN * (float(reach[-1]) + sight(inputs))
    sigmas = {f"{phase} position": _longest(run.trajectory(phase).covariance) for phase in run.phases}
    if run.map is not None and inputs.map is None and inputs.sensor.sees_points:
        sigmas["landmark"] = _longest(run.map.covariance)
    for name, sigma in sigmas.items():
        if not (sigma > largest).any():
            continue
        largest = max(largest, MARGIN * _dead_reckoned(inputs))
        beyond = sigma > largest
        if beyond.any():
            k = int(np.argmax(beyond))
            frame = max(int(run.map.first_frame[k]), 0) if name == "landmark" and run.map is not None else k
            claimed, driven = float(sigma[k]), float(reach[-1])
            yield _failure(frame, Code.COVARIANCE_TOO_LARGE, of=name, sigma=claimed, driven=driven)


def _dead_reckoned(inputs: Inputs) -> float:
    """The largest sigma [m] of prediction alone."""
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    alone = run_filter(inputs, nothing)
    return float(_longest(Trajectory(alone.pose, alone.covariance).covariance).max())


def _failure(frame: int, code: Code, **values: Value) -> Failure:
    return Failure(IMPLAUSIBLE, frame, notice(code, Severity.ERROR, None, **values))
