"""Plausibility checks without truth: runs with physically impossible values are marked.

Checked are mean innovations (ten times the stated sigma), the path (farther than the robot can have driven), landmarks
(out of the sensor's reach) and covariances (larger than the world). A run that is merely wrong passes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from data import se2
from data.inputs import Inputs, LabelledObservations
from data.notice import Code, Notice, Value, notice
from data.result import DISCARD, Failure, Run
from data.se2 import Array
from ekf.whole_run import run_filter
from eval.referee.lost import ABSURD
from eval.referee.residuals import used_by
from graph.optimum import SUSPECT

IMPLAUSIBLE = "implausible"  # the status word
SIGMAS = 3.0  # sigmas that are added to the length of every increment
MARGIN = 2.0
"""Factor of the distance driven, the sensor's range, and dead reckoning's sigma. Arena, circle, corridor, park and
linear world use at most 0.44, 1.0 and 0.23 of them; a scale that is wrong by half stays within."""
WILD = 10.0  # sigmas of an observation that are added to the range
LEFT_OUT = 0.1  # Suspicious share of labelled observations that a gate discarded; misread ones give 0.0012


def judged(runs: Sequence[Run], inputs: Inputs) -> list[Run]:
    """The runs on these inputs, marked if implausible, with suspicions in their notes."""
    tested = (with_plausibility(r, inputs) for r in runs)
    return [replace(r, notes=(*r.notes, *suspicions(r, inputs))) for r in tested]


def suspicions(run: Run, inputs: Inputs) -> Iterator[Notice]:
    """Notices of unlikely values."""
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
    """The run as replayed, marked if it is implausible; `inputs` may have a map in SLAM."""
    found = implausibility(run, inputs)
    return run if found is None else replace(run, implausible=found)


def implausibility(run: Run, inputs: Inputs) -> Failure | None:
    """The first impossible value of a run; None without one, for failed runs and for dead reckoning."""
    if run.failure is not None or run.association == "none":
        return None
    if run.task == "slam":
        inputs = inputs.without_map()
    reach = _reach(inputs)
    found = [*_innovations(run, inputs), *_path(run, inputs, reach)]
    found += [*_landmarks(run, inputs, reach), *_covariances(run, inputs, reach)]
    return min(found, key=lambda f: f.frame, default=None)


def _innovations(run: Run, inputs: Inputs) -> Iterator[Failure]:
    """Innovations or a least-squares cost that no noise explains."""
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
    """First frame whose odometry or observations are 10 sigma from the last path and map, else that of the worst."""
    path = run.trajectory(run.phases[-1]).pose
    worst = np.zeros(len(inputs))
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    off[:, 2] = se2.wrap_angle(off[:, 2])
    worst[1:] = _squared(off, inputs.increments.covariance[1:]) / 3.0
    used = used_by(run, inputs)
    rows = np.flatnonzero(used.number >= 0)
    if len(rows):
        o, xy = inputs.observations, used.landmarks[used.number[rows]]
        sensor = inputs.sensor_of(rows)
        nu = sensor.residual(o.z[rows], sensor.predict(path[o.frame[rows]], xy))
        np.maximum.at(worst, o.frame[rows], _squared(nu, o.R[rows]) / 2.0)
    wild = worst > ABSURD
    return int(np.argmax(wild)) if wild.any() else int(np.argmax(worst))


def _squared(off: Array, covariance: Array) -> Array:
    """Squared distances (n,) under covariances that may be singular; infinite for misfits that are not finite."""
    size, axes = np.linalg.eigh(covariance)
    along = np.einsum("nji,nj->ni", axes, np.nan_to_num(off))
    known = size > 0.0
    squared: Array = np.sum(np.where(known, along**2 / np.where(known, size, 1.0), 0.0), axis=1)
    return np.where(np.isfinite(off).all(axis=1), squared, np.inf)


def _reach(inputs: Inputs) -> Array:
    """Largest distance (N,) [m] of the robot from its prior position by each frame."""
    step = np.hypot(inputs.increments.mean[:, 0], inputs.increments.mean[:, 1])
    reach = np.cumsum(step + SIGMAS * _longest(inputs.increments.covariance))
    reach += SIGMAS * float(_longest(inputs.prior.covariance[None])[0])
    if inputs.map is not None and len(inputs.map.id):  # a kidnapped robot may be anywhere in its map
        corner = 1.0 if inputs.sensor.sees_points else math.sqrt(2.0)
        reach += corner * float(inputs.sensor.distances(inputs.map.xy, inputs.prior.mean).max())
    return reach


def _longest(covariance: Array) -> Array:
    """Largest standard deviation (n,) of x and y over all directions; covariances (n, d, d)."""
    xx, yy, xy = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
    return np.sqrt(np.maximum(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy), 0.0))


def farthest_observed(inputs: Inputs) -> float:
    """Largest distance [m] of an observed landmark: the sensor's range, or the longest observed one, with a margin."""
    if inputs.several_or_partial and not inputs.measured()[:, 0].all():
        return math.inf  # bearings have no end
    longest = float(inputs.sensor_of().polar(inputs.observations.z)[:, 0].max(initial=0.0))
    most = max(s.max_range for s in inputs.sensors or (inputs.sensor,))
    sigma = math.sqrt(float(inputs.observations.R[:, 0, 0].max(initial=0.0)))
    return MARGIN * max(longest, most if math.isfinite(most) else 0.0) + WILD * sigma


def _path(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Poses farther from the start than the distance driven and the range of an observation."""
    for phase in run.phases:
        away = np.hypot(*(run.trajectory(phase).pose[:, :2] - inputs.prior.mean[:2]).T)
        beyond = away > MARGIN * reach + farthest_observed(inputs)
        if beyond.any():
            k = int(np.argmax(beyond))
            yield _failure(k, Code.PATH_TOO_FAR, phase=phase, away=float(away[k]), driven=float(reach[k]))


def _landmarks(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Landmarks that are too far from the start, or from all poses of a smoother that observed them."""
    m = run.map
    if inputs.map is not None or m is None or not len(m):
        return
    seen, first = farthest_observed(inputs), np.maximum(m.first_frame, 0)
    away = inputs.sensor.distances(m.xy, inputs.prior.mean)
    beyond = ~(away <= MARGIN * reach[-1] + seen)
    if beyond.any():
        k = int(first[beyond].min())
        many, farthest = int(beyond.sum()), float(away[beyond].max())
        yield _failure(k, Code.LANDMARKS_TOO_FAR, landmarks=many, away=farthest, driven=float(reach[-1]))
    if run.final is None:
        return
    slot = used_by(run, inputs).number
    rows = np.flatnonzero(slot >= 0)
    slot, pose = slot[rows], run.final.pose[inputs.observations.frame[rows]]
    nearest = np.full(len(m), np.inf)
    np.minimum.at(nearest, slot, inputs.sensor.distances(m.xy[slot], pose))
    unseen = np.isfinite(nearest) & (nearest > seen)
    if unseen.any():
        k = int(first[unseen].min())
        many, farthest = int(unseen.sum()), float(nearest[unseen].max())
        yield _failure(k, Code.LANDMARKS_UNSEEN, landmarks=many, away=farthest)


def _covariances(run: Run, inputs: Inputs, reach: Array) -> Iterator[Failure]:
    """Standard deviations larger than the world and than those of dead reckoning."""
    largest = MARGIN * (float(reach[-1]) + farthest_observed(inputs))
    sigmas = {f"{phase} position": _longest(run.trajectory(phase).covariance) for phase in run.phases}
    if run.map is not None and inputs.map is None and inputs.sensor.sees_points:
        sigmas["landmark"] = _longest(run.map.covariance)
    for name, sigma in sigmas.items():
        if not (sigma > largest).any():
            continue
        reckoned = run_filter(inputs, np.full(len(inputs.observations.frame), DISCARD, np.int64))
        largest = max(largest, MARGIN * float(_longest(reckoned.covariance).max()))
        beyond = sigma > largest
        if beyond.any():
            k = int(np.argmax(beyond))
            frame = max(int(run.map.first_frame[k]), 0) if name == "landmark" and run.map is not None else k
            claimed, driven = float(sigma[k]), float(reach[-1])
            yield _failure(frame, Code.COVARIANCE_TOO_LARGE, of=name, sigma=claimed, driven=driven)


def _failure(frame: int, code: Code, **values: Value) -> Failure:
    return Failure(IMPLAUSIBLE, frame, notice(code, None, **values))
