"""What a careful person would ask the author of a log before working with it: units, frames, numbers of things.

A question is a notice: its code says what it is about, its values are the numbers that it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data.inputs import Inputs
from data.log import Log
from data.motion.velocity import carried
from data.notice import Code, Notice, notice
from data.se2 import Array, BoolArray, compose, wrap_angle
from data.sensors import RELATIVE_POINT, RangeBearing
from data.timeline import MAX_GAP

SPARSE = 0.5
"""Share of frames with a true pose below which the scores are about a sample of the run. The least in the recordings
this was tried on is 0.92 (a camera system that was switched off before the robot)."""
FEW = 50
"""Fewer labelled readings say nothing about how often a landmark is seen."""


def truth_rate(log: Log) -> list[Notice]:
    """True poses in a small part of the frames."""
    pose = log.truth.pose
    if pose is None or len(pose) < 2:
        return []
    known = log.truth.known_poses
    if known >= SPARSE * len(pose):
        return []
    return [notice(Code.TRUTH_RATE, known=known, frames=len(pose), gap=MAX_GAP)]


def labels(log: Log) -> list[Notice]:
    """Labels that number the readings instead of the landmarks."""
    label = log.granted
    if label is None:
        return []
    named = label[label >= 0]
    distinct = len(np.unique(named))
    if len(named) < FEW or 2 * distinct <= len(named):
        return []
    return [notice(Code.LABELS, readings=len(named), landmarks=distinct)]


TURN = 2.0 * np.pi
FASTEST = TURN
"""rad/s. A revolution a second; the fastest second of all recordings and worlds this was tried on turns 1.7 rad."""
SHARE = 0.01
"""Of the seconds in which it turns, how many must be that fast: a single slip or jump asks nothing."""
RATIO = (180.0 / np.pi) ** 0.5
"""Half-way (in logarithms) between two headings in one unit and one of them in degrees."""
TURNING = 0.05
"""rad/s. Root mean square below which a ratio of turn rates is one of noises."""
SLOW_FRAMES, FAST_FRAMES = 5.0, 1e-4
"""s. Frames are at most 1 s apart by the rules of the format; 10 Hz in ms gives 100 s, ms taken for ns 1e-7 s."""


def bearings(log: Log) -> list[Notice]:
    """Bearings beyond one half turn."""
    sensor, z = log.recorded.sensor, log.recorded.observations.z
    if not isinstance(sensor, RangeBearing) or len(z) == 0:
        return []
    beyond = np.abs(z[:, 1]) > np.pi * (1.0 + 1e-6)
    if not beyond.any():
        return []
    low, high = float(z[:, 1].min()), float(z[:, 1].max())
    one_turn = max(abs(low), abs(high)) <= TURN * (1.0 + 1e-6)
    count = int(beyond.sum())
    return [notice(Code.BEARING_UNIT, beyond=count, readings=len(z), low=low, high=high, one_turn=one_turn)]


def turn_rates(log: Log) -> list[Notice]:
    """Odometry or truth that turns faster than a robot does, or one of them many times faster than the other."""
    inputs, pose = log.recorded, log.truth.pose
    if len(inputs) < 2:
        return []
    odometry = _per_second(inputs.time, inputs.increments.mean[1:, 2])
    truth = None if pose is None else _per_second(inputs.time, _changes(pose[:, 2]))
    found = []
    for of, rate in (("odometry", odometry), ("truth", truth)):
        if rate is not None and (np.abs(rate) > FASTEST).sum() > max(2.0, SHARE * np.count_nonzero(rate)):
            fast, largest = int((np.abs(rate) > FASTEST).sum()), float(np.abs(rate).max())
            found.append(notice(Code.TURN_RATE, of=of, fast=fast, seconds=len(rate), largest=largest))
    if found or truth is None:
        return found
    one, two = (float(np.sqrt(np.mean(rate**2))) for rate in (odometry, truth))
    if min(one, two) > 0.0 and max(one, two) > TURNING and max(one / two, two / one) > RATIO:
        found.append(notice(Code.TURN_RATES, odometry=one, truth=two))
    return found


def _changes(heading: Array) -> Array:
    """Changes of heading from frame to frame as they are written, without the jumps by 2 pi; 0 where one is unknown."""
    change = np.nan_to_num(np.diff(heading))
    change[np.abs(np.abs(change) - TURN) < 1.0] = 0.0
    return change


def _per_second(time: Array, turn: Array) -> Array:
    """Rates [rad/s] over the stretches of at least 1 s (or 1 step) that frames make up, which end together."""
    second = np.floor(time - time[0])
    edges = np.unique(np.concatenate([[0], 1 + np.flatnonzero(second[1:] > second[:-1]), [len(time) - 1]]))
    total = np.concatenate([[0.0], np.cumsum(turn)])
    rate: Array = np.diff(total[edges]) / np.maximum(np.diff(time[edges]), 1.0)
    return rate


def stamps(log: Log) -> list[Notice]:
    """Frames so far apart, or so close together, that the stamps are not seconds."""
    inputs = log.recorded
    if inputs.time_is_index or len(inputs) < 3:
        return []
    gap = float(np.median(np.diff(inputs.time)))
    span = float(inputs.time[-1] - inputs.time[0])
    if gap > SLOW_FRAMES:
        unit = next(name for name, limit in (("ms", 1e4), ("us", 1e7), ("ns", np.inf)) if gap < limit)
        return [notice(Code.TIME_UNIT, gap=gap, span=span, unit=unit, blind=None)]
    if gap < FAST_FRAMES:
        return [notice(Code.TIME_UNIT, gap=gap, span=span, unit="", blind=None)]
    blind = _blind(log)
    return [notice(Code.TIME_UNIT, gap=gap, span=span, unit="ms", blind=blind)] if blind > 0.5 else []


def _blind(log: Log) -> float:
    """Share of increments that bridge a gap in the odometry: no motion, and doubt that is the same along and across."""
    increments = log.recorded.increments
    mean, P = increments.mean[1:], increments.covariance[1:]
    still = ~mean.any(axis=1)
    return float((still & (P[:, 0, 0] == P[:, 1, 1]) & (P[:, 0, 0] > 1e-6)).mean())


BEYOND = 0.01
"""Share of readings past the stated field of view by more than `MARGIN`; noise at its edge gives 3e-5."""
MARGIN = 4.0
"""Standard deviations of a reading."""
FIRST = 50
"""Readings at the start of a log that are looked at: before the odometry has gone astray."""
FEWEST = 5
"""Fewer readings say nothing."""
GATE = 18.42
"""chi-square of 2 at 0.9999."""
EXPLAINED = 0.2
"""Share of the first readings that a prior in the map's frame explains at least; measured: see the tests."""
SLACK, SLACK_HEADING = 1.0, 0.2
"""m, rad: how far prior and first true pose may differ besides five standard deviations of the prior."""


def reach(log: Log) -> list[Notice]:
    """Readings past the sensor's stated range or angles."""
    inputs = log.recorded
    sensor, o = inputs.sensor, inputs.observations
    if len(o.z) < FEWEST:
        return []
    polar = sensor.polar(o.z)
    sigma = np.sqrt(np.trace(o.R, axis1=1, axis2=2)) if sensor.kind == RELATIVE_POINT else np.sqrt(o.R[:, 0, 0])
    found = []
    past = polar[:, 0] > sensor.max_range + MARGIN * sigma
    if past.mean() > BEYOND:
        stated, farthest = sensor.max_range, float(polar[:, 0].max())
        beyond = int(past.sum())
        found.append(notice(Code.MAX_RANGE, past=beyond, readings=len(past), stated=stated, farthest=farthest))
    middle, half = 0.5 * (sensor.min_angle + sensor.max_angle), 0.5 * (sensor.max_angle - sensor.min_angle)
    cartesian = sensor.kind == RELATIVE_POINT
    sigma = sigma / np.maximum(polar[:, 0], 1e-6) if cartesian else np.sqrt(o.R[:, 1, 1])
    aside = np.abs(wrap_angle(polar[:, 1] - middle)) > half + MARGIN * sigma
    if aside.mean() > BEYOND:
        low, high = sensor.min_angle, sensor.max_angle
        found.append(notice(Code.FIELD_OF_VIEW, aside=int(aside.sum()), readings=len(aside), low=low, high=high))
    return found


def prior(log: Log) -> list[Notice]:
    """A prior from which the first readings hit no landmark of the map."""
    inputs = log.recorded
    if inputs.map is None or len(inputs.map.id) == 0:
        return []
    hit = explained(inputs)
    if len(hit) < FEWEST or hit.mean() >= EXPLAINED:
        return []
    first = None if log.truth.pose is None else log.truth.pose[0]
    return [
        notice(
            Code.PRIOR,
            mean=tuple(inputs.prior.mean.tolist()),
            fitting=int(hit.sum()),
            readings=len(hit),
            x=(float(inputs.map.xy[:, 0].min()), float(inputs.map.xy[:, 0].max())),
            y=(float(inputs.map.xy[:, 1].min()), float(inputs.map.xy[:, 1].max())),
            walls=not inputs.sensor.sees_points,
            truth=None if first is None or not np.isfinite(first).all() else tuple(first.tolist()),
        )
    ]


def explained(inputs: Inputs) -> BoolArray:
    """Whether each of the first readings (m,) lies in some landmark's gate, from the prior by dead reckoning; bool."""
    assert inputs.map is not None
    hits: list[bool] = []
    pose, P = np.array(inputs.prior.mean), np.array(inputs.prior.covariance)
    for k in range(len(inputs)):
        if k:
            step = inputs.increment(k)
            _, _, F, B = carried(pose[2], step.mean)
            P = F @ P @ F.T + B @ step.covariance @ B.T
            pose = compose(pose, step.mean)
        seen = inputs.frame_observations(k)
        if len(seen.z) == 0:
            continue
        z_hat, Hx, _ = inputs.sensor.linearize(pose, inputs.map.xy)
        S = (Hx @ P @ Hx.transpose(0, 2, 1))[None] + seen.R[:, None]
        nu = inputs.sensor.residual(seen.z[:, None], z_hat[None])
        d2 = np.einsum("mli,mli->ml", nu, np.linalg.solve(S, nu[..., None])[..., 0])
        hits += (d2.min(axis=1) < GATE).tolist()
        if len(hits) >= FIRST:
            break
    return np.array(hits[:FIRST], bool)


def truth_start(log: Log) -> list[Notice]:
    """A first true pose that the prior excludes: truth in a frame of its own, so that every error is the shift."""
    pose, inputs = log.truth.pose, log.recorded
    if pose is None or not np.isfinite(pose[0]).all():
        return []
    away = pose[0] - inputs.prior.mean
    sigma = np.sqrt(np.diag(inputs.prior.covariance))
    distance, turned = float(np.hypot(*away[:2])), abs(float(wrap_angle(away[2])))
    if distance <= SLACK + 5.0 * sigma[:2].max() and turned <= SLACK_HEADING + 5.0 * sigma[2]:
        return []
    return [notice(Code.TRUTH_FRAME, distance=distance, turned=turned, sigma=tuple(sigma.tolist()))]


def labels_against_map(log: Log) -> list[Notice]:
    """Labels and a map whose numbers have nothing to do with each other."""
    label, known = log.granted, log.recorded.map
    if label is None or known is None or not (label >= 0).any():
        return []
    named = label[label >= 0]
    strange = ~np.isin(named, known.id)
    if strange.mean() <= 0.5:
        return []
    labels, ids = (int(named.min()), int(named.max())), (int(known.id.min()), int(known.id.max()))
    return [notice(Code.LABEL_NAMES, strange=int(strange.sum()), readings=len(named), labels=labels, ids=ids)]


CHECKS: tuple[Callable[[Log], list[Notice]], ...] = (
    stamps,
    bearings,
    turn_rates,
    reach,
    prior,
    labels_against_map,
    truth_start,
    truth_rate,
    labels,
)


def ask(log: Log) -> tuple[Notice, ...]:
    """What a careful person would ask before working with this log; nothing where it looks as it should."""
    return tuple(question.about(log=log.name) for check in CHECKS for question in check(log))
