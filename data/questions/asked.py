"""Questions to the author of a log: units, frames, numbers of things.

A question is a notice with the numbers that raise it. Its value `flags` are the words of a command that mend it, of
`slamref convert table` unless the notice says otherwise.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from data.inputs import Inputs
from data.log import ODOMETRY_KIND, TRUTH_POSE, Log
from data.motion.velocity import compose_in_place
from data.notice import Code, Notice, notice
from data.questions.examination import contradictions
from data.questions.readings import as_pose, metres_of
from data.se2 import BoolArray, compose, inverse, wrap_angle
from data.sensors import RELATIVE_POINT
from data.timeline import MAX_GAP
from data.truth_windows import bad_truth, misplaced
from data.wing import of_all

SPARSE = 0.5  # Smallest share of frames with a true pose; recordings have at least 0.92
FEW = 50  # Least number of labelled observations for a question about labels


def truth_rate(log: Log) -> list[Notice]:
    """True poses in few frames."""
    pose, known = log.truth.pose, log.truth.known_poses
    if pose is None or len(pose) < 2 or known >= SPARSE * len(pose):
        return []
    return [notice(Code.TRUTH_RATE, known=known, frames=len(pose), gap=MAX_GAP)]


def labels(log: Log) -> list[Notice]:
    """Labels that number observations instead of landmarks."""
    label = log.granted
    named = np.empty(0, np.int64) if label is None else label[label >= 0]
    distinct = len(np.unique(named))
    if len(named) < FEW or 2 * distinct <= len(named):
        return []
    return [notice(Code.LABELS, readings=len(named), landmarks=distinct)]


CRAWL = 5e-3  # m/s and rad/s; a robot that drives 0.5 m/s by stamps in ms drives 5e-4 m/s
SLOW_FRAMES, FAST_FRAMES = 5.0, 1e-4  # s, extreme frame intervals; 10 Hz in ms gives 100 s, ms taken for ns 1e-7 s


def stamps(log: Log) -> list[Notice]:
    """Frame intervals that do not fit seconds."""
    inputs = log.recorded
    if inputs.time_is_index or len(inputs) < 3 or any(q.code == Code.STAMPS_BACK for q in log.asked):
        return []
    gap = float(np.median(np.diff(inputs.time)))
    span = float(inputs.time[-1] - inputs.time[0])
    gap = max(gap, span / len(inputs)) if gap < FAST_FRAMES else gap  # of messages that come in bursts
    unit, blind = "", None
    if gap > SLOW_FRAMES:
        unit = next(name for name, limit in (("ms", 1e4), ("us", 1e7), ("ns", np.inf)) if gap < limit)
    elif gap >= FAST_FRAMES and (inputs.scans is not None or log.source.get(ODOMETRY_KIND) == "none"):
        return []
    elif gap >= FAST_FRAMES:
        # of poses that are interpolated: the slowest of robots, hardly moving and hardly turning
        way = np.abs(inputs.increments.mean[1:])
        rate = way / np.diff(inputs.time)[:, None]
        crawls = (np.quantile(rate, 0.9, axis=0) < CRAWL).all() and way[:, :2].sum() > 1.0
        crawls &= (np.sum(rate * way, axis=0) <= CRAWL * np.sum(way, axis=0)).all()  # whatever pauses there are
        # increments across gaps of the odometry: no motion, and an isotropic covariance
        mean, P = inputs.increments.mean[1:], inputs.increments.covariance[1:]
        still = ~mean.any(axis=1) & (P[:, 0, 0] == P[:, 1, 1]) & (P[:, 0, 0] > 1e-6)
        seen = np.isin(np.arange(1, len(inputs)), inputs.observations.frame)  # not those within a single gap
        blind = float((still[seen] if seen.any() else still).mean())
        if blind <= 0.5 and not crawls:
            return []
        unit = "ms"
    flags = (f"--unit time={unit}",) if unit else ()
    return [notice(Code.TIME_UNIT, gap=gap, span=span, unit=unit, blind=blind, flags=flags)]


BEYOND = 0.01  # Largest share of observations outside the stated field of view by more than `MARGIN`; noise gives 3e-5
MARGIN = 4.0  # Standard deviations of an observation
FIRST = 50  # Number of first observations that are checked, before the odometry drifts
FEWEST = 5  # Least number of observations for a question
GATE = 18.42  # 0.9999 quantile of chi-square with 2 dof
EXPLAINED = 0.2  # Least share of the first observations that a prior in the map's frame explains
SLACK, SLACK_HEADING = 1.0, 0.2  # m, rad, beside five sigmas of the prior, of its distance from the true pose


def reach(log: Log) -> list[Notice]:
    """Observations outside the sensor's stated range or angles."""
    inputs = log.recorded
    sensor, o = inputs.sensor, inputs.observations
    if len(o.z) < FEWEST:
        return []
    polar = sensor.polar(o.z)
    sigma = np.sqrt(np.trace(o.R, axis1=1, axis2=2)) if sensor.kind == RELATIVE_POINT else np.sqrt(o.R[:, 0, 0])
    found = []
    past = polar[:, 0] > sensor.max_range + MARGIN * sigma
    if past.mean() > BEYOND:
        beyond, farthest = int(past.sum()), float(polar[:, 0].max())
        unit = 10.0 ** (math.floor(math.log10(farthest)) - 2)  # three digits, not less
        far = math.ceil(farthest / unit - 1e-9) * unit
        stated, flags = sensor.max_range, (f"--max-range {far:.12g}{metres_of(log)}",)
        about = notice(Code.MAX_RANGE, farthest=farthest, past=beyond, readings=len(past), stated=stated, flags=flags)
        found.append(about)
    middle, half = 0.5 * (sensor.min_angle + sensor.max_angle), 0.5 * (sensor.max_angle - sensor.min_angle)
    sigma = sigma / np.maximum(polar[:, 0], 1e-6) if sensor.kind == RELATIVE_POINT else np.sqrt(o.R[:, 1, 1])
    aside = np.abs(wrap_angle(polar[:, 1] - middle)) > half + MARGIN * sigma
    if aside.mean() > BEYOND:
        low, high = sensor.min_angle, sensor.max_angle
        off = np.degrees(np.append(wrap_angle(polar[:, 1] - middle), [-half, half]))
        ends = (math.floor(math.degrees(middle) + off.min()), math.ceil(math.degrees(middle) + off.max()))
        flags = (f"--view={ends[0]}deg,{ends[1]}deg",)
        outside = int(aside.sum())
        found.append(notice(Code.FIELD_OF_VIEW, aside=outside, readings=len(aside), low=low, high=high, flags=flags))
    return found


def prior(log: Log) -> list[Notice]:
    """A prior from which the first observations match no landmark of the map."""
    inputs = log.recorded
    if inputs.map is None or len(inputs.map.id) == 0:
        return []
    hit = explained(inputs)
    if len(hit) < FEWEST or hit.mean() >= EXPLAINED:
        return []
    first = None if log.truth.pose is None else log.truth.pose[0]
    if first is not None and as_pose(first) == as_pose(inputs.prior.mean):
        first = None  # as stated
    low, high = inputs.map.xy.min(axis=0).tolist(), inputs.map.xy.max(axis=0).tolist()
    known = first is not None and bool(np.isfinite(first).all())
    mends = False
    if first is not None and known:
        mends = bool(explained(replace(inputs, prior=replace(inputs.prior, mean=first))).mean() >= EXPLAINED)
    return [notice(
        Code.PRIOR, mean=tuple(inputs.prior.mean.tolist()), fitting=int(hit.sum()), readings=len(hit),
        x=(low[0], high[0]), y=(low[1], high[1]), walls=not inputs.sensor.sees_points,
        truth=tuple(first.tolist()) if first is not None and known else None,
        flags=(f"--prior={as_pose(first, metres_of(log))}",) if first is not None and mends else (),
    )]  # fmt: skip


def explained(inputs: Inputs) -> BoolArray:
    """Whether each of the first observations (m,) lies in some landmark's gate, by dead reckoning from the prior."""
    assert inputs.map is not None
    hits: list[bool] = []
    pose, P = np.array(inputs.prior.mean), np.array(inputs.prior.covariance)
    for k in range(len(inputs)):
        if k:
            step = inputs.increment(k)
            compose_in_place(pose, P, np.array(step.mean), np.array(step.covariance), pose, P)
        seen = inputs.frame_observations(k)
        if len(seen.z) == 0:
            continue
        z_hat, Hx, Hl = inputs.sensor.linearize(pose, inputs.map.xy)
        S = (Hx @ P @ Hx.transpose(0, 2, 1))[None] + seen.R[:, None]
        if inputs.map.sigma is not None:
            S = S + (Hl * inputs.map.sigma[:, None, :] ** 2) @ Hl.transpose(0, 2, 1)
        nu = inputs.sensor.residual(seen.z[:, None], z_hat[None])
        hits += (np.einsum("mli,mli->ml", nu, np.linalg.solve(S, nu[..., None])[..., 0]).min(axis=1) < GATE).tolist()
        if len(hits) >= FIRST:
            break
    return np.array(hits[:FIRST], bool)


def truth_start(log: Log) -> list[Notice]:
    """A first true pose that the prior excludes: truth in another frame."""
    pose, inputs = log.truth.pose, log.recorded
    if pose is None or not np.isfinite(pose[0]).all():
        return []
    away = pose[0] - inputs.prior.mean
    sigma = np.sqrt(np.diag(inputs.prior.covariance))
    distance, turned = float(np.hypot(*away[:2])), abs(float(wrap_angle(away[2])))
    if distance <= SLACK + 5.0 * sigma[:2].max() and turned <= SLACK_HEADING + 5.0 * sigma[2]:
        return []
    if any(question.named["flags"] for question in prior(log)):  # the map fits the truth, and not the prior
        return []
    given = np.array(log.source.get(TRUTH_POSE, np.zeros(3)), float)
    carry = compose(compose(inputs.prior.mean, inverse(pose[0])), given)
    flags = (f"--truth-transform={as_pose(carry, metres_of(log))}",)
    return [notice(Code.TRUTH_FRAME, distance=distance, turned=turned, sigma=tuple(sigma.tolist()), flags=flags)]


def map_rows(log: Log) -> list[Notice]:
    """Rows of the map that look swapped or shifted."""
    found = misplaced(log)
    if not found:
        return []
    at = {r.id: r.at for r in found}
    pairs = [(i, j) for i, j in at.items() if i < j and at.get(j) == i]
    swapped = tuple(i for pair in pairs for i in pair)
    return [notice(
        Code.MAP_ROWS, swapped=swapped, shifted=tuple(i for i in at if i not in swapped),
        distance=max(r.distance for r in found), observations=sum(r.observations for r in found),
    )]  # fmt: skip


def assumed_noise(log: Log) -> list[Notice]:
    """A notice where nobody stated the noise."""
    return [notice(Code.ASSUMED_NOISE, of=log.assumed_noise).about(log=log.name)] if log.assumed_noise else []


def truth_windows(log: Log) -> list[Notice]:
    """Windows of bad ground truth, left out already or not."""
    found = log.truth.left_out or bad_truth(log)
    if not found:
        return []
    off = [w.off for w in found if np.isfinite(w.off)]
    start, end = tuple(w.start for w in found), tuple(w.end for w in found)
    poses = sum(w.last - w.first + 1 for w in found), len(log.recorded)
    flags = tuple(f"--exclude-truth {w.start:.15g}:{w.end:.15g}" for w in found)
    return [notice(
        Code.BAD_TRUTH, frame=found[0].first, start=start, end=end, off=max(off) if off else None, poses=poses,
        left_out=bool(log.truth.left_out), mrclam=log.source.get("kind") == "mrclam", flags=flags,
    ).about(log=log.name)]  # fmt: skip


@lru_cache(maxsize=16)  # logs; first lines, judgements and the answers of a lab ask
def conventions(log: Log) -> tuple[Notice, ...]:
    """Conventions of the log that are not those stated."""
    return (*contradictions(log), *(question for of_wing in of_all("questions") for question in of_wing(log)))


Checks = tuple[Callable[[Log], list[Notice]], ...]
CHECKS: Checks = (map_rows, truth_windows, stamps, reach, prior, truth_start, truth_rate, labels)
FOLLOWS = (map_rows, truth_windows, prior, truth_start)  # Their questions follow from parts that contradict each other
OF_ONE_SENSOR = (reach, prior)  # Checks that read the observations of one sensor that locates its landmarks


def ask(log: Log) -> tuple[Notice, ...]:
    """Questions about a log, the one that explains most first; none where it looks as it should."""
    found = stamps(log)
    checks = CHECKS
    if found or any(q.code == Code.HEADING_UNIT for q in log.asked):  # all else follows
        checks = (reach,)
    else:
        found = [*conventions(log)]
        if any(q.code == Code.CONTRADICTION for q in found):
            checks = tuple(c for c in CHECKS if c not in FOLLOWS)
    if log.truth.left_out and truth_windows not in checks:  # what is not scored is always said
        checks = (*checks, truth_windows)
    if log.recorded.several_or_partial:
        checks = tuple(c for c in checks if c not in OF_ONE_SENSOR)
    found += [question for check in checks for question in check(log)]
    return tuple(question.about(log=log.name) for question in [*log.asked, *found])
